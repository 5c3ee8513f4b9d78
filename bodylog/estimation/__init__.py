"""Estimation: from features and a learned body to a belief about the joint angles, one file per method."""

from collections.abc import Callable, Mapping
from dataclasses import replace

from ..errors import UsageError
from ..settings import Estimation
from ..threads import one_thread
from ..types import BodyModel, Estimate, Features
from .faults.consistency import doubts
from .measurements import gather
from .measurements.joints_alone import joints_body, readings, unlearned_body
from .methods import filtering, kalman, predictive_coding, smoother
from .methods.finite import finite, solvable
from .poses.estimate import estimate as still_poses
from .timing.correction import as_stamped, dated, unsure

__all__ = ["METHODS", "check", "estimate", "joints_body", "readings", "unlearned_body"]

METHODS: Mapping[str, Callable[[Features, BodyModel, Estimation], Estimate]] = {
    "laplace": filtering.laplace,
    "smoother": smoother.estimate,
    "ekf": filtering.ekf,
    "kalman": kalman.estimate,
    "predictive-coding": predictive_coding.estimate,
}
PRINTED = ("predictive-coding", "kalman")
"""Methods the paper has."""


def estimate(
    features: Features, body: BodyModel, settings: Estimation, delay: str | Mapping[str, float] = "auto"
) -> Estimate:
    """The belief by `settings.method`, each camera's `delay` taken off as `dated` has it.

    ModelError, EvidenceError or UsageError when it cannot be had: there are no numbers in it that are none.
    """
    check(body, settings)
    if features.poses:
        with one_thread():
            found = still_poses(features, body, settings)
        return replace(found, findings=(*found.findings, *doubts(found, settings)))
    with one_thread():
        timely = dated(features, body, delay)
        with solvable(settings.method):
            found = finite(METHODS[settings.method](timely.features, body, settings))
    if timely.delays:
        found = unsure(as_stamped(found, features, timely.features), timely)
        told = {"delay": dict(timely.delays), "delay_std": dict(timely.errors)}
        found = replace(found, settings={**found.settings, **told})
    return replace(found, findings=(*timely.findings, *found.findings, *doubts(found, settings)))


def check(body: BodyModel, settings: Estimation) -> None:
    """UsageError for a method, a form of touch, a preset or a sense that there is not, whatever the log may show."""
    if settings.method not in METHODS:
        raise UsageError(f"method: {settings.method!r} is none of {', '.join(METHODS)}")
    if settings.touch == "literal" and settings.method != "predictive-coding":
        raise UsageError("touch: 'literal' is the paper's form, for predictive-coding alone; type --touch likelihood")
    if settings.preset == "paper" and settings.method not in PRINTED:
        raise UsageError(f"preset: 'paper' is not for {settings.method}; type --method {' or --method '.join(PRINTED)}")
    gather.chosen((), body, settings)
