"""Images to blobs on several threads: each takes a
few images in order, searches them and frees them.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from threading import Condition
from typing import NamedTuple, Self

import numpy as np

from ...errors import InputError
from ...logs.protocol import Progress
from ...runtime.blas_threads import lower_priority, one_opencv
from ...types import Array, ConsumedFrames, LazyImage
from ..colours import blob_measurement as blobs
from ..colours import coarse_search
from ..colours.coarse_search import Window, convert_to_gray
from ..colours.hsv_ranges import HsvRange
from .contract import Tracked, Tracker

# images a thread takes at once; takes that wait; takes measured together: with more, the working
# memory outgrows what a process keeps, and its pages are faulted in again
_TAKEN = 4
_AHEAD = 4
_SHEET = 8
_AT_ONCE = 1 << 23
"""Bytes of images searched together."""
_MOST_HELD = 1 << 26
"""Bytes of copied messages in one take, and in all that wait: raw images of many megapixels."""
_MOST_WAITING = 8
"""Lists of frames that may wait before a thread that
brings another is blocked: this bounds the memory.
"""


class InOrder:
    """Takes numbered lists of gray frames from any thread;
    the thread with the next one in order runs the trackers.
    """

    def __init__(self, trackers: Sequence[Tracker]) -> None:
        """Nothing happens before the first list."""
        self._trackers = trackers
        self._changed = Condition()
        self._waiting = dict[int, Sequence[Array | None]]()
        self._next = 0
        self._busy = False

    def put(self, number: int, frames: Sequence[Array | None]) -> None:
        """Add the list of that number, counted from 0; returns once only a few lists wait."""
        with self._changed:
            self._waiting[number] = frames
            self._changed.wait_for(lambda: not self._busy or len(self._waiting) <= _MOST_WAITING)
            if self._busy:
                return
            self._busy = True
        try:
            while (due := self._due()) is not None:
                self._add(due)
        except BaseException:
            self._idle()
            raise

    def _due(self) -> Sequence[Array | None] | None:
        """The next list in order; None, and no thread is busy any more, if it is not there yet."""
        with self._changed:
            due = self._waiting.pop(self._next, None)
            self._next += due is not None
            self._busy = due is not None
            self._changed.notify_all()
            return due

    def _idle(self) -> None:
        with self._changed:
            self._busy = False
            self._changed.notify_all()

    def _add(self, frames: Sequence[Array | None]) -> None:
        for tracker in self._trackers:
            for gray in frames:
                tracker.add(gray)


class SearchedFrames(NamedTuple):
    """t (N,) · source_ns (N,) · blobs (N,colours,CANDIDATES,FIELDS)
    px · undecodable (N,) bool · greatest width, px.

    size: width and height (px) of the log's first image; None where it cannot be read. tracked:
    what each tracker found in all images consumed; number (N,): the frames' places among those.
    """

    t: Array
    source_ns: Array
    blobs: Array
    broken: Array
    width: float
    size: tuple[int, int] | None
    tracked: tuple[Tracked, ...] = ()
    number: Array = np.empty(0, np.int64)


Take = tuple[int, list[LazyImage]]
"""Images in order, and the number of lists before this one."""


SearchResult = tuple[list[Window], list[tuple[int, int, int]]]
"""The windows found in some images, and each image's width
and height in px as searched (0: undecodable) and scale.
"""


class FrameSearcher:
    """Consumes images one by one, within a `with`:
    this thread and `threads` - 1 others search them.

    Only a few images wait, and the result is the same whichever thread takes which:
    what is measured together depends on their order alone. A caller that brings one too
    many searches some itself. `progress` may be called by any thread. `trackers` get
    every image, whole, in the order of the file.
    """

    def __init__(
        self,
        ranges: Sequence[HsvRange],
        progress: Progress | None,
        fast: bool,
        threads: int,
        trackers: Sequence[Tracker] = (),
    ) -> None:
        """No library is loaded and no thread starts before the first image."""
        self._ranges = ranges
        self._progress = progress
        self._threads = threads
        self._fast = fast and not trackers
        self._trackers = trackers
        self._in_order = InOrder(trackers)
        self._begun = ExitStack()
        self._others = list[Future[None]]()
        self._ready = Condition()
        self._told = list[LazyImage]()
        self._over = False
        self._waiting = deque[Take]()
        self._takes = 0
        self._sheets: dict[int, dict[int, SearchResult]] = {}
        self._measured: dict[int, tuple[Array, Array]] = {}

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __call__(self, frame: LazyImage) -> None:
        """Add an image; its time does not matter. Errors of other threads are raised here."""
        self._told.append(frame)
        if len(self._told) == _TAKEN or _count_held_bytes(self._told) > _MOST_HELD:
            self._hand_out()

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Search the images that are left, unless there was an error."""
        with self._begun:
            if kind is None and self._told:
                self._hand_out()
            with self._ready:
                self._over = True
                if kind is not None:
                    self._waiting.clear()
                self._ready.notify_all()
            self._work()
        for other in self._others if kind is None else ():
            other.result()

    def seen(self, consumed: ConsumedFrames) -> SearchedFrames:
        """The search results of the consumed images that are frames."""
        for sheet, results in self._sheets.items():
            self._measured[sheet] = _measure_results(results, self._ranges)
        parts = [
            _measure_results({}, self._ranges),
            *(part for _, part in sorted(self._measured.items())),
        ]
        found, sizes = (np.concatenate(each) for each in zip(*parts, strict=True))
        first = next(((width, height) for width, height, _ in sizes[:1].tolist() if width), None)
        wide, _, scale = sizes[consumed.number].T
        whole = blobs.enlarge_blobs(found[consumed.number], scale)
        width = float((wide * scale).max(initial=0))
        tracked = tuple(tracker.tracked() for tracker in self._trackers)
        return SearchedFrames(
            consumed.t, consumed.source_ns, whole, wide == 0, width, first, tracked, consumed.number
        )

    def _begin(self) -> None:
        self._begun.enter_context(one_opencv())
        pool = self._begun.enter_context(
            ThreadPoolExecutor(self._threads, initializer=lower_priority)
        )
        self._others += [pool.submit(self._work) for _ in range(self._threads - 1)]

    def _hand_out(self) -> None:
        if not self._takes:
            self._begin()
        with self._ready:
            self._waiting.append((self._takes, self._told))
            self._takes = self._takes + 1
            self._told = []
            mine = self._waiting.popleft() if self._too_many_wait() else None
            self._ready.notify()
        for other in self._others:
            if other.done():
                other.result()
        if mine:
            self._search(*mine)

    def _too_many_wait(self) -> bool:
        waiting = sum(_count_held_bytes(frames) for _, frames in self._waiting)
        return len(self._waiting) > _AHEAD or waiting > _MOST_HELD

    def _work(self) -> None:
        """Search images until there are no more."""
        while True:
            with self._ready:
                self._ready.wait_for(lambda: self._waiting or self._over)
                if not self._waiting:
                    return
                number, frames = self._waiting.popleft()
            self._search(number, frames)

    def _search(self, number: int, frames: Sequence[LazyImage]) -> None:
        """Search images; the thread that completes a sheet measures it."""
        grays: list[Array | None] | None = [] if self._trackers else None
        found = _search_images(frames, self._ranges, self._fast, 0 if number else 1, grays)
        if grays is not None:
            self._in_order.put(number, grays)
        sheet = number // _SHEET
        with self._ready:
            self._sheets.setdefault(sheet, {})[number] = found
            whole = self._sheets.pop(sheet) if len(self._sheets[sheet]) == _SHEET else None
            if self._progress:
                self._progress(len(frames))
        if whole:
            self._measured[sheet] = _measure_results(whole, self._ranges)


def _count_held_bytes(frames: Sequence[LazyImage]) -> int:
    return sum(frame.held_bytes for frame in frames)


def _search_images(
    frames: Sequence[LazyImage],
    ranges: Sequence[HsvRange],
    fast: bool,
    whole: int,
    grays: list[Array | None] | None,
) -> SearchResult:
    """Search some images, the first few at full size even if `fast`; `grays` gets them in gray."""
    found: list[Window] = []
    images: dict[int, Array] = {}
    sizes: list[tuple[int, int, int]] = []
    for picture, frame in enumerate(frames):
        scale = 2 if fast and frame.shrinks and picture >= whole else 1
        image = _decode_or_none(frame, scale)
        sizes.append((0, 0, scale) if image is None else (image.shape[1], image.shape[0], scale))
        if grays is not None:
            grays.append(None if image is None else convert_to_gray(image))
        if image is not None:
            images[picture] = image
        if sum(image.size for image in images.values()) > _AT_ONCE:
            found += coarse_search.find_windows(images, ranges)
            images.clear()
    return [*found, *coarse_search.find_windows(images, ranges)], sizes


def _decode_or_none(frame: LazyImage, scale: int) -> Array | None:
    with suppress(InputError):
        return frame.decode(scale)
    return None


def _measure_results(
    results: Mapping[int, SearchResult], ranges: Sequence[HsvRange]
) -> tuple[Array, Array]:
    """Blobs (n,colours,CANDIDATES,FIELDS) and sizes (n,3) of search results by number."""
    found: list[Window] = []
    sizes: list[tuple[int, int, int]] = []
    for _, (windows, measured) in sorted(results.items()):
        found += [window._replace(picture=window.picture + len(sizes)) for window in windows]
        sizes += measured
    return blobs.blob_tables(found, len(sizes), ranges), np.array(sizes, dtype=np.int64).reshape(
        -1, 3
    )
