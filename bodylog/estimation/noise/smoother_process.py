"""Process variances of a smoother with the least squared error, rather than the greatest evidence.

The evidence covers motion up to the smoother's cut-off frequency. Arms move more smoothly than white noise in
derivative n, so the evidence prefers a large q, which lets more noise pass than necessary. How far the path moves with
q shows what motion adds to the error near the cut-off. Noise makes 1 − 1/2n of a steady variance V, and grows as
q^(1/2n). For angles with spectrum ω^−p, motion adds an error that falls as q^(−(p − 1)/2n). The sum is least where the
latter is 1/(p − 1) of the former. p is 2n for white noise and 8 for minimum-jerk reaches (Flash & Hogan 1985); the rate
at which moves fall with q shows it. Beyond 2n + 2 the error hardly falls, so q stays at its value there. The stated
share of V is noise, plus motion as far as the path still moves.
"""

from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from ...types import Array
from ..inference import adjoint
from ..inference.filter_records import Dynamics, Readings
from ..inference.initial_path import handed_over, priors
from ..inference.problem import Problem
from ..inference.scan import Keep, Trace, scan
from ..inference.solution import Solution
from .correlated_noise import WHOLE
from .visibility import LONG

PER_STEP = 2
"""Factors tried per step of the cut-off by √2. With 1 the errors of two recorded logs are 1 to 7 % larger, those of 120
drawn ones the same to 0.3 %."""
TURNS = 2
"""Rounds in which stretches hand over their ends."""


class Spectra(NamedTuple):
    """What a smoother of one order does to motion of spectrum ω^−p, for each of the powers p (5,).

    step: factor on q that moves the cut-off by √2 · most: mean squared move of the path per step, over that of noise,
    at the least error · left: error by motion over the path's move · noise, sway: shares of V, error by noise and the
    path's mean squared move by noise.
    """

    step: float
    powers: Array
    most: Array
    left: Array
    noise: float
    sway: float


@cache
def spectra(order: int) -> Spectra:
    """By quadrature, with the smoother's response 1/(1 + u²ⁿ/q), u the frequency over the cut-off."""
    u, step, powers = np.exp(np.linspace(-10.0, 8.0, 4001)), 2.0**order, 2.0 * order + np.arange(5.0)

    def passed(q: float) -> Array:
        return np.asarray(1.0 / (1.0 + u ** (2 * order) / q))

    def whole(y: Array) -> Array:
        return np.asarray(np.trapezoid(y * u, np.log(u)))

    moved, motion = np.square(passed(step**0.5) - passed(step**-0.5)), u ** -powers[:, None]
    noise, missed = whole(passed(1.0) ** 2), whole((1.0 - passed(1.0)) ** 2 * motion)
    most = 1.0 + noise / ((powers - 1.0) * missed) * whole(moved * motion) / whole(moved)
    v = whole(passed(1.0))
    flat = np.minimum(powers, powers[2])
    most, left = np.interp(flat, powers, most), missed / whole(moved * motion)
    return Spectra(step, powers, most, left, float(noise / v), float(whole(moved) / v))


def least(part: Problem, solved: Solution) -> tuple[Array, float]:
    """Process variances (M,) of least error, as one factor on the problem's, and this error's share of V.

    `solved`: the solution of the filter.
    """
    known = spectra(part.precision.order)
    factors = known.step ** np.arange(-3.0, 2.5, 1.0 / PER_STEP)
    paths, var = _paths(part, solved, factors)
    present = _without_gaps(part, part.timeline.t[part.timeline.sampled])
    moves = np.square(paths[PER_STEP:] - paths[:-PER_STEP])[:, present]
    moved = moves.mean(axis=1)
    # noise's share of it grows as q^(1/2n)
    noise = moved[-1] * (factors[:-PER_STEP] / factors[-PER_STEP - 1])[:, None] ** (1.0 / known.powers[0])
    ratios = (moved / np.maximum(noise, np.finfo(float).tiny)).mean(axis=1)
    power = _power(ratios, known)
    over = np.log(np.maximum(ratios, np.finfo(float).tiny) / np.interp(power, known.powers, known.most))
    last = int(np.flatnonzero(over > 0.0).max(initial=-1))
    beyond = 0.5 * PER_STEP + over[last] / (over[last] - over[last + 1]) if last >= 0 else 0.0
    # the path's mean squared move per step at this factor, over V
    sway = (moves / np.sqrt(var[PER_STEP:] * var[:-PER_STEP])[:, present]).mean(axis=(1, 2))
    sway = np.maximum(sway, np.finfo(float).tiny)  # 0 between poses that are far apart
    sway = np.exp(np.interp(max(last, 0) + beyond - 0.5 * PER_STEP, np.arange(len(sway)), np.log(sway)))
    stated = known.noise + np.interp(power, known.powers, known.left) * (sway - known.sway)
    factor = factors[max(last, 0)] * known.step ** (beyond / PER_STEP)
    return np.asarray(part.precision.process * factor), float(np.clip(stated, known.noise, 1.0))


def _without_gaps(part: Problem, t: Array) -> Array:
    """Times t (E,) s outside long silences of an encoder, in which a path moves far with q."""
    encoders = part.evidence.encoders
    known = np.empty(0) if encoders is None else encoders.t[np.isfinite(encoders.values).all(axis=1)]
    if len(known) < 2:
        return np.ones(len(t), bool)
    steps = np.diff(known)
    quick = np.concatenate([[True], steps <= LONG * np.median(steps), [True]])
    return quick[np.searchsorted(known, t)]


def _power(ratios: Array, known: Spectra) -> float:
    """p, from the rate at which moves over those of noise, 1 + b q^(−p/2n), fall; ratios (5,)."""
    last = max(int(np.flatnonzero(ratios > known.most[0]).max(initial=0)), PER_STEP)
    before, after = ratios[[last - PER_STEP, last]] - 1.0
    if after <= 0.0 or before <= after:
        return float(known.powers[-1])
    rate = np.log(before / after) / np.log(known.step)
    return float(np.clip(known.powers[0] * rate, known.powers[0], known.powers[-1]))


def _paths(part: Problem, solved: Solution, factors: Array) -> tuple[Array, Array]:
    """Smoothed angles (G,B,M) for each factor at the images, with the tangents of `solved`; and V there.

    One factor after the other, as a smoother keeps covariances of all instants.
    """
    solved.tangents.draw(part, solved.fold, solved.readings)
    known, trace, found = spectra(part.precision.order), None, []
    for process in factors[:, None] * part.precision.process:
        posed = replace(part, precision=replace(part.precision, process=process, stated=known.noise))
        path, var, trace = _path(posed, solved, trace)
        found.append((path, var))
    paths, variances = map(np.stack, zip(*found, strict=True))
    return paths, variances


def _path(posed: Problem, solved: Solution, into: Trace | None) -> tuple[Array, Array, Trace]:
    """Smoothed angles (B,M) and V (B,M) at the images; and the trace, which may be `into`, overwritten.

    A steady smoother has 1/2n of its filter's variance.
    """
    fold, dynamics, m = solved.fold, posed.dynamics, len(posed.start)
    var = solved.tangents.weighed(posed, fold, solved.readings, WHOLE)
    readings, trace = replace(solved.readings, var=var), into
    z, p = handed_over(*priors(posed, fold), solved.trace.z[-1], solved.trace.end_p)
    for _ in range(TURNS):
        trace = scan(readings, dynamics, z, p, Keep.MEANS, into=trace)
        z, p = handed_over(z, p, trace.z[-1], trace.end_p)
    assert trace is not None
    ends = np.zeros_like(z)
    for _ in range(TURNS):
        smooth, start = adjoint.smoothed(readings, trace, ends, dynamics)
        ends = adjoint.before(start)
    var, images = 0.5 / dynamics.order * np.einsum("liic->lic", trace.cov[:, :m, :m]), posed.timeline.sampled
    return fold.unfold(smooth[:, :m])[images], fold.unfold(var)[images], trace


def side_by_side(
    part: Problem, solved: Solution, processes: Array, var: Array
) -> tuple[Readings, Dynamics, Array, Array]:
    """What `scan` takes for candidates of process variances (M,G) and variances of frames (L,T,D,C,G).

    Their stretches start where those of `solved` ended.
    """
    g, fold = processes.shape[1], solved.fold
    dynamics = replace(part.dynamics, process=np.tile(processes, fold.count))
    starts = handed_over(*priors(part, fold), solved.trace.z[-1], solved.trace.end_p)
    z, p = (np.repeat(part, g, axis=-1) for part in starts)
    return replace(solved.readings, var=var.reshape(*var.shape[:-2], var.shape[-2] * g)), dynamics, z, p
