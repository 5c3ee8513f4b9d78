"""Encoder offsets: whether the log asks for one, whose it is, and since when it drifts."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..types import Array, Fault
from .grain import grain
from .laplace import Problem, Solution
from .senses import Encoders
from .suspicion import promise

WALKS = (1e-4, 1e-5, 1e-3)
"""rad²/s: how fast an offset may wander, the first tried first."""
GAIN = 20.0
"""Nats of evidence that one more offset must win."""
SIGMAS, LEAST = 4.0, 0.01
"""An offset is a fault when it is this many of its standard deviations, and this many rad, from where it began."""


def suspects(problem: Problem, solved: Solution) -> Array:
    """Encoders (M,) bool whose lie would, to first order, explain GAIN nats of the log: a sound one costs no more."""
    gain, offset, var = promise(problem, solved, WALKS[0])
    certain = _certain(offset, var, least(problem.evidence.encoders))
    return np.asarray((gain > GAIN) & certain.any(axis=0) & (_given(problem) == 0))


def choose(problem: Problem, solved: Solution, suspected: Array, cost: Callable[[Problem], float]) -> Problem:
    """The problem with an offset for each encoder whose lie explains GAIN nats of the log; `cost` in nats.

    suspected (M,) bool: the encoders asked first, at least one.
    """
    least = cost(problem)
    best = _added(problem, suspected, nats(solved) if np.isinf(least) else least, cost)
    if best is problem:
        return problem
    others = [with_drift(best, _given(best) * (walk / WALKS[0])) for walk in WALKS[1:]]
    # pictures taken for blurred on the lie's account are as sharp as perception says
    sharp = replace(best.precision, scale=dict.fromkeys(best.precision.scale, 1.0))
    return min([best, replace(best, precision=sharp), *others], key=cost)


def _added(problem: Problem, suspected: Array, least: float, cost: Callable[[Problem], float]) -> Problem:
    """The problem, which costs `least` nats, with one offset after the other while each wins GAIN of them."""
    best = problem
    while suspected.any():
        drift = _given(best)
        trials = [with_drift(problem, np.where(alone, WALKS[0], drift)) for alone in np.eye(len(drift))[suspected] > 0]
        costs = [cost(trial) for trial in trials]
        if min(costs) > least - GAIN:
            return best
        least, best = min(zip(costs, trials, strict=True), key=lambda pair: pair[0])
        # with one lie out of the way, any other may show
        suspected = _given(best) == 0
    return best


def _given(problem: Problem) -> Array:
    """Walks (M,) rad²/s of the offsets allowed so far."""
    return np.zeros(len(problem.start)) if problem.precision.drift is None else np.asarray(problem.precision.drift)


def nats(solution: Solution) -> float:
    """Free energy of a whole filtered log."""
    return float(solution.fold.unfold(solution.trace.nats).sum())


def with_drift(problem: Problem, drift: Array) -> Problem:
    """The problem with offsets that wander as `drift` (M,) rad²/s says; 0 for none."""
    return replace(problem, precision=replace(problem.precision, drift=drift))


def allowed(setting: str, names: tuple[str, ...], known: tuple[Fault, ...]) -> Array | None:
    """Walks (M,) rad²/s given before any evidence: to all when `on`, under `auto` to encoders that jumped."""
    jumped = {fault.name for fault in known if fault.kind == "jumping"}
    if setting == "on" or (setting == "auto" and jumped):
        return np.array([WALKS[1] if setting == "on" or name in jumped else 0.0 for name in names])
    return None


def least(encoders: Encoders | None) -> Array | float:
    """Offsets (M,) rad that may be faults at least: a sound encoder is off by half the step it counts in.

    One that never moved is taken to count in the steps of the others.
    """
    if encoders is None:
        return LEAST
    said = [column[np.isfinite(column)] for column in encoders.values.T]
    steps = [grain(y) for y in said]
    shown = [step if len(y) and np.ptp(y) else max(steps) for step, y in zip(steps, said, strict=True)]
    return np.maximum(LEAST, shown)


def _certain(offset: Array, var: Array, least: Array | float) -> Array:
    """Where offsets (N,M), of variances (N,M), are faults, which are no smaller than `least` (M,) rad."""
    return np.asarray(np.abs(offset) > np.maximum(least, SIGMAS * np.sqrt(var)))


def faults(
    names: tuple[str, ...], t: Array, offset: Array, var: Array, known: tuple[Fault, ...], least: Array | float = LEAST
) -> tuple[Fault, ...]:
    """Drifting encoders from offsets and their variances (N,M): since when they are certainly off, and by how much.

    least (M,) rad: smaller offsets are none.
    """
    found, certain = [], _certain(offset, var, least)
    for joint, name in enumerate(names):
        if any(fault.name == name for fault in known):
            continue
        off = certain[:, joint]
        lasting = off & (np.cumsum(off[::-1])[::-1] > 0.5 * np.arange(len(t), 0, -1))
        if lasting.any():
            size = offset[np.abs(offset[:, joint]).argmax(), joint]
            found.append(Fault("encoders", name, "drifting", float(t[lasting.argmax()]), float(size), "rad"))
    return tuple(found)
