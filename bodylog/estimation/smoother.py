"""The full-interval posterior: Gauss–Newton over the whole log, each round one filter forth and one adjoint back.

Linearising all frames at the smoothed angles until they rest gives the maximum a posteriori path. The way back is the
Bryson–Frazier form, which needs the filter's gains but no inverse.
"""

from dataclasses import dataclass

import numpy as np

from ..settings import Estimation
from ..types import Array, BodyModel, Estimate, Features
from . import results
from .filtering import drifts, pose, settled
from .folds import fold_for
from .laplace import SETTLED, SWEEPS, Problem, Restless, Solution, far, guesses, handed_over, heard, starts
from .results import Beliefs
from .scan import EVEN, Readings, Trace, columns, rescan
from .tangents import Tangents
from .walk import walk

FORTH = 2
"""Sweeps that only go forth, until the stretches start nearly where they should."""


@dataclass(frozen=True, eq=False)
class Smooth(Solution):
    """A smoothed log: with the last way forth, the smoothed state z (L,K,C), and cov (L,M,M,C) of the angles."""

    z: Array
    cov: Array


def estimate(features: Features, body: BodyModel, settings: Estimation) -> Estimate:
    """Smoothed belief: at each output time, all that the whole log says about it."""
    problem, warm, faults = pose(features, body, settings)
    problem, smooth = settled(problem, warm, settings, solve, once)
    unfold, m, precision = smooth.fold.unfold, len(problem.start), problem.precision
    z, cov = unfold(smooth.z), unfold(smooth.cov)
    beliefs = Beliefs(
        z, cov, unfold(smooth.trace.nats), z[:, :m], cov, unfold(smooth.trace.encoder_d), precision.scale,
        precision.plain(), (*faults, *drifts(problem, body.joints, smooth, faults)),
    )  # fmt: skip
    return results.estimate("smoother", body, problem.evidence, problem.timeline, beliefs)


def solve(problem: Problem, warm: Solution | None = None) -> Smooth:
    """The maximum a posteriori path; Restless when the rounds do not settle."""
    fold, line, m = fold_for(len(problem.timeline.t)), problem.timeline, len(problem.start)
    readings, (z, p) = heard(problem, fold), starts(problem, fold, warm)
    tangents, forth = Tangents(guesses(problem) if warm is None else warm.points), FORTH if warm is None else 0
    ends, moving, rest = (np.zeros_like(z), np.zeros_like(p)), np.ones(fold.count, bool), np.inf
    trace, ways = None, None
    for sweep in range(SWEEPS):
        moving |= tangents.draw(problem, fold, readings)
        if trace is not None and ways is not None and not moving.any():
            return Smooth(fold, readings, tangents.points, trace, ways[0], ways[1])
        if sweep <= forth:
            moving[:] = True
        trace = rescan(readings, problem.dynamics, z, p, moving, trace, remember=True)
        if sweep >= forth:
            ways = _again(readings, trace, ends, moving, fold.takeover, ways)
        means = trace.z if ways is None else ways[0]
        tangents.follow(tuple(fold.pick(means, events)[:, :m] for events in line.sightings))
        next_z, next_p = handed_over(z, p, trace, fold)
        moves, next_ends = far(z, p, next_z, next_p), ends if ways is None else before((ways[2], ways[3]))
        moves = np.maximum(moves, _adjoint_moved(ends, next_ends, next_p))
        moving, rest = moves >= SETTLED, float(moves.max())
        for now, later in ((z, next_z), (p, next_p), *zip(ends, next_ends, strict=True)):
            now[..., moving] = later[..., moving]
    raise Restless(f"smoother: no rest after {SWEEPS} sweeps, last move {rest:.2g}")


def _again(
    readings: Readings, trace: Trace, ends: tuple[Array, Array], moving: Array, keep: int,
    whole: tuple[Array, ...] | None,
) -> tuple[Array, ...]:  # fmt: skip
    """`back`, but only over the stretches `moving` (C,); the others stay as they are in `whole`."""
    if whole is None:
        return back(readings, trace, ends, keep)
    some = back(columns(readings, moving), columns(trace, moving), (ends[0][:, moving], ends[1][..., moving]), keep)
    for kept, part in zip(whole, some, strict=True):
        kept[..., moving] = part
    return whole


def once(problem: Problem) -> Smooth:
    """The path smoothed one time along the filter's own tangents: what is left where rounds do not come to rest."""
    solution = walk(problem, remember=True)
    k = problem.dynamics.size
    means, cov, *_ = back(solution.readings, solution.trace, (np.zeros((k, 1)), np.zeros((k, k, 1))), 0)
    return Smooth(solution.fold, solution.readings, solution.points, solution.trace, means, cov)


def back(
    readings: Readings, trace: Trace, ends: tuple[Array, Array], keep: int
) -> tuple[Array, ...]:
    """Smoothed state (L,K,C), covariance (L,M,M,C) of the angles; adjoint (K,C), (K,K,C) before instant `keep`."""
    adjoint, information = ends[0].copy(), ends[1].copy()
    length, m, c = readings.encoders.shape
    smooth, cov = np.empty_like(trace.z), np.empty((length, m, m, c))
    for i in range(length - 1, -1, -1):
        p = trace.p[i]
        smooth[i] = trace.z[i] - np.einsum("klc,lc->kc", p, adjoint)
        half = np.einsum("jkc,klc->jlc", p[:m], information)
        cov[i] = p[:m, :m] - np.einsum("jlc,lkc->jkc", half, p[:, :m])
        _unhear(readings, trace, i, adjoint, information)
        dt = readings.dt[i]
        adjoint[m : 2 * m] += dt * adjoint[:m]
        information[m : 2 * m] += dt * information[:m]
        information[:, m : 2 * m] += dt * information[:, :m]
        if i % EVEN == 0:
            information[:] = 0.5 * (information + information.transpose(1, 0, 2))
        if i == keep:
            kept = adjoint.copy(), information.copy()
    return smooth, cov, *kept


def _unhear(readings: Readings, trace: Trace, i: int, adjoint: Array, information: Array) -> None:
    """Carry the adjoint (K,C) and its information (K,K,C) back over all readings of instant i, last heard first."""
    assert trace.back is not None
    gains, weights, nus = (part[i] for part in trace.back)
    m, k = readings.encoders.shape[1], len(adjoint)
    jac = readings.jac[i].reshape(-1, m, adjoint.shape[1])
    for row in range(len(gains) - 1, -1, -1):
        gain, weight = gains[row], weights[row]
        pull = np.einsum("kc,kc->c", gain, adjoint) + nus[row] * weight
        b = np.einsum("klc,lc->kc", information, gain)
        curve = np.einsum("kc,kc->c", gain, b) + weight
        if row >= m:
            h = jac[row - m]
            adjoint[:m] -= h * pull
            information[:m] -= h[:, None] * b[None]
            information[:, :m] -= b[:, None] * h[None]
            information[:m, :m] += (h * curve)[:, None] * h[None]
            continue
        rows = [row] if k == 2 * m else [row, 2 * m + row]
        for j in rows:
            adjoint[j] -= pull
            information[j] -= b
            information[:, j] -= b
        for j in rows:
            information[j, rows] += curve


def before(at_start: tuple[Array, Array]) -> tuple[Array, Array]:
    """Ends for the next round: each stretch ends where its successor began, and nothing comes after the last."""
    adjoint, information = (np.zeros_like(part) for part in at_start)
    adjoint[:, :-1], information[..., :-1] = at_start[0][:, 1:], at_start[1][..., 1:]
    return adjoint, information


def _adjoint_moved(a: tuple[Array, Array], b: tuple[Array, Array], p: Array) -> Array:
    """How far the future's word moved each stretch's end (C,), in standard deviations; p (K,K,C) sets the scale."""
    std = np.sqrt(np.maximum(np.einsum("iic->ic", p), 0.0))
    curve = np.abs((b[1] - a[1]) * std[:, None] * std[None]).max(axis=(0, 1))
    return np.asarray(np.maximum(np.abs((b[0] - a[0]) * std).max(axis=0), curve))
