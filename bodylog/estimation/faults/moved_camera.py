"""A moved camera: from some time on, everything it shows is displaced by the same pixels.

Means of encoder readings predict positions. The residuals r (R,) px of a track's curve are normal with covariance C:
noise, model error (correlated by posture), and wandering offsets of all encoders. A displacement Δ ~ N(0, σ²I) from the
k-th mean on, with all k equally likely, adds ½ bᵀA⁻¹b − ½ ln|σ²A| to ln p(r), where A = SᵀC⁻¹S + I/σ² and b = SᵀC⁻¹r.
It must win against no displacement, against encoders that all wander, and against one encoder that wanders far.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...body_model import BodyModel, ForwardModel
from ...linear_algebra import forward_substituted
from ...types import Array, Fault, Hypothesis
from ..inference.conditioning import GATE
from ..inference.initial_path import OFFSET_STD
from ..measurements.gather import camera
from ..measurements.records import Encoders, Evidence, Sighting
from ..measurements.track_curve import Curve, interpolated, track_curve
from .contract import Verdict
from .encoder_offset import WALKS
from .threshold import FAR, NATS

PIXELS = ("u", "v")
"""Outputs of a track in the image."""
SIZE = 30.0
"""px: prior standard deviation of a camera's displacement."""
MOST = 160
"""Most means of encoder readings, evenly spread: the cost grows with their third power."""
FAST = 1e-2
"""rad²/s: random walk of one faulty encoder."""
LATE = 2e-3
"""s: std of the delay left after correction."""
BESIDE = 5
"""Rows of the median beside which a row that is far off counts less, as in the filter."""
POOR = 4.0
"""Largest mean square of whitened residuals after the displacements; 1 where all noise is as stated."""
MOVES = 3
"""Most displacements of one camera."""


@dataclass(frozen=True, eq=False)
class Displacement:
    """A displacement (2,) px since t (s), its covariance (2,2), and the nats won against all other explanations."""

    t: float
    size: Array
    cov: Array
    nats: float


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows of all tracks at t (R,) s: track and output (R,) · postures x (R,M) · r (R,) px · jac (R,M) · noise (R,)
    px², encoder variance (R,M) rad² of the means, model variance (R,) px² · speed (R,) px/s · reach (R,M) rad.
    """

    t: Array
    track: Array
    output: Array
    x: Array
    r: Array
    jac: Array
    noise: Array
    encoder: Array
    model: Array
    speed: Array
    reach: Array


def detect(evidence: Evidence, body: BodyModel) -> Verdict:
    """Undo camera displacements in the tracks; the uncertainty of each is added to the model's variance.

    Without effect if encoders read another function of the angle.
    """
    if evidence.encoders is None or "encoders" in body.senses:
        return Verdict(evidence)
    sightings, faults, hypotheses = list(evidence.sightings), list[Fault](), list[Hypothesis]()
    tracks = [k for k, s in enumerate(sightings) if s.name != "touch" and s.model.outputs == PIXELS]
    for name in dict.fromkeys(camera(sightings[k].name) for k in tracks):
        own = [k for k in tracks if camera(sightings[k].name) == name]
        for found in displacements(evidence.encoders, [sightings[k] for k in own]):
            hypotheses.append(Hypothesis("camera moved", name, found.nats, NATS, found.nats > NATS))
            if found.nats > NATS:
                faults.append(_fault(name, found))
                for k in own:
                    sightings[k] = undisplaced(sightings[k], found)
    found_in = replace(evidence, sightings=tuple(sightings))
    return Verdict(found_in, tuple(faults), (), tuple(hypotheses))


def _fault(name: str, found: Displacement) -> Fault:
    size = float(np.hypot(*found.size))
    std = float(np.sqrt(found.size @ found.cov @ found.size)) / size
    return Fault("vision", name, "displaced", found.t, size, "px", std)


def undisplaced(sighting: Sighting, moved: Displacement) -> Sighting:
    """Return the sighting with the displacement subtracted from its time on."""
    off = (sighting.t >= moved.t)[:, None] * moved.size
    before = np.zeros_like(sighting.values) if sighting.displaced is None else sighting.displaced
    unsure = InflatedVariance(sighting.model, np.diag(moved.cov))
    return replace(sighting, model=unsure, values=sighting.values - off, displaced=before + off)


class InflatedVariance:
    """A forward model with added variance (D,) unit²; otherwise the plain model."""

    def __init__(self, plain: ForwardModel, added: Array) -> None:
        """Wrap a plain model."""
        self._plain, self._added = plain, added

    def __getattr__(self, name: str) -> Any:
        """An attribute of the plain model."""
        if name.startswith("__") or name == "_plain":
            raise AttributeError(name)
        return getattr(self._plain, name)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the D outputs."""
        return self._plain.outputs

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        """Predict at x (N,M) rad: mean (N,D) · Jacobian (N,D,M) per rad · variance (N,D)."""
        mean, jac, var = self._plain.predict(x)
        return mean, jac, var + self._added


def displacements(encoders: Encoders, seen: Sequence[Sighting]) -> list[Displacement]:
    """Return the displacements of one camera's tracks that win NATS, by time, or else the most likely one.

    Empty where too little is seen.
    """
    found = [(s, curve) for s in seen if (curve := track_curve(encoders, s, MOST // len(seen))) is not None]
    rows = _rows(found) if found else None
    if rows is None or not len(rows.t):
        return []
    cov = _robust_covariance(rows)
    moves = _displacements(rows, cov)
    if moves[0].nats > NATS:
        beyond = _gain_over_encoders(rows, cov, moves)
        moves = [replace(one, nats=min(one.nats, beyond)) for one in (moves if beyond > NATS else moves[:1])]
    return sorted(moves, key=lambda one: one.t)


def _robust_covariance(rows: _Rows) -> Array:
    """Covariance (R,R) with variance added to rows far from the median of their neighbours."""
    cov, far = _covariance(rows), np.zeros(len(rows.t))
    spread = np.sqrt(np.diag(cov))
    for track, output in {*zip(rows.track.tolist(), rows.output.tolist(), strict=True)}:
        own = np.flatnonzero((rows.track == track) & (rows.output == output))
        if len(own) >= BESIDE:
            # a median preserves a step
            beside = np.lib.stride_tricks.sliding_window_view(np.pad(rows.r[own], BESIDE // 2, "edge"), BESIDE)
            far[own] = np.abs(rows.r[own] - np.median(beside, axis=1)) / (GATE * spread[own])
    cov[np.diag_indices_from(cov)] += rows.noise * (np.maximum(far, 1.0) ** 2 - 1.0)
    return cov


def _displacements(rows: _Rows, cov: Array) -> list[Displacement]:
    """Add displacements while each wins NATS, re-estimating the others each time; else the most likely one."""
    moves = [_best_displacement(rows, cov, [])]
    while moves[-1].nats > NATS and len(moves) < MOVES:
        more = [*moves, _best_displacement(rows, cov, moves)]
        for k in range(len(more)):
            more[k] = _best_displacement(rows, cov, more[:k] + more[k + 1 :])
        if min(one.nats for one in more) <= NATS:
            break
        moves = more
    return moves


def _best_displacement(rows: _Rows, cov: Array, others: list[Displacement]) -> Displacement:
    """The most likely displacement given the others, and the nats it wins."""
    left = replace(rows, r=_residuals(rows, others))
    found, none = _best_step(left, cov, np.eye(2)[rows.output], SIZE)
    return replace(found, nats=none - found.nats)


def _residuals(rows: _Rows, moves: list[Displacement]) -> Array:
    """Residuals (R,) px after the displacements."""
    return np.asarray(rows.r - sum(one.size[rows.output] * (rows.t >= one.t) for one in moves))


def _gain_over_encoders(rows: _Rows, cov: Array, moves: list[Displacement]) -> float:
    """Nats won against the best alternative: encoders wander, one wanders far, steps, or all err at first.

    Negative where residuals exceed the noise: the model is not linear over a large offset. A step of one encoder is as
    simple as one displacement, so it is compared with the first displacement alone.
    """
    joints, none = range(rows.x.shape[1]), _cost(rows.r, cov)
    white = forward_substituted(np.linalg.cholesky(cov), _residuals(rows, moves)[:, None])
    if (poor := POOR * len(white) - np.square(white).sum()) < 0.0:
        return 0.5 * float(poor)
    wander = [_offset_covariance(rows, rows.jac, OFFSET_STD, walk) for walk in (WALKS[0], WALKS[2])]
    wander += [_offset_covariance(rows, rows.jac[:, joint, None], FAR, FAST) for joint in joints]
    # each given those before it: given those after it, too, displacements that cancel win twice
    moved = none - sum(_best_displacement(rows, cov, moves[:k]).nats for k in range(len(moves)))
    one = none - moves[0].nats if len(moves) == 1 else none - _best_displacement(rows, cov, []).nats
    steps = min(_best_step(rows, cov, rows.jac[:, joint, None], FAR)[0].nats for joint in joints)
    settled = _best_step(rows, cov, rows.jac, FAR, until=True)[0].nats
    return min(steps - one, settled - moved, min(_cost(rows.r, cov + more) for more in wander) - moved)


def _rows(found: Sequence[tuple[Sighting, Curve]]) -> _Rows:
    """The tracks' curves beside the encoders, as rows."""
    parts = []
    for number, (sighting, curve) in enumerate(found):
        place, speed, *_, sound = interpolated(curve, 0.0)
        noise = np.broadcast_to(curve.noise, place.shape)
        reach = np.broadcast_to(getattr(sighting.model, "reach", np.inf), curve.x.shape)
        track, off = np.full(len(curve.at), number), place - curve.predicted
        for d in range(off.shape[1]):
            columns = (
                curve.at, track, np.full(len(track), d), curve.x, off[:, d], curve.jac[:, d], noise[:, d],
                curve.encoder, curve.model[:, d], speed[:, d], reach,
            )  # fmt: skip
            parts.append(tuple(column[sound] for column in columns))
    return _Rows(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _covariance(rows: _Rows) -> Array:
    """Covariance (R,R) px² of r with a fixed camera and sound encoders."""
    # rows of one time share the same means of encoder readings
    cov = (rows.t[:, None] == rows.t) * ((rows.jac * rows.encoder) @ rows.jac.T)
    cov += LATE**2 * np.outer(rows.speed, rows.speed)
    cov += _offset_covariance(rows, rows.jac, OFFSET_STD, WALKS[-1])
    model, place = np.sqrt(rows.model), (rows.x / rows.reach).T
    for track, output in {*zip(rows.track.tolist(), rows.output.tolist(), strict=True)}:
        own = np.flatnonzero((rows.track == track) & (rows.output == output))
        apart = sum(np.square(np.subtract.outer(x, x)) for x in place[:, own])
        cov[np.ix_(own, own)] += np.outer(model[own], model[own]) * np.exp(-0.5 * apart)
    cov[np.diag_indices_from(cov)] += rows.noise
    return np.asarray(cov)


def _offset_covariance(rows: _Rows, leans: Array, offset: float, walk: float) -> Array:
    """Covariance (R,R) px² added by offsets of std `offset` (rad) that wander by `walk` (rad²/s).

    leans (R,J) px/rad: Jacobian of the encoders that have one.
    """
    since = rows.t - rows.t.min()
    return np.asarray((leans @ leans.T) * (offset**2 + walk * np.minimum.outer(since, since)))


def _best_step(
    rows: _Rows, cov: Array, basis: Array, wide: float, until: bool = False
) -> tuple[Displacement, float]:  # fmt: skip
    """The most likely step along a basis (R,D), with D ~ N(0, wide²), and its time; the cost (nats) without one.

    Its `nats` is the cost, −ln p of all rows, averaged over all times of a step. `until`: it is undone at its time.
    """
    times, d = np.unique(rows.t), basis.shape[1]
    chol = np.linalg.cholesky(cov)
    steps = basis[:, :, None] * ((rows.t[:, None] >= times) != until)[:, None, :]
    white = forward_substituted(chol, np.column_stack([rows.r, steps.reshape(len(rows.t), -1)]))
    r, s = white[:, 0], white[:, 1:].reshape(len(rows.t), d, len(times))
    info = np.einsum("rdk,rek->kde", s, s) + np.eye(d) / wide**2
    pull = np.einsum("rdk,r->kd", s, r)
    size = np.linalg.solve(info, pull[..., None])[..., 0]
    won = 0.5 * (pull * size).sum(axis=1) - 0.5 * np.linalg.slogdet(wide**2 * info)[1]
    square = r @ r - 2.0 * won
    logdet = 2.0 * float(np.log(np.diag(chol)).sum())
    cost = _scaled_nats(square, len(r)) + 0.5 * logdet
    best = int(cost.argmin())
    # all times are equally likely
    total = float(cost[best] - np.log(np.exp(cost[best] - cost).mean()))
    none = float(_scaled_nats(r @ r, len(r)) + 0.5 * logdet)
    return Displacement(float(times[best]), size[best], np.linalg.inv(info[best]), total), none


def _cost(r: Array, cov: Array) -> float:
    """−ln p (nats) of rows r (R,) without a displacement, up to a constant of all hypotheses."""
    chol = np.linalg.cholesky(cov)
    white = forward_substituted(chol, r[:, None])
    return float(_scaled_nats(np.square(white).sum(), len(r)) + np.log(np.diag(chol)).sum())


def _scaled_nats(square: Array, count: int) -> Array:
    """−ln p (nats) from squared whitened residuals, at the most likely common noise scale ≥ 1."""
    scale = np.maximum(square / count, 1.0)
    return np.asarray(0.5 * (square / scale + count * np.log(scale)))
