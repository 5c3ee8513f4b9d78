"""The table of fault detectors, and one pass of all of them over the measurements."""

from collections.abc import Callable, Mapping
from dataclasses import replace

from ...body_model import BodyModel
from ...settings import Estimation
from ...types import Features
from ..measurements.gather import gather, sound
from ..measurements.records import Evidence
from . import encoder_faults, frozen_camera, moved_camera, observability, out_of_range

Detector = Callable[[Evidence, BodyModel], Evidence]
"""Takes the readings of one kind of fault out of the evidence; adds the faults, remarks and hypotheses compared."""
DETECTORS: Mapping[str, Detector] = {
    "out_of_range": out_of_range.detect,
    "encoders": encoder_faults.detect,
    "frozen_camera": frozen_camera.detect,
    "moved_camera": moved_camera.detect,
}
"""In this order: each sees what the ones before it left."""
OF_POSES: Mapping[str, Detector] = {name: DETECTORS[name] for name in ("out_of_range", "frozen_camera")}
"""Those that do not compare consecutive readings."""


def screened(features: Features, body: BodyModel, settings: Estimation, repairs: bool = True) -> Evidence:
    """Gather the measurements that the settings ask for and run all detectors; EvidenceError if a named sense is empty.

    Without `repairs`, encoder faults are named, but the readings stay as they were.
    """
    gathered = gather(features, body, settings)
    found = gathered
    for name, detect in (OF_POSES if features.poses else DETECTORS).items():
        known, found = found.findings, detect(found, body)
        if name == "encoders" and not repairs:
            found = replace(found, findings=known)  # on repairs
    found = sound(found if repairs else replace(found, encoders=gathered.encoders), features, body, settings)
    return observability.warned(found, features.poses)
