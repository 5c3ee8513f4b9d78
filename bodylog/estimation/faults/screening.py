"""One pass of all fault detectors over the measurements."""

from dataclasses import replace

from ...body_model import BodyModel
from ...settings import EstimationSettings
from ...types import Features
from ..measurements.gather import gather_measurements, require_measurements
from ..measurements.records import Evidence
from . import encoder_faults, frozen_camera, moved_camera, observability, out_of_range


def screen_measurements(
    features: Features, body: BodyModel, settings: EstimationSettings, repairs: bool = True
) -> Evidence:
    """Gather the measurements that the settings ask for and
    run all detectors; EvidenceError if a named sense is empty.

    Each detector takes the readings of one kind of fault out of the evidence, adds the faults,
    remarks and hypotheses compared, and sees what the ones before it left. Without `repairs`,
    encoder faults are named, but the readings stay as they were.
    """
    gathered = gather_measurements(features, body, settings)
    found = out_of_range.detect_out_of_range(gathered, body)
    # still poses have no motion, and no time from which a sensor is wrong
    if not features.poses:
        named = encoder_faults.detect_encoder_faults(found, body)
        found = named if repairs else replace(named, findings=found.findings)  # on repairs
    found = frozen_camera.detect_frozen_camera(found, body)
    if not features.poses:
        found = moved_camera.detect_moved_camera(found, body)
    found = require_measurements(
        found if repairs else replace(found, encoders=gathered.encoders), features, body, settings
    )
    return observability.warn_of_undetermined_joints(found, features.poses)
