"""Pictures to colour tracks: decoding and looking on a pool of threads, in order, a bounded number ahead."""

from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import suppress
from contextvars import ContextVar
from itertools import chain, islice

import numpy as np

from ..errors import InputError
from ..settings import Colour
from ..threads import one_opencv
from ..types import Array, Finding, Frame, Health, Series
from . import blobs, choose, search
from .ranges import Range, covered, nearest, resolve
from .search import CANDIDATES, Window

THREADS: ContextVar[int] = ContextVar("threads", default=2)
"""How many threads look at pictures: one where whole logs are worked on side by side."""
# pictures looked at by one task, tasks ahead of the reader, pictures whose finds are measured together
_BATCH, _AHEAD, _SHEET = 4, 4, 32
_NOTABLE = 1e-4

Seen = tuple[list[Window], list[tuple[int, int]]]
"""What a batch of pictures shows; of each its width in px as looked at (0: undecodable) and how often it is shrunk."""

Looked = tuple[list[Frame], Seen]

Tracks = tuple[dict[str, Series], dict[str, Health], tuple[Finding, ...]]


def track(
    frames: Callable[[], Iterator[Frame]],
    colours: Mapping[str, Colour],
    progress: Callable[[int], None] | None = None,
    fast: bool = False,
) -> Tracks:
    """One Series (u, v in px with std; NaN where not seen) per named colour, its Health, and findings.

    `progress` is told how many more pictures are done; `fast` looks at compressed ones at half scale. Raises
    ConfigError for a colour that means nothing.
    """
    ranges = [resolve(colour, name) for name, colour in colours.items()]
    t, source_ns, found, broken, size = _look_at_all(frames(), ranges, progress, fast)
    tracks, health, findings = {}, {}, []
    for index, name in enumerate(colours):
        track, reasons = choose.best(t, found[:, index], size)
        tracks[name] = Series(t, track[:, :2], ("u", "v"), "px", source_ns, track[:, 2:])
        health[name] = _health(t, track, reasons, broken)
    unseen = [name for name in colours if health[name].used == 0]
    if not t.size:
        findings.append(Finding("warning", "camera: no picture in this log; no tracks, no strokes"))
    elif unseen:
        instead = _saturated(frames(), t.size)
        taken = {other for each in ranges for other in covered(each)}
        findings += [_unseen(name, colours[name], t.size, instead, taken) for name in unseen]
    if broken.any():
        findings.append(Finding("lost", f"{int(broken.sum())} of {t.size} pictures could not be decoded"))
    return tracks, health, tuple(findings)


def _look_at_all(
    frames: Iterator[Frame], ranges: Sequence[Range], progress: Callable[[int], None] | None, fast: bool
) -> tuple[Array, Array, Array, Array, float]:
    """t (N,) · source_ns (N,) · blobs (N,colours,…) · undecodable (N,) bool · width of the widest picture in px."""
    t: list[float] = []
    source_ns: list[int] = []
    sizes: list[tuple[int, int]] = []
    tables: list[list[Future[Array]]] = [[] for _ in ranges]
    with one_opencv(), ThreadPoolExecutor(THREADS.get()) as pool:
        for some in _by_sheets(_in_order(pool, frames, ranges, fast)):
            found: list[Window] = []
            before = len(sizes)
            for batch, (windows, measured) in some:
                found += [window._replace(picture=window.picture + len(sizes) - before) for window in windows]
                t += [frame.t for frame in batch]
                source_ns += [frame.source_ns for frame in batch]
                sizes += measured
                if progress:
                    progress(len(batch))
            for index, colour in enumerate(ranges):
                of_colour = [window for window in found if window.colour == index]
                tables[index].append(pool.submit(blobs.table, of_colour, len(sizes) - before, colour))
        none = np.zeros((0, CANDIDATES, blobs.FIELDS))
        stacked = np.stack([np.concatenate([none, *(each.result() for each in some)]) for some in tables], axis=1)
    wide, scale = np.array(sizes, dtype=np.int64).reshape(-1, 2).T
    widest = float((wide * scale).max(initial=0))
    return np.array(t), np.array(source_ns, dtype=np.int64), blobs.enlarged(stacked, scale), wide == 0, widest


def _in_order(pool: Executor, frames: Iterator[Frame], ranges: Sequence[Range], fast: bool) -> Iterator[Looked]:
    """Batches of frames and what a look at them gave, in order, a bounded number ahead of the reader."""
    waiting: deque[tuple[list[Frame], Future[Seen]]] = deque()
    try:
        while batch := list(islice(frames, _BATCH)):
            waiting.append((batch, pool.submit(_look, batch, ranges, fast)))
            if len(waiting) > _AHEAD:
                yield _first(waiting)
        while waiting:
            yield _first(waiting)
    finally:
        for _, future in waiting:
            future.cancel()


def _first(waiting: deque[tuple[list[Frame], Future[Seen]]]) -> Looked:
    batch, future = waiting.popleft()
    return batch, future.result()


def _by_sheets(looks: Iterator[Looked]) -> Iterator[Iterator[Looked]]:
    """The looks in groups whose windows are measured together."""
    for first in looks:
        yield chain([first], islice(looks, _SHEET // _BATCH - 1))


def _look(batch: Sequence[Frame], ranges: Sequence[Range], fast: bool) -> Seen:
    found: list[Window] = []
    sizes: list[tuple[int, int]] = []
    for picture, frame in enumerate(batch):
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


def _health(t: Array, track: Array, reasons: Array, broken: Array) -> Health:
    """Counts of one track: rejected = frames looked at that gave no point, by reason."""
    used = np.isfinite(track[:, 0])
    reasons = np.where(broken, "undecodable picture", reasons)
    kinds, counts = np.unique(reasons[~used].astype(str), return_counts=True)
    gaps = np.diff(t[used])
    return Health(
        int(t.size),
        int(used.sum()),
        {str(kind): int(count) for kind, count in zip(kinds, counts, strict=True)},
        float(gaps.max()) if gaps.size else 0.0,
    )


def _saturated(frames: Iterator[Frame], count: int) -> dict[str, float]:
    """Share (0..1) of each colour name among all pixels of a dozen pictures, where saturated, largest first."""
    import cv2

    histogram, pixels = np.zeros(180), 0
    for index, frame in enumerate(frames):
        if index % max(1, count // 12):
            continue
        try:
            hsv = cv2.cvtColor(np.ascontiguousarray(frame.decode(1)[::4, ::4]), cv2.COLOR_BGR2HSV)
        except InputError:
            continue
        pixels += hsv[..., 0].size
        histogram += np.bincount(hsv[..., 0][(hsv[..., 1] >= 90) & (hsv[..., 2] >= 50)], minlength=180)
    shares: dict[str, float] = {}
    for hue in np.flatnonzero(histogram):
        name = nearest(float(hue))
        shares[name] = shares.get(name, 0.0) + float(histogram[hue]) / pixels
    return dict(sorted(shares.items(), key=lambda item: -item[1]))


def _unseen(name: str, colour: Colour, count: int, instead: Mapping[str, float], taken: Collection[str]) -> Finding:
    """What was seen instead; of it the first colour that no feature is set to is proposed."""
    wanted = f"'{colour}'" if isinstance(colour, str) else str(dict(colour))
    shares = {other: share for other, share in instead.items() if share >= _NOTABLE}
    others = ", ".join(f"{other} ({share:.2%} of the pixels)" for other, share in shares.items())
    free = next((other for other in shares if other not in taken), None)
    hint = f"; type: [colours] {name.rpartition('/')[2]} = \"{free}\"" if free else ""
    severity = "info" if name == "hand" else "warning"
    return Finding(severity, f"{name}: {wanted} was never found in {count} pictures; seen: {others or 'none'}{hint}")
