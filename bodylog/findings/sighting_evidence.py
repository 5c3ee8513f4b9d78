"""How likely a log's sightings are, given encoders,
body and some unknowns: the evidence of `misfit`.

A sighting y (2,) px is that of a body's track at the encoders' angles x, y = g(x) + e with e ~ N(0,
S), or with probability ODD it is something else, anywhere in the image. S holds the body's own
uncertainty, the noise of encoders and track, and MIN_DELAY_S s of delay. The log's noise is not
learned here: a log that does not fit would be all noise.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..body_model import BodyModel, ForwardModel
from ..estimation.faults.encoder_faults import repair_readings
from ..estimation.faults.threshold import CERTAIN_SIGMA, MIN_DELAY_S, PRIOR_STD_RAD
from ..estimation.inference.tangents import OFFSET_STD
from ..estimation.measurements.gather import gather_measurements
from ..estimation.measurements.long_arrays import MIN_READINGS, find_finite_rows
from ..estimation.measurements.records import Encoders, Sighting
from ..settings import EstimationSettings
from ..types import Array, Features

OFF_SIGMA = 3.0
"""Standard deviations beyond which a sighting is off."""
MOST_TRACKS = 4
MOST_ROWS = 160
"""Tracks and sightings that are compared, evenly spread:
more of them do not change which explanation wins.
"""
OUTLIER_PROBABILITY = 0.05
"""Probability that a sighting is of something else."""
LONGEST_GAP_S = 0.3
"""s: encoder readings farther from a sighting say nothing about it."""
DELAY_STD_S = 0.05
"""s: prior standard deviation of a camera's delay that is not corrected."""
TURN_STD = 0.1
"""Prior standard deviation of the entries of a
small turn's matrix: some degrees, a tenth in scale.
"""
WALK = "walk"
OFFSET = "offset"
MOVED = "moved"
TURNED = "turned"
LATE_KIND = "late"
"""Kinds of unknowns: a joint's offset that wanders, a constant one; an image that moves at some
time, that is affine in what it was, that is late."""
ROUNDING = 2.0**10 * float(np.finfo(float).eps)
"""Share of a covariance's trace that rounding leaves
of its smaller axis: a damaged body may claim less.
"""
_KNOTS = 40
_ONSETS = 8
_TURNS = 8
_WIDENED = 5.0
_WIDEST = 1e3
_OFFSETS = np.linspace(-np.pi, np.pi, 33)


@dataclass(frozen=True, eq=False)
class TrackSightings:
    """Sightings of one track at t (N,) s: y (N,2) px of variance var (N,2), the angles x (N,M) read
    at t, of variance (M,), and the rates of x (N,M) rad/s.
    """

    name: str
    model: ForwardModel
    t: Array
    y: Array
    var: Array
    x: Array
    encoder_var: Array
    rate: Array


@dataclass(frozen=True, eq=False)
class UnknownColumns:
    """Unknowns that a fault adds, and their prior precision: the offset
    of a `joint` is shape (N,K) times K unknowns; without a joint, a delay
    is one unknown, and the displacement of each image coordinate has K.
    """

    kind: str
    joint: int | None
    shape: tuple[Array, ...]
    precision: Array


@dataclass(frozen=True, eq=False)
class FittedUnknowns:
    """−ln p (nats) of the sightings with the likeliest
    values of some unknowns, and the share of them off.
    """

    nats: float
    off: float


@dataclass(frozen=True, eq=False)
class SightingLog:
    """The sightings of a log's tracks, and the area of the image, px²."""

    tracks: tuple[TrackSightings, ...]
    area: float

    @cached_property
    def count(self) -> int:
        """Number of sightings."""
        return sum(len(track.t) for track in self.tracks)

    def changed(self, change: Array) -> "SightingLog":
        """The log with other angles: `change` (M,M) times those read."""
        squares = np.square(change)
        tracks = (
            replace(
                track,
                x=track.x @ change.T,
                encoder_var=squares @ track.encoder_var,
                rate=track.rate @ change.T,
            )
            for track in self.tracks
        )
        return replace(self, tracks=tuple(tracks))

    def seen_by(self, models: Mapping[str, ForwardModel]) -> "SightingLog":
        """The log with other forward models of some tracks."""
        tracks = (
            replace(track, model=models.get(track.name, track.model)) for track in self.tracks
        )
        return replace(self, tracks=tuple(tracks))


def select_sightings(
    features: Features, body: BodyModel, settings: EstimationSettings
) -> SightingLog | None:
    """The sightings to compare; None where a joint is missing, or too little is seen."""
    joints = features.joints
    if joints is None or "encoders" in body.senses or not set(body.joints) <= set(joints.names):
        return None
    found = gather_measurements(
        features, body, replace(settings, without=(*settings.without, "touch"))
    )
    named = [
        one
        for one in found.sightings
        if one.name in features.tracks and one.model.outputs == ("u", "v")
    ]
    if found.encoders is None or not named:
        return None
    encoders = found.encoders
    if not features.poses:
        encoders = repair_readings(encoders, named, body.joints)
    some = _spread_evenly(named, MOST_TRACKS)
    tracks = [
        track
        for one in some
        if len((track := _select_track_sightings(one, encoders, MOST_ROWS // len(some))).t)
    ]
    if sum(len(track.t) for track in tracks) < MIN_READINGS:
        return None
    places = np.concatenate([track.y for track in tracks])
    size = features.picture_size or tuple(np.maximum(np.ptp(places, axis=0), 1.0))
    return SightingLog(tuple(tracks), float(size[0] * size[1]))


def _spread_evenly(items: Sequence[Sighting], most: int) -> list[Sighting]:
    """At most `most` of the items, evenly spread."""
    places = np.unique(np.linspace(0, len(items) - 1, min(most, len(items))).astype(int))
    return [items[place] for place in places]


def _select_track_sightings(sighting: Sighting, encoders: Encoders, most: int) -> TrackSightings:
    """At most `most` sightings of a track, where all joints are read close by."""
    shown = np.flatnonzero(find_finite_rows(sighting.values))
    for column in encoders.values.T:
        known = np.append(encoders.t[np.isfinite(column)], np.inf)
        after = np.searchsorted(known, sighting.t[shown]).clip(1, max(len(known) - 2, 1))
        beside = np.stack([known[after - 1], known[np.minimum(after, max(len(known) - 2, 0))]])
        shown = shown[np.abs(beside - sighting.t[shown]).max(axis=0) < LONGEST_GAP_S]
    shown = (
        shown[np.unique(np.linspace(0, len(shown) - 1, min(most, len(shown))).astype(int))]
        if len(shown)
        else shown
    )
    t = sighting.t[shown]
    apart = 0.5 * LONGEST_GAP_S
    rate = (encoders.interpolate_at(t + apart) - encoders.interpolate_at(t - apart)) / (2.0 * apart)
    x = encoders.interpolate_at(t)
    values = sighting.values[shown]
    var = sighting.var[shown]
    return TrackSightings(sighting.name, sighting.model, t, values, var, x, encoders.variance, rate)


def wide_nats(log: SightingLog) -> float:
    """−ln p (nats) of the sightings with standard deviations `_WIDENED` times as large."""
    nats = 0.0
    for track in log.tracks:
        mean, jac, var = track.model.predict(track.x)
        nats += float(
            _each_nats(
                track.y - mean, _WIDENED**2 * _sighting_covariance(track, jac, var), log.area
            )[0].sum()
        )
    return nats


def _sighting_covariance(track: TrackSightings, jac: Array, model: Array) -> Array:
    """Covariance (N,2,2) px² of the sightings about their predictions."""
    speed = np.einsum("ndm,nm->nd", jac, track.rate)
    cov = (
        np.einsum("ndm,m,nem->nde", jac, track.encoder_var, jac)
        + MIN_DELAY_S**2 * speed[:, :, None] * speed[:, None, :]
    )
    diagonal = np.einsum("ndd->nd", cov)
    diagonal += model + track.var
    diagonal += ROUNDING * diagonal.sum(axis=1, keepdims=True)
    return np.asarray(cov)


def _each_nats(off: Array, cov: Array, area: float) -> tuple[Array, Array]:
    """−ln p (N,) of residuals (N,2) px, each of the track
    or, ODD, anywhere; and probabilities (N,) of the former.
    """
    square = np.einsum("nd,nd->n", off, np.linalg.solve(cov, off[..., None])[..., 0])
    track = np.log1p(-OUTLIER_PROBABILITY) - 0.5 * (
        square + np.linalg.slogdet(2.0 * np.pi * cov)[1]
    )
    odd = np.log(OUTLIER_PROBABILITY / area)
    total = np.logaddexp(track, odd)
    return -total, np.exp(track - total)


def usual_offsets(log: SightingLog) -> tuple[UnknownColumns, ...]:
    """Unknowns of every log: encoders' offsets that are no faults."""
    m = log.tracks[0].x.shape[1]
    shape = tuple(np.ones((len(track.t), 1)) for track in log.tracks)
    small = np.array([[OFFSET_STD**-2]])
    return tuple(UnknownColumns(OFFSET, joint, shape, small) for joint in range(m))


def possible_faults(log: SightingLog) -> Iterator[UnknownColumns]:
    """Yield the faults that may be in any log: a joint's
    offset that wanders, a camera that is late or moved.
    """
    m = log.tracks[0].x.shape[1]
    t = np.concatenate([track.t for track in log.tracks])
    knots = np.linspace(t.min(), t.max() + 1e-9, _KNOTS)
    width = knots[1] - knots[0]
    hats = tuple(
        np.maximum(0.0, 1.0 - np.abs(track.t[:, None] - knots) / width) for track in log.tracks
    )
    steps = np.diff(np.eye(_KNOTS), axis=0) / PRIOR_STD_RAD
    walk = steps.T @ steps + np.eye(_KNOTS) * (0.1 / PRIOR_STD_RAD) ** 2
    for joint in range(m):
        yield UnknownColumns(WALK, joint, hats, walk)
    image = log.area**0.5
    for onset in np.quantile(t, np.arange(_ONSETS) / _ONSETS):
        both = tuple(
            np.column_stack([np.ones(len(track.t)), track.t >= onset]) for track in log.tracks
        )
        yield UnknownColumns(f"{MOVED} at {onset:.3f} s", None, both, np.eye(4) / image**2)
    constant = tuple(np.ones((len(track.t), 1)) for track in log.tracks)
    yield UnknownColumns(
        TURNED, None, constant, np.eye(6) / np.tile([image, TURN_STD, TURN_STD], 2) ** 2
    )
    yield UnknownColumns(LATE_KIND, None, constant, np.array([[DELAY_STD_S**-2]]))


def constant_offsets(log: SightingLog) -> Iterator[UnknownColumns]:
    """Yield a constant offset of each joint."""
    one = tuple(np.ones((len(track.t), 1)) for track in log.tracks)
    for joint in range(log.tracks[0].x.shape[1]):
        yield UnknownColumns(OFFSET, joint, one, np.array([[PRIOR_STD_RAD**-2]]))


def count_determined_offsets(log: SightingLog) -> int:
    """How many directions of constant offsets of all encoders images determine so well that one of
    PRIOR_STD_RAD would be certain, at postures that differ by no more than the arm has moved.
    """
    m = log.tracks[0].x.shape[1]
    information = np.zeros((m, m))
    for track in log.tracks:
        _, jac, var = track.model.predict(_remove_noise(track))
        white = np.linalg.solve(_sighting_covariance(track, jac, var), jac)
        information += np.einsum("ndk,ndl->kl", jac, white)
    certain = (CERTAIN_SIGMA / PRIOR_STD_RAD) ** 2
    return int((np.linalg.eigvalsh(information) > certain).sum())


def _remove_noise(track: TrackSightings) -> Array:
    """Angles (N,M) as far from their mean as joints have moved: noise moves none."""
    middle = track.x.mean(axis=0)
    spread = track.x.var(axis=0)
    moved = np.maximum(spread - track.encoder_var, 0.0)
    share = np.sqrt(moved / np.maximum(spread, np.finfo(float).tiny))
    return np.asarray(middle + share * (track.x - middle))


def hold_still(log: SightingLog) -> SightingLog:
    """The log as if the arm had stood at its mean posture."""
    tracks = (replace(one, x=np.tile(one.x.mean(axis=0), (len(one.x), 1))) for one in log.tracks)
    return replace(log, tracks=tuple(tracks))


def fit_unknowns(log: SightingLog, unknowns: Sequence[UnknownColumns]) -> FittedUnknowns:
    """Fit some unknowns to the sightings by robust Gauss-Newton, from wide errors to true ones."""
    precision = _block_diagonal([one.precision for one in unknowns])
    values = _start_values(log, unknowns)
    deviations = np.concatenate(
        [_rms_deviations(off, cov) for off, cov, _ in _linearise_sightings(log, unknowns, values)]
    )
    widest = float(np.clip(np.median(deviations), 1.0, _WIDEST))
    for width in (*np.geomspace(widest, 1.0, _TURNS), 1.0):
        information = precision.copy()
        pull = np.zeros(len(values))
        for off, cov, design in _linearise_sightings(log, unknowns, values):
            weight = _each_nats(off, width**2 * cov, log.area)[1]
            white = np.linalg.solve(cov, design)
            information += np.einsum("n,ndk,ndl->kl", weight, design, white)
            pull += np.einsum("n,ndk,nd->k", weight, white, off + design @ values)
        values = np.linalg.solve(information, pull)
    nats = 0.5 * float(values @ precision @ values)
    nats += 0.5 * float(np.linalg.slogdet(information)[1] - np.linalg.slogdet(precision)[1])
    far = 0
    for off, cov, _ in _linearise_sightings(log, unknowns, values):
        nats += float(_each_nats(off, cov, log.area)[0].sum())
        far += int((np.abs(off) > OFF_SIGMA * np.sqrt(np.einsum("ndd->nd", cov))).any(axis=1).sum())
    return FittedUnknowns(nats, far / log.count)


def _rms_deviations(off: Array, cov: Array) -> Array:
    """Root mean square (N,) of residuals (N,2) in standard deviations."""
    return np.asarray(
        np.sqrt(0.5 * np.einsum("nd,nd->n", off, np.linalg.solve(cov, off[..., None])[..., 0]))
    )


def _block_diagonal(blocks: Sequence[Array]) -> Array:
    """Square matrices along the diagonal of one."""
    ends = np.cumsum([len(block) for block in blocks]).tolist()
    found = np.zeros((ends[-1], ends[-1]))
    for end, block in zip(ends, blocks, strict=True):
        found[end - len(block) : end, end - len(block) : end] = block
    return found


def _start_values(log: SightingLog, unknowns: Sequence[UnknownColumns]) -> Array:
    """Values (K,) to begin with: 0, but the likeliest
    constant offset for a joint that may be anywhere.
    """
    found = []
    for one in unknowns:
        large = one.joint is not None and one.precision[-1, -1] < 1.0 / OFFSET_STD**2
        first = _likeliest_offset(log, one.joint) if large and one.joint is not None else 0.0
        found.append(np.full(len(one.precision), first))
    return np.concatenate(found)


def _likeliest_offset(log: SightingLog, joint: int) -> float:
    """The constant offset of one joint (rad), of some over
    a whole turn, with which the sightings are likeliest.
    """
    moved = np.arange(log.tracks[0].x.shape[1]) == joint

    def nats(offset: float) -> float:
        return wide_nats(
            replace(log, tracks=tuple(replace(one, x=one.x + offset * moved) for one in log.tracks))
        )

    return float(min(_OFFSETS, key=nats))


def _linearise_sightings(
    log: SightingLog, unknowns: Sequence[UnknownColumns], values: Array
) -> Iterator[tuple[Array, Array, Array]]:
    """Yield each track's residuals (N,2) px, their covariance
    (N,2,2), and the derivatives (N,2,K) of predictions.
    """
    parts = np.split(values, np.cumsum([len(one.precision) for one in unknowns])[:-1])
    for number, track in enumerate(log.tracks):
        x = track.x.copy()
        each = list(zip(unknowns, parts, strict=True))
        for one, value in each:
            if one.joint is not None:
                x[:, one.joint] += one.shape[number] @ value
            elif one.kind == LATE_KIND:
                x -= value * track.rate
        mean, jac, model = track.model.predict(x)
        design = [_design_matrix(one, number, mean, jac, track.rate) for one in unknowns]
        moved = sum(
            slope @ value
            for slope, (one, value) in zip(design, each, strict=True)
            if _of_image(one)
        )
        yield (
            track.y - mean - moved,
            _sighting_covariance(track, jac, model),
            np.concatenate(design, axis=2),
        )


def _of_image(unknown: UnknownColumns) -> bool:
    """Whether unknowns displace the image, not the angles."""
    return unknown.joint is None and unknown.kind != LATE_KIND


def _design_matrix(
    unknown: UnknownColumns, number: int, mean: Array, jac: Array, rate: Array
) -> Array:
    """Derivatives (N,2,K) of a track's predictions, mean (N,2)
    px, by some unknowns; jac (N,2,M) px/rad, rate (N,M).
    """
    shape = unknown.shape[number]
    if unknown.joint is not None:
        return np.asarray(jac[:, :, unknown.joint, None] * shape[:, None, :])
    if unknown.kind == LATE_KIND:
        return np.asarray(-np.einsum("ndm,nm->nd", jac, rate)[..., None])
    if unknown.kind == TURNED:
        # an image that a camera shows after a small turn is nearly affine in the image before it
        shape = np.column_stack([shape, mean - mean.mean(axis=0)])
    return np.asarray(np.einsum("de,nk->ndek", np.eye(2), shape).reshape(len(shape), 2, -1))
