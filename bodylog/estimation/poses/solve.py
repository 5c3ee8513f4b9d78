"""Angles of still poses by robust Gauss–Newton, each from its own encoders and positions, all vectorised.

The cost of a pose is ½ Σ ρ(d) over its readings, d in standard deviations: d² within GATE, 2 GATE² ln beyond, so that
outliers lose influence with distance (the weight of a row is 1, then GATE²/d²).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...body_model import BodyModel
from ...types import Array
from ..inference.conditioning import GATE
from ..measurements.records import Encoders, Sighting
from ..measurements.timeline import union

GUESSES, CANDIDATES = 4, 400
"""Explored postures at which the search starts for poses without all encoders, and how many are compared."""


@dataclass(frozen=True, eq=False)
class Poses:
    """P poses: t (P,) s · source_ns · encoders z (P,M) rad, NaN if missing · positions y, var (P,K) of all tracks, px,
    px².

    The prior of an angle is `centre` (M,) with std `span` (M,) rad: the range in which the body's tracks were learned,
    or else the range of encoder readings. rows {sighting: its columns of K}.
    """

    t: Array
    source_ns: Array
    z: Array
    y: Array
    var: Array
    sightings: tuple[Sighting, ...]
    rows: tuple[slice, ...]
    centre: Array
    span: Array

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        """Predict at x (P,M) rad: positions (P,K) · Jacobian (P,K,M) · the model's variance (P,K)."""
        parts = [sighting.model.predict(x) for sighting in self.sightings]
        if not parts:
            return np.empty((len(x), 0)), np.empty((len(x), 0, x.shape[1])), np.empty((len(x), 0))
        g, jac, var = (np.concatenate(column, axis=1) for column in zip(*parts, strict=True))
        return g, jac, var


@dataclass(frozen=True, eq=False)
class Solved:
    """At each pose: x (P,M) rad · cov (P,M,M) · residuals (P,K), Jacobian (P,K,M), variance (P,K), weights 0..1 of the
    positions · encoder residuals e (P,M) rad and their weights · cost (P,), nats: minus the log density of the
    readings.
    """

    x: Array
    cov: Array
    r: Array
    jac: Array
    var: Array
    weight: Array
    e: Array
    encoder_weight: Array
    cost: Array


def gathered(encoders: Encoders | None, sightings: Sequence[Sighting], body: BodyModel) -> Poses:
    """Collect the readings of every pose, by time."""
    clocks = [s.t for s in sightings] + ([] if encoders is None else [encoders.t])
    t = union(*clocks)
    m, sources = len(body.joints), np.zeros(len(t), np.int64)
    z = np.full((len(t), m), np.nan)
    width = [s.values.shape[1] for s in sightings]
    ends = np.cumsum([0, *width]).tolist()
    rows = tuple(map(slice, ends, ends[1:]))
    y, var = np.full((len(t), ends[-1]), np.nan), np.ones((len(t), ends[-1]))
    for sighting, columns in zip(sightings, rows, strict=True):
        at = np.searchsorted(t, sighting.t)
        y[at, columns], var[at, columns], sources[at] = sighting.values, sighting.var, sighting.source_ns
    if encoders is not None:
        at = np.searchsorted(t, encoders.t)
        z[at], sources[at] = encoders.values, encoders.source_ns
    known = [model.samples for model in body.senses.values() if hasattr(model, "samples")]
    explored = np.concatenate(known) if known else z
    low, high = (np.nan_to_num(end.reduce(explored, axis=0, initial=np.nan)) for end in (np.fmin, np.fmax))
    # a joint that was hardly explored may still be anywhere near
    span = np.maximum(high - low, 0.1)
    return Poses(t, sources, z, y, var, tuple(sightings), rows, (low + high) / 2.0, span)


def solved(poses: Poses, encoder: Array, offset: Array, start: Array | None = None) -> Solved:
    """Most likely angles of every pose for encoder variances (M,) rad² and offsets (M,) rad, from x (P,M) if given."""
    if start is not None:
        return descended(poses, encoder, offset, start)
    z = poses.z - offset
    first = np.where(np.isfinite(z), z, poses.centre)
    best = descended(poses, encoder, offset, first)
    loose = np.flatnonzero(~np.isfinite(z).all(axis=1) & np.isfinite(poses.y).any(axis=1))
    if not len(loose):
        return best
    some = subset(poses, loose)
    for guess in guesses(some, encoder, offset):
        tried = descended(some, encoder, offset, guess)
        better = tried.cost < best.cost[loose] - 1e-9
        best = merged(best, tried, loose[better], better)
    return best


def subset(poses: Poses, chosen: Array) -> Poses:
    """Some of the poses."""
    return replace(poses, **{name: getattr(poses, name)[chosen] for name in ("t", "source_ns", "z", "y", "var")})


def merged(whole: Solved, some: Solved, rows: Array, chosen: Array) -> Solved:
    """The solution with `rows` replaced by those chosen (bool) of another."""
    columns = {name: values.copy() for name, values in vars(whole).items()}
    for name, values in columns.items():
        values[rows] = getattr(some, name)[chosen]
    return Solved(**columns)


def guesses(poses: Poses, encoder: Array, offset: Array) -> Array:
    """Explored postures (G,P,M) rad nearest to the readings of each pose."""
    known = [s.model.samples for s in poses.sightings if hasattr(s.model, "samples")]
    x = np.concatenate(known)
    x = x[np.unique(np.linspace(0, len(x) - 1, min(len(x), CANDIDATES)).round().astype(int))]
    g = poses.predict(x)[0]
    far = np.zeros((len(poses.t), len(x)))
    for k in range(g.shape[1]):
        seen = np.isfinite(poses.y[:, k])
        far[seen] += (poses.y[seen, k, None] - g[None, :, k]) ** 2 / np.maximum(np.var(g[:, k]), 1e-12)
    z = poses.z - offset
    apart = (z[:, None] - x[None]) ** 2 / poses.span**2
    far += np.where(np.isfinite(apart), apart, 0.0).sum(axis=2)
    nearest = np.argsort(far, axis=1, kind="stable")[:, :GUESSES].T
    return np.where(np.isfinite(z), z, x[nearest])


def descended(poses: Poses, encoder: Array, offset: Array, x: Array) -> Solved:
    """Gauss–Newton with damping for each pose, raised where a step does not lower the cost at fixed variances."""
    now, damp = _at(poses, encoder, offset, x), np.full(len(x), 1e-6)
    active = np.ones(len(x), bool)
    for _ in range(60):
        step = _step(poses, encoder, now, damp)
        tried = _at(poses, encoder, offset, np.where(active[:, None], now.x + step, now.x))
        before, after = (_misfit(poses, at, now.var, encoder) for at in (now, tried))
        better = active & (after <= before + 1e-12)
        size = np.abs(step) / np.sqrt(np.einsum("pmm->pm", now.cov))
        resting = size.max(axis=1) < 1e-7  # standard deviations
        damp = np.where(better, np.maximum(damp * 0.1, 1e-9), damp * 10.0)
        now = merged(now, tried, np.flatnonzero(better), better)
        active &= ~resting & (damp < 1e9)
        if not active.any():
            break
    return now


def _step(poses: Poses, encoder: Array, now: Solved, damp: Array) -> Array:
    """The Gauss–Newton step (P,M), damped along the posterior's axes (Levenberg–Marquardt)."""
    pull = np.einsum("pkm,pk->pm", now.jac, now.weight * now.r / now.var)
    pull += now.encoder_weight * now.e / encoder + (poses.centre - now.x) / poses.span**2
    information = np.linalg.inv(now.cov)
    information += damp[:, None, None] * np.eye(now.x.shape[1]) * np.einsum("pmm->pm", information)[:, None]
    return np.asarray(np.linalg.solve(information, pull[..., None])[..., 0])


def _at(poses: Poses, encoder: Array, offset: Array, x: Array) -> Solved:
    """Residuals, weights, covariance and cost at x (P,M)."""
    g, jac, model = poses.predict(x)
    var, seen, known = model + poses.var, np.isfinite(poses.y), np.isfinite(poses.z)
    r, e = np.where(seen, poses.y - g, 0.0), np.where(known, poses.z - offset - x, 0.0)
    weight, encoder_weight = weights(r, var) * seen, weights(e, encoder) * known
    information = np.einsum("pki,pk,pkj->pij", jac, weight / var, jac)
    information += np.eye(x.shape[1]) * (encoder_weight / encoder + poses.span**-2.0)[:, None]
    found = Solved(x, np.linalg.inv(information), r, jac, var, weight, e, encoder_weight, np.empty(len(x)))
    logs = (np.log(2.0 * np.pi * var) * seen).sum(axis=1) + (np.log(2.0 * np.pi * encoder) * known).sum(axis=1)
    logs += np.linalg.slogdet(information)[1] + 2.0 * np.log(poses.span).sum()
    return replace(found, cost=_misfit(poses, found, var, encoder) + 0.5 * logs)


def _misfit(poses: Poses, at: Solved, var: Array, encoder: Array) -> Array:
    """Half the robust squares (P,) of all readings and of the prior, with variances (P,K) px² and (M,) rad²."""
    away = np.square((at.x - poses.centre) / poses.span)
    return np.asarray(costs(at.r, var).sum(axis=1) + costs(at.e, encoder).sum(axis=1) + 0.5 * away.sum(axis=1))


def weights(r: Array, var: Array) -> Array:
    """Weights of residuals with their variances: 1 within the gate of d standard deviations, GATE²/d² beyond."""
    return np.asarray(1.0 / np.maximum(np.square(r) / (GATE**2 * var), 1.0))


def costs(r: Array, var: Array) -> Array:
    """Half the robust squares of residuals with their variances, nats."""
    over = np.square(r) / (GATE**2 * var)
    return np.asarray(0.5 * GATE**2 * (np.minimum(over, 1.0) + np.log(np.maximum(over, 1.0))))
