"""Estimation: from features and a learned body to a
belief about the joint angles, one file per method.
"""

from collections.abc import Mapping
from dataclasses import asdict, replace

from ..body_model import BodyModel
from ..errors import UsageError
from ..runtime.blas_threads import one_thread
from ..settings import EstimationSettings
from ..types import HARDWARE_ERRORS, Estimate, Features
from .common_cause import infer_common_causes
from .inference.kernel_call import load_kernel
from .measurements import gather
from .measurements.arm_errors import read_arm_errors
from .measurements.reading_units import (
    JOINT_UNIT_KEY,
    convert_estimate_to_units,
    find_joint_unit,
    scale_to_angles,
)
from .methods.consistency import (
    check_consistency,
    describe_moved_joints,
    report_numerical_errors,
    require_finite_estimate,
)
from .methods.table import METHODS, warn_of_ignored_settings
from .noise import noise_model
from .poses import estimate_still_poses as still_poses
from .timing.correction import (
    add_delay_uncertainty,
    correct_camera_delays,
    measure_delays_left,
    reconsider_delays,
    restore_stamps,
)

__all__ = ["METHODS", "check_estimation_settings", "estimate_from_features"]


def estimate_from_features(
    features: Features,
    body: BodyModel,
    settings: EstimationSettings,
    delay: str | Mapping[str, float] = "auto",
) -> Estimate:
    """Estimate by `settings.method` after each camera's `delay` is corrected (see
    `correct_camera_delays`).

    All its numbers are finite; otherwise ModelError, EvidenceError or UsageError.
    """
    check_estimation_settings(body, settings)
    unit, size = find_joint_unit(features.joints) if "encoders" not in body.senses else ("rad", 1.0)
    if size != 1.0 and not body.senses and not settings.typed and settings.start is None:
        angles = estimate_from_features(scale_to_angles(features, size), body, settings, delay)
        found = convert_estimate_to_units(angles, unit, size)
        return replace(found, settings={**found.settings, JOINT_UNIT_KEY: unit})
    method = METHODS[settings.method]
    with one_thread(), report_numerical_errors(settings.method):
        if features.poses:
            found = still_poses(features, body, settings, method.can)
        else:
            found = _estimate_with_corrected_times(features, body, settings, delay)
    used = {**found.settings, **({} if unit == "rad" else {JOINT_UNIT_KEY: unit})}
    found = replace(found, can=method.can, settings=used)
    findings = (
        *read_arm_errors(body).warn_of_narrow_bars(),
        *check_consistency(found, settings, unit, size, describe_moved_joints(features, body)),
    )
    return replace(found, findings=(*found.findings, *findings))


def _estimate_with_corrected_times(
    features: Features,
    body: BodyModel,
    settings: EstimationSettings,
    delay: str | Mapping[str, float],
) -> Estimate:
    """The method's estimate from images at the time when they were taken."""
    timely = correct_camera_delays(features, body, delay)

    def estimate_finite(sensed: Features, chosen: EstimationSettings) -> Estimate:
        return require_finite_estimate(METHODS[settings.method].estimate(sensed, body, chosen))

    def weigh_causes(sensed: Features) -> Features:
        if settings.common_cause is None:
            return sensed
        return infer_common_causes(sensed, body, settings, settings.common_cause, estimate_finite)

    found = estimate_finite(weigh_causes(timely.features), settings)
    left = found.settings.get(HARDWARE_ERRORS, {}).get("late")
    if left is None:
        left = measure_delays_left(timely.features, body, found.faults)
    if (again := reconsider_delays(timely, features, body, delay, left)) is not None:
        timely = again
        found = estimate_finite(weigh_causes(timely.features), settings)
    used = dict(found.settings)
    if timely.delays or read_arm_errors(body).rows:
        found = restore_stamps(found, features)
    if timely.delays:
        used |= {"delay": dict(timely.delays), "delay_std": dict(timely.errors)}
    if timely.measured:
        found = add_delay_uncertainty(found, timely)
        used["delay_measured"] = {
            name: {
                "seconds": one.seconds,
                "std_error": one.std_error,
                "doubt": one.doubt,
                "evident": not one.doubt or name in timely.unsure,
            }
            for name, one in timely.measured.items()
        }
    if weighed := [*map(asdict, timely.hypotheses), *used.get("hypotheses", ())]:
        used["hypotheses"] = weighed
    findings = (*timely.findings, *found.findings, *warn_of_ignored_settings(settings))
    return replace(found, settings=used, findings=findings)


def check_estimation_settings(body: BodyModel, settings: EstimationSettings) -> None:
    """UsageError for a method, form of touch, preset or
    sense that does not exist or that the method cannot use.

    Also loads the compiled filter, before workers start.
    """
    load_kernel("weigh_noise_ratios")
    load_kernel("filter_instants")
    if settings.method not in METHODS:
        raise UsageError(f"method: {settings.method!r} is unknown; possible: {', '.join(METHODS)}")
    method = METHODS[settings.method]
    if not method.can.causal:
        load_kernel("carry_adjoint_back")
        load_kernel("carry_information_back")
    if settings.touch == "literal" and not method.literal_touch:
        able = " or ".join(name for name, one in METHODS.items() if one.literal_touch)
        raise UsageError(
            f"touch: 'literal' is the paper's form, for {able} alone; type --touch likelihood"
        )
    if settings.preset == "paper" and not method.can.from_paper:
        able = " or --method ".join(name for name, one in METHODS.items() if one.can.from_paper)
        raise UsageError(f"preset: 'paper' is not for {settings.method}; type --method {able}")
    if settings.motion != "auto":
        noise_model.require_motion_model(settings.motion, "[estimate]", "auto")
    gather.choose_senses((), body, settings)
    noise_model.check_typed_variances(
        settings, body.joints, [name for name in body.senses if name != "encoders"]
    )
