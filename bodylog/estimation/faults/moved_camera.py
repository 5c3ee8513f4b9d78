"""A moved camera: from some time on, everything it shows is displaced by the same pixels.

Means of encoder readings predict positions. The residuals r (R,) px of a track's curve are normal
with covariance C: noise, model error (correlated by posture), errors of encoders that last, and
wandering offsets of all encoders. A displacement Δ ~ N(0, σ²I) from the k-th mean on, with all k
equally likely, adds ½ bᵀA⁻¹b − ½ ln|σ²A| to ln p(r), where A = SᵀC⁻¹S + I/σ² and b = SᵀC⁻¹r. It
must win against no displacement, encoders that wander, one that steps, and all wrong at first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...body_model import BodyModel, ForwardModel
from ...linear_algebra import forward_substituted
from ...types import TRACK_AXES, Array, Fault, FaultKind, Hypothesis
from ..inference.tangents import OFFSET_STD
from ..measurements.arm_errors import follow_links, learned_arm_errors
from ..measurements.long_arrays import noise_variance
from ..measurements.records import Encoders, Evidence, Sighting
from ..measurements.track import camera_of_track
from ..measurements.track_curve import BLUNDER_MEDIANS, Curve, interpolate_curve, track_curve
from .encoder_offset import RANDOM_WALKS
from .threshold import EVIDENCE_THRESHOLD_NATS, MIN_DELAY_S, PRIOR_STD_RAD

TRACKED = tuple(axes for axes, _ in TRACK_AXES.values())
"""Outputs of tracks in images, and of points in space."""
NO_ERRORS = (0.0, 1.0)
"""σ (rad) and τ (s) of encoders without errors that last."""
MAX_READING_MEANS = 160
"""Most means of encoder readings, evenly spread: the cost grows with their third power."""


@dataclass(frozen=True, eq=False)
class CameraDisplacement:
    """A displacement (2,) px, or (3,) mm, since t (s), its
    covariance, and the nats won against all other explanations.
    """

    t: float
    size: Array
    cov: Array
    nats: float


@dataclass(frozen=True, eq=False)
class _DisplacementRows:
    """Rows of all tracks: t (R,) s · output (R,) 0 or 1 · residuals r (R,) px · jac (R,M) px/rad ·
    the Cholesky factor (R,R) of their covariance.
    """

    t: Array
    output: Array
    r: Array
    jac: Array
    chol: Array

    def without(self, moves: Sequence[CameraDisplacement]) -> "_DisplacementRows":
        """The rows with displacements subtracted."""
        return replace(
            self, r=self.r - sum(one.size[self.output] * (self.t >= one.t) for one in moves)
        )

    def wandering(self, walk: float) -> "_DisplacementRows":
        """The rows with encoders' offsets that wander by `walk` rad²/s."""
        more = _offset_covariance(self.t, self.jac, walk)
        return replace(self, chol=np.linalg.cholesky(self.chol @ self.chol.T + more))

    @property
    def cost(self) -> float:
        """−ln p (nats), up to a constant of all hypotheses."""
        return float(
            _nats_at_best_scale(
                np.square(forward_substituted(self.chol, self.r[:, None])).sum(), self.chol
            )
        )


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
    """Undo camera displacements in the tracks; the
    uncertainty of each is added to the model's variance.

    The arm's play, and errors of its encoders that last, are those of its exploration.
    Without effect if encoders read another function of the angle.
    """
    if evidence.encoders is None or "encoders" in body.senses:
        return evidence
    errors = learned_arm_errors(body)
    encoders = _remove_blunders(evidence.encoders)
    links = follow_links(encoders.t, encoders.values, body.joints, errors.play)
    encoders = replace(encoders, values=links)
    lasting = [errors.lasting.get(name, NO_ERRORS) for name in body.joints]
    sightings = list(evidence.sightings)
    faults = list[Fault]()
    hypotheses = list[Hypothesis]()
    tracks = [
        k for k, s in enumerate(sightings) if s.name != "touch" and s.model.outputs in TRACKED
    ]
    for name in dict.fromkeys(camera_of_track(sightings[k].name) for k in tracks):
        own = [k for k in tracks if camera_of_track(sightings[k].name) == name]
        for found in find_displacements(encoders, [sightings[k] for k in own], lasting):
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
                faults.append(_displacement_fault(name, found))
                for k in own:
                    sightings[k] = subtract_displacement(sightings[k], found)
    found_in = replace(evidence, sightings=tuple(sightings), faults=(*evidence.faults, *faults))
    return replace(found_in, hypotheses=(*evidence.hypotheses, *hypotheses))


def _remove_blunders(encoders: Encoders) -> Encoders:
    """The encoders without single readings that are far from both neighbours: the mean of a few
    readings would be off, and so would a link that they drag through its play.
    """
    y = encoders.values
    near = np.stack([y[:-2], y[1:-1], y[2:]])
    limit = np.maximum(BLUNDER_MEDIANS * np.sqrt(noise_variance(y)), OFFSET_STD)
    off = np.abs(y[1:-1] - np.median(near, axis=0)) > limit
    values = y.copy()
    values[1:-1][off] = np.nan
    return replace(encoders, values=values)


def _displacement_fault(name: str, found: CameraDisplacement) -> Fault:
    size = float(np.linalg.norm(found.size))
    std = float(np.sqrt(found.size @ found.cov @ found.size)) / size
    unit = TRACK_AXES[len(found.size)][1]
    return Fault("vision", name, FaultKind.DISPLACED, found.t, size, unit, std)


def subtract_displacement(sighting: Sighting, moved: CameraDisplacement) -> Sighting:
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


def find_displacements(
    encoders: Encoders, seen: Sequence[Sighting], lasting: Sequence[tuple[float, float]]
) -> list[CameraDisplacement]:
    """Return the displacements of one camera's tracks that win EVIDENCE_THRESHOLD_NATS, by time, or
    else the most likely one.

    lasting: σ (rad) and τ (s) of each encoder's errors that last. Empty where too little is seen.
    """
    found = [
        (s, curve)
        for s in seen
        if (curve := track_curve(encoders, s, MAX_READING_MEANS // len(seen))) is not None
    ]
    rows = _build_displacement_rows(found, np.array(lasting)) if found else None
    if rows is None or not len(rows.t):
        return []
    moves = _search_displacements(rows)
    if moves[0].nats > EVIDENCE_THRESHOLD_NATS:
        beyond = _gain_over_encoders(rows, moves)
        moves = [
            replace(one, nats=min(one.nats, beyond))
            for one in (moves if beyond > EVIDENCE_THRESHOLD_NATS else moves[:1])
        ]
    return sorted(moves, key=lambda one: one.t)


def _search_displacements(rows: _DisplacementRows) -> list[CameraDisplacement]:
    """Add displacements while each wins EVIDENCE_THRESHOLD_NATS, re-estimating the others each
    time; else the most likely one.
    """
    moves = [_best_displacement(rows)]
    while moves[-1].nats > EVIDENCE_THRESHOLD_NATS:
        more = [*moves, _best_displacement(rows.without(moves))]
        for k in range(len(more)):
            more[k] = _best_displacement(rows.without(more[:k] + more[k + 1 :]))
        if min(one.nats for one in more) <= EVIDENCE_THRESHOLD_NATS:
            break
        moves = more
    return moves


def _best_displacement(rows: _DisplacementRows) -> CameraDisplacement:
    """The most likely displacement, and the nats it wins."""
    # a priori as large as an encoder's offset shows, or 1e-3 px if joints do not move the track
    wide = max(PRIOR_STD_RAD * float(np.sqrt(np.square(rows.jac).mean())), 1e-3)
    found = _best_step(rows, np.eye(1 + rows.output.max())[rows.output], wide)
    return replace(found, nats=rows.cost - found.nats)


def _gain_over_encoders(rows: _DisplacementRows, moves: list[CameraDisplacement]) -> float:
    """Nats won by each move against the best alternative:
    encoders wander, one steps, or all err at first.

    Negative where residuals exceed the noise: the model is not linear
    over a large offset. A step of one encoder is as simple as one
    displacement, so it is compared with the first displacement alone.
    """
    white = forward_substituted(rows.chol, rows.without(moves).r[:, None])
    # the mean square is 1 where all noise is as stated
    if (poor := 4.0 * len(white) - np.square(white).sum()) < 0.0:
        return 0.5 * float(poor)
    wandering = [rows.wandering(walk).cost for walk in (RANDOM_WALKS[0], RANDOM_WALKS[2])]
    steps = min(_best_step(rows, lean[:, None], PRIOR_STD_RAD).nats for lean in rows.jac.T)
    settled = _best_step(rows, rows.jac, PRIOR_STD_RAD, until=True).nats
    # each given those before it: given those after it, too, displacements that cancel win twice
    won = [_best_displacement(rows.without(moves[:k])).nats for k in range(len(moves))]
    return min(
        steps - rows.cost + won[0], (min(settled, *wandering) - rows.cost + sum(won)) / len(moves)
    )


def _build_displacement_rows(
    found: Sequence[tuple[Sighting, Curve]], lasting: Array
) -> _DisplacementRows:
    """The tracks' curves beside the encoders, as rows whose
    covariance is that of a fixed camera and sound encoders.

    lasting (M,2): σ (rad) and τ (s) of each encoder's errors that last.
    """
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
                curve.at,
                np.full(len(curve.at), d),
                off[:, d],
                curve.jac[:, d],
                curve.encoder,
                speed[:, d],
            )
            parts.append(tuple(column[sound] for column in columns))
    t, output, r, jac, encoder, speed = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    # rows of one time share the same means of encoder readings
    cov = (t[:, None] == t) * ((jac * encoder) @ jac.T) + _offset_covariance(
        t, jac, RANDOM_WALKS[-1]
    )
    for (std, seconds), lean in zip(lasting, jac.T, strict=True):
        cov += np.outer(std * lean, std * lean) * np.exp(-np.abs(np.subtract.outer(t, t)) / seconds)
    # smaller delays are left
    cov += MIN_DELAY_S**2 * np.outer(speed, speed)
    for end, block in zip(np.cumsum([len(block) for block in own]).tolist(), own, strict=True):
        cov[end - len(block) : end, end - len(block) : end] += block
    return _DisplacementRows(t, output, r, jac, np.linalg.cholesky(cov))


def _offset_covariance(t: Array, jac: Array, walk: float) -> Array:
    """Covariance (R,R) px² added by encoders' offsets
    that wander by `walk` rad²/s; jac (R,M) px/rad.
    """
    since = t - t.min(initial=np.inf)
    return np.asarray((jac @ jac.T) * (OFFSET_STD**2 + walk * np.minimum.outer(since, since)))


def _best_step(
    rows: _DisplacementRows, basis: Array, wide: float, until: bool = False
) -> CameraDisplacement:
    """The most likely step along a basis (R,D), with D ~ N(0, wide²), and its time.

    Its `nats` is the cost, −ln p of all rows, averaged over
    all times of a step. `until`: it is undone at its time.
    """
    times = np.unique(rows.t)
    d = basis.shape[1]
    steps = basis[:, :, None] * ((rows.t[:, None] >= times) != until)[:, None, :]
    white = forward_substituted(
        rows.chol, np.column_stack([rows.r, steps.reshape(len(rows.t), -1)])
    )
    r = white[:, 0]
    s = white[:, 1:].reshape(len(rows.t), d, len(times))
    info = np.einsum("rdk,rek->kde", s, s) + np.eye(d) / wide**2
    pull = np.einsum("rdk,r->kd", s, r)
    size = np.linalg.solve(info, pull[..., None])[..., 0]
    won = 0.5 * (pull * size).sum(axis=1) - 0.5 * np.linalg.slogdet(wide**2 * info)[1]
    cost = _nats_at_best_scale(r @ r - 2.0 * won, rows.chol)
    best = int(cost.argmin())
    # all times are equally likely
    total = float(cost[best] - np.log(np.exp(cost[best] - cost).mean()))
    return CameraDisplacement(float(times[best]), size[best], np.linalg.inv(info[best]), total)


def _nats_at_best_scale(square: Array, chol: Array) -> Array:
    """−ln p (nats) from squared whitened residuals, at the most likely common noise scale ≥ 1."""
    scale = np.maximum(square / len(chol), 1.0)
    return np.asarray(
        0.5 * (square / scale + len(chol) * np.log(scale)) + np.log(np.diag(chol)).sum()
    )
