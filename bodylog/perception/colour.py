"""Pictures to colour tracks: decoding and looking on a pool of threads, in order, a bounded number ahead."""

from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice

import numpy as np

from ..errors import InputError
from ..settings import Colour
from ..types import Array, Finding, Frame, Health, Series
from . import blobs, choose
from .ranges import Range, covered, nearest, resolve

_THREADS = 2
_BATCH, _AHEAD = 4, 4
_NOTABLE = 1e-4

Seen = tuple[Array | None, int]
"""What one picture shows (None: undecodable), and its width in px."""

Tracks = tuple[dict[str, Series], dict[str, Health], tuple[Finding, ...]]


def track(
    frames: Callable[[], Iterator[Frame]],
    colours: Mapping[str, Colour],
    progress: Callable[[int], None] | None = None,
) -> Tracks:
    """One Series (u, v in px with std; NaN where not seen) per named colour, its Health, and findings.

    `progress` is told how many more pictures are done. Raises ConfigError for a colour that means nothing.
    OpenCV's own threads are left as they are: the pictures' threads are the pool's.
    """
    ranges = [resolve(colour, name) for name, colour in colours.items()]
    t, source_ns, found, broken, size = _look_at_all(frames(), ranges, progress)
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


def in_order(frames: Iterable[Frame], task: Callable[[Frame], Seen]) -> Iterator[tuple[Frame, Seen]]:
    """Each frame with task(frame), in order, on a pool of threads a few frames ahead of the reader and no more."""
    waiting: deque[tuple[list[Frame], Future[list[Seen]]]] = deque()
    source = iter(frames)
    with ThreadPoolExecutor(_THREADS) as pool:
        try:
            while batch := list(islice(source, _BATCH)):
                waiting.append((batch, pool.submit(lambda some: [task(frame) for frame in some], batch)))
                if len(waiting) > _AHEAD:
                    yield from _first(waiting)
            while waiting:
                yield from _first(waiting)
        finally:
            for _, future in waiting:
                future.cancel()


def _first(waiting: "deque[tuple[list[Frame], Future[list[Seen]]]]") -> Iterator[tuple[Frame, Seen]]:
    batch, future = waiting.popleft()
    return zip(batch, future.result(), strict=True)


def _look_at_all(
    frames: Iterator[Frame], ranges: Sequence[Range], progress: Callable[[int], None] | None
) -> tuple[Array, Array, Array, Array, float]:
    """t (N,) · source_ns (N,) · blobs (N,colours,…) · undecodable (N,) bool · width of the widest picture in px."""
    none = np.full((len(ranges), blobs.CANDIDATES, blobs.FIELDS), np.nan)
    t, source_ns, found, broken, width = [], [], [], [], 0

    def task(frame: Frame) -> Seen:
        try:
            image = frame.decode(1)
        except InputError:
            return None, 0
        return blobs.look(image, ranges), image.shape[1]

    for frame, (seen, wide) in in_order(frames, task):
        t.append(frame.t)
        source_ns.append(frame.source_ns)
        found.append(none if seen is None else seen)
        broken.append(seen is None)
        width = max(width, wide)
        if progress:
            progress(1)
    stacked = np.stack(found) if found else none[None][:0]
    return np.array(t), np.array(source_ns, dtype=np.int64), stacked, np.array(broken, dtype=bool), float(width)


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
    hint = f"; type: [colours] {name} = \"{free}\"" if free else ""
    severity = "info" if name == "hand" else "warning"
    return Finding(severity, f"{name}: {wanted} was never found in {count} pictures; seen: {others or 'none'}{hint}")
