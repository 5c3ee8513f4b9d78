"""Seeing against its limits: two colours in 640×480 pictures on two threads, beside decoding alone and plain OpenCV.

Run as `python -m tests.benchmarks.bench_perception`.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import cv2
import numpy as np

from bodylog.perception.colours import hsv_ranges
from bodylog.types import Array, LazyImage
from tests.benchmarks.timing import side_by_side
from tests.perception import scenes
from tests.perception.scenes import track_colours

COUNT = 600
COLOURS = {"effector": "green", "hand": "red"}


def main() -> None:
    """Print times, ratios and errors."""
    pictures, truth = _pictures()
    payloads = [scenes.jpeg(picture) for picture in pictures]
    wanted = [hsv_ranges.resolve_colour(name, key) for key, name in COLOURS.items()]
    side_by_side(
        f"{COUNT} JPEG pictures, ×1 is cv2.imdecode alone",
        {
            "cv2.imdecode alone": lambda: _run(payloads, _decode),
            "track": lambda: _track(payloads, _decode),
            "track at half scale": lambda: _track(payloads, _decode, fast=True),
            "imdecode and the plain pipeline": lambda: _run(payloads, lambda p: _plain(_decode(p), wanted)),
        },
    )
    side_by_side(
        f"{COUNT} raw pictures, ×1 is cv2.cvtColor to HSV alone",
        {
            "cv2.cvtColor to HSV alone": lambda: _run(pictures, lambda p: cv2.cvtColor(p, cv2.COLOR_BGR2HSV)),
            "track": lambda: _track(pictures, _whole),
            "plain pipeline: HSV, inRange, connected components": lambda: _run(pictures, lambda p: _plain(p, wanted)),
        },
    )
    found = {
        "JPEG track": _track(payloads, _decode),
        "JPEG track at half scale": _track(payloads, _decode, fast=True),
        "JPEG plain": np.array([_plain(_decode(payload), wanted) for payload in payloads]),
        "raw  track": _track(pictures, _whole),
        "raw  plain": np.array([_plain(picture, wanted) for picture in pictures]),
    }
    print("\nerror of the centre, px: median, 99th percentile")
    for name, centres in found.items():
        error = np.hypot(*np.moveaxis(centres - truth, -1, 0))
        print(f"  {name:<26}{np.median(error):8.3f}{np.quantile(error, 0.99):8.3f}")


def _pictures() -> tuple[list[Array], Array]:
    """Pictures and the true centres (COUNT, 2, 2) px: a green disc and a larger red one wander about."""
    rng = np.random.default_rng(0)
    wall = scenes.wall(rng, 640, 480)
    phase = np.arange(COUNT)[:, None] / 40.0
    effector = np.array([220.0, 240.0]) + 120.0 * np.column_stack([np.sin(phase), np.cos(1.3 * phase)])
    hand = np.array([480.0, 240.0]) + 90.0 * np.column_stack([np.cos(0.7 * phase), np.sin(1.1 * phase)])
    pictures = [
        scenes.draw(wall, [scenes.Disc(*e, 12.0), scenes.Disc(*h, 18.0, scenes.RED)], rng)
        for e, h in zip(effector.tolist(), hand.tolist(), strict=True)
    ]
    return pictures, np.stack([effector, hand], axis=1)


def _decode(payload: Array, k: int = 1) -> Array:
    return np.asarray(cv2.imdecode(payload, scenes.REDUCED[k]))


def _whole(picture: Array, _: int) -> Array:
    return picture


def _frames(items: Sequence[Array], decode: Callable[[Array, int], Array]) -> Iterator[LazyImage]:
    return (LazyImage(index / 30.0, index, partial(decode, item), shrinks=True) for index, item in enumerate(items))


def _track(items: Sequence[Array], decode: Callable[[Array, int], Array], fast: bool = False) -> Array:
    """Where each colour was seen: (COUNT, 2, 2) px."""
    tracks, _, _ = track_colours(lambda: _frames(items, decode), COLOURS, fast=fast)
    return np.stack([track.values for track in tracks.values()], axis=1)


def _run(items: Sequence[Array], task: Callable[[Array], object]) -> None:
    """The task on every item, on as many threads as the tracker has."""
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(2) as pool:
        for _ in pool.map(task, items):
            pass


def _plain(picture: Array, wanted: Sequence[hsv_ranges.HsvRange]) -> list[Array]:
    """The centroid of each colour's largest component, the textbook way."""
    hsv = cv2.cvtColor(picture, cv2.COLOR_BGR2HSV)
    found = []
    for one in wanted:
        _, _, stats, centroids = cv2.connectedComponentsWithStats(hsv_ranges.mask_of_range(hsv, one))
        found.append(centroids[1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))])
    return found


if __name__ == "__main__":
    main()
