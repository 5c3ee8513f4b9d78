"""Estimation: from features and a learned body to a belief about the joint angles, one file per method."""

from collections.abc import Mapping
from dataclasses import asdict, replace

from ..body_model import BodyModel
from ..errors import UsageError
from ..runtime.blas_threads import one_thread
from ..settings import Estimation
from ..types import Estimate, Features
from .faults.consistency import consistency_findings
from .inference import kernel
from .measurements import gather
from .measurements.joint_limits import limit_findings
from .measurements.joints_alone import joints_body, no_body_findings, reading_findings
from .methods.choices import ignored_settings
from .methods.finite import finite, solvable
from .methods.table import METHODS
from .noise import typed
from .poses.estimate import estimate as still_poses
from .timing.correction import add_delay_uncertainty, as_stamped, corrected

__all__ = ["METHODS", "check", "estimate", "joints_body", "limit_findings", "no_body_findings", "reading_findings"]


def estimate(
    features: Features, body: BodyModel, settings: Estimation, delay: str | Mapping[str, float] = "auto"
) -> Estimate:
    """Estimate by `settings.method` after each camera's `delay` is corrected (see `corrected`).

    All its numbers are finite; otherwise ModelError, EvidenceError or UsageError.
    """
    check(body, settings)
    method = METHODS[settings.method]
    if features.poses:
        with one_thread():
            found = replace(still_poses(features, body, settings, method.can), can=method.can)
        return replace(found, findings=(*found.findings, *consistency_findings(found, settings)))
    with one_thread(), solvable(settings.method):
        timely = corrected(features, body, delay)
        found = replace(finite(method.estimate(timely.features, body, settings)), can=method.can)
    if timely.delays:
        found = add_delay_uncertainty(as_stamped(found, features, timely.features), timely)
        delays = {"delay": dict(timely.delays), "delay_std": dict(timely.errors)}
        found = replace(found, settings={**found.settings, **delays})
    weighed = [asdict(one) for one in timely.hypotheses] + list(found.settings.get("hypotheses", ()))
    found = replace(found, settings={**found.settings, "hypotheses": weighed} if weighed else found.settings)
    findings = (*timely.findings, *found.findings, *ignored_settings(settings), *consistency_findings(found, settings))
    return replace(found, findings=findings)


def check(body: BodyModel, settings: Estimation) -> None:
    """UsageError for a method, form of touch, preset or sense that does not exist or that the method cannot use.

    Also without the compiled library, which is no fault of a log.
    """
    kernel.library()
    if settings.method not in METHODS:
        raise UsageError(f"method: {settings.method!r} is unknown; possible: {', '.join(METHODS)}")
    method = METHODS[settings.method]
    if settings.touch == "literal" and not method.literal_touch:
        able = " or ".join(name for name, one in METHODS.items() if one.literal_touch)
        raise UsageError(f"touch: 'literal' is the paper's form, for {able} alone; type --touch likelihood")
    if settings.preset == "paper" and not method.can.from_paper:
        able = " or --method ".join(name for name, one in METHODS.items() if one.can.from_paper)
        raise UsageError(f"preset: 'paper' is not for {settings.method}; type --method {able}")
    gather.chosen((), body, settings)
    typed.check(settings, body.joints, [name for name in body.senses if name != "encoders"])
