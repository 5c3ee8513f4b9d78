"""Every detector of faults, one line each, and one pass of all of them over what was measured."""

from collections.abc import Mapping
from dataclasses import replace

from ...body_model import BodyModel
from ...settings import Estimation
from ...types import Features
from ..measurements.gather import gather, sound
from ..measurements.records import Evidence
from . import encoder_faults, frozen_camera, moved_camera, observability, out_of_range
from .contract import Detector

DETECTORS: Mapping[str, Detector] = {
    "out_of_range": out_of_range.detect,
    "encoders": encoder_faults.detect,
    "frozen_camera": frozen_camera.detect,
    "moved_camera": moved_camera.detect,
}
"""In this order: each judges by what those before it left."""
POSES = {name: DETECTORS[name] for name in ("out_of_range", "frozen_camera")}
"""Of poses that no motion joins: what goes by the readings before and after does not count."""


def screened(
    features: Features, body: BodyModel, settings: Estimation, whole: bool = True, repairs: bool = True,
    detectors: Mapping[str, Detector] = DETECTORS,
) -> Evidence:  # fmt: skip
    """The evidence the settings ask for, gathered and screened once; EvidenceError where a named sense says nothing.

    `whole`: all frames of one touch count as one sighting. Without `repairs` faults of encoders are named, but their
    readings stay as they were.
    """
    gathered = gather(features, body, settings, whole)
    found = gathered
    for name, detect in detectors.items():
        verdict = detect(found, body)
        found = replace(
            verdict.evidence,
            faults=(*found.faults, *verdict.faults),
            findings=(*found.findings, *(verdict.findings if repairs or name != "encoders" else ())),
            hypotheses=(*found.hypotheses, *verdict.hypotheses),
        )
    found = sound(found if repairs else replace(found, encoders=gathered.encoders), features, body, settings)
    return replace(found, findings=(*found.findings, *observability.detect(found, body).findings))
