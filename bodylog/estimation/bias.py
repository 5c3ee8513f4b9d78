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
LASTING, LEAN = 1.0, 8.0
"""s, and standard deviations: an encoder's summed errors over so long, white when all is well, beyond that ask too."""
GAIN = 20.0
"""Nats of evidence that one more offset must win."""
SIGMAS, LEAST = 4.0, 0.01
"""An offset is a fault when it is this many of its standard deviations, and this many rad, from where it began."""


def surprised(problem: Problem, solved: Solution) -> bool:
    """Whether vision, or an encoder beside it, disagrees with the belief for long, as when an encoder drifts."""
    seen = [
        events[np.isfinite(sighting.values).all(axis=1)]
        for sighting, events in zip(problem.evidence.sightings, problem.timeline.sightings, strict=True)
    ]
    names = [sighting.name for sighting in problem.evidence.sightings]
    visual = [k for k, name in enumerate(names) if name != "touch" and len(seen[k]) >= WINDOW]
    # a lie may have been taken for blurred pictures, or sharp ones were believed at once, to the encoders' surprise
    blurred = any(problem.precision.scale.get(names[k], 1.0) > SURPRISE for k in visual)
    return blurred or any(_astray(solved, k, seen[k]) for k in visual) or (bool(visual) and _leaning(problem, solved))


def _astray(solved: Solution, track: int, seen: Array) -> bool:
    """Whether the sightings of one track, at instants `seen` (F,), are far from the belief for long."""
    fold, trace, m = solved.fold, solved.trace, solved.readings.encoders.shape[1]
    x, cov = fold.pick(trace.prior, seen), fold.pick(trace.prior_cov, seen)
    jac = fold.pick(solved.readings.jac[:, track], seen)
    nu = fold.pick(solved.readings.y[:, track], seen) - np.einsum("fdm,fm->fd", jac, x)
    s = np.einsum("fdj,fjk,fek->fde", jac, cov[:, :m, :m], jac, optimize=True)
    np.einsum("fdd->fd", s)[:] += fold.pick(solved.readings.var[:, track], seen)
    d2 = np.einsum("fd,fd->f", nu, np.linalg.solve(s, nu[..., None])[..., 0]) / nu.shape[1]
    # single blunders are the gate's business: the median of the window, not its mean
    windows = np.lib.stride_tricks.sliding_window_view(d2, WINDOW)
    return bool(np.median(windows, axis=1).max() > SURPRISE)


def _leaning(problem: Problem, solved: Solution) -> bool:
    """Whether an encoder is off to the same side for LASTING s, by more than white noise of its own ever is."""
    rows = solved.fold.unfold(solved.trace.encoder_d)[problem.timeline.encoders]
    for column in rows.T:
        d = np.clip(column[np.isfinite(column)], -SURPRISE, SURPRISE)
        count = int(LASTING * len(d) / max(np.ptp(problem.timeline.t), LASTING))
        total = np.concatenate([[0.0], np.cumsum(d)])
        if count >= WINDOW and np.abs(total[count:] - total[:-count]).max() > LEAN * np.sqrt(count):
            return True
    return False


def choose(problem: Problem, least: float, cost: Callable[[Problem], float]) -> Problem:
    """The problem, which costs `least` nats, with an offset for each encoder whose lie explains GAIN of them."""
    best, m = problem, len(problem.start)
    for _ in range(m):
        drift = np.zeros(m) if best.precision.drift is None else np.asarray(best.precision.drift)
        trials = [with_drift(problem, drift + WALKS[0] * np.eye(m)[j]) for j in np.flatnonzero(drift == 0)]
        costs = [cost(trial) for trial in trials]
        if not costs or min(costs) > least - GAIN:
            break
        least, best = min(zip(costs, trials, strict=True), key=lambda pair: pair[0])
    if best is problem:
        return problem
    others = [with_drift(best, np.asarray(best.precision.drift) * (walk / WALKS[0])) for walk in WALKS[1:]]
    # pictures taken for blurred on the lie's account are as sharp as perception says
    sharp = replace(best.precision, scale=dict.fromkeys(best.precision.scale, 1.0))
    return min([best, replace(best, precision=sharp), *others], key=cost)


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
