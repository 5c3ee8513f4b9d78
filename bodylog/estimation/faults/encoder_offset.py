"""Encoder offsets: whether the log needs one, which encoder has it, and since when it drifts."""

from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ...types import Array, Fault, Hypothesis
from ..inference.problem import Problem
from ..inference.solution import Solution
from ..measurements.records import Encoders
from ..noise.quantisation import step_size
from .offset_score import offset_score
from .offset_step import EARLY, Step, free_energy, likeliest_step
from .threshold import LEAST, NATS, SIGMAS

MOST = 2000
"""Most instants used for the size of a fault."""
WALKS = (1e-4, 1e-5, 1e-3, 1e-7)
"""rad²/s: random-walk variances tried; the last one is a constant offset, as of a joint homed differently."""
EITHER = " or "
"""Separator between names of joints when the faulty one cannot be identified."""
OFFSET, STEP = "encoder offset", "encoder step"
"""Names of hypotheses."""


@dataclass(frozen=True, eq=False)
class Chosen:
    """A problem, its cost (nats), by joint number the joints whose offset explains nearly as much, and steps found.

    hypotheses {(name, joint): with the nats won over the problem before}.
    """

    problem: Problem
    nats: float
    alternatives: Mapping[int, tuple[int, ...]] = field(default_factory=dict)
    steps: Mapping[int, Step] = field(default_factory=dict)
    hypotheses: Mapping[tuple[str, str], Hypothesis] = field(default_factory=dict)

    def of(self, problem: Problem) -> "Chosen":
        """Return a copy with another problem."""
        return replace(self, problem=problem)


def suspected_encoders(problem: Problem, solved: Solution) -> tuple[Array, Array]:
    """Encoders (M,) bool whose offset would, to first order, explain NATS nats of the log, and these nats (M,)."""
    gain, offset, var = offset_score(problem, solved, WALKS[0])
    certain = _significant(offset, var, smallest_fault(problem.evidence.encoders))
    return np.asarray((gain > NATS) & certain.any(axis=0) & (_walks(problem) == 0)), gain


def with_hypotheses(problem: Problem, gains: Array, chosen: "Chosen | None" = None) -> Problem:
    """The problem with a hypothesis of an offset of each encoder: `chosen`, else with its first-order nats (M,)."""
    if not gains.any():
        return problem
    evidence, exact = problem.evidence, {} if chosen is None else chosen.hypotheses
    first = {
        (OFFSET, name): Hypothesis(OFFSET, name, float(gain), NATS, False)
        for name, gain in zip(evidence.joints, gains, strict=True)
    }
    found = (*evidence.hypotheses, *{**first, **exact}.values())
    return replace(problem, evidence=replace(evidence, hypotheses=found))


def choose(problem: Problem, solved: Solution, suspected: Array, cost: Callable[[Problem], float]) -> Chosen:
    """Return the problem with an offset for each encoder where that wins NATS; `cost` gives nats.

    suspected (M,) bool: the encoders tried first, at least one. Steps are taken out of the readings, and are faults and
    hypotheses of the evidence.
    """
    first = cost(problem)
    found = _added(Chosen(problem, free_energy(solved) if np.isinf(first) else first), solved, suspected, cost)
    if found.problem is problem:
        return found
    # images that looked blurred because of the offset regain the std that perception states
    precision = found.problem.precision
    sharp = replace(found.problem, precision=replace(precision, scale=dict.fromkeys(precision.scale, 1.0)))
    unchanged = sharp.precision.scale == precision.scale or cost(sharp) >= found.nats
    return _named(found if unchanged else found.of(sharp))


def _named(found: Chosen) -> Chosen:
    """The same with its steps among the faults of the evidence; one from the start is no jump."""
    evidence, start = found.problem.evidence, found.problem.timeline.t[0]
    faults = tuple(
        Fault("encoders", either, kind, step.since, np.nan if EITHER in either else step.size, "rad", step.std)
        for joint, step in found.steps.items()
        for kind in ["jumping" if step.since > start + EARLY else "drifting"]
        for either in [EITHER.join(evidence.joints[k] for k in (joint, *found.alternatives[joint]))]
    )
    return found.of(replace(found.problem, evidence=replace(evidence, faults=(*evidence.faults, *faults))))


def _added(found: Chosen, solved: Solution, suspected: Array, cost: Callable[[Problem], float]) -> Chosen:
    """Add one offset after the other while each wins NATS."""
    while suspected.any():
        drift = _walks(found.problem)
        asked = np.flatnonzero(suspected)
        own = [np.arange(len(drift)) == j for j in asked]
        costs = np.array([cost(with_drift(found.problem, np.where(one, WALKS[0], drift))) for one in own])
        best, joints = int(costs.argmin()), found.problem.evidence.joints
        tried = {j: found.nats - nats for j, nats in zip(asked.tolist(), costs, strict=True)}
        if costs[best] > found.nats - NATS:
            return replace(found, hypotheses={**found.hypotheses, **_compared(joints, tried, {}, (), None)})
        near = [int(j) for j, nats in zip(asked, costs, strict=True) if nats < costs[best] + NATS]
        # the kind of offset is chosen before a further one is tried: one that wanders too freely hides others
        ways = {j: _best_way(found.problem, j, float(costs[asked == j][0]), solved, cost) for j in near}
        least = min(way.nats for way in ways.values())
        # among indistinguishable joints take the smallest walk: a larger one follows errors of the body model
        near = [j for j, way in ways.items() if way.nats < least + NATS]
        joint = min(near, key=lambda j: (_walks(ways[j].problem)[j], ways[j].nats, j))
        way, others = ways[joint], tuple(sorted(j for j in near if j != joint))
        steps = {**found.steps, joint: way} if isinstance(way, Step) else found.steps
        won = {j: found.nats - one.nats for j, one in ways.items()}
        stepping = [j for j, one in ways.items() if isinstance(one, Step)]
        hypotheses = {**found.hypotheses, **_compared(joints, tried, won, stepping, joint)}
        found = Chosen(way.problem, way.nats, {**found.alternatives, joint: others}, steps, hypotheses)
        # once one offset is modelled, another may show
        suspected = (_walks(found.problem) == 0) & ~np.isin(np.arange(len(drift)), list(steps))
    return found


def _compared(
    names: tuple[str, ...], walks: Mapping[int, float], ways: Mapping[int, float], steps: Container[int],
    chosen: int | None,
) -> dict[tuple[str, str], Hypothesis]:  # fmt: skip
    """Hypotheses of an offset of each joint tried: nats won by the first of its `walks`, and by the best of its `ways`.

    steps: joints whose best way is a step · chosen: the joint whose offset is chosen.
    """
    found = {(OFFSET, joint): (nats, False) for joint, nats in walks.items()}
    found |= {(STEP if j in steps else OFFSET, j): (nats, j == chosen) for j, nats in ways.items()}
    each = (Hypothesis(kind, names[j], float(nats), NATS, won) for (kind, j), (nats, won) in found.items())
    return {(one.name, one.about): one for one in each}


def _best_way(
    problem: Problem, joint: int, least: float, solved: Solution, cost: Callable[[Problem], float]
) -> Chosen | Step:  # fmt: skip
    """The best random walk of one joint's offset, or its step where that costs less; the first walk costs `least`."""
    own = np.arange(len(problem.start)) == joint
    ways = [with_drift(problem, np.where(own, walk, _walks(problem))) for walk in WALKS]
    costs = [least, *(cost(way) for way in ways[1:])]
    walk = int(np.argmin(costs))
    step = likeliest_step(problem, ways[walk], joint, solved)
    return step if step is not None and step.nats < costs[walk] else Chosen(ways[walk], costs[walk])


def _walks(problem: Problem) -> Array:
    """Random walks (M,) rad²/s of the offsets in the problem so far."""
    return np.zeros(len(problem.start)) if problem.precision.drift is None else np.asarray(problem.precision.drift)


def with_drift(problem: Problem, drift: Array) -> Problem:
    """Return the problem with random walks `drift` (M,) rad²/s of encoder offsets; 0 for no offset."""
    return replace(problem, precision=replace(problem.precision, drift=drift))


def preset_walks(setting: str, names: tuple[str, ...], known: tuple[Fault, ...]) -> Array | None:
    """Random walks (M,) rad²/s set without evidence: for all joints if `on`, for encoders that jumped if `auto`."""
    jumped = {fault.name for fault in known if fault.kind == "jumping"}
    if setting == "on" or (setting == "auto" and jumped):
        return np.array([WALKS[1] if setting == "on" or name in jumped else 0.0 for name in names])
    return None


def smallest_fault(encoders: Encoders | None) -> Array | float:
    """Smallest offsets (M,) rad that count as faults: sound encoders are off by half a step of their counts.

    An encoder that never moved is assumed to have the largest step of the others.
    """
    if encoders is None:
        return LEAST
    columns = [column[np.isfinite(column)] for column in encoders.values.T]
    steps = [step_size(y) for y in columns]
    steps_shown = [step if len(y) and np.ptp(y) else max(steps) for step, y in zip(steps, columns, strict=True)]
    return np.maximum(LEAST, steps_shown)


def _significant(offset: Array, var: Array, least: Array | float) -> Array:
    """Where offsets (N,M) with variances (N,M) are significant and at least `smallest_fault` (M,) rad."""
    return np.asarray(np.abs(offset) > np.maximum(least, SIGMAS * np.sqrt(var)))


def faults(
    problem: Problem, names: tuple[str, ...], offset: Array, var: Array, known: tuple[Fault, ...]
) -> tuple[Fault, ...]:
    """Return drifting encoders, since when and how far, from offsets and their variances (N,M).

    Where another joint's offset explains nearly as much, both are named and the size is NaN.
    """
    t, walks = problem.timeline.t, _walks(problem)
    found, certain = [], _significant(offset, var, smallest_fault(problem.evidence.encoders))
    faulty = {name for fault in (*known, *problem.evidence.faults) for name in fault.name.split(EITHER)}
    for joint, name in enumerate(names):
        if name in faulty:
            continue
        off = certain[:, joint]
        lasting = off & (np.cumsum(off[::-1])[::-1] > 0.5 * np.arange(len(t), 0, -1))
        if lasting.any():
            alternatives = problem.alternatives.get(joint, ())
            own = offset[:, joint], var[:, joint], float(walks[joint])
            size, std = (np.nan, None) if alternatives else _largest_smoothed(t, *own)
            either = EITHER.join([name, *(names[k] for k in alternatives)])
            found.append(Fault("encoders", either, "drifting", float(t[lasting.argmax()]), size, "rad", std))
    return tuple(found)


def _largest_smoothed(t: Array, offset: Array, var: Array, walk: float) -> tuple[float, float]:
    """Largest smoothed offset and its std (rad) from filtered ones (N,) with variances (N,) at t (N,) s."""
    some = np.unique(np.linspace(0, len(t) - 1, min(len(t), MOST)).astype(int))
    ahead = var[some][:-1] + walk * np.diff(t[some])
    back = var[some][:-1] / np.maximum(ahead, np.finfo(float).tiny)
    whole, spread = offset[some].tolist(), var[some].tolist()
    for k in range(len(whole) - 2, -1, -1):
        whole[k] += back[k] * (whole[k + 1] - whole[k])
        spread[k] += back[k] ** 2 * (spread[k + 1] - ahead[k])
    at = int(np.argmax(np.abs(whole)))
    return float(whole[at]), float(np.sqrt(max(spread[at], 0.0)))
