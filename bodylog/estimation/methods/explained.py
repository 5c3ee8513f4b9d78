"""Beliefs that allow for errors of the hardware, in
place of those of a filter that knows white noise alone.
"""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from ...body_model import BodyModel
from ...settings import EstimationSettings
from ...types import HARDWARE_ERRORS, Array, Estimate, Finding
from ..factors.columns import Play, RowTime
from ..factors.whole_log import ExplainedLog, Instants, SolvedLog, explain_log, solve_log
from ..faults.threshold import EVIDENCE_THRESHOLD_NATS
from ..inference.problem import FilterProblem
from . import results
from .results import Beliefs, find_evident_error, predict_frames, with_lasting_error
from .trust import reason_of_disagreement, reason_of_misfit, reason_to_widen

Place = tuple[Array, Array, Array]
"""Of a sighting's frames: mean (F,D), covariance (F,D,D)
without their own noise, and the model's variance (F,D).
"""

DRIFTS_S = 5.0
"""s: errors that last longer can imitate an encoder that drifts."""
EVIDENT_SIGMAS = 3.0
"""Standard deviations from zero of a joint's play that is reported."""


def explained_estimate(
    method: str,
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
    kept = results.build_estimate(method, body, problem.evidence, problem.timeline, beliefs)
    lasting = find_evident_error(kept, problem, beliefs.z, settings)
    if lasting is None:
        return kept
    try:
        made = _explain_estimate(method, body, problem, first, beliefs, settings, lasting.std)
    except np.linalg.LinAlgError as singular:
        made = f"their explanation has no solution ({singular})"
    return with_lasting_error(kept, lasting, made) if isinstance(made, str) else made


def _explain_estimate(
    method: str,
    body: BodyModel,
    problem: FilterProblem,
    first: FilterProblem,
    beliefs: Beliefs,
    settings: EstimationSettings,
    std: float,
) -> Estimate | str:
    """The estimate that allows for errors of about std rad, or why it is not to be trusted."""
    why = reason_to_widen(problem, body.joints, std, settings)
    if why is not None:
        return why
    found = explain_log(problem)
    if found is None:
        return "no images show the joints"
    causal = settings.method != "smoother"
    why = reason_of_disagreement(problem, beliefs, found, causal)
    if why is not None:
        return why
    if has_offsets(problem, first):
        without = _without_offsets(problem, first)
        simpler = explain_log(without)
        if (
            simpler is not None
            and _explains_offsets(simpler)
            and simpler.nats - found.nats <= EVIDENCE_THRESHOLD_NATS
        ):
            problem = without
            found = simpler
            beliefs = replace(beliefs, faults=())
    if found.explanation.is_sound:
        return "white noise explains the log as well"
    solved = solve_log(problem, found, causal)
    why = reason_of_misfit(problem, found, solved, causal)
    if why is not None:
        return why
    explained = _with_explanation(problem, beliefs, found, solved)
    made = results.build_estimate(method, body, problem.evidence, problem.timeline, explained)
    errors = _describe_errors(found, problem.evidence.joints)
    text = "; ".join(_error_sentences(errors)) or "encoders: errors last"
    finding = Finding(
        "warning", f'{text}: angles allow for it; see "What real arms do" in docs/validation.md'
    )
    return replace(
        made,
        settings={**made.settings, HARDWARE_ERRORS: errors},
        findings=(*made.findings, finding),
    )


def has_offsets(problem: FilterProblem, first: FilterProblem) -> bool:
    """Whether encoder offsets were found since the first problem."""
    return problem.evidence.faults != first.evidence.faults or bool(problem.alternatives)


def _explains_offsets(found: ExplainedLog) -> bool:
    """Whether play explains what looked like an offset: an
    error that lasts for long would be the offset itself.
    """
    joints = found.noise.joints
    return "play" in found.explanation.gains and bool(
        (joints.seconds[joints.learned] < DRIFTS_S).all()
    )


def _without_offsets(problem: FilterProblem, first: FilterProblem) -> FilterProblem:
    """The problem without the offsets that were found, and the evidence beside it."""
    evidence = replace(first.evidence, hypotheses=problem.evidence.hypotheses)
    precision = replace(problem.precision, drift=first.precision.drift)
    return replace(problem, evidence=evidence, precision=precision, alternatives={})


def _with_explanation(
    problem: FilterProblem, beliefs: Beliefs, found: ExplainedLog, solved: SolvedLog
) -> Beliefs:
    """The beliefs of an explained log."""
    instants = solved.instants
    parts = [instants.angles, instants.rates]
    if problem.precision.drift is not None:
        parts.append(instants.offsets)
    names = [one.name for one in problem.evidence.sightings]
    scale = {**beliefs.scale, **dict(zip(found.senses, found.noise.scales, strict=True))}
    places = tuple(
        solved.places[name] if name in solved.places else _place(problem, instants, number)
        for number, name in enumerate(names)
    )
    return replace(
        beliefs,
        z=np.concatenate(parts, axis=1),
        cov=instants.cov,
        nats=instants.nats,
        before=instants.before,
        before_cov=instants.before_cov,
        encoder_errors=instants.encoder_errors,
        scale=scale,
        places=places,
    )


def _place(problem: FilterProblem, instants: Instants, number: int) -> Place:
    """Where a sense that shows nothing would have been."""
    at = problem.timeline.sightings[number]
    return predict_frames(
        problem.evidence.sightings[number], instants.before[at], instants.before_cov[at]
    )


def _describe_errors(found: ExplainedLog, names: tuple[str, ...]) -> dict[str, Any]:
    """The errors as plain numbers: what lasts, each joint's
    play, a picture's row time, and nats by which each wins.
    """
    explanation = found.explanation
    joints = found.noise.joints
    learned = explanation.learned
    sizes = learned.sizes.tolist()
    stds = np.sqrt(np.diag(learned.sizes_cov)).tolist()
    errors: dict[str, Any] = {
        "nats": explanation.nats,
        "play": {},
        "row_time": None,
        "lasting": None,
    }
    for column, size, std in zip(explanation.columns, sizes, stds, strict=True):
        if isinstance(column, Play) and size > EVIDENT_SIGMAS * std:
            errors["play"][names[column.joint]] = {"rad": 2.0 * size, "std": 2.0 * std}
        elif isinstance(column, RowTime):
            errors["row_time"] = {"seconds": size, "std": std}
    errors["gains"] = dict(explanation.gains)
    errors["late"] = {one.camera: asdict(one) for one in explanation.delays}
    if joints.error is not None and (explanation.lasts or not errors["play"]):
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


def _error_sentences(errors: Mapping[str, Any]) -> Iterator[str]:
    """The errors in words."""
    for joint, one in errors["play"].items():
        width, std = np.rad2deg([one["rad"], one["std"]])
        yield f"{joint}: {width:.2f} ± {std:.2f}° of play"
    if errors["lasting"]:
        one = errors["lasting"]
        yield (
            f"encoders: errors last {one['seconds']:.2g} s, {1e3 * one['std']:.2g} mrad, at "
            f"the {one['at']} "
            f"({one['nats']:.0f} nats)"
        )
    if errors["row_time"]:
        one = errors["row_time"]
        yield (
            f"pictures: rows seen {1e3 * abs(one['seconds']):.0f} ± {1e3 * one['std']:.0f} ms apart"
        )
