"""Pictures to blobs on several threads: each takes a few pictures in their order, looks at them and lets them go."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from itertools import islice
from threading import Lock
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..threads import one_opencv
from ..types import Array, Frame
from . import blobs, search
from .ranges import Range
from .search import Window

# pictures a thread takes at once; takes whose finds are measured together: with more, what is worked on outgrows the
# memory a process keeps, and is faulted in anew
_TAKEN, _SHEET = 8, 4


class Seen(NamedTuple):
    """t (N,) · source_ns (N,) · blobs (N,colours,CANDIDATES,FIELDS) px · undecodable (N,) bool · greatest width, px."""

    t: Array
    source_ns: Array
    blobs: Array
    broken: Array
    width: float


Look = tuple[list[Window], list[tuple[int, int]]]
"""What some pictures show; of each its width in px as looked at (0: undecodable) and how often it is shrunk."""


def look(
    frames: Iterator[Frame],
    ranges: Sequence[Range],
    progress: Callable[[int], None] | None = None,
    fast: bool = False,
    threads: int = 1,
) -> Seen:
    """What all pictures show of each colour; `progress` is told how many more are done, by whichever thread did them.

    The same bytes whichever thread takes which pictures: what is measured together depends on their order alone.
    """
    work = _Work(frames, ranges, progress, fast)
    with one_opencv(), ThreadPoolExecutor(threads) as pool:
        others = [pool.submit(work.run) for _ in range(threads - 1)]
        work.run()
        for other in others:
            other.result()
    return work.seen()


class _Work:
    """Pictures to be taken, and what was found in those that were."""

    def __init__(
        self, frames: Iterator[Frame], ranges: Sequence[Range], progress: Callable[[int], None] | None, fast: bool
    ) -> None:
        self._frames, self._ranges, self._progress, self._fast = frames, ranges, progress, fast
        self._lock, self._takes = Lock(), 0
        self._dates: list[tuple[float, int]] = []
        self._sheets: dict[int, dict[int, Look]] = {}
        self._measured: dict[int, tuple[Array, Array]] = {}

    def run(self) -> None:
        """Take pictures as long as there are any and no thread has failed."""
        try:
            while taken := self._take():
                number, frames = taken
                self._put(number, _look(frames, self._ranges, self._fast))
        finally:
            with self._lock:
                self._frames = iter(())

    def seen(self) -> Seen:
        """All that was found, once every thread is through; the last sheet is rarely full."""
        for sheet, looks in self._sheets.items():
            self._measured[sheet] = _measured(looks, self._ranges)
        parts = [_measured({}, self._ranges), *(part for _, part in sorted(self._measured.items()))]
        found, sizes = (np.concatenate(each) for each in zip(*parts, strict=True))
        wide, scale = sizes.T
        t, source_ns = np.array([t for t, _ in self._dates]), np.array([ns for _, ns in self._dates], dtype=np.int64)
        return Seen(t, source_ns, blobs.enlarged(found, scale), wide == 0, float((wide * scale).max(initial=0)))

    def _take(self) -> tuple[int, list[Frame]] | None:
        with self._lock:
            frames = list(islice(self._frames, _TAKEN))
            self._dates += [(frame.t, frame.source_ns) for frame in frames]
            self._takes += 1
            return (self._takes - 1, frames) if frames else None

    def _put(self, number: int, found: Look) -> None:
        """Keep what was found; who brings the last look of a sheet measures it."""
        sheet = number // _SHEET
        with self._lock:
            self._sheets.setdefault(sheet, {})[number] = found
            whole = self._sheets.pop(sheet) if len(self._sheets[sheet]) == _SHEET else None
            if self._progress:
                self._progress(len(found[1]))
        if whole:
            self._measured[sheet] = _measured(whole, self._ranges)


def _look(frames: Sequence[Frame], ranges: Sequence[Range], fast: bool) -> Look:
    found: list[Window] = []
    sizes: list[tuple[int, int]] = []
    for picture, frame in enumerate(frames):
        scale = 2 if fast and frame.shrinks else 1
        image = _decoded(frame, scale)
        sizes.append((0 if image is None else image.shape[1], scale))
        if image is not None:
            found += search.windows(picture, image, ranges)
    return found, sizes


def _decoded(frame: Frame, scale: int) -> Array | None:
    with suppress(InputError):
        return frame.decode(scale)
    return None


def _measured(looks: Mapping[int, Look], ranges: Sequence[Range]) -> tuple[Array, Array]:
    """Blobs (n,colours,CANDIDATES,FIELDS) and sizes (n,2) of looks by their number."""
    found: list[Window] = []
    sizes: list[tuple[int, int]] = []
    for _, (windows, measured) in sorted(looks.items()):
        found += [window._replace(picture=window.picture + len(sizes)) for window in windows]
        sizes += measured
    return blobs.tables(found, len(sizes), ranges), np.array(sizes, dtype=np.int64).reshape(-1, 2)
