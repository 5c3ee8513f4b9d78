"""A moved camera: from some time on, everything it shows is displaced by the same pixels.

Means of encoder readings predict positions. The residuals r (R,) px of a track's curve are normal
with covariance C: noise, model error (correlated by posture), errors of encoders that last, and
wandering offsets of all encoders. A displacement Δ ~ N(0, σ²I) from the k-th mean on, with all k
equally likely, adds ½ bᵀA⁻¹b − ½ ln|σ²A| to ln p(r), where A = SᵀC⁻¹S + I/σ² and b = SᵀC⁻¹r. It
must win against no displacement, encoders that wander, one that steps, and all wrong at first.

A blow may move a camera and shift a joint. So steps and steady drifts of single encoders are found
in the same way, and displacements must win beside them, and over the best explanation without any.
Play that an arm has got since its exploration is measured beside the most likely displacement.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from ...body_model import BodyModel, ForwardModel
from ...linear_algebra import forward_substituted
from ...types import TRACK_AXES, Array, Fault, FaultKind, Hypothesis
from ..inference.tangents import OFFSET_STD
from ..measurements.arm_errors import (
    LEAST_PLAY,
    PLAY_STD,
    follow_links,
    follow_slack,
    read_arm_errors,
    read_slack,
    smooth_motors,
)
from ..measurements.long_arrays import estimate_noise_variance
from ..measurements.records import Encoders, Evidence, Sighting
from ..measurements.track import group_tracks_by_camera
from ..measurements.track_curve import (
    BLUNDER_MEDIANS,
    MAX_FRAME_GAP_S,
    build_track_curve,
    interpolate_curve,
)
from ..noise.encoder_noise import MAX_MEMORY_S
from .offset_changes import RANDOM_WALKS, shape_change
from .threshold import EVIDENCE_THRESHOLD_NATS, MIN_DELAY_S, PRIOR_STD_RAD

NO_ERRORS = (0.0, 1.0)
"""σ (rad) and τ (s) of encoders without errors that last."""
PLAY_ROUNDS = 4
"""Rounds in which the place of links within their play and its size are found: of 10 drawn logs
with 1° of play, the size is within 1 % of that of the round before.
"""
MAX_READING_MEANS = 160
"""Most means of encoder readings, evenly spread: the cost grows with their third power."""


CAMERA_CHANGE = (None, False)
"""The kind of a displacement: of no joint's encoder, and it does not grow."""


@dataclass(frozen=True, eq=False)
class SensorChange:
    """What a sensor shows too much since t (s), its covariance,
    and the nats won against all other explanations.

    size: displacement of the camera's images (2,) px, or points (3,) mm; of the encoder of a
    `joint`, (1,) rad · grows: steadily, to that size in the end.
    """

    t: float
    size: Array
    cov: Array
    nats: float
    joint: int | None = None
    grows: bool = False


@dataclass(frozen=True, eq=False)
class _DisplacementRows:
    """Rows of all tracks: keys (R,), a number of track and output plus i t · t (R,) s · output (R,)
    0 or 1 · residuals r (R,) px · jac (R,M) px/rad · the Cholesky factor (R,R) of their covariance.
    """

    keys: Array
    t: Array
    output: Array
    r: Array
    jac: Array
    chol: Array

    def form_basis(self, joint: int | None) -> Array:
        """What a unit of a displacement (R,D), or of what an encoder reads too much (R,1), adds."""
        if joint is not None:
            return -self.jac[:, joint : joint + 1]
        return np.asarray(np.eye(1 + self.output.max())[self.output])

    def select_rows(self, keys: Array) -> "_DisplacementRows":
        """The rows with these keys."""
        kept = np.isin(self.keys, keys)
        cov = (self.chol @ self.chol.T)[np.ix_(kept, kept)]
        return _DisplacementRows(
            self.keys[kept],
            self.t[kept],
            self.output[kept],
            self.r[kept],
            self.jac[kept],
            np.linalg.cholesky(cov),
        )

    def stack_columns(self, changes: Sequence[SensorChange]) -> Array:
        """What units of all sizes of changes add (R,·), side by side."""
        found = [
            self.form_basis(one.joint) * shape_change(self.t, one.t, one.grows)[:, None]
            for one in changes
        ]
        return np.concatenate([np.empty((len(self.t), 0)), *found], axis=1)

    def choose_prior_std(self, joint: int | None) -> float:
        """A displacement is a priori as large as an encoder's offset
        shows, or 1e-3 px if joints do not move the track.
        """
        if joint is not None:
            return PRIOR_STD_RAD
        return max(PRIOR_STD_RAD * float(np.sqrt(np.square(self.jac).mean())), 1e-3)

    def allow_for_changes(self, changes: Sequence[SensorChange]) -> "_DisplacementRows":
        """The rows with changes of unknown sizes."""
        if not changes:
            return self
        wide = [np.full(len(one.size), self.choose_prior_std(one.joint)) for one in changes]
        return self.allow_for_columns(self.stack_columns(changes) * np.concatenate(wide))

    def allow_for_columns(self, more: Array) -> "_DisplacementRows":
        """The rows with errors along columns (R,C), each of one standard deviation."""
        return self.allow_for_covariance(more @ more.T)

    def allow_for_wandering(self, walk: float) -> "_DisplacementRows":
        """The rows with encoders' offsets that wander by `walk` rad²/s."""
        return self.allow_for_covariance(_build_offset_covariance(self.t, self.jac, walk))

    def allow_for_covariance(self, more: Array) -> "_DisplacementRows":
        """The rows with errors of covariance (R,R) beside their own."""
        return replace(self, chol=np.linalg.cholesky(self.chol @ self.chol.T + more))

    def measure_cost_beside(self, changes: Sequence[SensorChange]) -> float:
        """The cost beside changes of unknown sizes, each at one of all times that are as likely."""
        times = len(changes) * np.log(len(np.unique(self.t)))
        return self.allow_for_changes(changes).cost + float(times)

    @property
    def cost(self) -> float:
        """−ln p (nats), up to a constant of all hypotheses."""
        white = forward_substituted(self.chol, self.r[:, None])
        return float(_measure_nats_at_best_scale(np.square(white).sum(), self.chol))


class _ModelWithAddedVariance:
    """A forward model with added variance (D,) unit²; otherwise the plain model."""

    def __init__(self, plain: ForwardModel, added: Array) -> None:
        self._plain = plain
        self._added = added
        self.outputs = plain.outputs

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "_plain":
            raise AttributeError(name)
        return getattr(self._plain, name)

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        mean, jac, var = self._plain.predict(x)
        return mean, jac, var + self._added


def detect_moved_camera(evidence: Evidence, body: BodyModel) -> Evidence:
    """Undo camera displacements in the tracks, the uncertainty of each added to the model's
    variance, and measure play that the arm has got since its exploration.

    Errors of the arm's encoders that last are those of its exploration, and so is its play, unless
    the log shows more. Without effect if encoders read another function of the angle.
    """
    if evidence.encoders is None or "encoders" in body.senses:
        return evidence
    errors = read_arm_errors(body)
    encoders = _remove_blunders(evidence.encoders)
    links = follow_links(encoders.t, encoders.values, body.joints, errors.play)
    encoders = replace(encoders, values=links)
    lasting = np.array([errors.lasting.get(name, NO_ERRORS) for name in body.joints])
    sightings = list(evidence.sightings)
    faults = list[Fault]()
    hypotheses = list[Hypothesis]()
    worn = np.zeros(len(body.joints))
    for name, own in group_tracks_by_camera(sightings).items():
        seen = [sightings[k] for k in own]
        rows = _build_displacement_rows(encoders, seen, lasting)
        if rows is not None and (more := _measure_worn_play(encoders, rows)).any():
            slack = read_slack(encoders.t, encoders.values, np.maximum(more, LEAST_PLAY))
            encoders = replace(encoders, values=encoders.values + more * slack)
            worn = worn + more
        for found in find_displacements(encoders, seen, lasting):
            hypotheses.append(
                Hypothesis(
                    "camera moved",
                    name,
                    found.nats,
                    EVIDENCE_THRESHOLD_NATS,
                    found.nats > EVIDENCE_THRESHOLD_NATS,
                )
            )
            if found.nats > EVIDENCE_THRESHOLD_NATS:
                faults.append(_make_displacement_fault(name, found))
                for k in own:
                    sightings[k] = subtract_displacement(sightings[k], found)
    found_in = replace(evidence, sightings=tuple(sightings), faults=(*evidence.faults, *faults))
    return replace(found_in, hypotheses=(*evidence.hypotheses, *hypotheses), worn=worn)


def _remove_blunders(encoders: Encoders) -> Encoders:
    """The encoders without single readings that are far from both neighbours: the mean of a few
    readings would be off, and so would a link that they drag through its play.
    """
    y = encoders.values
    near = np.stack([y[:-2], y[1:-1], y[2:]])
    limit = np.maximum(BLUNDER_MEDIANS * np.sqrt(estimate_noise_variance(y)), OFFSET_STD)
    off = np.abs(y[1:-1] - np.median(near, axis=0)) > limit
    values = y.copy()
    values[1:-1][off] = np.nan
    return replace(encoders, values=values)


def _make_displacement_fault(name: str, found: SensorChange) -> Fault:
    size = float(np.linalg.norm(found.size))
    std = float(np.sqrt(found.size @ found.cov @ found.size)) / size
    unit = TRACK_AXES[len(found.size)][1]
    return Fault("vision", name, FaultKind.DISPLACED, found.t, size, unit, std)


def subtract_displacement(sighting: Sighting, moved: SensorChange) -> Sighting:
    """Return the sighting with the displacement subtracted from its time on."""
    off = (sighting.t >= moved.t)[:, None] * moved.size
    before = np.zeros_like(sighting.values) if sighting.displaced is None else sighting.displaced
    unsure = _ModelWithAddedVariance(sighting.model, np.diag(moved.cov))
    return replace(sighting, model=unsure, values=sighting.values - off, displaced=before + off)


def restore_displacements(evidence: Evidence) -> Evidence:
    """The evidence as if no camera had moved."""
    sightings = tuple(
        one
        if one.displaced is None
        else replace(
            one,
            model=_without_added_variance(one.model),
            values=one.values + one.displaced,
            displaced=None,
        )
        for one in evidence.sightings
    )
    faults = tuple(one for one in evidence.faults if one.kind != FaultKind.DISPLACED)
    hypotheses = tuple(
        replace(one, chosen=False) if one.name == "camera moved" else one
        for one in evidence.hypotheses
    )
    return replace(evidence, sightings=sightings, faults=faults, hypotheses=hypotheses)


def _without_added_variance(model: ForwardModel) -> ForwardModel:
    while isinstance(model, _ModelWithAddedVariance):
        model = model._plain
    return model


@dataclass(frozen=True, eq=False)
class _Explanation:
    """Changes that explain rows, and what was taken out of encoders before."""

    rows: _DisplacementRows
    changes: list[SensorChange]
    removed: list[SensorChange]

    @property
    def displacements(self) -> list[SensorChange]:
        """The displacements of the camera."""
        return [one for one in self.changes if one.joint is None]

    @property
    def encoder_changes(self) -> list[SensorChange]:
        """What encoders read too much, in all."""
        return [*self.removed, *(one for one in self.changes if one.joint is not None)]

    def measure_cost(self, keys: Array) -> float:
        """−ln p (nats) of some rows with the changes."""
        return self.rows.select_rows(keys).measure_cost_beside([*self.removed, *self.changes])


def find_displacements(
    encoders: Encoders, seen: Sequence[Sighting], lasting: Array
) -> list[SensorChange]:
    """Return the displacements of one camera's tracks that win EVIDENCE_THRESHOLD_NATS, by time, or
    else the most likely one; none where too little is seen.

    lasting (M,2): σ (rad) and τ (s) of each encoder's errors that last.
    """

    def predict_rows(read: Encoders) -> _DisplacementRows | None:
        return _build_displacement_rows(read, seen, lasting)

    rows = predict_rows(encoders)
    if rows is None:
        return []
    first = _find_best_change(rows)
    if first.nats <= EVIDENCE_THRESHOLD_NATS:
        return [first]
    begin = rows.t.min() + MAX_MEMORY_S
    settled = _find_best_step(rows, rows.jac, PRIOR_STD_RAD, until=True)
    if settled.t <= begin and (more := settled.nats + first.nats - rows.cost) < 0.0:
        return [replace(first, nats=more)]
    if first.t <= begin and (more := _measure_gain_over_offsets(rows, first)) < 0.0:
        return [replace(first, nats=more)]
    joints = list(product(range(rows.jac.shape[1]), (False, True)))
    fixed = _explain_rows(rows, encoders, predict_rows, joints)
    found = _explain_rows(rows, encoders, predict_rows, [CAMERA_CHANGE, *joints])
    moves = found.displacements
    if not moves:
        cost = rows.measure_cost_beside(found.removed or found.changes)
        return [replace(first, nats=min(first.nats - rows.cost + cost, 0.0))]
    # compared by the images that both explanations predict
    keys = np.intersect1d(fixed.rows.keys, found.rows.keys)
    gain = min(
        (fixed.measure_cost(keys) - found.measure_cost(keys)) / len(moves),
        _measure_gain_over_settling(found.rows, found.changes),
        _measure_gain_over_encoders(found.rows.allow_for_changes(found.encoder_changes), moves),
    )
    if gain <= EVIDENCE_THRESHOLD_NATS:
        return [replace(first, nats=gain)]
    sized = _size_changes(found.rows, [*moves, *found.encoder_changes])[: len(moves)]
    return sorted((replace(one, nats=min(one.nats, gain)) for one in sized), key=lambda one: one.t)


def _measure_worn_play(encoders: Encoders, rows: _DisplacementRows) -> Array:
    """Half of the play (M,) rad that joints have beyond what encoders were made to follow; zero
    where it does not win EVIDENCE_THRESHOLD_NATS.

    A step or a drift of an encoder may resemble play: beside the most likely displacement, play
    must win over such a change, too.
    """
    first = _find_best_change(rows)
    beside = rows.allow_for_changes([first])
    half, cost = _fit_play(encoders, beside)
    none = np.zeros(len(half))
    if beside.cost - cost <= EVIDENCE_THRESHOLD_NATS:
        return none
    pair = _find_best_pair(rows, [CAMERA_CHANGE, *product(range(len(half)), (False, True))])
    gain = rows.measure_cost_beside(pair or [first]) - cost
    return half if gain > EVIDENCE_THRESHOLD_NATS else none


def _fit_play(encoders: Encoders, rows: _DisplacementRows) -> tuple[Array, float]:
    """Half of each joint's play (M,) rad, and what the rows cost beside it.

    Links that trail their motors' links through more play trail the motors through the sum of both.
    Noise of readings moves a motor within its play, so play within that noise would explain it:
    half of it must be more than the motors' angles are unsure.
    """
    motors, noise = smooth_motors(encoders.t, encoders.values)
    half = np.zeros(rows.jac.shape[1])
    shown = np.ones(len(half), bool)
    for _ in range(PLAY_ROUNDS):
        slack = follow_slack(motors, np.maximum(half, LEAST_PLAY), noise)
        at_rows = np.column_stack([np.interp(rows.t, encoders.t, column) for column in slack.T])
        columns = PLAY_STD * rows.jac * at_rows * shown
        white = forward_substituted(rows.chol, np.column_stack([rows.r, columns]))
        info = white[:, 1:].T @ white[:, 1:] + np.eye(len(half))
        half = PLAY_STD * np.maximum(np.linalg.solve(info, white[:, 1:].T @ white[:, 0]), 0.0)
        shown = half > noise
    return half * shown, rows.allow_for_columns(columns * shown).cost


def _explain_rows(
    rows: _DisplacementRows,
    encoders: Encoders,
    predict_rows: Callable[[Encoders], _DisplacementRows | None],
    kinds: Sequence[tuple[int | None, bool]],
) -> _Explanation:
    """The most likely changes of these kinds, with predictions about what the encoders should have
    read: they are linear in small errors only.
    """
    changes = _search_changes(rows, kinds)
    removed = [one for one in changes if one.joint is not None]
    again = predict_rows(_remove_changes(encoders, removed)) if removed else None
    if again is None:
        return _Explanation(rows, changes, [])
    return _Explanation(again, _search_changes(again.allow_for_changes(removed), kinds), removed)


def _search_changes(
    rows: _DisplacementRows, kinds: Sequence[tuple[int | None, bool]]
) -> list[SensorChange]:
    """Displacements of the camera, and steps and steady drifts of encoders, each of which wins
    EVIDENCE_THRESHOLD_NATS beside the others; their sizes are those of all together.

    kinds: joint, None for the camera, and whether it grows.
    """
    found = _find_best_pair(rows, kinds)
    while True:
        left = rows.allow_for_changes(found)
        more = [
            *found,
            max((_find_best_change(left, *kind) for kind in kinds), key=lambda one: one.nats),
        ]
        more = _refine_changes(rows, more)
        if not _stand_apart(more):
            return _size_changes(rows, found)
        found = more


def _find_best_pair(
    rows: _DisplacementRows, kinds: Sequence[tuple[int | None, bool]]
) -> list[SensorChange]:
    """The most likely two changes of these kinds that stand apart; empty where none do."""
    # alone, a displacement may look like the error of a sound encoder
    begin = [CAMERA_CHANGE] if CAMERA_CHANGE in kinds else kinds
    first = max((_find_best_change(rows, *kind) for kind in begin), key=lambda one: one.nats)
    beside = rows.allow_for_changes([first])
    pairs = [_refine_changes(rows, [first, _find_best_change(beside, *kind)]) for kind in kinds]
    apart = [pair for pair in pairs if _stand_apart(pair)]
    return min(apart, key=rows.measure_cost_beside, default=[])


def _stand_apart(changes: Sequence[SensorChange]) -> bool:
    """Whether each change is evident beside the others, and is
    no part of another: images between which a displacement lies show some of it.
    """
    shown = np.diff(sorted(one.t for one in changes if one.joint is None))
    evident = min(one.nats for one in changes) > EVIDENCE_THRESHOLD_NATS
    return evident and bool((shown > MAX_FRAME_GAP_S).all())


def _refine_changes(rows: _DisplacementRows, changes: Sequence[SensorChange]) -> list[SensorChange]:
    """The changes, each most likely beside the others."""
    found = list(changes)
    for k, one in enumerate(changes):
        others = rows.allow_for_changes(found[:k] + found[k + 1 :])
        found[k] = _find_best_change(others, one.joint, one.grows)
    return found


def _find_best_change(
    rows: _DisplacementRows, joint: int | None = None, grows: bool = False
) -> SensorChange:
    """The most likely displacement, or change of what one encoder reads, and the nats it wins."""
    found = _find_best_step(rows, rows.form_basis(joint), rows.choose_prior_std(joint), grows=grows)
    return replace(found, nats=rows.cost - found.nats, joint=joint, grows=grows)


def _remove_changes(encoders: Encoders, read: Sequence[SensorChange]) -> Encoders:
    """The encoders without what they read too much."""
    values = encoders.values.copy()
    for one in read:
        assert one.joint is not None
        values[:, one.joint] -= one.size * shape_change(encoders.t, one.t, one.grows)
    return replace(encoders, values=values)


def _size_changes(rows: _DisplacementRows, changes: Sequence[SensorChange]) -> list[SensorChange]:
    """The changes with their sizes and covariances beside each other, at their times; what
    encoders read too much may have been removed from the rows.
    """
    found = []
    for k, one in enumerate(changes):
        others = rows.allow_for_changes([*changes[:k], *changes[k + 1 :]])
        white = forward_substituted(
            others.chol, np.column_stack([rows.r, rows.stack_columns([one])])
        )
        info = (
            white[:, 1:].T @ white[:, 1:]
            + np.eye(len(one.size)) / rows.choose_prior_std(one.joint) ** 2
        )
        cov = np.linalg.inv(info)
        found.append(replace(one, size=cov @ (white[:, 1:].T @ white[:, 0]), cov=cov))
    return found


def _measure_gain_over_encoders(rows: _DisplacementRows, moves: list[SensorChange]) -> float:
    """Nats won by each move against encoders that wander, and one that steps.

    Negative where residuals exceed the noise: the model is not linear
    over a large offset. A step of one encoder is as simple as one
    displacement, so it is compared with the first displacement alone.
    """
    white = forward_substituted(rows.allow_for_changes(moves).chol, rows.r[:, None])
    # the mean square is 1 where all noise is as stated
    if (poor := 4.0 * len(white) - np.square(white).sum()) < 0.0:
        return 0.5 * float(poor)
    wandering = [rows.allow_for_wandering(walk).cost for walk in (RANDOM_WALKS[0], RANDOM_WALKS[2])]
    steps = min(_find_best_step(rows, lean[:, None], PRIOR_STD_RAD).nats for lean in rows.jac.T)
    first = rows.cost - _find_best_change(rows).nats
    return min(steps - first, (min(wandering) - rows.measure_cost_beside(moves)) / len(moves))


def _measure_gain_over_settling(rows: _DisplacementRows, changes: Sequence[SensorChange]) -> float:
    """Nats won by each change against encoders that all err at first."""
    settled = _find_best_step(rows, rows.jac, PRIOR_STD_RAD, until=True).nats
    return (settled - rows.measure_cost_beside(changes)) / len(changes)


def _measure_gain_over_offsets(rows: _DisplacementRows, first: SensorChange) -> float:
    """Nats won by the first displacement against encoders that are all off by a constant: all
    images of an arm that stands still show the same of both.
    """
    offsets = rows.allow_for_columns(PRIOR_STD_RAD * rows.jac)
    return offsets.cost - rows.measure_cost_beside([first])


def _build_displacement_rows(
    encoders: Encoders, seen: Sequence[Sighting], lasting: Array
) -> _DisplacementRows | None:
    """The tracks' curves beside the encoders, as rows whose covariance is that
    of a fixed camera and sound encoders; None where too little is seen.

    lasting (M,2): σ (rad) and τ (s) of each encoder's errors that last.
    """
    curves = [(s, build_track_curve(encoders, s, MAX_READING_MEANS // len(seen))) for s in seen]
    found = [(sighting, curve) for sighting, curve in curves if curve is not None]
    if not found:
        return None
    parts = list[tuple[Array, ...]]()
    own = list[Array]()
    for sighting, curve in found:
        place, speed, *_, sound = interpolate_curve(curve, 0.0)
        x = curve.x[sound] / getattr(sighting.model, "reach", np.inf)
        off = place - curve.predicted
        correlation = np.exp(
            -0.5 * sum(np.square(np.subtract.outer(column, column)) for column in x.T)
        )
        for d in range(off.shape[1]):
            model = np.sqrt(curve.model[sound, d])
            own.append(np.outer(model, model) * correlation + curve.noise[d] * np.eye(len(model)))
            columns = (
                len(parts) + 1j * curve.at,
                curve.at,
                np.full(len(curve.at), d),
                off[:, d],
                curve.jac[:, d],
                curve.encoder,
                speed[:, d],
            )
            parts.append(tuple(column[sound] for column in columns))
    keys, t, output, r, jac, encoder, speed = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    if not len(t):
        return None
    # rows of one time share the same means of encoder readings
    cov = (t[:, None] == t) * ((jac * encoder) @ jac.T) + _build_offset_covariance(
        t, jac, RANDOM_WALKS[-1]
    )
    for (std, seconds), lean in zip(lasting, jac.T, strict=True):
        cov += np.outer(std * lean, std * lean) * np.exp(-np.abs(np.subtract.outer(t, t)) / seconds)
    # smaller delays are left
    cov += MIN_DELAY_S**2 * np.outer(speed, speed)
    for end, block in zip(np.cumsum([len(block) for block in own]).tolist(), own, strict=True):
        cov[end - len(block) : end, end - len(block) : end] += block
    return _DisplacementRows(keys, t, output, r, jac, np.linalg.cholesky(cov))


def _build_offset_covariance(t: Array, jac: Array, walk: float) -> Array:
    """Covariance (R,R) px² added by encoders' offsets
    that wander by `walk` rad²/s; jac (R,M) px/rad.
    """
    since = t - t.min(initial=np.inf)
    return np.asarray((jac @ jac.T) * (OFFSET_STD**2 + walk * np.minimum.outer(since, since)))


def _find_best_step(
    rows: _DisplacementRows, basis: Array, wide: float, until: bool = False, grows: bool = False
) -> SensorChange:
    """The most likely step along a basis (R,D), with D ~ N(0, wide²), and its time.

    Its `nats` is the cost, −ln p of all rows, averaged over
    all times of a step. `until`: it is undone at its time. `grows`: from there on.
    """
    times = np.unique(rows.t)
    d = basis.shape[1]
    shapes = shape_change(rows.t[:, None], times, grows)
    steps = basis[:, :, None] * (1.0 - shapes if until else shapes)[:, None, :]
    white = forward_substituted(
        rows.chol, np.column_stack([rows.r, steps.reshape(len(rows.t), -1)])
    )
    r = white[:, 0]
    s = white[:, 1:].reshape(len(rows.t), d, len(times))
    info = np.einsum("rdk,rek->kde", s, s) + np.eye(d) / wide**2
    pull = np.einsum("rdk,r->kd", s, r)
    size = np.linalg.solve(info, pull[..., None])[..., 0]
    won = 0.5 * (pull * size).sum(axis=1) - 0.5 * np.linalg.slogdet(wide**2 * info)[1]
    cost = _measure_nats_at_best_scale(r @ r - 2.0 * won, rows.chol)
    best = int(cost.argmin())
    # all times are equally likely
    total = float(cost[best] - np.log(np.exp(cost[best] - cost).mean()))
    return SensorChange(float(times[best]), size[best], np.linalg.inv(info[best]), total)


def _measure_nats_at_best_scale(square: Array, chol: Array) -> Array:
    """−ln p (nats) from squared whitened residuals, at the most likely common noise scale ≥ 1."""
    scale = np.maximum(square / len(chol), 1.0)
    return np.asarray(
        0.5 * (square / scale + len(chol) * np.log(scale)) + np.log(np.diag(chol)).sum()
    )
