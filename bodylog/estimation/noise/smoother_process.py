"""Process variances of a smoother with the least squared error, rather than the greatest evidence.

The evidence covers motion up to the smoother's cut-off frequency. Arms move more
smoothly than white noise in derivative n, so the evidence prefers a large q, which lets
more noise pass than necessary. How far the path moves with q shows what motion adds to
the error near the cut-off. Noise makes 1 − 1/2n of a steady variance V, and grows as
q^(1/2n). For angles with spectrum ω^−p, motion adds an error that falls as q^(−(p −
1)/2n). The sum is least where the latter is 1/(p − 1) of the former. p is 2n for white
noise and 8 for minimum-jerk reaches (Flash & Hogan 1985); the rate at which moves fall
with q shows it. Beyond 2n + 2 the error hardly falls, so q stays at its value there.
The stated share of V is that of noise and motion where their sum is least, (1 − 1/2n)
p/(p − 1).
"""

from dataclasses import replace

import numpy as np

from ...types import Array
from ..inference import adjoint
from ..inference.filter_records import FilterDynamics, FilterReadings
from ..inference.initial_path import hand_over_starts, stretch_priors
from ..inference.problem import FilterProblem
from ..inference.scan import FilterTrace, TraceDetail, filter_stretches
from ..inference.solution import Solution
from .visibility import GAP_STEPS


def least_error_process(part: FilterProblem, solved: Solution) -> tuple[Array, float]:
    """Process variances (M,) of least error, as one
    factor on the problem's, and this error's share of V.

    `solved`: the solution of the filter.
    """
    order = part.precision.order
    step = 2.0 ** (0.5 * order)  # moves the cut-off by 2^¼
    factors = step ** np.arange(-6.0, 5.0)
    present = _without_gaps(part, part.timeline.t)
    moved = np.square(np.diff(_smooth_candidates(part, solved, factors), axis=0))[:, present].mean(
        axis=1
    )
    # noise's share of it grows as q^(1/2n)
    noise = moved[-1] * (factors[:-1] / factors[-2])[:, None] ** (0.5 / order)
    ratios = (moved / np.maximum(noise, np.finfo(float).tiny)).mean(axis=1)
    power = _fit_motion_power(ratios, step, order)
    over = np.log(np.maximum(ratios, np.finfo(float).tiny) / move_at_least(power, order))
    last = int(np.flatnonzero(over > 0.0).max(initial=-1))
    beyond = 0.5 + over[last] / (over[last] - over[last + 1]) if last >= 0 else 0.0
    factor = factors[max(last, 0)] * step**beyond
    return np.asarray(part.precision.process * factor), _noise_share(part) * power / (power - 1.0)


def move_at_least(power: float, order: int) -> float:
    """How far the path moves with ln q at the least error,
    squared, over that by noise; motion's spectrum is ω^−power.

    By the smoother's response 1 / (1 + u²ⁿ), u the frequency
    over the cut-off, which moves by u²ⁿ / (1 + u²ⁿ)².
    """
    return (min(power, 2.0 * order + 2.0) + 4.0 * order) / (2.0 * order + 1.0)


def _noise_share(part: FilterProblem) -> float:
    """Share of V that noise makes."""
    return 1.0 - 0.5 / part.precision.order


def _without_gaps(part: FilterProblem, t: Array) -> Array:
    """Times t (E,) s outside long silences of an encoder, in which a path moves far with q."""
    encoders = part.evidence.encoders
    known = (
        np.empty(0) if encoders is None else encoders.t[np.isfinite(encoders.values).all(axis=1)]
    )
    if len(known) < 2:
        return np.ones(len(t), bool)
    steps = np.diff(known)
    quick = np.concatenate([[True], steps <= GAP_STEPS * np.median(steps), [True]])
    return quick[np.searchsorted(known, t)]


def _fit_motion_power(ratios: Array, step: float, order: int) -> float:
    """p, from the rate at which moves over those of noise,
    1 + b q^(−p/2n), fall; ratios (10,), a step of q apart.
    """
    last = max(int(np.flatnonzero(ratios > move_at_least(2.0 * order, order)).max(initial=0)), 2)
    before, after = ratios[[last - 2, last]] - 1.0
    if after <= 0.0 or before <= after:
        return 2.0 * order + 4.0
    rate = np.log(before / after) / (2.0 * np.log(step))
    return float(np.clip(2.0 * order * rate, 2.0 * order, 2.0 * order + 4.0))


def _smooth_candidates(part: FilterProblem, solved: Solution, factors: Array) -> Array:
    """Smoothed angles (G,E,M) for each factor, with the tangents of `solved`.

    One factor after the other, as a smoother keeps covariances of all instants.
    """
    solved.tangents.draw(part, solved.fold, solved.readings)
    trace = None
    paths = []
    for process in factors[:, None] * part.precision.process:
        posed = replace(
            part, precision=replace(part.precision, process=process, stated=_noise_share(part))
        )
        path, trace = _smooth_path(posed, solved, trace)
        paths.append(path)
    return np.stack(paths)


def _smooth_path(
    posed: FilterProblem, solved: Solution, into: FilterTrace | None
) -> tuple[Array, FilterTrace]:
    """Smoothed angles (E,M); and the trace, which may be `into`, overwritten."""
    fold = solved.fold
    dynamics = posed.dynamics
    m = len(posed.start)
    var = solved.tangents.weighed(posed, fold, solved.readings, whole=True)
    readings = replace(solved.readings, var=var)
    prior = stretch_priors(posed, fold)
    before = solved.trace
    trace = filter_stretches(
        readings,
        dynamics,
        *hand_over_starts(*prior, before.z[-1], before.end_p),
        TraceDetail.MEANS,
        into,
    )
    trace = filter_stretches(
        readings,
        dynamics,
        *hand_over_starts(*prior, trace.z[-1], trace.end_p),
        TraceDetail.MEANS,
        trace,
    )
    _, start = adjoint.smooth_states(readings, trace, np.zeros_like(trace.z[-1]), dynamics)
    smooth, _ = adjoint.smooth_states(
        readings, trace, adjoint.adjoints_for_next_round(start), dynamics
    )
    return fold.unfold(smooth[:, :m]), trace


def stack_candidates(
    part: FilterProblem, solved: Solution, processes: Array, var: Array
) -> tuple[FilterReadings, FilterDynamics, Array, Array]:
    """What `filter_stretches` takes for candidates of process
    variances (M,G) and variances of frames (L,T,D,C,G).

    Their stretches start where those of `solved` ended.
    """
    g = processes.shape[1]
    fold = solved.fold
    dynamics = replace(part.dynamics, process=np.tile(processes, fold.count))
    starts = hand_over_starts(*stretch_priors(part, fold), solved.trace.z[-1], solved.trace.end_p)
    z, p = (np.repeat(part, g, axis=-1) for part in starts)
    return (
        replace(solved.readings, var=var.reshape(*var.shape[:-2], var.shape[-2] * g)),
        dynamics,
        z,
        p,
    )
