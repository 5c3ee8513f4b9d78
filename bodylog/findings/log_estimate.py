"""The estimate of one log, with the checks around it:
whether it fits the body, and what changed since learning.
"""

from dataclasses import dataclass, replace
from pathlib import Path

from ..body_model import BodyModel
from ..checks import log_context, require_tracks
from ..robot import effector_poses
from ..settings import Settings
from ..types import Estimate, Features, Finding, Recording
from . import changes as change_findings
from .faults import unseen_findings


@dataclass(frozen=True, eq=False)
class LogWithBody:
    """A log that was read, and the body that it is estimated by.

    settings: with the features of the body where the user named none · typed: as the user gave
    them.
    """

    path: Path
    read: Recording
    features: Features
    body: BodyModel
    settings: Settings
    typed: Settings


def estimate_log(log: LogWithBody) -> Estimate:
    """`infer` and the checks around it; errors name the log and what it lost."""
    from .misfit import find_misfit, from_many_faults, with_doubt

    features = log.features
    learned = log.body
    settings = log.settings
    chosen = settings.estimate, settings.time.delay
    with log_context(log.path, log.read.facts.findings):
        misfit = find_misfit(features, learned, *chosen)
        if misfit is None:
            found = change_findings.compare_changes_with_faults(
                features, learned, infer(features, learned, settings), settings.estimate
            )
            misfit = from_many_faults(found, features, learned, *chosen)
        if misfit is not None:
            found = with_doubt(infer_from_encoders(features, learned, settings), features, misfit)
        found = effector_poses.add_kinematic_results(learned, found, features)
    if misfit is not None:
        return found
    require_tracks(
        log.path, found.used, features, log.typed, "; or go on with the rest: --without {}"
    )
    unseen = unseen_findings(found, features, learned, settings)
    return replace(found, findings=(*found.findings, *unseen))


def infer_from_encoders(features: Features, learned: BodyModel, settings: Settings) -> Estimate:
    """Where the body was, by its encoders, of a log whose images the body does not explain."""
    joints = replace(features, tracks={}, boards={}, touches=None, strokes=(), synchrony=())
    chosen = replace(settings.estimate, senses=None, without=())
    return infer(joints, replace(learned, senses={}), replace(settings, estimate=chosen))


def infer(features: Features, learned: BodyModel, settings: Settings) -> Estimate:
    """Where the body was, from what was found in a log and a learned body."""
    from .. import estimation
    from ..body.senses import encoder_function
    from ..evaluation.scores import ENCODERS_READ_KEY

    estimation.check_estimation_settings(learned, settings.estimate)
    coding = estimation.METHODS[settings.estimate.method].encoder_model
    understood = encoder_function.convert_readings_to_angles(
        features, learned, settings.estimate, coding
    )
    found = estimation.estimate_from_features(*understood, settings.time.delay)
    if "encoders" not in learned.senses or features.joints is None:
        return found
    left_out = Finding(
        "info", "encoders: read what the body has learned, no angles; rmse/encoders is left out"
    )
    return replace(
        found,
        settings={**found.settings, ENCODERS_READ_KEY: "as learned"},
        findings=(*found.findings, left_out),
    )
