"""Threads that look at pictures: what they find does not depend on them, and none is left behind."""

from collections.abc import Iterator
from threading import active_count

import numpy as np
import pytest

from bodylog.errors import LogError
from bodylog.perception.colours import hsv_ranges
from bodylog.perception.tracking.frame_search import FrameSearcher, SearchedFrames
from bodylog.types import Array, ConsumedFrames, LazyImage
from tests.perception import scenes
from tests.perception.scenes import Disc

GREEN = [hsv_ranges.resolve_colour("green", "it")]


def look(frames: Iterator[LazyImage], threads: int, number: Array | None = None) -> SearchedFrames:
    with FrameSearcher(GREEN, None, False, threads) as given:
        count = 0
        for frame in frames:
            given(frame)
            count += 1
    chosen = np.arange(count) if number is None else number
    return given.seen(ConsumedFrames(chosen / 30.0, chosen, chosen, given))


def _film(count: int, seed: int) -> list[LazyImage]:
    rng = np.random.default_rng(seed)
    wall = scenes.wall(rng, 160, 120)
    places = rng.uniform((20, 20), (140, 100), (count, 2))
    pictures = (scenes.jpeg(scenes.draw(wall, [Disc(u, v, 6.0)], rng)) for u, v in places)
    return [scenes.frame(index / 30.0, picture) for index, picture in enumerate(pictures)]


@pytest.mark.parametrize("seed", range(3))
def test_look_does_not_depend_on_thread_count(seed: int) -> None:
    film = _film(75, seed)
    alone, *others = (look(iter(film), threads) for threads in (1, 2, 2, 3))
    assert np.isfinite(alone.blobs[:, 0, 0, 0]).all()
    for seen in others:
        assert seen.blobs.tobytes() == alone.blobs.tobytes() and seen.width == alone.width == 160


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_frame_searcher_raises_errors_and_ends_all_threads(threads: int) -> None:
    film = _film(40, 0)
    taken = []

    def source() -> Iterator[LazyImage]:
        for index, frame in enumerate(film):
            if index == 20:
                raise LogError("log.mcap: is damaged")
            taken.append(index)
            yield frame

    before = active_count()
    with pytest.raises(LogError, match="is damaged"):
        look(source(), threads)
    assert taken == list(range(20)) and active_count() == before


@pytest.mark.parametrize("threads", [1, 2])
def test_look_stops_all_threads_after_a_failure(threads: int) -> None:
    film = _film(40, 0)
    asked = []

    def failing(_: int) -> Array:
        raise ZeroDivisionError

    def source() -> Iterator[LazyImage]:
        yield LazyImage(0.0, 0, failing)
        for _ in range(1000):
            for frame in film:
                asked.append(frame)
                yield frame

    with pytest.raises(ZeroDivisionError):
        look(source(), threads)
    assert len(asked) < 1000


def test_frame_searcher_keeps_the_consumed_images_that_are_frames_in_order() -> None:
    film = _film(40, 1)
    whole, number = look(iter(film), 2), np.array([33, 2, 7, 39])
    some = look(iter(film), 2, number)
    assert some.blobs.tobytes() == whole.blobs[number].tobytes()
    assert some.source_ns.tolist() == number.tolist()


@pytest.mark.parametrize("threads", [1, 2])
def test_copied_messages_of_many_megapixels_do_not_wait_together(threads: int) -> None:
    film = _film(24, 0)
    held: set[int] = set()
    most = []

    def heavy(number: int, frame: LazyImage) -> LazyImage:
        def decode(scale: int) -> Array:
            held.discard(number)
            return frame.decode(scale)

        return LazyImage(frame.t, frame.source_ns, decode, frame.shrinks, 50 << 20)

    def source() -> Iterator[LazyImage]:
        for number, frame in enumerate(film):
            held.add(number)
            most.append(len(held))
            yield heavy(number, frame)

    heavily = look(source(), threads)
    assert max(most) <= 2 * (1 + threads)
    assert heavily.blobs.tobytes() == look(iter(film), 1).blobs.tobytes()
