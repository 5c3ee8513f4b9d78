"""The time axis of a log: the measurements of each instant, the output times, and the tracks in
view over time.

White acceleration fits no motion at all time scales, and the images
determine the time scale: where fewer tracks than usual are in view,
the process variance is the one that these tracks alone would give.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...errors import EvidenceError, UsageError
from ...types import Array
from .long_arrays import find_finite_rows, measure_median_step
from .records import Evidence, Sighting

GAP_STEPS = 10
"""Usual steps after which there is a gap: an unseen track is out of view, a filter of encoder
readings restarts. A few lost messages leave none.
"""
MAX_OUTPUT_RATE_HZ = 100.0
"""Hz: encoders faster than this are all used, but the output is on a grid of this rate, and noise
is learned from means of so many a second, because a shorter stretch shows no acceleration."""
MAX_EXTRA_INSTANTS = 1_000_000
"""A grid of so many more instants than there are stamps mostly covers silence and is refused."""

View = tuple[str, ...]
"""Names of the tracks in view."""


@dataclass(frozen=True, eq=False)
class Timeline:
    """Instants t (E,) s · instants of encoder rows (N,), of
    sightings' rows (F,), of outputs (O,) · source_ns (O,).
    """

    t: Array
    encoders: Array
    sightings: tuple[Array, ...]
    outputs: Array
    source_ns: Array


def select_visual_sightings(sightings: Sequence[Sighting]) -> list[Sighting]:
    """Sightings of tracks seen at least once, without touch."""
    return [s for s in sightings if s.name != "touch" and find_finite_rows(s.values).any()]


def list_track_sets(sightings: Sequence[Sighting], t: Array) -> tuple[list[View], Array]:
    """The distinct sets of tracks in view at the times t (E,) s, and the index (E,) of the set."""
    tracks = select_visual_sightings(sightings)
    code = np.zeros(len(t), int)
    for bit, track in enumerate(tracks):
        code |= _is_in_view(track, t).astype(int) << bit
    found, which = np.unique(code, return_inverse=True)
    return [tuple(s.name for bit, s in enumerate(tracks) if one >> bit & 1) for one in found], which


def _is_in_view(track: Sighting, t: Array) -> Array:
    """Whether a track is in view at times t (E,), with sightings shortly before and after."""
    seen = track.t[find_finite_rows(track.values)]
    around = np.concatenate([[min(t[0], seen[0])], seen, [max(t[-1], seen[-1])]])
    if len(track.t) < 2:
        return np.zeros(len(t), bool)
    quick = np.diff(around) <= GAP_STEPS * measure_median_step(track.t)
    return np.asarray(quick[np.searchsorted(seen, t)])


def build_timeline(evidence: Evidence, rate: float | None) -> Timeline:
    """Union of all stamps and output times; equal times
    are one instant, so simultaneous senses have no order.
    """
    clock = np.empty(0) if evidence.encoders is None else evidence.encoders.t
    wanted = choose_output_times(evidence, rate)
    regular = np.array_equal(wanted, clock)
    clocks = [clock, *(s.t for s in evidence.sightings), wanted[:0] if regular else wanted]
    t = np.unique(np.concatenate(clocks))
    encoders = np.searchsorted(t, clock)
    sightings = tuple(np.searchsorted(t, s.t) for s in evidence.sightings)
    outputs = encoders if regular else np.searchsorted(t, wanted)
    source_ns = _find_latest_source(evidence, t, encoders, sightings)[outputs]
    return Timeline(t, encoders, sightings, outputs, source_ns)


def choose_output_times(evidence: Evidence, rate: float | None) -> Array:
    """Times (O,) s: encoder stamps (frames without encoders)
    up to 100 Hz, else a 100 Hz grid; `rate` overrides.
    """
    if rate is not None and not rate > 0:
        raise UsageError(f"rate: {rate} found, a frequency above 0 Hz is possible; type --rate 100")
    clocks = (
        [s.t for s in evidence.sightings] if evidence.encoders is None else [evidence.encoders.t]
    )
    t = np.unique(np.concatenate(clocks))
    if len(t) == 0:
        raise EvidenceError("joints: no sound time stamp to estimate at")
    if rate is None and (len(t) < 2 or measure_median_step(t) > 0.99 / MAX_OUTPUT_RATE_HZ):
        return t
    rate = rate or MAX_OUTPUT_RATE_HZ
    _check_grid(rate, t)
    return snap_to_stamps(t[0] + np.arange(int((t[-1] - t[0]) * rate + 1e-6) + 1) / rate, t)


def _check_grid(rate: float, t: Array) -> None:
    """UsageError for a grid of `rate` (Hz) with far more instants than the stamps t (N,) s."""
    count = (t[-1] - t[0]) * rate
    if count > MAX_EXTRA_INSTANTS + len(t):
        at = int(np.diff(t).argmax()) if len(t) > 1 else 0
        raise UsageError(
            f"rate: {rate:g} Hz found, {count:.3g} instants for {len(t)} stamps, none of "
            f"these between {t[at]:.3f} and "
            f"{t[min(at + 1, len(t) - 1)]:.3f} s; type --rate "
            f"{max(MAX_EXTRA_INSTANTS / (t[-1] - t[0]), 1e-9):.1g} or less"
        )


def list_span_starts(t: Array, width: float) -> Array:
    """Starts (B,) s of the spans of `width` s, counted
    from t[0], that contain any of ascending t (N,) s.
    """
    number = np.floor((t - t[:1]) / width)
    return np.asarray(t[:1] + width * number[np.append(True, number[1:] != number[:-1])[: len(t)]])


def snap_to_stamps(grid: Array, t: Array) -> Array:
    """Grid times (O,) s moved onto a stamp of t that is the same up to rounding, 1e-6 s."""
    right = np.minimum(np.searchsorted(t, grid), len(t) - 1)
    near = np.where(
        np.abs(t[right] - grid) <= np.abs(t[np.maximum(right - 1, 0)] - grid), right, right - 1
    )
    return np.where(np.abs(t[near] - grid) < 1e-6, t[near], grid)


def _find_latest_source(
    evidence: Evidence, t: Array, encoders: Array, sightings: tuple[Array, ...]
) -> Array:
    """Log time (E,) of the last message up to each instant."""
    latest = np.full(len(t), np.iinfo(np.int64).min)
    if evidence.encoders is not None:
        latest[encoders] = evidence.encoders.source_ns
    for sighting, events in zip(evidence.sightings, sightings, strict=True):
        latest[events] = np.maximum(latest[events], sighting.source_ns)
    return np.maximum.accumulate(latest)  # the first instant is a message's
