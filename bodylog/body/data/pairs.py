"""Training pairs from features: smoothed joint angles with their variance beside each sighting."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np

from ...errors import ConfigError, EvidenceError, LogError
from ...types import Array, Features, Finding, Series
from ..gp.fit import Coupling
from .angle_smoother import ReadingChain, WhiteMotion, build_reading_chain, fit_white_motion
from .angles import Angles, Moving, motion_of_resting_joint, poses_with_readings

_LEAST_RANGE = 0.02
_BLOCKS = 10
_FEWEST = 4
_EARLIER = -1
_SEED = 0
# no joint turns so far in any unit, and its square does not overflow
_ABSURD = 1e12
# share of a joint's range: a sighting with a more uncertain angle is dropped
_VAGUE = 0.1
# px or mm: larger than any image, and farther than any tracker measures
_FAR = 1e6
NO_ERRORS: Mapping[str, tuple[float, float]] = MappingProxyType({})
_COLUMNS = ("x", "variance", "y", "floor", "block", "log", "t")


@dataclass(frozen=True, eq=False)
class Pairs:
    """x (n,M) rad, variance (n,M) · y (n,D) px or mm, floor (n,D) variance · block (n,) of time.

    log (n,) · t (n,) s, ascending within a log · frames searched.
    """

    x: Array
    variance: Array
    y: Array
    floor: Array
    block: Array
    log: Array
    t: Array
    frames: int

    def rows(self, chosen: Array) -> "Pairs":
        """Return some rows, in ascending order."""
        x, variance, y, floor = (a[chosen] for a in (self.x, self.variance, self.y, self.floor))
        return Pairs(
            x, variance, y, floor, self.block[chosen], self.log[chosen], self.t[chosen], self.frames
        )


@dataclass(frozen=True, eq=False)
class SmoothedJoint:
    """One joint over all logs: its angles in each, one white acceleration
    for all, and the std (rad) of its encoder's error that lasts.
    """

    name: str
    angles: tuple[Angles, ...]
    acceleration: WhiteMotion
    lasting: float = 0.0

    @cached_property
    def range(self) -> float:
        """Span of smoothed angles, rad, between the 1st and 99th percentile."""
        means = [one.at(one.t)[0] for one in self.angles]
        low, high = np.percentile(np.concatenate(means), [1, 99])
        return float(high - low)


def smooth_all_joints(
    features: Sequence[Features],
    wanted: tuple[str, ...] | None,
    lasting: Mapping[str, tuple[float, float]] = NO_ERRORS,
) -> list[SmoothedJoint]:
    """The joints with readings in all logs, or those wanted.

    lasting {joint: (std rad, seconds)}: of its encoder's error.

    LogError without readings, ConfigError for an unknown name, EvidenceError where logs share no
    joint or a wanted joint has too few readings.
    """
    readings = [_require_readings(f, i, len(features)) for i, f in enumerate(features)]
    common = [n for n in readings[0].names if all(n in r.names for r in readings)]
    if not common:
        have = "; ".join(f"log {i + 1} has {', '.join(r.names)}" for i, r in enumerate(readings))
        raise EvidenceError(f"the logs share no joint: {have}; fit one body for each robot")
    unknown = [n for n in wanted or () if n not in common]
    if unknown:
        raise ConfigError(
            f"[body] joints: found {unknown[0]!r}, possible: {', '.join(common)}; type: "
            "bodylog info LOG"
        )
    sparse = sparse_joints(features)
    if missing := [sparse[n] for n in wanted or () if n in sparse]:
        raise EvidenceError(f"{missing[0]}, but [body] joints names it; type: bodylog info LOG")
    still = [f.poses for f in features]
    return [
        _smooth_joint_over_logs(n, readings, still, lasting.get(n, (0.0, 1.0)))
        for n in wanted or common
        if n not in sparse
    ]


def sparse_joints(features: Sequence[Features]) -> dict[str, str]:
    """A message for each joint with too few readings in some log."""
    found = {}
    few = f"{_FEWEST} are needed"
    for index, readings in enumerate(f.joints for f in features if f.joints is not None):
        for name, column in zip(readings.names, readings.values.T, strict=True):
            count = len(np.unique(readings.t[np.isfinite(column)]))
            if count < _FEWEST:
                found[name] = (
                    f"{name}: only {count} of {len(column)} readings in log {index + 1} are "
                    f"numbers, {few}"
                )
    return found


def drop_impossible_values(features: Sequence[Features]) -> tuple[list[Features], list[Finding]]:
    """Remove impossible readings and positions, and return
    a remark for each joint and track that had some.
    """
    kept = []
    findings = []
    for index, found in enumerate(features):
        found, far = _drop_far_positions(found, index)
        findings += far
        for role in ("joints", "reference"):
            series = getattr(found, role)
            absurd = np.zeros((0, 0), bool) if series is None else np.abs(series.values) > _ABSURD
            if not absurd.any():
                continue
            found = replace(
                found, **{role: replace(series, values=np.where(absurd, np.nan, series.values))}
            )
            for m in np.flatnonzero(absurd.any(axis=0)):
                example = f"{series.values[absurd[:, m], m][0]:.3g} {series.unit}"
                what = (
                    f"{series.names[m]}: {absurd[:, m].sum()} of {len(absurd)} readings in log "
                    f"{index + 1}"
                )
                findings.append(Finding("warning", f"{what} left out: no joint reaches {example}"))
        kept.append(found)
    return kept, findings


def _drop_far_positions(found: Features, index: int) -> tuple[Features, list[Finding]]:
    """Remove positions beyond any image, and return a remark for each track that had some."""
    tracks = dict(found.tracks)
    findings = []
    for name, track in found.tracks.items():
        far: Array = np.asarray((np.abs(track.values) > _FAR).any(axis=1))
        if far.any():
            tracks[name] = replace(track, values=np.where(far[:, None], np.nan, track.values))
            what = f"{name}: {far.sum()} of {len(far)} places in log {index + 1} left out"
            findings.append(Finding("warning", f"{what}: beyond {_FAR:g} {track.unit}"))
    return replace(found, tracks=tracks), findings


def has_moved(joint: SmoothedJoint) -> bool:
    """Whether the joint moved: smoothed noise alone spans far less."""
    return joint.range > _LEAST_RANGE


def find_moving_joints(features: Sequence[Features]) -> list[str]:
    """Joints whose raw readings span more than those of a joint at rest."""
    found: dict[str, None] = {}
    for series in (f.joints for f in features if f.joints is not None):
        for name, column in zip(series.names, series.values.T, strict=True):
            known = column[np.isfinite(column)]
            if len(known) and float(np.ptp(np.percentile(known, [1, 99]))) > _LEAST_RANGE:
                found[name] = None
    return list(found)


def pair_sightings(
    features: Sequence[Features], track: str, chosen: Sequence[SmoothedJoint], every: int
) -> Pairs:
    """Sightings of one track with the angles of the chosen joints at the same times."""
    parts = [
        _pair_track(f.tracks[track], i, chosen, every)
        for i, f in enumerate(features)
        if track in f.tracks
    ]
    still = [f.poses for f in features if track in f.tracks]
    return join_pairs(
        [_shuffle_blocks(part) if posed else part for part, posed in zip(parts, still, strict=True)]
    )


def pairs_of_samples(x: Array, y: Array, spread: Array) -> Pairs:
    """The samples of an existing body, whose variance
    spread (n,D) already includes that of the angles.
    """
    label = np.full(len(x), _EARLIER)
    block = np.arange(len(x)) * _BLOCKS // len(x) - _BLOCKS
    return Pairs(
        x, np.zeros(x.shape), y, spread, block, label, np.arange(len(x), dtype=float), len(x)
    )


def join_pairs(parts: Sequence[Pairs]) -> Pairs:
    """Concatenate pairs."""
    columns = {name: np.concatenate([getattr(p, name) for p in parts]) for name in _COLUMNS}
    return Pairs(**columns, frames=sum(p.frames for p in parts))


def correlate_angle_errors(part: Pairs, chosen: Sequence[SmoothedJoint]) -> Coupling:
    """Correlation of the smoothed joints' errors between sightings."""
    nothing = np.zeros(0, np.int64)
    found = [(nothing, nothing, nothing, np.zeros(0))]
    for m, joint in enumerate(chosen):
        for log in np.unique(part.log[part.log != _EARLIER]):
            rows = np.flatnonzero(part.log == log)
            i, j, value = joint.angles[log].coupling(part.t[rows])
            found.append((rows[i], rows[j], np.full(len(i), m), value))
    return Coupling(*(np.concatenate(column) for column in zip(*found, strict=True)))


def _shuffle_blocks(part: Pairs) -> Pairs:
    """Poses in random blocks: they often lie on a grid,
    of which no contiguous part predicts the rest.
    """
    return replace(part, block=np.random.default_rng(_SEED).permutation(part.block))


def _require_readings(features: Features, index: int, count: int) -> Series:
    if features.joints is None or not len(features.joints.t):
        raise LogError(
            f"log {index + 1} of {count}: no joint readings to learn from; type: bodylog info LOG"
        )
    return features.joints


def _smooth_joint_over_logs(
    name: str, readings: Sequence[Series], still: Sequence[bool], lasting: tuple[float, float]
) -> SmoothedJoint:
    columns = [(r.t, r.values[:, r.names.index(name)]) for r in readings]
    chains = {k: build_reading_chain(*column) for k, column in enumerate(columns) if not still[k]}
    pooled = fit_white_motion(list(chains.values()), 2) if chains else motion_of_resting_joint()
    each = {
        k: pooled if len(chains) == 1 else fit_white_motion([one], 2) for k, one in chains.items()
    }
    moving = {k: Moving(one, _likelier_motion(one, each[k]), *lasting) for k, one in chains.items()}
    return SmoothedJoint(
        name,
        tuple(moving.get(k) or poses_with_readings(*column) for k, column in enumerate(columns)),
        pooled,
        lasting[0],
    )


def _likelier_motion(signal: ReadingChain, acceleration: WhiteMotion) -> WhiteMotion:
    """White acceleration or white jerk, whichever has the greater evidence."""
    jerk = fit_white_motion([signal], 3)
    return jerk if jerk.evidence > acceleration.evidence else acceleration


def _pair_track(track: Series, log: int, chosen: Sequence[SmoothedJoint], every: int) -> Pairs:
    rows = np.argsort(track.t, kind="stable")[::every]
    t = track.t[rows]
    y = track.values[rows]
    floor = np.zeros_like(y) if track.std is None else track.std[rows] ** 2
    both = [j.angles[log].at(t) for j in chosen]
    x, variance = (np.column_stack(part) for part in zip(*both, strict=True))
    sound = np.isfinite(y).all(axis=1) & np.isfinite(x).all(axis=1) & np.isfinite(floor).all(axis=1)
    sound &= (variance <= np.square([_VAGUE * max(j.range, _LEAST_RANGE) for j in chosen])).all(
        axis=1
    )
    block = log * _BLOCKS + np.arange(sound.sum()) * _BLOCKS // max(sound.sum(), 1)
    label = np.full(sound.sum(), log)
    return Pairs(x[sound], variance[sound], y[sound], floor[sound], block, label, t[sound], len(t))
