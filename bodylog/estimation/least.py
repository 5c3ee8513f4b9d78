"""Process variances of a smoother: those of least squared error, and not of greatest evidence.

Evidence weighs all of a motion up to the frequency where smoothing cuts off. Arms move slower than that and smoothly,
which it lays to a large q, and more noise passes than must. What motion adds to the error near the cut-off shows in
how far the path moves with q. Of a steady variance V noise makes 3/4, which grows as q^¼. What is left of an arm that
moves with white jerk falls as q^(−5/4): their sum is least where this is 3V/20, and the error then is 9V/10.
"""

from dataclasses import replace

import numpy as np

from ..types import Array
from . import adjoint
from .alike import WHOLE
from .brief import Brief, tile
from .laplace import Problem, Solution
from .outset import handed_over, priors
from .scan import scan

STEP = 4.0
FACTORS = STEP ** np.arange(-3.0, 3.0)
"""Times the process variances of greatest evidence that are tried."""
MOST = 2.93
"""Mean squared move of the path by one STEP, over what noise makes of it, where a white jerk's error is least.

With H(q) = 1/(1 + u⁴/q) these are ∫ (H(2) − H(½))² (1 + 0.6 u⁻⁶) du and ∫ (H(2) − H(½))² du.
"""
STATED = 0.9
"""Share of V that the error then is."""
TURNS = 2
"""Times stretches hand over their ends."""


def least(part: Problem, told: tuple[Brief, Solution]) -> Array:
    """Process variances (M,) of least error: the problem's, all times one factor; `told` is its filter's solution."""
    moved = np.square(np.diff(_paths(part, told), axis=0)).mean(axis=1)
    # noise's share of it grows as q^¼
    noise = moved[-1] * (FACTORS[:-1] / FACTORS[-2])[:, None] ** 0.25
    ratios = np.log((moved / np.maximum(noise, np.finfo(float).tiny)).mean(axis=1) / MOST)
    over = np.flatnonzero(ratios > 0.0)
    if not len(over):
        return np.asarray(part.precision.process * FACTORS[0])
    last = int(over[-1])
    beyond = ratios[last] / (ratios[last] - ratios[last + 1])
    return np.asarray(part.precision.process * FACTORS[last] * STEP ** (0.5 + beyond))


def _paths(part: Problem, told: tuple[Brief, Solution]) -> Array:
    """Smoothed angles (G,E,M) of the log in brief for each of FACTORS, along the tangents of `told`."""
    (brief, first), g, m = told, len(FACTORS), len(part.start)
    few, fold = replace(part, timeline=brief.problem.timeline), brief.fold
    first.tangents.draw(few, fold, brief.readings)
    processes = part.precision.process[:, None] * FACTORS
    precisions = [replace(part.precision, process=process) for process in processes.T]
    var = [first.tangents.weighed(replace(few, precision=p), fold, brief.readings, WHOLE) for p in precisions]
    tiled = tile(brief, np.stack(var, axis=-1), processes)
    dynamics = replace(few.dynamics, process=np.tile(processes, fold.count))
    z, p = (np.repeat(a, g, axis=-1) for a in handed_over(*priors(few, fold), first.trace.z[-1], first.trace.p[-1]))
    trace = None
    for _ in range(TURNS):
        trace = scan(tiled, dynamics, z, p, remember=True, into=trace)
        z[:, g:], p[:, :, g:] = trace.z[-1][:, :-g], trace.p[-1][:, :, :-g]
    assert trace is not None
    ends = np.zeros_like(z)
    for _ in range(TURNS):
        after, start = adjoint.adjoints(tiled, trace, ends)
        ends[:, :-g] = start[:, g:]
    x = adjoint.means(trace, after)[:, :m].reshape(fold.length, m, fold.count, g)
    return np.stack([fold.unfold(x[..., k]) for k in range(g)])
