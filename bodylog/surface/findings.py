"""Judge a log by the robot's own surface, for `doctor LOG
--urdf ROBOT.urdf`: delay, lens, row time, joint zeros.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..body_model import BodyModel
from ..delays import findings as delay_findings
from ..delays.findings import ExaminedDelays, middle_of_recording
from ..errors import EvidenceError, ModelError
from ..settings import Settings
from ..types import SURFACE_CHANGES, Fault, Finding, Recording, Score
from .calibration import LONGEST_S, MOST_IMAGES, SurfaceCalibration, calibrate_cameras
from .estimate import estimate_by_surface, judge_by_camera, judge_together
from .tracks import LinkedTracks, describe_foreign, link_tracks

SIGNIFICANT_SIGMA = 3.0
LATE_S = 0.003
"""A delay below this matters to nobody."""


def examine_delays(log: Path, body: BodyModel | None, settings: Settings) -> ExaminedDelays:
    """Examine a log by its surface (a URDF, no body); else by a body, or one learned from it."""
    if body is None and settings.kinematics.urdf is not None:
        return examine_by_surface(log, settings)
    if body is not None and body.surface is not None:
        return examine_by_body(log, body, settings)
    return delay_findings.measure_image_delays(log, body, settings)


def examine_by_surface(log: Path, settings: Settings) -> ExaminedDelays:
    """Calibrate each camera of a log by the surface and
    judge the log with that; a finding where that cannot be.

    ModelError where the URDF has no joint of the log.
    """
    from ..recording import recording

    read = middle_of_recording(
        recording.read_recording(log, settings, settings.input.strict), LONGEST_S, MOST_IMAGES
    )
    scores = list[Score]()
    findings = list[Finding]()
    row_shares = dict[str, tuple[float, float, float]]()
    try:
        for one in calibrate_cameras([(log, read)], settings):
            if isinstance(one, EvidenceError):
                findings.append(Finding("info", f"{one}; nothing is learned from its images"))
                continue
            scores += scores_of(one)
            known = float(one.slopes[0]), one.rolling.seconds, one.rolling.std_error
            row_shares[f"delay/{one.camera or 'camera'}"] = known
            findings += [Finding(f.severity, f"{log}: {f.text}") for f in findings_of(one)]
    except EvidenceError as problem:
        findings.append(Finding("info", str(problem)))
    return ExaminedDelays(tuple(scores), tuple(findings), row_shares=row_shares)


def examine_by_body(log: Path, body: BodyModel, settings: Settings) -> ExaminedDelays:
    """Judge a log by a body of the robot's surface: delays,
    and what differs from the logs it was learned from.
    """
    from ..findings.faults import fault_warnings
    from ..findings.joints_only import read_joints_alone
    from ..findings.log_estimate import LogWithBody

    read, features = read_joints_alone(log, settings, body)
    found = estimate_by_surface(LogWithBody(log, read, features, body, settings, settings))
    from ..evaluation.figures import list_delays

    all_findings = (*found.findings, *fault_warnings(found.faults))
    return ExaminedDelays(
        tuple(list_delays(found)),
        tuple(Finding(one.severity, f"{log}: {one.text}") for one in all_findings),
        found.faults,
        found.settings.get(SURFACE_CHANGES, {}),
    )


def examine_together(
    logs: Sequence[Mapping[str, Any]], body: BodyModel
) -> tuple[tuple[Finding, ...], tuple[Fault, ...]]:
    """What several logs tell together that a body of the robot's surface judged, each by its
    `ExaminedDelays.changes`: a fault that all have in common, and what would not be seen.
    """
    from ..fault_kinds import fault_warning
    from ..findings.verdict import describe_least_offsets

    findings = list[Finding]()
    faults = list[Fault]()
    for camera, count, fault, least in judge_together(logs, body):
        where = f"{camera}: {count} logs together"
        if fault is None:
            text = f"no fault in common; {describe_least_offsets(least)}"
            findings.append(Finding("info", f"{where}: {text}"))
        else:
            findings.append(Finding("warning", f"{where}: {fault_warning(fault)}"))
            faults.append(fault)
    return tuple(findings), tuple(faults)


def linked_cameras(
    log: Path, read: Recording, settings: Settings, body: Path | None
) -> Iterator[tuple[str, LinkedTracks]]:
    """Yield each camera of a log with its corners by link: by a body of the robot's surface, or
    by the log itself and a URDF. EvidenceError where no arm is seen, ModelError where the body has
    no surface.
    """
    from ..body import storage
    from .calibration import smoothed_motion

    if body is None:
        for found in calibrate_cameras([(log, read)], settings):
            if isinstance(found, EvidenceError):
                raise found
            linked = link_tracks(found.fit.model, found.fit.phi, found.seen)
            yield found.camera or "camera", linked
        return
    learned = storage.load_body(body)
    if learned.surface is None or read.signals.joints is None:
        raise ModelError(f"{body}: it has no surface of a robot; leave --body out")
    motion = smoothed_motion(read.signals.joints, learned.joints)
    for camera in learned.surface.cameras:
        yield camera.name, judge_by_camera(log, read, learned.surface, camera, motion).linked


def scores_of(one: SurfaceCalibration) -> Iterator[Score]:
    """Delay, row time, focal length and zeros with
    their deviations; the delay is the first log's.
    """
    import numpy as np

    from ..body.kinematic.scores import zero_scores
    from ..kinematics.identifiability import joint_zeros

    name = one.camera or "camera"
    fit = one.fit
    std = np.sqrt(np.diag(one.covariance))
    model = fit.model
    row = model.of_row_time
    focal = float(np.exp(fit.phi[6]))
    yield Score(f"delay/{name}", float(one.delays[0]), "s")
    yield Score(f"std/delay/{name}", float(one.delay_std[0]), "s")
    yield Score(f"row_time/{name}", float(fit.phi[row]), "s")
    yield Score(f"std/row_time/{name}", float(std[row]), "s")
    yield Score(f"focal/{name}", focal, "px")
    yield Score(f"std/focal/{name}", focal * float(std[6]), "px")
    yield Score(f"rmse/surface/{name}", fit.error_px, "px")
    yield Score(f"used_share/{name}", one.used_share, "1")
    yield from zero_scores(joint_zeros(model.rig, fit.phi, one.covariance))


def findings_of(one: SurfaceCalibration) -> Iterator[Finding]:
    """What a calibration tells in sentences: delay,
    row time, lens, zeros, and what it does not tell.
    """
    import numpy as np

    from ..estimation.timing.correction import describe_delay
    from ..kinematics.identifiability import describe_unidentified, joint_zeros

    name = one.camera or "camera"
    fit = one.fit
    std = np.sqrt(np.diag(one.covariance))
    model = fit.model
    links = len(
        {int(body) for body in fit.landmarks.body if len(model.bodies[int(body)].chain.column)}
    )
    used = f"{len(fit.used)} of {one.moving} moving corners lie on"
    if one.landmarks is not None:
        used = f"{one.landmarks.count} landmarks are found again and again on"
    text = f"{used} {links} links, {fit.error_px:.2f} px off per axis"
    yield Finding("info", f"{name}: {text}")
    yield Finding("info", describe_foreign(name, 1.0 - one.used_share))
    delay = float(one.delays[0])
    error = float(one.delay_std[0])
    words = f"{name}: {describe_delay(delay, error)}, by the robot's surface"
    if abs(delay) > max(SIGNIFICANT_SIGMA * error, LATE_S):
        yield Finding("warning", f"{words}; fit and estimate measure and correct it")
    else:
        yield Finding("info", f"{words}; not significant")
    row = float(fit.phi[model.of_row_time])
    row_error = float(std[model.of_row_time])
    if abs(row) > SIGNIFICANT_SIGMA * row_error:
        yield Finding(
            "info",
            f"{name}: a rolling shutter takes {1e3 * row:.0f} ± {1e3 * row_error:.0f} ms an image",
        )
    elsewhere = [str(log) for log, k in zip(one.logs, model.placements, strict=False) if k]
    if elsewhere:
        text = f"{name}: by its still scene it stood elsewhere in {', '.join(elsewhere)}"
        yield Finding("warning", f"{text}; the pose is that of the last log")
    focal = float(np.exp(fit.phi[6]))
    yield Finding("info", f"{name}: focal length {focal:.0f} ± {focal * float(std[6]):.0f} px")
    found = joint_zeros(model.rig, fit.phi, one.covariance)
    for zero in found:
        if zero.identifiable and abs(zero.value) > SIGNIFICANT_SIGMA * zero.std:
            yield Finding("warning", f"{zero.joint}: its zero is off by {zero.shown}")
    for reason in describe_unidentified(found):
        yield Finding("info", reason)
    if one.still:
        yield Finding(
            "info", f"joints at rest, of which the log says nothing: {', '.join(one.still)}"
        )
