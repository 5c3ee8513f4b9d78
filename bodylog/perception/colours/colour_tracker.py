"""Images to colour tracks: each colour's places, counts
of all images, and which other colours were seen.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextvars import ContextVar
from itertools import islice

import numpy as np

from ...errors import InputError
from ...logs.protocol import Progress
from ...settings import Colour
from ...types import Array, ConsumedFrames, Finding, Frames, Health, LazyImage, Series
from ..tracking import target_selection
from ..tracking.contract import Tracker
from ..tracking.frame_search import FrameSearcher, SearchedFrames
from . import clutter, overlap
from .coarse_search import CANDIDATES
from .hsv_ranges import HsvRange, covered_hue_names, hue_histogram, nearest_hue_name, resolve_colour

THREADS: ContextVar[int] = ContextVar("threads", default=2)
"""Threads that search images: one where several logs are processed in parallel."""
_NOTABLE = 1e-4
_SEVERAL = 0.02
"""Share of the images with several things of a
colour above which the joints decide between them.
"""

Tracks = tuple[dict[str, Series], dict[str, Health], tuple[Finding, ...]]


def colour_searcher(
    colours: Mapping[str, Colour],
    progress: Progress | None,
    fast: bool,
    trackers: Sequence[Tracker] = (),
) -> FrameSearcher:
    """A consumer of images; `progress` gets the number of
    further ones done, `fast` searches them at half scale.

    `trackers` get the same images. Raises ConfigError for an unknown colour.
    """
    ranges = [resolve_colour(colour, name) for name, colour in colours.items()]
    return FrameSearcher(ranges, progress, fast, THREADS.get(), trackers)


def search_colours(
    frames: Frames,
    colours: Mapping[str, Colour],
    progress: Progress | None = None,
    fast: bool = False,
    trackers: Sequence[Tracker] = (),
) -> SearchedFrames:
    """Search images now, as by `colour_searcher`."""
    t: list[float] = []
    source_ns: list[int] = []
    with colour_searcher(colours, progress, fast, trackers) as searching:
        for frame in frames():
            t.append(frame.t)
            source_ns.append(frame.source_ns)
            searching(frame)
    times = np.array(t), np.array(source_ns, dtype=np.int64)
    return searching.seen(ConsumedFrames(*times, np.arange(len(t)), searching))


def colour_tracks(
    seen: SearchedFrames,
    frames: Frames,
    colours: Mapping[str, Colour],
    joints: Series | None = None,
) -> Tracks:
    """One Series (u, v in px with std; NaN where not
    seen) per named colour, its Health, and findings.

    Among several things of one colour, the one that moves with the
    `joints` is the target, except the hand's. Some frames are searched
    again where a colour was never seen, or where two things of it overlap.
    """
    t, source_ns, found, broken, width = seen[:5]
    tracks = {}
    health = {}
    findings = []
    for index, name in enumerate(colours):
        moves = None if name == "hand" else joints
        track, reasons = _choose_target(
            t, found[:, index], width, frames, resolve_colour(colours[name], name), moves
        )
        tracks[name] = Series(t, track[:, :2], ("u", "v"), "px", source_ns, track[:, 2:])
        health[name] = _health_of_colour(t, track, reasons, broken)
    unseen = [name for name in colours if health[name].used == 0]
    if not t.size:
        findings.append(Finding("warning", "camera: no picture in this log; no tracks, no strokes"))
    elif unseen and not broken.all():
        instead = _saturated_shares(frames(), t.size)
        taken = {
            other
            for name, colour in colours.items()
            for other in covered_hue_names(resolve_colour(colour, name))
        }
        findings += [
            _unseen_finding(name, colours[name], t.size, instead, taken) for name in unseen
        ]
    if broken.any():
        text = f"{int(broken.sum())} of {t.size} pictures could not be decoded"
        findings.append(
            Finding(
                "lost",
                f"{text}, the first for this: {_decoding_failure(frames(), int(broken.argmax()))}",
            )
        )
    return tracks, health, tuple(findings)


def _choose_target(
    t: Array, found: Array, width: float, frames: Frames, colour: HsvRange, joints: Series | None
) -> tuple[Array, Array]:
    """u, v, std_u, std_v (N,4) px of the target among
    blobs found (N,PLACES,FIELDS), and why not (N,) str.
    """
    several = np.count_nonzero(np.isfinite(found[:, 1:, 0]).any(axis=1))
    choice = (
        clutter.choose_arm_blobs(t, found, joints, width) if several > _SEVERAL * len(t) else None
    )
    if choice is None:
        return target_selection.select_target(t, found[:, :CANDIDATES], width)
    track, why = target_selection.select_target(
        t, overlap.resolve_overlaps(found, choice, frames, colour, width), width
    )
    why[
        (choice.number < 0)
        & np.isfinite(found[:, :, 0]).any(axis=1)
        & (why == target_selection.HIDDEN)
    ] = target_selection.FOREIGN
    return track, why


def _decoding_failure(frames: Iterator[LazyImage], number: int) -> str:
    """Why a frame cannot be decoded."""
    try:
        next(islice(frames, number, None)).decode(1)
    except InputError as problem:
        return str(problem)
    return "unknown"


def _health_of_colour(t: Array, track: Array, reasons: Array, broken: Array) -> Health:
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


def _saturated_shares(frames: Iterator[LazyImage], count: int) -> dict[str, float]:
    """Share (0..1) of each colour name among all pixels
    of a dozen pictures, where saturated, largest first.
    """
    counts = np.zeros(180)
    pixels = 0
    for index, frame in enumerate(frames):
        if index % max(1, count // 12):
            continue
        try:
            some, of = hue_histogram(frame.decode(1))
        except InputError:
            continue
        counts = counts + some
        pixels = pixels + of
    shares: dict[str, float] = {}
    for hue in np.flatnonzero(counts):
        name = nearest_hue_name(float(hue))
        shares[name] = shares.get(name, 0.0) + float(counts[hue]) / pixels
    return dict(sorted(shares.items(), key=lambda item: -item[1]))


def _unseen_finding(
    name: str, colour: Colour, count: int, instead: Mapping[str, float], taken: Collection[str]
) -> Finding:
    """Which colours were seen instead; the first one without a feature is proposed."""
    wanted = f"'{colour}'" if isinstance(colour, str) else str(dict(colour))
    shares = {other: share for other, share in instead.items() if share >= _NOTABLE}
    others = ", ".join(f"{other} ({share:.2%} of the pixels)" for other, share in shares.items())
    free = next((other for other in shares if other not in taken), None)
    hint = f'; type: [colours] {name.rpartition("/")[2]} = "{free}"' if free else ""
    severity = "info" if name == "hand" else "warning"
    return Finding(
        severity,
        f"{name}: {wanted} was never found in {count} pictures; seen: {others or 'none'}{hint}",
    )
