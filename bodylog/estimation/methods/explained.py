"""Beliefs that allow for errors of the hardware, in place of those of a filter that knows white noise alone."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from ...body_model import BodyModel
from ...settings import Estimation
from ...types import HARDWARE_ERRORS, Estimate, Finding
from ..factors.columns import Play, RowTime
from ..factors.whole_log import ExplainedLog, explain_log
from ..inference.problem import Problem
from ..noise.lasting_error import FrameBelief, residuals_last
from . import results
from .results import Beliefs, Place, predicted

EVIDENT_SIGMAS = 3.0
"""Standard deviations from zero of a joint's play that is told."""


def explained_estimate(
    method: str, body: BodyModel, problem: Problem, beliefs: Beliefs, settings: Estimation
) -> Estimate:
    """The estimate of these beliefs, or of those that allow for errors of the hardware where they explain the log."""
    beliefs, findings, told = explain_by_hardware(problem, beliefs, settings)
    found = results.estimate(method, body, problem.evidence, problem.timeline, beliefs)
    return replace(found, settings={**found.settings, **told}, findings=(*found.findings, *findings))


def explain_by_hardware(
    problem: Problem, beliefs: Beliefs, settings: Estimation
) -> tuple[Beliefs, tuple[Finding, ...], Mapping[str, Any]]:
    """Beliefs, remarks and settings where errors of the hardware explain the log better; else beliefs as they are."""
    unchanged: tuple[Beliefs, tuple[Finding, ...], Mapping[str, Any]] = (beliefs, (), {})
    if settings.precision != "auto" or settings.typed or problem.stepwise or not _may_last(problem, beliefs):
        return unchanged
    causal = settings.method != "smoother"
    found = explain_log(problem, causal)
    if found is None:
        return unchanged
    instants = found.instants
    parts = [instants.angles, instants.rates]
    if problem.precision.drift is not None:
        parts.append(instants.offsets)
    names = [one.name for one in problem.evidence.sightings]
    scale = {**beliefs.scale, **dict(zip(found.senses, found.noise.scales, strict=True))}
    places = tuple(
        found.places.get(name, _place(problem, found, number)) for number, name in enumerate(names)
    )
    explained = replace(
        beliefs, z=np.concatenate(parts, axis=1), cov=instants.cov, nats=instants.nats, before=instants.before,
        before_cov=instants.before_cov, encoder_errors=instants.encoder_errors, scale=scale, places=places,
    )  # fmt: skip
    told = _describe(found, problem.evidence.joints)
    text = "; ".join(_sentences(told))
    finding = Finding("warning", f'{text}: angles allow for it; see "What real arms do" in docs/validation.md')
    return explained, (finding,), {HARDWARE_ERRORS: told}


def _may_last(problem: Problem, beliefs: Beliefs) -> bool:
    """Whether images disagree with readings in a way that lasts: what is worth the search for an explanation."""
    m = len(problem.start)
    z, line = beliefs.z, problem.timeline
    offsets = z[:, 2 * m :] if z.shape[1] > 2 * m else np.zeros((len(z), m))
    frames = [FrameBelief(z[at, :m], z[at, m : 2 * m], offsets[at]) for at in line.sightings]
    evidence = problem.evidence
    return residuals_last(evidence.encoders, evidence.sightings, frames, problem.precision.encoder)


def _place(problem: Problem, found: ExplainedLog, number: int) -> Place:
    """Where a sense that shows nothing would have been."""
    at = problem.timeline.sightings[number]
    return predicted(problem.evidence.sightings[number], found.instants.before[at], found.instants.before_cov[at])


def _describe(found: ExplainedLog, names: tuple[str, ...]) -> dict[str, Any]:
    """The errors as plain numbers: what lasts, each joint's play, a picture's row time, and nats by which each wins."""
    explanation, joints = found.explanation, found.noise.joints
    learned = explanation.learned
    sizes = learned.sizes.tolist()
    stds = np.sqrt(np.diag(learned.sizes_cov)).tolist()
    told: dict[str, Any] = {"nats": explanation.nats, "play": {}, "row_time": None, "lasting": None}
    for column, size, std in zip(explanation.columns, sizes, stds, strict=True):
        if isinstance(column, Play) and size > EVIDENT_SIGMAS * std:
            told["play"][names[column.joint]] = {"rad": 2.0 * size, "std": 2.0 * std}
        elif isinstance(column, RowTime):
            told["row_time"] = {"seconds": size, "std": std}
    told["gains"] = dict(explanation.gains)
    told["late"] = {one.camera: asdict(one) for one in explanation.delays}
    if joints.error is not None and (explanation.lasts or not told["play"]):
        size = float(np.sqrt(np.mean(np.square(joints.error[joints.learned]))))
        where = "link" if joints.at_link.any() else "encoder"
        seconds = float(joints.seconds[joints.learned][0])
        told["lasting"] = {"std": size, "seconds": seconds, "nats": explanation.lasting, "at": where}
    return told


def _sentences(told: Mapping[str, Any]) -> Iterator[str]:
    """The errors in words."""
    for joint, one in told["play"].items():
        width, std = np.rad2deg([one["rad"], one["std"]])
        yield f"{joint}: {width:.2f} ± {std:.2f}° of play"
    if told["lasting"]:
        one = told["lasting"]
        yield (
            f"encoders: errors last {one['seconds']:.2g} s, {1e3 * one['std']:.2g} mrad, at the {one['at']} "
            f"({one['nats']:.0f} nats)"
        )
    if told["row_time"]:
        one = told["row_time"]
        yield f"pictures: rows seen {1e3 * abs(one['seconds']):.0f} ± {1e3 * one['std']:.0f} ms apart"
