"""Beliefs that allow for errors of the hardware, in
place of those of a filter that knows white noise alone.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from ...body_model import BodyModel
from ...fault_kinds import OFF_FROM_START_S
from ...settings import EstimationSettings
from ...types import Array, Estimate, Fault, FaultKind, Finding
from ..factors.columns import EncoderShift, ImageShift, Play, describe_displacement
from ..factors.factor_problem import ANY_ERRORS, CHANGE, LastingPrior, Noise
from ..factors.hypotheses import DRIFTS_S, OFFSET, Explanation
from ..factors.load import (
    FIRST_BEND,
    Load,
    LoadColumns,
    bend_under_load,
    build_load_columns,
    describe_load,
)
from ..factors.whole_log import ExplainedLog, SolvedLog, explain_log, resembles_load, solve_log
from ..faults.moved_camera import restore_displacements
from ..faults.threshold import EVIDENCE_THRESHOLD_NATS, SIGNIFICANT_SIGMA
from ..inference.filter_problem import FilterProblem
from ..measurements.arm_errors import LEAST_NEES, read_arm_errors
from ..noise.lasting_error import LastingError
from . import results
from .results import (
    Beliefs,
    estimate_white_nees,
    find_evident_error,
    predict_frames,
    with_lasting_error,
)
from .slip_estimates import estimate_stick_slip
from .trust import (
    find_reason_of_disagreement,
    find_reason_of_misfit,
    find_reason_to_widen,
    measure_rough_motion,
)

LIKE_OFFSETS = "offsets of encoders explain the log as well as a load does, or better"
"""Why a load that a log resembles is not taken out of its angles."""


def estimate_with_hardware_errors(
    body: BodyModel,
    problem: FilterProblem,
    first: FilterProblem,
    beliefs: Beliefs,
    settings: EstimationSettings,
) -> Estimate:
    """The estimate of these beliefs; where errors of encoders last, that of beliefs which allow for
    errors of the hardware, if these can be trusted, or else with wider error bars.

    first: the problem before encoder offsets were looked for. Offsets that other errors of the
    hardware explain, too, are no faults.
    """
    kept = results.build_estimate(settings.method, problem.evidence, problem.timeline, beliefs)
    halves = _read_play_halves(body)
    prior = _choose_lasting_prior(body)
    lasting = find_evident_error(kept, problem, beliefs.z, settings, kept.faults)
    if lasting is None and (halves.any() or prior.known) and settings.precision == "auto":
        square = float(np.mean(np.square(halves)))
        square += np.exp(2.0 * prior.error[0]) if prior.known else 0.0
        lasting = LastingError(square**0.5, 0.0, 0.0)

    def try_explanation(std: float, is_white: bool) -> Estimate | str:
        known = (halves, prior)
        try:
            return _explain_estimate(body, problem, first, beliefs, settings, std, known, is_white)
        except np.linalg.LinAlgError as singular:
            return f"their explanation has no solution ({singular})"

    if lasting is None:
        suspected = _suspect_error(kept, problem, beliefs, settings)
        made = None if suspected is None else try_explanation(suspected, False)
        if isinstance(made, Estimate):
            return made
    # a load looks like an encoder that drifts, by less than counts as a fault, too
    if lasting is None and not beliefs.faults and not _has_offsets(problem, first):
        if settings.precision != "auto":
            return kept
        rough = measure_rough_motion(problem, beliefs, settings.method != "smoother")
        if rough is None or estimate_white_nees(kept, rough.variance) < LEAST_NEES:
            return kept
        slipping = estimate_stick_slip(problem, beliefs, settings, rough)
        return results.with_rough_motion(kept, rough.variance) if slipping is None else slipping
    made = try_explanation(FIRST_BEND if lasting is None else lasting.std, lasting is None)
    if isinstance(made, Estimate):
        return made
    if lasting is not None:
        return with_lasting_error(kept, lasting, made)
    if made != LIKE_OFFSETS or beliefs.faults:
        return kept
    text = (
        "encoders: offsets smaller than a fault explain the log, and a load does about as well; "
        "error bars hold for the offsets alone"
    )
    return replace(kept, findings=(*kept.findings, Finding("warning", text)))


def _suspect_error(
    kept: Estimate, problem: FilterProblem, beliefs: Beliefs, settings: EstimationSettings
) -> float | None:
    """The size (rad) of an error which the beliefs hide: play that came after the exploration, or
    what lasts where an offset that wanders follows it, even one as large as a fault.
    """
    worn = problem.evidence.worn
    if worn.any() and settings.precision == "auto":
        return float(np.sqrt(np.mean(np.square(worn))))
    if not beliefs.faults:
        return None
    hidden = find_evident_error(kept, problem, beliefs.z, settings, problem.evidence.faults)
    return None if hidden is None else hidden.std


def _explain_estimate(
    body: BodyModel,
    problem: FilterProblem,
    first: FilterProblem,
    beliefs: Beliefs,
    settings: EstimationSettings,
    std: float,
    known: tuple[Array, LastingPrior],
    is_white: bool,
) -> Estimate | str:
    """The estimate that allows for errors of about std rad, or why it is not to be trusted.

    known: half of each joint's play (M,) rad in the exploration, and its encoders' errors ·
    is_white: encoders that are off are all that the log shows.
    """
    why = find_reason_to_widen(problem, std, settings)
    if why is not None:
        return why
    assert problem.evidence.encoders is not None  # or bars are widened
    loads = build_load_columns(body, problem.evidence.encoders.values)
    simpler_ones = _drop_faults(problem, first)
    if is_white and not any(resembles_load(problem, one, loads) for one in simpler_ones):
        return "white noise explains the log as well"
    found = explain_log(problem, *known, loads)
    if found is None:
        return "no images show the joints"
    causal = settings.method != "smoother"
    simpler = _explain_without_faults(problem, first, found, beliefs.faults, known, loads)
    if simpler is not None:
        problem, found = simpler
        beliefs = replace(beliefs, faults=())
    elif is_white:
        return LIKE_OFFSETS
    solved = solve_log(problem, found, causal)
    if simpler is None:
        why = find_reason_of_disagreement(problem, beliefs, found, solved, causal)
        if why is not None:
            return why
    if found.explanation.is_sound:
        return "white noise explains the log as well"
    why = find_reason_of_misfit(problem, found, solved, causal)
    if why is not None:
        return why
    explained = _with_explanation(problem, beliefs, found, solved)
    problem = _size_steps_again(problem, found.explanation)
    made = results.build_estimate(settings.method, problem.evidence, problem.timeline, explained)
    errors = _describe_errors(found, problem.evidence.joints)
    text = "; ".join(_describe_errors_in_words(errors)) or "encoders: errors last"
    return results.with_hardware_errors(made, errors, f"{text}: angles allow for it")


def _read_play_halves(body: BodyModel) -> Array:
    """Half of the play (M,) rad that each joint had in the exploration."""
    play = read_arm_errors(body).play
    return np.array([0.5 * play[name][0] if name in play else 0.0 for name in body.joints])


def _choose_lasting_prior(body: BodyModel) -> LastingPrior:
    """What is known of errors of encoders before a log: those of the
    exploration, if it had any, to about half of their size.
    """
    found = read_arm_errors(body).lasting
    if not found:
        return ANY_ERRORS
    each = [found[name] for name in body.joints if name in found]
    std = float(np.sqrt(np.mean([one**2 for one, _ in each])))
    seconds = max(one for _, one in each)
    return LastingPrior((float(np.log(std)), CHANGE), (float(np.log(seconds)), CHANGE), True)


def _explain_without_faults(
    problem: FilterProblem,
    first: FilterProblem,
    found: ExplainedLog,
    faults: tuple[Fault, ...],
    known: tuple[Array, LastingPrior],
    loads: tuple[LoadColumns, ...],
) -> tuple[FilterProblem, ExplainedLog] | None:
    """The most probable explanation without encoder offsets, or with no
    moved camera either, where that is as good as with faults; else None.
    """
    best = None
    for without in _drop_faults(problem, first):
        simpler = explain_log(without, *known, loads)
        assert simpler is not None  # as the log with faults has one
        cameras = len(first.evidence.faults) - len(without.evidence.faults)
        allowance = _choose_fault_allowance(simpler, found, problem, faults, cameras)
        if simpler.nats - found.nats <= allowance and (best is None or simpler.nats < best[1].nats):
            best = (without, simpler)
    return best


def _drop_faults(problem: FilterProblem, first: FilterProblem) -> Iterator[FilterProblem]:
    """Yield the problem without the encoder offsets that were
    found, and without the displacements of cameras, too.
    """
    drift = replace(problem.precision, drift=first.precision.drift)
    evidence = replace(first.evidence, hypotheses=problem.evidence.hypotheses)
    plain = replace(problem, evidence=evidence, precision=drift, alternatives={})
    if _has_offsets(problem, first):
        yield plain
    if any(one.kind == FaultKind.DISPLACED for one in evidence.faults):
        yield replace(plain, evidence=restore_displacements(evidence))


def _choose_fault_allowance(
    found: ExplainedLog,
    beside: ExplainedLog,
    problem: FilterProblem,
    faults: tuple[Fault, ...],
    cameras: int,
) -> float:
    """Nats by which a log without encoder offsets and this number
    of moved cameras may be less likely than with them.

    beside: the log with them. What lasts for long, or is several times the exploration's, would be
    an offset itself. Play, unless it is there beside the offsets, too, and one load explain several
    offsets at once, and one encoder more that is off from the first reading on counts as one fault
    more. A load, or one encoder that is off beside other errors, is as simple as an offset of one
    encoder, if it is evident beside errors that last,
    or is there beside the offsets, too; if not, it must be evident beside offsets of known size.
    An offset too small for a fault goes
    where the log is as likely without it. The sizes of a displacement cost no evidence.
    """
    passing = _is_usual(found.noise)
    moves = 0.0 if _is_picked_up(found.explanation) else cameras * EVIDENCE_THRESHOLD_NATS
    gains = found.explanation.gains
    off = _count_from_start(problem, faults)
    if off > 1 and (passing or "load" in gains):
        return moves + (off - 1) * EVIDENCE_THRESHOLD_NATS
    if ("load" in gains or "offset" in gains) and passing:
        named = any(np.isfinite(fault.size) for fault in faults)
        gain = gains["load"] if "load" in gains else gains["offset"]
        evident = gain > EVIDENCE_THRESHOLD_NATS or "load" in beside.explanation.gains
        return moves - EVIDENCE_THRESHOLD_NATS if named and not evident else moves
    if passing and not faults and not cameras:
        return 0.0
    if not (passing and "play" in gains) or cameras:
        return -np.inf
    return 0.0 if "play" in beside.explanation.gains else EVIDENCE_THRESHOLD_NATS


def _is_picked_up(explanation: Explanation) -> bool:
    """Whether a load explains the log that is not carried all the time."""
    loads = (one for one in explanation.columns if isinstance(one, Load))
    return any(one.moments != (-np.inf,) for one in loads)


def _is_usual(noise: Noise) -> bool:
    """Whether encoders' errors last too short to imitate an offset, and are of a size that is
    probable before the log. No error is usual, too.
    """
    joints = noise.joints
    if joints.error is None:
        return True
    middle, std = noise.prior.error
    usual = joints.error <= np.exp(middle + SIGNIFICANT_SIGMA * std)
    return bool((usual & (joints.seconds < DRIFTS_S))[joints.learned].all())


def _count_from_start(problem: FilterProblem, faults: tuple[Fault, ...]) -> int:
    """How many encoders have an offset, if all that are named have had it from the start."""
    begin = problem.timeline.t[0] + OFF_FROM_START_S
    if not faults or problem.precision.drift is None:
        return 0
    off = int((problem.precision.drift > 0.0).sum())
    return off if all(fault.since < begin for fault in faults) else 0


def _has_offsets(problem: FilterProblem, first: FilterProblem) -> bool:
    """Whether encoder offsets were found since the first problem."""
    return problem.evidence.faults != first.evidence.faults or bool(problem.alternatives)


def _with_explanation(
    problem: FilterProblem, beliefs: Beliefs, found: ExplainedLog, solved: SolvedLog
) -> Beliefs:
    """The beliefs of an explained log."""
    instants = solved.instants
    parts = [instants.angles, instants.rates]
    if problem.precision.drift is not None:
        parts.append(instants.offsets)
    scale = {**beliefs.scale, **dict(zip(found.senses, found.noise.scales, strict=True))}
    places = [
        solved.places[sighting.name]
        if sighting.name in solved.places
        else predict_frames(sighting, instants.before[at], instants.before_cov[at])
        for sighting, at in zip(problem.evidence.sightings, problem.timeline.sightings, strict=True)
    ]
    return replace(
        beliefs,
        z=np.concatenate(parts, axis=1),
        cov=instants.cov + np.diag(_estimate_resting_variances(found.noise)),
        nats=instants.nats,
        before=instants.before,
        before_cov=instants.before_cov,
        encoder_errors=instants.encoder_errors,
        scale=scale,
        findings=(),  # they are of beliefs that are not reported
        places=tuple(places),
    )


def _size_steps_again(problem: FilterProblem, explanation: Explanation) -> FilterProblem:
    """The problem with faults of the sizes and standard deviations that steps of encoders have
    beside what explains the log, and with the encoder that is off all the time.
    """
    begin = float(problem.timeline.t[0])
    faults = list(problem.evidence.faults)
    learned = explanation.learned
    stds = np.sqrt(np.diag(learned.sizes_cov)).tolist()
    for column, more, std in zip(explanation.columns, learned.sizes.tolist(), stds, strict=True):
        if not isinstance(column, EncoderShift):
            continue
        name = problem.evidence.joints[column.joint]
        if column.name == OFFSET:
            unit = problem.evidence.unit
            faults.append(Fault("encoders", name, FaultKind.DRIFTING, begin, more, unit, std))
        for k, fault in enumerate(faults):
            is_same = fault.names[0] == name and fault.since == column.since
            if is_same and fault.std is not None:
                faults[k] = replace(fault, size=fault.size + more, std=std)
    return replace(problem, evidence=replace(problem.evidence, faults=tuple(faults)))


def _estimate_resting_variances(noise: Noise) -> Array:
    """Variances (M,) of the errors of joints that rest, taken from the joints that turn."""
    joints = noise.joints
    found = np.zeros(len(joints.white))
    if joints.error is not None and noise.resting is not None and joints.learned.any():
        found[noise.resting] = np.mean(np.square(joints.error[joints.learned]))
    return found


def _describe_errors(found: ExplainedLog, names: tuple[str, ...]) -> dict[str, Any]:
    """The errors as plain numbers: what lasts, each joint's
    play, a load, and nats by which each wins.
    """
    explanation = found.explanation
    joints = found.noise.joints
    learned = explanation.learned
    sizes = learned.sizes.tolist()
    stds = np.sqrt(np.diag(learned.sizes_cov)).tolist()
    errors: dict[str, Any] = {"nats": explanation.nats, "play": {}, "lasting": None, "load": None}
    for column, size, std in zip(explanation.columns, sizes, stds, strict=True):
        if isinstance(column, Play) and size > SIGNIFICANT_SIGMA * std:
            errors["play"][names[column.joint]] = {"rad": 2.0 * size, "std": 2.0 * std}
    if loads := [one for one in explanation.columns if isinstance(one, Load)]:
        errors["load"] = _describe_load(loads, explanation, names)
    errors["displaced"] = list(_describe_displaced(explanation))
    errors["gains"] = dict(explanation.gains)
    errors["late"] = {one.camera: asdict(one) for one in explanation.delays}
    others = errors["play"] or errors["load"] or errors["displaced"]
    is_reported = explanation.lasts or not others
    if joints.error is not None and joints.learned.any() and is_reported:
        size = float(np.sqrt(np.mean(np.square(joints.error[joints.learned]))))
        where = "link" if joints.at_link.any() else "encoder"
        seconds = float(joints.seconds[joints.learned][0])
        errors["lasting"] = {
            "std": size,
            "seconds": seconds,
            "nats": explanation.lasting,
            "at": where,
        }
    return errors


def _describe_displaced(explanation: Explanation) -> Iterator[dict[str, Any]]:
    """Yield each camera whose images are displaced, from when to when (s), None at an end of the
    log, and how far along each axis (px or mm).
    """
    sizes = zip(explanation.columns, explanation.learned.sizes.tolist(), strict=True)
    shifts: dict[tuple[str, float, float], list[float]] = {}
    for one, size in sizes:
        if isinstance(one, ImageShift):
            shifts.setdefault((one.camera, one.since, one.until), []).append(size)
    for (camera, *moments), size in shifts.items():
        since, until = (one if np.isfinite(one) else None for one in moments)
        yield {"camera": camera, "since": since, "until": until, "size": size}


def _describe_load(
    loads: Sequence[Load], explanation: Explanation, names: tuple[str, ...]
) -> dict[str, Any]:
    """How far (rad) each joint bends at most, whether as under a weight at the hand, when it is
    taken and put down in turn (s), None from the start, and the nats by which that wins.
    """
    learned = explanation.learned
    moved = bend_under_load(
        explanation.columns, learned.sizes, learned.path.knots, learned.path.angles
    )
    farthest = np.abs(moved).max(axis=0).tolist()
    return {
        "weight": loads[0].name == "payload",
        "moments": [one if np.isfinite(one) else None for one in loads[0].moments],
        "nats": explanation.gains["load"],
        "rad": {name: one for name, one in zip(names, farthest, strict=True) if one > 0.0},
    }


def _describe_errors_in_words(errors: Mapping[str, Any]) -> Iterator[str]:
    """The errors in words."""
    for joint, one in errors["play"].items():
        width, std = np.rad2deg([one["rad"], one["std"]])
        yield f"{joint}: {width:.2f} ± {std:.2f}° of play"
    yield from map(describe_displacement, errors["displaced"])
    if errors["lasting"]:
        one = errors["lasting"]
        yield (
            f"encoders: errors last {one['seconds']:.2g} s, {1e3 * one['std']:.2g} mrad, at "
            f"the {one['at']} "
            f"({one['nats']:.0f} nats)"
        )
    if errors["load"]:
        yield describe_load(errors["load"])
