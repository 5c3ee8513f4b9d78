"""A moved camera: from some time on, everything it shows is displaced by the same pixels.

Means of encoder readings predict positions. The residuals r (R,) px of a track's curve are normal with covariance C:
noise, model error (correlated by posture), and wandering offsets of all encoders. A displacement Δ ~ N(0, σ²I) from the
k-th mean on, with all k equally likely, adds ½ bᵀA⁻¹b − ½ ln|σ²A| to ln p(r), where A = SᵀC⁻¹S + I/σ² and b = SᵀC⁻¹r.
It must win against no displacement, encoders that wander, one that wanders far or steps, and all wrong at first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...body_model import BodyModel, ForwardModel
from ...linear_algebra import forward_substituted
from ...types import Array, Fault, Hypothesis
from ..inference.initial_path import OFFSET_STD
from ..measurements.gather import camera
from ..measurements.records import Encoders, Evidence, Sighting
from ..measurements.track_curve import Curve, interpolated, track_curve
from .encoder_offset import WALKS
from .threshold import FAR, LATE, NATS

MOST = 160
"""Most means of encoder readings, evenly spread: the cost grows with their third power."""
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
    """Rows of all tracks at t (R,) s: number of track and output (R,), and output (R,) · postures x (R,M) in the
    model's length scales · r (R,) px · jac (R,M) · noise (R,) px², encoder variance (R,M) rad² of the means, model
    variance (R,) px² · speed (R,) px/s.
    """

    t: Array
    number: Array
    output: Array
    x: Array
    r: Array
    jac: Array
    noise: Array
    encoder: Array
    model: Array
    speed: Array


class _Unsure:
    """A forward model with added variance (D,) unit²; otherwise the plain model."""

    def __init__(self, plain: ForwardModel, added: Array) -> None:
        self._plain, self._added, self.outputs = plain, added, plain.outputs

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "_plain":
            raise AttributeError(name)
        return getattr(self._plain, name)

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        mean, jac, var = self._plain.predict(x)
        return mean, jac, var + self._added


def detect(evidence: Evidence, body: BodyModel) -> Evidence:
    """Undo camera displacements in the tracks; the uncertainty of each is added to the model's variance.

    Without effect if encoders read another function of the angle.
    """
    if evidence.encoders is None or "encoders" in body.senses:
        return evidence
    sightings, faults, hypotheses = list(evidence.sightings), list[Fault](), list[Hypothesis]()
    tracks = [k for k, s in enumerate(sightings) if s.name != "touch" and s.model.outputs == ("u", "v")]
    for name in dict.fromkeys(camera(sightings[k].name) for k in tracks):
        own = [k for k in tracks if camera(sightings[k].name) == name]
        for found in displacements(evidence.encoders, [sightings[k] for k in own]):
            hypotheses.append(Hypothesis("camera moved", name, found.nats, NATS, found.nats > NATS))
            if found.nats > NATS:
                faults.append(_fault(name, found))
                for k in own:
                    sightings[k] = undisplaced(sightings[k], found)
    found_in = replace(evidence, sightings=tuple(sightings), faults=(*evidence.faults, *faults))
    return replace(found_in, hypotheses=(*evidence.hypotheses, *hypotheses))


def _fault(name: str, found: Displacement) -> Fault:
    size = float(np.hypot(*found.size))
    std = float(np.sqrt(found.size @ found.cov @ found.size)) / size
    return Fault("vision", name, "displaced", found.t, size, "px", std)


def undisplaced(sighting: Sighting, moved: Displacement) -> Sighting:
    """Return the sighting with the displacement subtracted from its time on."""
    off = (sighting.t >= moved.t)[:, None] * moved.size
    before = np.zeros_like(sighting.values) if sighting.displaced is None else sighting.displaced
    unsure = _Unsure(sighting.model, np.diag(moved.cov))
    return replace(sighting, model=unsure, values=sighting.values - off, displaced=before + off)


def displacements(encoders: Encoders, seen: Sequence[Sighting]) -> list[Displacement]:
    """Return the displacements of one camera's tracks that win NATS, by time, or else the most likely one.

    Empty where too little is seen.
    """
    found = [(s, curve) for s in seen if (curve := track_curve(encoders, s, MOST // len(seen))) is not None]
    rows = _rows(found) if found else None
    if rows is None or not len(rows.t):
        return []
    cov = _covariance(rows)
    moves = _displacements(rows, np.linalg.cholesky(cov))
    if moves[0].nats > NATS:
        beyond = _gain_over_encoders(rows, cov, moves)
        moves = [replace(one, nats=min(one.nats, beyond)) for one in (moves if beyond > NATS else moves[:1])]
    return sorted(moves, key=lambda one: one.t)


def _displacements(rows: _Rows, chol: Array) -> list[Displacement]:
    """Add displacements while each wins NATS, re-estimating the others each time; else the most likely one."""
    moves = [_best_displacement(rows, chol, [])]
    while moves[-1].nats > NATS and len(moves) < MOVES:
        more = [*moves, _best_displacement(rows, chol, moves)]
        for k in range(len(more)):
            more[k] = _best_displacement(rows, chol, more[:k] + more[k + 1 :])
        if min(one.nats for one in more) <= NATS:
            break
        moves = more
    return moves


def _best_displacement(rows: _Rows, chol: Array, others: list[Displacement]) -> Displacement:
    """The most likely displacement given the others, and the nats it wins."""
    left = replace(rows, r=_residuals(rows, others))
    # a priori as large as an encoder's offset shows, or 1e-3 px if joints do not move the track
    wide = max(FAR * float(np.sqrt(np.square(rows.jac).mean())), 1e-3)
    found = _best_step(left, chol, np.eye(2)[rows.output], wide)
    return replace(found, nats=_cost(left.r, chol) - found.nats)


def _residuals(rows: _Rows, moves: list[Displacement]) -> Array:
    """Residuals (R,) px after the displacements."""
    return np.asarray(rows.r - sum(one.size[rows.output] * (rows.t >= one.t) for one in moves))


def _gain_over_encoders(rows: _Rows, cov: Array, moves: list[Displacement]) -> float:
    """Nats won against the best alternative: encoders wander, one wanders far, steps, or all err at first.

    Negative where residuals exceed the noise: the model is not linear over a large offset. A step of one encoder is as
    simple as one displacement, so it is compared with the first displacement alone.
    """
    joints, chol = range(rows.jac.shape[1]), np.linalg.cholesky(cov)
    none, white = _cost(rows.r, chol), forward_substituted(chol, _residuals(rows, moves)[:, None])
    # the mean square is 1 where all noise is as stated
    if (poor := 4.0 * len(white) - np.square(white).sum()) < 0.0:
        return 0.5 * float(poor)
    offsets = [_offset_covariance(rows, rows.jac, OFFSET_STD, walk) for walk in (WALKS[0], WALKS[2])]
    offsets += [_offset_covariance(rows, rows.jac[:, joint, None], FAR, WALKS[2]) for joint in joints]
    # each given those before it: given those after it, too, displacements that cancel win twice
    won = [_best_displacement(rows, chol, moves[:k]).nats for k in range(len(moves))]
    steps = min(_best_step(rows, chol, rows.jac[:, joint, None], FAR).nats for joint in joints)
    settled = _best_step(rows, chol, rows.jac, FAR, until=True).nats
    others = min(settled, *(_cost(rows.r, np.linalg.cholesky(cov + one)) for one in offsets))
    return min(steps - none + won[0], others - none + sum(won))


def _rows(found: Sequence[tuple[Sighting, Curve]]) -> _Rows:
    """The tracks' curves beside the encoders, as rows."""
    parts = []
    for track, (sighting, curve) in enumerate(found):
        place, speed, *_, sound = interpolated(curve, 0.0)
        x, off = curve.x / getattr(sighting.model, "reach", np.inf), place - curve.predicted
        for d in range(2):
            number, output = np.full_like(curve.at, 2 * track + d, int), np.full_like(curve.at, d, int)
            noise = np.full_like(curve.at, curve.noise[d])
            columns = (curve.at, number, output, x, off[:, d], curve.jac[:, d], noise, curve.encoder, curve.model[:, d])
            parts.append(tuple(column[sound] for column in (*columns, speed[:, d])))
    return _Rows(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _covariance(rows: _Rows) -> Array:
    """Covariance (R,R) px² of r with a fixed camera and sound encoders."""
    # rows of one time share the same means of encoder readings
    cov = (rows.t[:, None] == rows.t) * ((rows.jac * rows.encoder) @ rows.jac.T)
    # smaller delays are left
    cov += LATE**2 * np.outer(rows.speed, rows.speed)
    cov += _offset_covariance(rows, rows.jac, OFFSET_STD, WALKS[-1])
    model = np.sqrt(rows.model)
    for own in (np.flatnonzero(rows.number == number) for number in np.unique(rows.number)):
        apart = sum(np.square(np.subtract.outer(x, x)) for x in rows.x[own].T)
        cov[np.ix_(own, own)] += np.outer(model[own], model[own]) * np.exp(-0.5 * apart)
    cov[np.diag_indices_from(cov)] += rows.noise
    return np.asarray(cov)


def _offset_covariance(rows: _Rows, lean: Array, std: float, walk: float) -> Array:
    """Covariance (R,R) px² added by encoders' offsets of `std` rad that wander by `walk` rad²/s; lean (R,J) px/rad."""
    since = rows.t - rows.t.min()
    return np.asarray((lean @ lean.T) * (std**2 + walk * np.minimum.outer(since, since)))


def _best_step(rows: _Rows, chol: Array, basis: Array, wide: float, until: bool = False) -> Displacement:
    """The most likely step along a basis (R,D), with D ~ N(0, wide²), and its time.

    Its `nats` is the cost, −ln p of all rows, averaged over all times of a step. `until`: it is undone at its time.
    """
    times, d = np.unique(rows.t), basis.shape[1]
    steps = basis[:, :, None] * ((rows.t[:, None] >= times) != until)[:, None, :]
    white = forward_substituted(chol, np.column_stack([rows.r, steps.reshape(len(rows.t), -1)]))
    r, s = white[:, 0], white[:, 1:].reshape(len(rows.t), d, len(times))
    info = np.einsum("rdk,rek->kde", s, s) + np.eye(d) / wide**2
    pull = np.einsum("rdk,r->kd", s, r)
    size = np.linalg.solve(info, pull[..., None])[..., 0]
    won = 0.5 * (pull * size).sum(axis=1) - 0.5 * np.linalg.slogdet(wide**2 * info)[1]
    cost = _nats(r @ r - 2.0 * won, chol)
    best = int(cost.argmin())
    # all times are equally likely
    total = float(cost[best] - np.log(np.exp(cost[best] - cost).mean()))
    return Displacement(float(times[best]), size[best], np.linalg.inv(info[best]), total)


def _cost(r: Array, chol: Array) -> float:
    """−ln p (nats) of rows r (R,) without a displacement, up to a constant of all hypotheses."""
    return float(_nats(np.square(forward_substituted(chol, r[:, None])).sum(), chol))


def _nats(square: Array, chol: Array) -> Array:
    """−ln p (nats) from squared whitened residuals, at the most likely common noise scale ≥ 1."""
    scale = np.maximum(square / len(chol), 1.0)
    return np.asarray(0.5 * (square / scale + len(chol) * np.log(scale)) + np.log(np.diag(chol)).sum())
