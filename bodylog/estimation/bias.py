"""Encoder offsets: whether the log asks for one, whose it is, and since when it drifts."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..types import Array, Fault
from .laplace import Problem, Solution

WALKS = (1e-4, 1e-5, 1e-3)
"""rad²/s: how fast an offset may wander, the first tried first."""
WINDOW = 12
"""Sightings over which surprise is averaged."""
SURPRISE = 4.0
"""Mean square of standardised errors over a window, 1 when all is well, that asks whether an encoder lies."""
GAIN = 20.0
"""Nats of evidence that one more offset must win."""
SIGMAS, LEAST = 4.0, 0.01
"""An offset is a fault when it is this many of its standard deviations, and this many rad, from where it began."""


def surprised(problem: Problem, solved: Solution) -> bool:
    """Whether vision disagrees with the belief for long, as it does when an encoder drifts."""
    fold, trace, m = solved.fold, solved.trace, len(problem.start)
    x, cov = fold.unfold(trace.prior), fold.unfold(trace.prior_cov)
    for index, (sighting, events) in enumerate(
        zip(problem.evidence.sightings, problem.timeline.sightings, strict=True)
    ):
        seen = events[np.isfinite(sighting.values).all(axis=1)]
        if sighting.name == "touch" or len(seen) < WINDOW:
            continue
        jac = fold.pick(solved.readings.jac[:, index], seen)
        nu = fold.pick(solved.readings.y[:, index], seen) - np.einsum("fdm,fm->fd", jac, x[seen])
        s = np.einsum("fdj,fjk,fek->fde", jac, cov[seen][:, :m, :m], jac, optimize=True)
        np.einsum("fdd->fd", s)[:] += fold.pick(solved.readings.var[:, index], seen)
        d2 = np.einsum("fd,fd->f", nu, np.linalg.solve(s, nu[..., None])[..., 0]) / nu.shape[1]
        # single blunders are the gate's business: the median of the window, not its mean
        windows = np.lib.stride_tricks.sliding_window_view(d2, WINDOW)
        if np.median(windows, axis=1).max() > SURPRISE:
            return True
    return False


def choose(problem: Problem, cost: Callable[[Problem], float]) -> Problem:
    """The problem with an offset for each encoder whose lie explains the log better by GAIN nats; `cost` in nats."""
    best, least = problem, cost(problem)
    m = len(problem.start)
    for _ in range(m):
        drift = np.zeros(m) if best.precision.drift is None else np.asarray(best.precision.drift)
        trials = [with_drift(problem, drift + WALKS[0] * np.eye(m)[j]) for j in np.flatnonzero(drift == 0)]
        costs = [cost(trial) for trial in trials]
        if not costs or min(costs) > least - GAIN:
            break
        least, best = min(zip(costs, trials, strict=True), key=lambda pair: pair[0])
    for factor in (walk / WALKS[0] for walk in WALKS[1:]) if best is not problem else ():
        trial = with_drift(problem, np.asarray(best.precision.drift) * factor)
        if (nats := cost(trial)) < least:
            least, best = nats, trial
    return best


def with_drift(problem: Problem, drift: Array) -> Problem:
    """The problem with offsets that wander as `drift` (M,) rad²/s says; 0 for none."""
    return replace(problem, precision=replace(problem.precision, drift=drift))


def allowed(setting: str, names: tuple[str, ...], known: tuple[Fault, ...]) -> Array | None:
    """Walks (M,) rad²/s given before any evidence: to all when `on`, under `auto` to encoders that jumped."""
    jumped = {fault.name for fault in known if fault.kind == "jumping"}
    if setting == "on" or (setting == "auto" and jumped):
        return np.array([WALKS[1] if setting == "on" or name in jumped else 0.0 for name in names])
    return None


def faults(
    names: tuple[str, ...], t: Array, offset: Array, var: Array, known: tuple[Fault, ...]
) -> tuple[Fault, ...]:
    """Drifting encoders from offsets and their variances (N,M): since when they are certainly off, and by how much."""
    found = []
    for joint, name in enumerate(names):
        if any(fault.name == name for fault in known):
            continue
        off = np.abs(offset[:, joint]) > np.maximum(LEAST, SIGMAS * np.sqrt(var[:, joint]))
        lasting = off & (np.cumsum(off[::-1])[::-1] > 0.5 * np.arange(len(t), 0, -1))
        if lasting.any():
            size = offset[np.abs(offset[:, joint]).argmax(), joint]
            found.append(Fault("encoders", name, "drifting", float(t[lasting.argmax()]), float(size), "rad"))
    return tuple(found)
