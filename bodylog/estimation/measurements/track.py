"""A point on the arm tracked in images: two rows, u and v in px."""

from collections.abc import Mapping, Sequence

import numpy as np

from ...body_model import BodyModel, ForwardModel
from ...types import Array, Features, Series
from .arm_errors import RowExposure, read_arm_errors, shift_by_rows
from .long_arrays import find_finite_rows, index_true_rows
from .records import Measured, Sighting, build_health


def read_tracks(features: Features, body: BodyModel) -> Mapping[str, Measured]:
    """Read every track that the body predicts, in the log's order; NaN where it was not seen."""
    rows = read_arm_errors(body).rows
    return {
        name: _read_track(name, track, body, rows.get(camera_of_track(name)))
        for name, track in features.tracks.items()
        if name in body.senses
    }


def camera_of_track(track: str) -> str:
    """Name of a track's camera; tracks of the first one, `camera`, have no prefix."""
    return track.rpartition("/")[0] or "camera"


def group_tracks_by_camera(sightings: Sequence[Sighting]) -> Mapping[str, list[int]]:
    """Numbers of each camera's tracks among sightings."""
    groups = dict[str, list[int]]()
    for number, sighting in enumerate(sightings):
        if sighting.is_track:
            groups.setdefault(camera_of_track(sighting.name), []).append(number)
    return groups


def _read_track(name: str, track: Series, body: BodyModel, rows: RowExposure | None) -> Measured:
    times = shift_by_rows(track, rows)
    rising = find_ascending_times(times)
    seen = find_finite_rows(track.values)
    reasons = {"time runs backwards": (~rising).sum(), "out of view": (rising & ~seen).sum()}
    counts = build_health(
        len(track.t), (rising & seen).sum(), reasons, find_longest_gap(times[rising & seen])
    )
    model = body.senses[name]
    noise = np.asarray(body.noise.senses.get(name, (1.0,)), float)
    pixels = choose_pixel_variance(track.std, model, noise)
    var = np.array(np.broadcast_to(pixels, track.values.shape))
    values = np.where(seen[:, None], track.values, np.nan)
    share = _measure_common_share(model, noise)
    every = Sighting(name, model, times, values, var, track.source_ns, share)
    return Measured(every.select_rows(index_true_rows(rising)), counts)


def find_ascending_times(t: Array) -> Array:
    """True where a time is later than all before it."""
    t = np.where(np.isfinite(t), t, -np.inf)
    before = np.concatenate([[-np.inf], np.maximum.accumulate(t)[:-1]])
    return np.asarray(t > before)


def find_longest_gap(t: Array) -> float:
    """Longest time (s) between neighbours of t (N,) s."""
    return float(np.diff(t).max()) if len(t) > 1 else 0.0


def choose_pixel_variance(std: Array | None, model: ForwardModel, fallback: Array) -> Array:
    """Variance px²: stated std (…,D) squared plus the
    model's learned excess, or `fallback` (D,) without a std.
    """
    if std is None:
        return fallback
    beyond = getattr(model, "noise", 0.0)
    return np.where(np.isfinite(std) & (std > 0), np.square(std) + beyond, fallback)


def _measure_common_share(model: ForwardModel, noise: Array) -> float:
    """Share of a model's variance that comes from encoder
    errors in exploration; `noise` (D,) px² is the pixels'.
    """
    spread = float(np.mean(getattr(model, "spread", 0.0)))
    pixels = float(np.mean(noise - getattr(model, "noise", 0.0)))
    return max(1.0 - pixels / spread, 0.0) if spread > 0.0 else 0.0
