"""Encoder offsets: whether the log needs one, and which encoder has it.

`find_suspected_encoders` scores an offset of each encoder to first order (`offset_scores`).
`choose_encoder_offsets` filters the log with each hypothesis: an offset that walks at random, a
step, or a steady drift (`offset_changes`).
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import numpy as np

from ...types import ALTERNATIVE_SEPARATOR, Array, Fault, FaultKind, Hypothesis
from ..inference.filter_problem import FilterProblem
from ..inference.solution import Solution
from ..inference.tangents import OFFSET_STD
from ..measurements.records import Evidence
from ..noise.quantisation import find_reading_step
from .offset_changes import (
    RANDOM_WALKS,
    OffsetHypothesis,
    find_likeliest_changes,
    list_random_walks,
    measure_free_energy,
    with_drift,
    with_walk,
)
from .offset_scores import rejects_images, score_encoder_offsets
from .threshold import CERTAIN_SIGMA, EVIDENCE_THRESHOLD_NATS


def find_suspected_encoders(
    problem: FilterProblem, solved: Solution
) -> tuple[FilterProblem, Array]:
    """The problem with the hypotheses of an offset of each encoder, to first order, and which (M,)
    bool win EVIDENCE_THRESHOLD_NATS.
    """
    gain, offset, var = score_encoder_offsets(problem, solved, RANDOM_WALKS[0])
    least = find_smallest_fault(problem.evidence)
    certain = _mark_significant_offsets(offset, var, least)
    if ((gain > EVIDENCE_THRESHOLD_NATS) & ~certain.any(axis=0)).any():
        # of readings with little noise, innovations that are cut show no offset of that size
        _, offset, var = score_encoder_offsets(problem, solved, RANDOM_WALKS[0], np.inf)
        certain = certain | _mark_significant_offsets(offset, var, least)
    found = (("offset", j, nats, False) for j, nats in enumerate(gain)) if gain.any() else ()
    return _add_hypotheses(problem, found), np.asarray(
        (gain > EVIDENCE_THRESHOLD_NATS) & certain.any(axis=0) & (list_random_walks(problem) == 0)
    )


def choose_encoder_offsets(
    problem: FilterProblem,
    solved: Solution,
    suspected: Array,
    relearn: Callable[[FilterProblem], FilterProblem],
) -> FilterProblem:
    """Add one offset after the other while each wins
    EVIDENCE_THRESHOLD_NATS, and the hypotheses compared.

    solved: a solution of the problem, from which each hypothesis is filtered · suspected (M,) bool:
    the encoders tried first, at least one · relearn: gives a problem noise by its own evidence.
    Steps are taken out of the readings, and are faults of the evidence. Joints with an offset are
    keys of the problem's `alternatives`.
    """
    found = problem
    nats = measure_free_energy(problem, solved)
    while suspected.any():
        walks = {
            j: measure_free_energy(with_walk(found, j, RANDOM_WALKS[0]), solved)
            for j in np.flatnonzero(suspected).tolist()
        }
        found = _add_hypotheses(
            found, (("offset", j, nats - walk, False) for j, walk in walks.items())
        )
        wins = min(walks.values()) <= nats - EVIDENCE_THRESHOLD_NATS
        if not wins and found.alternatives:
            break
        # a gate rejects the readings after a large step, so that
        # no offset wanders there: only a step is left to try
        near = _list_near_optimal_joints(walks) if wins else list(walks)
        # the kind of offset is chosen before a further one
        # is tried: one that wanders too freely hides others
        offsets = {j: _find_best_offset(found, j, solved, relearn) for j in near}
        costs = {j: offset.nats for j, offset in offsets.items()}
        if min(costs.values()) > nats - EVIDENCE_THRESHOLD_NATS:
            break
        # among indistinguishable joints take the smallest
        # walk: a larger one follows errors of the body model
        near = sorted(_list_near_optimal_joints(costs))
        joint = min(near, key=lambda j: (list_random_walks(offsets[j].problem)[j], costs[j]))
        compared = [(offsets[j].name, j, nats - costs[j], j == joint) for j in offsets]
        found = _add_hypotheses(_with_offset_hypothesis(offsets[joint], joint, near), compared)
        nats = costs[joint]
        # once one offset is modelled, another may show
        suspected = (list_random_walks(found) == 0) & ~np.isin(
            np.arange(len(suspected)), list(found.alternatives)
        )
    if len(found.alternatives) < 2:
        return found
    return _reconsider_offsets(problem, found, nats, solved, relearn)


def _reconsider_offsets(
    problem: FilterProblem,
    found: FilterProblem,
    nats: float,
    solved: Solution,
    relearn: Callable[[FilterProblem], FilterProblem],
) -> FilterProblem:
    """Each of several offsets again, given the others, if all of them together then cost less.

    The first was chosen while the others were unknown, and may have taken up part of them.
    """
    again = found
    again_nats = nats
    for joint, others in found.alternatives.items():
        offset = _find_best_offset(
            _remove_joint_offset(problem, again, joint), joint, solved, relearn
        )
        again = _with_offset_hypothesis(offset, joint, [joint, *others])
        again_nats = offset.nats
    return again if again_nats < nats else found


def _remove_joint_offset(problem: FilterProblem, found: FilterProblem, joint: int) -> FilterProblem:
    """The problem with the offsets found but for one joint's, whose readings are as they were."""
    assert problem.evidence.encoders is not None and found.evidence.encoders is not None
    own = np.arange(len(problem.start)) == joint
    values = np.where(own, problem.evidence.encoders.values, found.evidence.encoders.values)
    name = problem.evidence.joints[joint]
    known = problem.evidence.faults
    kept = [fault for fault in found.evidence.faults if fault in known or fault.names[0] != name]
    encoders = replace(found.evidence.encoders, values=values)
    evidence = replace(found.evidence, encoders=encoders, faults=tuple(kept))
    alternatives = {j: others for j, others in found.alternatives.items() if j != joint}
    return with_drift(
        replace(found, evidence=evidence, alternatives=alternatives),
        np.where(own, list_random_walks(problem), list_random_walks(found)),
    )


def _list_near_optimal_joints(costs: Mapping[int, float]) -> list[int]:
    """Joints whose cost is within EVIDENCE_THRESHOLD_NATS of the least."""
    return [
        joint
        for joint, nats in costs.items()
        if nats < min(costs.values()) + EVIDENCE_THRESHOLD_NATS
    ]


def _add_hypotheses(
    problem: FilterProblem, found: Iterable[tuple[str, int, float, bool]]
) -> FilterProblem:
    """The problem with further hypotheses: kind, joint, nats
    won, chosen or not; the last one of a joint and kind.
    """
    evidence = problem.evidence
    each = (
        Hypothesis(f"encoder {kind}", evidence.joints[j], float(nats), EVIDENCE_THRESHOLD_NATS, won)
        for kind, j, nats, won in found
    )
    new = {(one.name, one.about): one for one in each}
    known = [new.pop((one.name, one.about), one) for one in evidence.hypotheses]
    return replace(problem, evidence=replace(evidence, hypotheses=(*known, *new.values())))


def _with_offset_hypothesis(offset: OffsetHypothesis, joint: int, near: list[int]) -> FilterProblem:
    """The problem with an offset of one joint, or of those in `near`, which explain as much."""
    evidence = offset.problem.evidence
    others = tuple(j for j in near if j != joint)
    if offset.fault is not None:
        size = np.nan if others else offset.fault.size
        fault = replace(
            offset.fault, name=_name_alternatives(evidence.joints, joint, others), size=size
        )
        evidence = replace(evidence, faults=(*evidence.faults, fault))
    return replace(
        offset.problem,
        evidence=evidence,
        alternatives={**offset.problem.alternatives, joint: others},
    )


def _name_alternatives(names: tuple[str, ...], joint: int, others: tuple[int, ...]) -> str:
    """A faulty joint's name, with those of others that the log cannot distinguish from it."""
    return ALTERNATIVE_SEPARATOR.join(names[j] for j in (joint, *others))


def _find_best_offset(
    problem: FilterProblem,
    joint: int,
    solved: Solution,
    relearn: Callable[[FilterProblem], FilterProblem],
) -> OffsetHypothesis:
    """The best random walk of one joint's offset, or its step or steady drift if that costs less.

    These are compared with noise learned again with the offset: the problem's own has absorbed it.
    """
    allowed = with_drift(
        relearn(with_walk(problem, joint, RANDOM_WALKS[0])), list_random_walks(problem)
    )
    walks = (with_walk(allowed, joint, walk) for walk in RANDOM_WALKS)
    hypotheses = (OffsetHypothesis(one, measure_free_energy(one, solved)) for one in walks)
    best = min(hypotheses, key=lambda offset: offset.nats)
    changes = find_likeliest_changes(allowed, best.problem, joint, solved)
    offset = min((best, *changes), key=lambda one: one.nats)
    # against no offset it counts with the problem's noise: less of it makes an offset of a poor
    # body's errors; with its own where the problem's is that of a filter which rejects all images
    found = replace(
        offset.problem, precision=replace(problem.precision, drift=offset.problem.precision.drift)
    )
    usual = offset._replace(problem=found, nats=measure_free_energy(found, solved) + offset.prior)
    lost = rejects_images(problem, solved)
    return min((usual, offset), key=lambda one: one.nats) if lost else usual


def choose_preset_walks(setting: str, evidence: Evidence) -> Array | None:
    """Random walks (M,) rad²/s set beforehand: for all joints if `on`, for encoders that are wrong
    after a jump if `auto`.

    Without images nothing tells what is left of a jump: its size's variance is all that is known.
    """
    names = evidence.joints
    seen = any(sighting.name != "touch" for sighting in evidence.sightings)
    jumped = {
        fault.name
        for fault in evidence.faults
        if fault.kind == FaultKind.JUMPING and fault.until is None and seen
    }
    if setting == "on" or (setting == "auto" and jumped):
        return np.array(
            [RANDOM_WALKS[1] if setting == "on" or name in jumped else 0.0 for name in names]
        )
    return None


def measure_repair_variance(problem: FilterProblem, offset_var: Array | None) -> Array:
    """Variance (E,M) rad² of angles by the sizes ± std
    of jumps that were taken out of earlier readings.

    offset_var (E,M) rad²: of offsets in the state, or None. Images that turned an offset's prior
    variance V into P hold the information 1/P − 1/V. They hold it of what is left of the jump, too:
    with a prior V + std² the variance would be 1/(1/(V + std²) + 1/P − 1/V), and P less is added.
    """
    t = problem.timeline.t
    walks = list_random_walks(problem)
    names = problem.evidence.joints
    added = np.zeros((len(t), len(names)))
    for fault in problem.evidence.faults:
        joint = fault.names[0]
        if fault.sense != "encoders" or fault.std is None or joint not in names:
            continue
        column = names.index(joint)
        left = np.full(len(t), fault.std**2)
        if offset_var is not None and walks[column] > 0.0:
            prior = OFFSET_STD**2 + walks[column] * (t - t[0])
            known = np.minimum(offset_var[:, column], prior)
            left = 1.0 / (1.0 / (prior + fault.std**2) + 1.0 / known - 1.0 / prior) - known
        added[:, column] += np.where((t >= fault.since) & (t < fault.end), left, 0.0)
    return added


def find_smallest_fault(evidence: Evidence) -> Array | float:
    """Smallest offsets (M,) that count as faults, in the
    readings' unit: sound encoders are off by half a count.

    An encoder that never moved is assumed to have the largest step of the others.
    """
    encoders = evidence.encoders
    least = OFFSET_STD / evidence.rad_per_unit
    if encoders is None:
        return least
    columns = [column[np.isfinite(column)] for column in encoders.as_read.values.T]
    steps = [find_reading_step(y) for y in columns]
    steps_shown = [
        step if len(y) and np.ptp(y) else max(steps) for step, y in zip(steps, columns, strict=True)
    ]
    return np.maximum(least, steps_shown)


def _mark_significant_offsets(offset: Array, var: Array, least: Array | float) -> Array:
    """Where offsets (N,M) with variances (N,M) are
    significant and at least the smallest fault, `least` (M,) rad.
    """
    return np.asarray(np.abs(offset) > np.maximum(least, CERTAIN_SIGMA * np.sqrt(var)))


def list_drifting_encoders(problem: FilterProblem, offset: Array, var: Array) -> tuple[Fault, ...]:
    """Return drifting encoders, since when and how far, from offsets and their variances (N,M).

    Where another joint's offset explains nearly as much, both are named and the size is NaN.
    """
    t = problem.timeline.t
    walks = list_random_walks(problem)
    names = problem.evidence.joints
    found = []
    certain = _mark_significant_offsets(offset, var, find_smallest_fault(problem.evidence))
    stepped = [
        (joint, *others) for joint, others in problem.alternatives.items() if not walks[joint]
    ]
    known = (fault.name for fault in problem.evidence.faults if fault.sense == "encoders")
    faulty = {*known, *(names[j] for joints in stepped for j in joints)}
    for joint, name in enumerate(names):
        if name in faulty:
            continue
        off = certain[:, joint]
        lasting = off & (np.cumsum(off[::-1])[::-1] > 0.5 * np.arange(len(t), 0, -1))
        if lasting.any():
            alternatives = problem.alternatives.get(joint, ())
            # the largest that is certain
            at = int((np.abs(offset[:, joint]) - CERTAIN_SIGMA * np.sqrt(var[:, joint])).argmax())
            size, std = (
                (np.nan, None)
                if alternatives
                else (float(offset[at, joint]), float(np.sqrt(var[at, joint])))
            )
            either = _name_alternatives(names, joint, alternatives)
            since = float(t[lasting.argmax()])
            found.append(
                Fault(
                    "encoders", either, FaultKind.DRIFTING, since, size, problem.evidence.unit, std
                )
            )
    return tuple(found)
