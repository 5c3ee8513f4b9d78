"""Angles of still poses by robust Gauss–Newton, each
from its own encoders and positions, all vectorised.

The cost of a pose is ½ Σ ρ(d) over its readings, d in standard
deviations: d² within GATE_SIGMA, 2 GATE² ln beyond, so that outliers
lose influence with distance (the weight of a row is 1, then GATE²/d²).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ...body_model import BodyModel
from ...types import Array
from ..inference.gate import GATE_SIGMA
from ..measurements.records import Encoders, Sighting
from ..measurements.timeline import merge_clocks


@dataclass(frozen=True, eq=False)
class StillPoses:
    """P poses: t (P,) s · source_ns · readings y (P,R), NaN if missing, with variances var (P,R).

    The first M rows are encoders, rad; those of each sighting follow, px. The prior of an angle is
    `centre` (M,) with std `span` (M,) rad: the range in which the body's tracks were learned, or
    else the range of encoder readings.
    """

    t: Array
    source_ns: Array
    y: Array
    var: Array
    sightings: tuple[Sighting, ...]
    centre: Array
    span: Array

    def rows(self) -> list[slice]:
        """The rows of each sighting."""
        return _sighting_columns(len(self.centre), self.sightings)

    def encoded(self, variance: Array, offset: Array) -> "StillPoses":
        """The same with encoders of `variance` (M,) rad², their `offset` (M,) rad subtracted."""
        m = len(offset)
        y = self.y.copy()
        var = self.var.copy()
        y[:, :m] -= offset
        var[:, :m] = variance
        return replace(self, y=y, var=var)

    def some(self, chosen: Array) -> "StillPoses":
        """Some of the poses."""
        return replace(
            self, **{name: getattr(self, name)[chosen] for name in ("t", "source_ns", "y", "var")}
        )

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        """Predict at x (P,M) rad: readings (P,R) ·
        Jacobian (P,R,M) · the model's variance (P,R).
        """
        encoders = x, np.broadcast_to(np.eye(x.shape[1]), (*x.shape, x.shape[1])), np.zeros(x.shape)
        parts = zip(
            encoders, *(sighting.model.predict(x) for sighting in self.sightings), strict=True
        )
        g, jac, var = (np.concatenate(part, axis=1) for part in parts)
        return g, jac, var


@dataclass(frozen=True, eq=False)
class SolvedPoses:
    """At each pose: x (P,M) rad · cov (P,M,M) · of the readings,
    residuals r (P,R), Jacobian (P,R,M), variance (P,R) and weights
    0..1 · cost (P,), nats: minus the log density of the readings.
    """

    x: Array
    cov: Array
    r: Array
    jac: Array
    var: Array
    weight: Array
    cost: Array


def collect_pose_readings(
    encoders: Encoders | None, sightings: Sequence[Sighting], body: BodyModel
) -> StillPoses:
    """Collect the readings of every pose, by time."""
    read = () if encoders is None else (encoders,)
    columns = _sighting_columns(len(body.joints), sightings)
    t = merge_clocks(*(sense.t for sense in (*sightings, *read)))
    width = columns[-1].stop if columns else len(body.joints)
    y = np.full((len(t), width), np.nan)
    var = np.ones((len(t), width))
    sources = np.zeros(len(t), np.int64)
    for sense, own in zip(
        (*sightings, *read), (*columns, slice(0, len(body.joints))), strict=False
    ):
        at = np.searchsorted(t, sense.t)
        y[at, own], sources[at] = sense.values, sense.source_ns
        var[at, own] = sense.var if isinstance(sense, Sighting) else 1.0
    known = [model.samples for model in body.senses.values() if hasattr(model, "samples")]
    explored = np.concatenate(known) if known else y[:, : len(body.joints)]
    low, high = (
        np.nan_to_num(end.reduce(explored, axis=0, initial=np.nan)) for end in (np.fmin, np.fmax)
    )
    # a joint that was hardly explored may still be anywhere near
    return StillPoses(
        t, sources, y, var, tuple(sightings), (low + high) / 2.0, np.maximum(high - low, 0.1)
    )


def _sighting_columns(first: int, sightings: Sequence[Sighting]) -> list[slice]:
    """Columns of each sighting beside each other, the first one's from `first` on."""
    ends = np.cumsum([first, *(s.values.shape[1] for s in sightings)]).tolist()
    return [slice(*each) for each in pairwise(ends)]


def solve_poses(poses: StillPoses, start: Array | None = None) -> SolvedPoses:
    """Most likely angles of every pose, from x (P,M) rad if given."""
    if start is not None:
        return descend_poses(poses, start)
    z = poses.y[:, : len(poses.centre)]
    best = descend_poses(poses, np.where(np.isfinite(z), z, poses.centre))
    loose = np.flatnonzero(
        ~np.isfinite(z).all(axis=1) & np.isfinite(poses.y[:, z.shape[1] :]).any(axis=1)
    )
    if not len(loose):
        return best
    tried = descend_poses(poses.some(loose), _guess_postures(poses.some(loose)))
    better = tried.cost < best.cost[loose] - 1e-9
    return _replace_solved_poses(best, tried, loose[better], better)


def _replace_solved_poses(
    whole: SolvedPoses, some: SolvedPoses, rows: Array, chosen: Array
) -> SolvedPoses:
    """The solution with `rows` replaced by those chosen (bool) of another."""
    columns = {name: values.copy() for name, values in vars(whole).items()}
    for name, values in columns.items():
        values[rows] = getattr(some, name)[chosen]
    return SolvedPoses(**columns)


def _guess_postures(poses: StillPoses) -> Array:
    """Angles (P,M) rad from which to search: those of
    least cost after one step from each explored posture.
    """
    z = poses.y[:, : len(poses.centre)]
    least = np.full(len(poses.t), np.inf)
    guess = np.where(np.isfinite(z), z, poses.centre)
    undamped = np.zeros(len(poses.t))
    explored = [s.model.samples for s in poses.sightings if hasattr(s.model, "samples")]
    for posture in np.unique(np.concatenate([poses.centre[None], *explored]), axis=0):
        near = _evaluate_poses(poses, np.where(np.isfinite(z), z, posture))
        near = _evaluate_poses(poses, near.x + _damped_step(poses, near, undamped))
        better = near.cost < least
        guess[better], least[better] = near.x[better], near.cost[better]
    return guess


def descend_poses(poses: StillPoses, x: Array) -> SolvedPoses:
    """Gauss–Newton with damping for each pose, raised where
    a step does not lower the cost at fixed variances.
    """
    now = _evaluate_poses(poses, x)
    damp = np.full(len(x), 1e-6)
    for _ in range(60):
        step = _damped_step(poses, now, damp)
        tried = _evaluate_poses(poses, now.x + step)
        better = (
            _robust_misfit(poses, tried, now.var) <= _robust_misfit(poses, now, now.var) + 1e-12
        )
        size = np.abs(step) / np.sqrt(np.einsum("pmm->pm", now.cov))
        damp = np.where(better, np.maximum(damp * 0.1, 1e-9), damp * 10.0)
        now = _replace_solved_poses(now, tried, np.flatnonzero(better), better)
        if size.max() < 1e-7:  # standard deviations
            break
    return now


def _damped_step(poses: StillPoses, now: SolvedPoses, damp: Array) -> Array:
    """The Gauss–Newton step (P,M), damped along the posterior's axes (Levenberg–Marquardt)."""
    pull = (
        np.einsum("prm,pr->pm", now.jac, now.weight * now.r / now.var)
        + (poses.centre - now.x) / poses.span**2
    )
    information = np.linalg.inv(now.cov)
    information += (
        damp[:, None, None] * np.eye(now.x.shape[1]) * np.einsum("pmm->pm", information)[:, None]
    )
    return np.asarray(np.linalg.solve(information, pull[..., None])[..., 0])


def _evaluate_poses(poses: StillPoses, x: Array) -> SolvedPoses:
    """Residuals, weights, covariance and cost at x (P,M)."""
    g, jac, model = poses.predict(x)
    var = model + poses.var
    seen = np.isfinite(poses.y)
    r = np.where(seen, poses.y - g, 0.0)
    weight = seen / np.maximum(np.square(r) / (GATE_SIGMA**2 * var), 1.0)
    information = (jac * (weight / var)[..., None]).swapaxes(1, 2) @ jac + np.diag(poses.span**-2.0)
    found = SolvedPoses(x, np.linalg.inv(information), r, jac, var, weight, np.empty(len(x)))
    logs = (np.log(2.0 * np.pi * var) * seen).sum(axis=1) + 2.0 * np.log(poses.span).sum()
    logs += np.linalg.slogdet(information)[1]
    return replace(found, cost=_robust_misfit(poses, found, var) + 0.5 * logs)


def _robust_misfit(poses: StillPoses, at: SolvedPoses, var: Array) -> Array:
    """Half the robust squares (P,) of all readings, with
    variances `var` (P,R), and of the prior, in nats.
    """
    over = np.square(at.r) / (GATE_SIGMA**2 * var)
    robust = GATE_SIGMA**2 * (np.minimum(over, 1.0) + np.log(np.maximum(over, 1.0)))
    return np.asarray(
        0.5 * (robust.sum(axis=1) + np.square((at.x - poses.centre) / poses.span).sum(axis=1))
    )
