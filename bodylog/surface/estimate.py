"""The estimate of a log by a body of the robot's surface: its encoders, less the
offsets that the surface shows, and the postures that its images tell.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..body_model import BodyModel, Surface, SurfaceCamera, name_surface_sense
from ..delays.findings import middle_of_recording
from ..errors import EvidenceError, ModelError
from ..findings.log_estimate import LogWithBody, estimate_log, infer
from ..types import (
    ALTERNATIVE_SEPARATOR,
    SURFACE_CHANGES,
    SURFACE_VIEWS,
    Array,
    Estimate,
    Fault,
    FaultKind,
    Features,
    Finding,
    PostureReadings,
    Recording,
)
from .calibration import (
    LONGEST_S,
    MOST_IMAGES,
    ROW_STRIDE,
    SAME_PICTURE_PX,
    SEARCH_PIECES,
    SEARCH_STRIDE,
    control_counts,
    explains_enough_pieces,
    picture_shift,
    smoothed_motion,
    track_camera,
)
from .map import find_again, refine
from .tracks import (
    LinkedTracks,
    describe_foreign,
    describe_postures,
    link_tracks,
    read_postures,
    views_as_values,
)

if TYPE_CHECKING:
    from ..kinematics.joint_motion import JointCurve
    from ..kinematics.landmark_fit import LandmarkFit
    from ..kinematics.landmark_hypotheses import ChangeHypothesis
    from ..kinematics.landmarks import LandmarkBelief, LandmarkModel
    from ..perception.surface.corner_tracks import KeyFrames

FAULT_EVIDENCE_NATS = 8.0
"""Evidence that a fault must win over a sound log."""
MARGIN_NATS = 4.0
"""Evidence that a fault must win over each other one; those within are its alternatives."""
LEAST_SIGMA = 4.0
"""Standard deviations from zero of an offset that is a fault."""
LEAST_OFFSET = 0.006
"""rad (m: a tenth): smaller offsets are within what two logs of a sound robot differ by, 0.3°."""
_SLIDES_BELOW = 0.05
"""Prior standard deviation of a zero below which it is in m: that of a sliding joint is a tenth."""
_SOUND_CHANGE = 0.0015
"""rad (m: a tenth): how far a sound joint's zero differs between logs, one standard deviation."""
_SWAY = 0.002
"""m and rad: how far a camera that did not move differs between logs, one standard deviation."""
_SEARCHED_IMAGES = 4
"""Images in which landmarks are looked for under each hypothesis."""
_SEARCH_REACH_PX = 10
_SEARCH_STEP = 0.05
"""rad (m: a tenth) between offsets under which landmarks are looked for: a hand of 0.15 m at 0.5 m
then moves by about _SEARCH_REACH_PX.
"""


@dataclass(frozen=True, eq=False)
class CameraChanges:
    """What one camera tells of what changed since the body was learned: every hypothesis.

    identifiable: joints of which it shows an offset as large as a faulty joint commonly has ·
    shift: of the still scene, px, None where scenes differ.
    """

    camera: str
    changes: "Sequence[ChangeHypothesis]"
    identifiable: tuple[str, ...]
    shift: float | None


@dataclass(frozen=True, eq=False)
class CameraJudgement(CameraChanges):
    """What one camera tells of a log: changes, its delay (s) ± std, and the corners by the links
    that they follow.
    """

    delay: tuple[float, float]
    linked: LinkedTracks


def estimate_by_surface(log: LogWithBody) -> Estimate:
    """Where the body was by its encoders, less an offset that the surface shows, by the postures
    that its images tell, and by markers where the body has them.

    Where the surface says nothing, the estimate without it, with a remark why. ModelError where
    images have another size than those that the body was learned from, or a joint is missing.
    """
    learned = log.body
    assert learned.surface is not None
    part = middle_of_recording(log.read, LONGEST_S, MOST_IMAGES)
    joints = part.signals.joints
    assert joints is not None
    missing = [name for name in learned.joints if name not in joints.names]
    if missing:
        raise ModelError(
            f"{log.path}: joint {missing[0]!r} of the body is missing; "
            f"it has {', '.join(joints.names)}"
        )
    motion = smoothed_motion(joints, learned.joints)
    judged = list[CameraJudgement]()
    findings = list[Finding]()
    for camera in learned.surface.cameras:
        try:
            judged.append(judge_by_camera(log.path, part, learned.surface, camera, motion))
        except EvidenceError as problem:
            others = "encoders and markers" if learned.senses else "encoders alone"
            findings.append(Finding("warning", f"{problem}; the estimate is by {others}"))
    faults = _faults_of_surface(judged, float(joints.t[0]), learned)
    sensed = _with_surface_readings(log.features, judged, faults, learned, log.read.start_ns)
    found = (
        estimate_log(replace(log, features=sensed))
        if learned.senses
        else infer(sensed, learned, log.settings)
    )
    for one in judged:
        found = _with_judgement(found, one, sensed.postures, learned)
    found = _add_offset_variances(found, faults)
    return replace(found, findings=(*found.findings, *findings))


def _faults_of_surface(
    judged: Sequence[CameraJudgement], since: float, learned: BodyModel
) -> tuple[Fault, ...]:
    """The faults that cameras name, each once, from `since` (s) on."""
    found = dict[tuple[str, str], Fault]()
    for one in judged:
        fault = _winning_fault(one, since, learned)
        if fault is None:
            continue
        other = found.get((fault.sense, fault.name))
        if other is None or (fault.std or float("inf")) < (other.std or float("inf")):
            found[fault.sense, fault.name] = fault
    return tuple(found.values())


def _with_surface_readings(
    features: Features,
    judged: Sequence[CameraJudgement],
    faults: Sequence[Fault],
    learned: BodyModel,
    start_ns: int,
) -> Features:
    """The features with readings less their offsets, and with the postures that images tell."""
    offsets = {fault.name: fault.size for fault in faults if fault.std is not None}
    joints = features.joints
    assert joints is not None
    less = [offsets.get(name, 0.0) for name in joints.names]
    postures = dict[str, PostureReadings]()
    for one in judged:
        reading = read_postures(one.linked, learned.joints, start_ns, one.delay[1])
        if reading is not None:
            less_too = [offsets.get(name, 0.0) for name in reading.names]
            postures[name_surface_sense(one.camera)] = replace(
                reading, values=reading.values - less_too
            )
    return replace(features, joints=replace(joints, values=joints.values - less), postures=postures)


def judge_together(
    logs: Sequence[Mapping[str, Any]], learned: BodyModel
) -> Iterator[tuple[str, int, Fault | None, Mapping[str, Any]]]:
    """Yield what several logs of one robot tell together: camera, the number of logs that show the
    arm, the fault that all have in common, and the smallest offsets that would be seen.

    logs: of each log the changes that its estimate's settings hold (SURFACE_CHANGES).
    """
    assert learned.surface is not None
    names = {joint: name for name, joint in learned.surface.joint_of.items()}
    for camera in learned.surface.cameras:
        each = [one[camera.name] for one in logs if camera.name in one]
        if len(each) < 2:
            continue
        joined = _join_logs(each, camera, learned.surface)
        least = _smallest_shown_offsets(joined, learned, names, {})
        yield camera.name, len(each), _winning_fault(joined, 0.0, learned), least


def _join_logs(
    each: Sequence[Mapping[str, Any]], camera: SurfaceCamera, surface: Surface
) -> CameraChanges:
    """What several logs tell together of one camera, by the changes of each."""
    from ..kinematics.landmark_hypotheses import ChangeHypothesis, join_changes

    changes = join_changes(
        [[ChangeHypothesis(**change) for change in one["changes"]] for one in each],
        len(camera.delays),
        MARGIN_NATS,
    )
    shifts = [one["shift_px"] for one in each]
    shift = None if None in shifts else max(shifts)
    return CameraChanges(camera.name, changes, _identifiable_joints(changes, surface), shift)


def find_lasting_faults(
    logs: Sequence[Mapping[str, Any]], learned: BodyModel
) -> Iterator[tuple[int, Fault]]:
    """Yield for each camera the fault that all logs from one on have in common, and the number of
    that one: of all numbers that with most evidence, less the logarithm of how many there are.

    logs: of each log, in order, the changes that its estimate's settings hold (SURFACE_CHANGES);
    empty where nothing was judged.
    """
    assert learned.surface is not None
    for camera in learned.surface.cameras:
        known = [number for number, one in enumerate(logs) if camera.name in one]
        found = list[tuple[float, int, Fault]]()
        for place, number in enumerate(known[:-1]):
            each = [logs[one][camera.name] for one in known[place:]]
            joined = _join_logs(each, camera, learned.surface)
            fault = _winning_fault(joined, 0.0, learned)
            nats = max(change.nats for change in joined.changes) - joined.changes[0].nats
            if fault is not None and nats >= FAULT_EVIDENCE_NATS + math.log(len(known)):
                found.append((nats, number, fault))
        if found:
            _, number, fault = max(found, key=lambda one: one[0])
            yield number, fault


def _add_offset_variances(found: Estimate, faults: Sequence[Fault]) -> Estimate:
    """The estimate with the surface's faults, and the variances of the offsets taken out."""
    cov = found.cov.copy()
    for fault in faults:
        if fault.std is not None:
            joint = found.joints.names.index(fault.name)
            cov[:, joint, joint] += fault.std**2
    return replace(found, cov=cov, faults=(*found.faults, *faults))


def judge_by_camera(
    log: Path, read: Recording, surface: Surface, camera: SurfaceCamera, motion: "JointCurve"
) -> CameraJudgement:
    """Judge a log by one camera of a body. EvidenceError
    where no arm is seen or images show another motion.
    """
    import numpy as np

    from ..body.surface import landmark_model
    from ..kinematics import landmark_hypotheses as hypotheses
    from ..kinematics.landmark_errors import unknowns_covariance
    from ..kinematics.landmark_fit import MOST_PIECES, choose_pieces, search_delay, staged_fit
    from ..kinematics.landmarks import join_landmark_tracks

    tracks, picture, keys = track_camera(log, read, camera.name)
    if tracks.size != camera.size:
        found, known = ("x".join(map(str, size)) for size in (tracks.size, camera.size))
        raise ModelError(
            f"{log}: {camera.name}: images of {found} px, of {known} px where the body was learned"
        )
    model = landmark_model(surface, camera, [motion])
    belief = _landmark_belief(model, camera)
    shift = picture_shift(camera.picture, picture, camera.size[0])
    may_move = shift is None or shift > SAME_PICTURE_PX
    free = hypotheses.widen_zero_belief(model, belief)
    seen = join_landmark_tracks([(tracks.piece, tracks.t[tracks.frame], tracks.uv)], tracks.size[1])
    part = seen.take(choose_pieces(seen, MOST_PIECES)).thinned(ROW_STRIDE)
    few = seen.take(choose_pieces(seen, SEARCH_PIECES)).thinned(SEARCH_STRIDE)
    start, _ = search_delay(free, belief.mean.copy(), few)
    fit = staged_fit(free, start, part)
    if fit is None or not explains_enough_pieces(fit, part):
        count = 0 if fit is None else len(fit.used)
        why = f"the body explains {count} of {part.count} moving corners"
        raise EvidenceError(f"{log}: {camera.name}: {why}; the surface says nothing")
    if (control := int(control_counts(fit, part)[0])) > 0.6 * len(fit.used):
        why = (
            f"the joints of another time explain the corners as well ({control} against "
            f"{len(fit.used)})"
        )
        raise EvidenceError(f"{log}: {camera.name}: {why}; the surface says nothing")
    changes = _weighed_changes(fit, belief, may_move)
    delay = fit.model.of_delays.start
    # tracks follow every image, landmarks are looked for in some
    late = float(fit.phi[delay]), float(np.sqrt(unknowns_covariance(fit)[delay, delay]))
    by_landmarks = _by_landmarks(camera, fit, belief, changes, keys, may_move)
    if by_landmarks is not None:
        fit, belief = by_landmarks
        changes = _weighed_changes(fit, belief, may_move)
    elif may_move:
        # corners alone: a pose that its prior holds is pulled at by all that the model lacks, and a
        # camera that is free would win by thousands of nats on a sound log
        loose = staged_fit(hypotheses.widen_zero_belief(model, belief, True), start, part)
        changes = changes if loose is None else _weighed_changes(loose, belief, may_move)
    linked = link_tracks(fit.model, fit.phi, seen)
    sure = _identifiable_joints(changes, surface)
    return CameraJudgement(camera.name, changes, sure, shift, late, linked)


def _identifiable_joints(
    changes: "Sequence[ChangeHypothesis]", surface: Surface
) -> tuple[str, ...]:
    names = {joint: name for name, joint in surface.joint_of.items()}
    return tuple(
        names[one.name]
        for one in changes
        if one.beforehand and _least_offset(one) <= one.beforehand
    )


def _weighed_changes(
    fit: "LandmarkFit", belief: "LandmarkBelief", camera_may_move: bool
) -> "list[ChangeHypothesis]":
    from ..kinematics.landmark_errors import unknowns_covariance
    from ..kinematics.landmark_hypotheses import information_of_log, weigh_hypotheses

    camera_evidence = information_of_log(fit.model, fit.phi, unknowns_covariance(fit))
    return weigh_hypotheses(fit.model, belief, camera_evidence, camera_may_move)


def _by_landmarks(
    camera: SurfaceCamera,
    fit: "LandmarkFit",
    belief: "LandmarkBelief",
    changes: "Sequence[ChangeHypothesis]",
    keys: "KeyFrames",
    camera_may_move: bool,
) -> "tuple[LandmarkFit, LandmarkBelief] | None":
    """Adjust from the body's landmarks alone, found again
    in some images, and what is believed of these unknowns.

    fit, belief and changes are by tracks: each change predicts where the landmarks are, and the
    one under which most are found is the start. None where too few are, or the body has none.
    """
    import numpy as np

    from ..kinematics.landmark_adjustment import Landmarks
    from ..kinematics.landmark_hypotheses import widen_zero_belief
    from ..kinematics.landmark_map import place_prior

    known = camera.landmarks
    if known is None:
        return None
    model = replace(fit.model, belief=None, changes=True)
    unchanged = _belief_of_changes(model, belief)
    free_model = widen_zero_belief(model, unchanged, camera_may_move)
    learned = np.delete(np.arange(len(belief.mean)), model.of_delays.start)
    prior = place_prior(known, learned, unchanged.mean, camera.unknowns)
    landmarks = Landmarks(known.body, known.places, prior)
    stride = max(len(keys.t) // _SEARCHED_IMAGES, 1)
    counts = []
    starts = list(_starts(free_model, fit, belief, changes))
    for phi in starts:
        found = find_again(free_model, phi, known, landmarks, [keys], _SEARCH_REACH_PX, stride)
        counts.append(0 if found is None else len(found.seen.t))
    free = np.ones(len(unchanged.mean), bool)
    free[: len(belief.mean)] = fit.free
    free[learned] = True
    refined = refine(free_model, starts[int(np.argmax(counts))], free, known, landmarks, [keys])
    return None if refined is None else (refined[0], unchanged)


def _belief_of_changes(model: "LandmarkModel", belief: "LandmarkBelief") -> "LandmarkBelief":
    """A belief of φ with the changes since the map,
    which are none but what sound logs differ by.
    """
    import numpy as np

    from ..kinematics.landmarks import LandmarkBelief

    count = len(belief.mean)
    std = np.full(count + 6 + len(model.rig.joints), _SWAY)
    for joint, index in enumerate(range(model.of_changes.start, model.of_changes.stop)):
        std[index] = _SOUND_CHANGE * (0.1 if model.rig.slides(joint) else 1.0)
    mean = np.zeros(len(std))
    covariance = np.diag(std**2)
    mean[:count] = belief.mean
    covariance[:count, :count] = belief.covariance
    return LandmarkBelief(mean, covariance)


def _starts(
    model: "LandmarkModel",
    fit: "LandmarkFit",
    belief: "LandmarkBelief",
    changes: "Sequence[ChangeHypothesis]",
) -> "Iterator[Array]":
    """Yield unknowns φ with each change that tracks show, or
    leave possible within two σ, and with all of them at once.
    """
    import numpy as np

    rig = model.rig
    sound = model.prior[0].copy()
    sound[model.of_delays] = fit.phi[fit.model.of_delays]
    for change in changes:
        if change.name not in rig.joints:
            yield sound.copy()
            continue
        joint = rig.joints.index(change.name)
        step = _SEARCH_STEP * (0.1 if rig.slides(joint) else 1.0)
        reach = int(2.0 * change.std / step)
        for offset in change.value + step * np.arange(-reach, reach + 1):
            phi = sound.copy()
            phi[model.of_changes.start + joint] = offset
            yield phi
    phi = sound.copy()
    phi[model.of_camera_change] = fit.phi[:6] - belief.mean[:6]
    phi[model.of_changes] = (fit.phi - belief.mean)[rig.of_joints]
    yield phi


def _landmark_belief(model: "LandmarkModel", camera: SurfaceCamera) -> "LandmarkBelief":
    """A body's belief of a log's φ: what it knows, and a delay that may be any."""
    import numpy as np

    from ..kinematics.landmarks import DELAY_STD_S, LandmarkBelief

    delay = model.of_delays.start
    rest = np.delete(np.arange(len(camera.unknowns) + 1), delay)
    mean = np.zeros(len(rest) + 1)
    covariance = np.zeros((len(rest) + 1, len(rest) + 1))
    mean[rest] = camera.unknowns
    mean[delay] = float(camera.delays.mean())
    covariance[np.ix_(rest, rest)] = camera.covariance
    covariance[delay, delay] = DELAY_STD_S**2
    return LandmarkBelief(mean, covariance)


def _with_judgement(
    found: Estimate,
    one: CameraJudgement,
    postures: Mapping[str, PostureReadings],
    learned: BodyModel,
) -> Estimate:
    """An estimate with one camera's delay, remarks and views."""
    from ..body.surface import surface_space
    from ..evaluation.figures import LEAST_OFFSETS, MEASURED_DELAYS

    assert learned.surface is not None
    seconds, std = one.delay
    evident = abs(seconds) > max(3.0 * std, 0.003)
    measured = {"seconds": seconds, "std_error": std, "doubt": "", "evident": evident}
    settings: dict[str, Any] = dict(found.settings)
    settings[MEASURED_DELAYS] = {**settings.get(MEASURED_DELAYS, {}), one.camera: measured}
    if evident:
        applied = settings.get("delay", {})
        settings["delay"] = {
            **(applied if isinstance(applied, Mapping) else {}),
            one.camera: seconds,
        }
    names = {joint: name for name, joint in learned.surface.joint_of.items()}
    blind = [name for name in learned.joints if name not in one.identifiable]
    findings = list(found.findings)
    if blind:
        findings.append(
            Finding("info", f"{one.camera}: offsets not identifiable: {', '.join(blind)}")
        )
    settings[LEAST_OFFSETS] = _smallest_shown_offsets(
        one, learned, names, settings.get(LEAST_OFFSETS, {})
    )
    if one.shift is None:
        findings.append(_describe_other_scene(one))
    elif one.shift > SAME_PICTURE_PX:
        text = (
            f"its still scene lies {one.shift:.1f} px beside that of the body: scene or camera "
            "moved"
        )
        findings.append(Finding("info", f"{one.camera}: {text}"))
    findings.append(Finding("info", describe_foreign(one.camera, one.linked.foreign_share)))
    reading = postures.get(name_surface_sense(one.camera))
    if reading is not None:
        findings.append(Finding("info", describe_postures(one.camera, reading)))
    views = views_as_values(one.linked, surface_space(learned.surface))
    settings[SURFACE_VIEWS] = {**settings.get(SURFACE_VIEWS, {}), one.camera: views}
    changes = {"shift_px": one.shift, "changes": [asdict(change) for change in one.changes]}
    settings[SURFACE_CHANGES] = {**settings.get(SURFACE_CHANGES, {}), one.camera: changes}
    return replace(found, settings=settings, findings=tuple(findings))


def _describe_other_scene(one: CameraJudgement) -> Finding:
    """That another scene does not show whether a camera moved; a warning if its corners do."""
    from ..kinematics.landmark_hypotheses import CAMERA, SOUND

    nats = {change.name: change.nats for change in one.changes}
    gain = nats[CAMERA] - nats[SOUND]
    text = (
        f"{one.camera}: its still scene does not look like the body's, so whether the camera moved "
        "is not judged"
    )
    if gain < FAULT_EVIDENCE_NATS:
        return Finding("info", text)
    why = f"a moved camera explains the arm's corners better ({gain:.0f} nats)"
    return Finding("warning", f"{text}; {why}, and so does an arm that looks another way")


def _smallest_shown_offsets(
    one: CameraChanges, learned: BodyModel, names: Mapping[str, str], by_others: Mapping[str, Any]
) -> dict[str, Any]:
    """The smallest offset of each joint that any camera
    would show: {"value", "unit"}; None where none would.
    """
    shown = {
        names[change.name]: {
            "value": _least_offset(change),
            "unit": "m" if change.beforehand < _SLIDES_BELOW else "rad",
        }
        for change in one.changes
        if change.beforehand and names[change.name] in one.identifiable
    }
    least = dict[str, Any]()
    for name in learned.joints:
        camera_evidence = [each[name] for each in (by_others, shown) if each.get(name) is not None]
        least[name] = min(camera_evidence, key=lambda each: float(each["value"]), default=None)
    return least


def _least_offset(change: "ChangeHypothesis") -> float:
    """The smallest offset, rad or m, that counts as a fault."""
    slides = change.beforehand < _SLIDES_BELOW
    return max(LEAST_SIGMA * change.std, LEAST_OFFSET * (0.1 if slides else 1.0))


def _winning_fault(one: CameraChanges, since: float, learned: BodyModel) -> Fault | None:
    """The fault that wins, if one does, from `since` (s) on; with a std where its size is known."""
    from ..kinematics.landmark_hypotheses import CAMERA, SOUND

    assert learned.surface is not None
    sound = next(change for change in one.changes if change.name == SOUND)
    best = max(one.changes, key=lambda change: change.nats)
    if best.nats - sound.nats < FAULT_EVIDENCE_NATS or best.name == SOUND:
        return None
    names = {joint: name for name, joint in learned.surface.joint_of.items()}
    indistinct_changes = [
        change
        for change in one.changes
        if change.name != SOUND and best.nats - change.nats < MARGIN_NATS
    ]
    if len(indistinct_changes) > 1:
        indistinct_names = [names.get(change.name, one.camera) for change in indistinct_changes]
        return Fault(
            "encoders",
            ALTERNATIVE_SEPARATOR.join(indistinct_names),
            FaultKind.OFFSET,
            since,
            float("nan"),
            "rad",
        )
    if best.name == CAMERA:
        # in another scene the surface itself may look another way, and its corners lie elsewhere
        moved = Fault("vision", one.camera, FaultKind.MOVED, since, float("nan"), "m")
        return None if one.shift is None else moved
    if abs(best.value) < _least_offset(best) or names[best.name] not in one.identifiable:
        return None
    # a reading that is too large by x needs a zero that is smaller by x
    unit = "m" if best.beforehand < _SLIDES_BELOW else "rad"
    return Fault("encoders", names[best.name], FaultKind.OFFSET, since, -best.value, unit, best.std)
