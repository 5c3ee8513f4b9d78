"""Process variances of a smoother with the least squared error, rather than the greatest evidence.

The evidence covers motion up to the smoother's cut-off frequency. Arms move more smoothly than white acceleration, so
the evidence prefers a large q, which lets more noise pass than necessary. How far the path moves with q shows what
motion adds to the error near the cut-off. Noise makes 3/4 of a steady variance V, and grows as q^¼. For angles with
spectrum ω^−p, motion adds an error that falls as q^(−(p − 1)/4). The sum is least where the latter is 1/(p − 1) of the
former. p is 4 for white acceleration, 6 for white jerk and 8 for minimum-jerk reaches (Flash & Hogan 1985); the rate
at which moves fall with q shows it. Beyond 6 the error hardly falls, so q stays at its value for 6. The stated
share of V is noise, plus motion as far as the path still moves.
"""

from dataclasses import replace

import numpy as np

from ...types import Array
from ..inference import adjoint
from ..inference.initial_path import handed_over, priors
from ..inference.knot_problem import KnotProblem, tile
from ..inference.problem import Problem
from ..inference.scan import scan
from ..inference.solution import Solution
from .correlated_noise import WHOLE
from .visibility import LONG

STEP = 4.0
FACTORS = STEP ** np.arange(-3.0, 3.0)
"""Factors on the process variances of greatest evidence that are tried."""
POWERS = np.arange(4.0, 9.0)
"""Values of p; beyond them the rest comes from few slow swings rather than from the cut-off."""
MOST = np.array([2.434, 2.674, 2.934, 2.934, 2.934])
"""For each p, mean squared move of the path per STEP, over that of noise, at the least error.

With H(q) = 1/(1 + u⁴/q) and motion a u^−p these are ∫ (H(2) − H(½))² (1 + a u^−p) du and ∫ (H(2) − H(½))² du.
"""
LEFT = np.array([2.388, 1.535, 1.062, 0.771, 0.579])
"""For each p, error by motion over the path's move per STEP.

That is ∫ (1 − H)² u^−p du over ∫ (H(2) − H(½))² u^−p du, whatever the motion's strength.
"""
NOISE, SWAY = 0.75, 0.073
"""Shares of V: error by noise, ∫ H² du, and the path's mean squared move by noise per STEP."""
TURNS = 2
"""Rounds in which stretches hand over their ends."""


def least(part: Problem, solved: tuple[KnotProblem, Solution]) -> tuple[Array, float]:
    """Process variances (M,) of least error, as one factor on the problem's, and this error's share of V.

    `solved`: the solution of the filter.
    """
    present = _without_gaps(part, solved[0].problem.timeline.t)
    moved = np.square(np.diff(_paths(part, solved, FACTORS)[0][:, present], axis=0)).mean(axis=1)
    # noise's share of it grows as q^¼
    noise = moved[-1] * (FACTORS[:-1] / FACTORS[-2])[:, None] ** 0.25
    ratios = (moved / np.maximum(noise, np.finfo(float).tiny)).mean(axis=1)
    power = _power(ratios)
    over = np.log(ratios / np.interp(power, POWERS, MOST))
    last = int(np.flatnonzero(over > 0.0).max(initial=-1))
    factor = FACTORS[0] if last < 0 else FACTORS[last] * STEP ** (0.5 + over[last] / (over[last] - over[last + 1]))
    return np.asarray(part.precision.process * factor), _stated(part, solved, float(factor), power)


def _without_gaps(part: Problem, t: Array) -> Array:
    """Times t (E,) s outside long silences of an encoder, in which a path moves far with q."""
    encoders = part.evidence.encoders
    known = np.empty(0) if encoders is None else encoders.t[np.isfinite(encoders.values).all(axis=1)]
    if len(known) < 2:
        return np.ones(len(t), bool)
    steps = np.diff(known)
    quick = np.concatenate([[True], steps <= LONG * np.median(steps), [True]])
    return quick[np.searchsorted(known, t)]


def _stated(part: Problem, solved: tuple[KnotProblem, Solution], factor: float, power: float) -> float:
    """The error's share of V at a factor: noise, plus motion as far as the path still moves."""
    paths, var = _paths(part, solved, factor * STEP ** np.array([-0.5, 0.5]))
    present = _without_gaps(part, solved[0].problem.timeline.t)
    moved = float((np.square(paths[1] - paths[0]) / np.sqrt(var[0] * var[1]))[present].mean())
    return float(np.clip(NOISE + np.interp(power, POWERS, LEFT) * (moved - SWAY), NOISE, 1.0))


def _power(ratios: Array) -> float:
    """p, from the rate at which moves over those of noise, 1 + b q^(−p/4), fall; ratios (5,)."""
    last = max(int(np.flatnonzero(ratios > MOST[0]).max(initial=0)), 1)
    before, after = ratios[last - 1 : last + 1] - 1.0
    if after <= 0.0 or before <= after:
        return float(POWERS[-1])
    return float(np.clip(4.0 * np.log(before / after) / np.log(STEP), POWERS[0], POWERS[-1]))


def _paths(part: Problem, solved: tuple[KnotProblem, Solution], factors: Array) -> tuple[Array, Array]:
    """Smoothed angles (G,E,M) of the knots for each factor, with the tangents of `solved`; and V there.

    A steady smoother has a quarter of its filter's variance.
    """
    (knots, first), g, m = solved, len(factors), len(part.start)
    few, fold = replace(part, timeline=knots.problem.timeline), knots.fold
    first.tangents.draw(few, fold, knots.readings)
    processes = part.precision.process[:, None] * factors
    precisions = [replace(part.precision, process=process, stated=NOISE) for process in processes.T]
    var = [first.tangents.weighed(replace(few, precision=p), fold, knots.readings, WHOLE) for p in precisions]
    tiled = tile(knots, np.stack(var, axis=-1), processes)
    dynamics = replace(few.dynamics, process=np.tile(processes, fold.count))
    z, p = (np.repeat(a, g, axis=-1) for a in handed_over(*priors(few, fold), first.trace.z[-1], first.trace.p[-1]))
    trace = None
    for _ in range(TURNS):
        trace = scan(tiled, dynamics, z, p, remember=True, into=trace)
        z[:, g:], p[:, :, g:] = trace.z[-1][:, :-g], trace.p[-1][:, :, :-g]
    assert trace is not None
    ends = np.zeros_like(z)
    for _ in range(TURNS):
        after, start = adjoint.adjoints(tiled, trace, ends, dynamics.order)
        ends[:, :-g] = start[:, g:]
    x, var = adjoint.means(trace, after)[:, :m], 0.25 * np.einsum("liic->lic", trace.p[:, :m, :m])
    tiles = np.stack([x, var]).reshape(2, fold.length, m, fold.count, g)
    paths, variances = (np.stack([fold.unfold(part[..., k]) for k in range(g)]) for part in tiles)
    return paths, variances
