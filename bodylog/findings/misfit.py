"""Whether a log fits a body, and if not, what would explain
it: one sentence in place of faults that nobody has.

Explanations are compared by −ln p of all sightings (`sighting_evidence`): the log as it is with at
most two faults, each at the cost of its unknowns, or with its columns read differently: two joints
swapped, a sign flipped, degrees for radians, two cameras swapped. What is read differently has no
unknowns; it must win EVIDENCE_THRESHOLD_NATS over any fault.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ..body_model import BodyModel
from ..estimation.faults.threshold import EVIDENCE_THRESHOLD_NATS, PRIOR_STD_RAD
from ..estimation.inference.tangents import OFFSET_STD
from ..estimation.measurements.track import camera_of_track
from ..estimation.methods.consistency import describe_moved_joints
from ..estimation.timing import correction
from ..evaluation.figures import MISFIT
from ..runtime.blas_threads import one_thread
from ..settings import EstimationSettings
from ..types import (
    ALTERNATIVE_SEPARATOR,
    LASTING_ERROR,
    Array,
    Estimate,
    FaultKind,
    Features,
    Finding,
    Health,
)
from .sighting_evidence import (
    WALK,
    FittedUnknowns,
    SightingLog,
    TrackSightings,
    constant_offsets,
    count_determined_offsets,
    fit_unknowns,
    hold_still,
    possible_faults,
    select_sightings,
    usual_offsets,
    wide_nats,
)

MAX_SHARE_OFF = 0.5
"""Share of sightings off from which a log does not fit. Encoders of real arms with play and load,
and one image in three of something else, stay below it."""
MIN_PREDICTABLE_SHARE = 0.9
"""Share of the images' motion that joints must predict where another camera is named."""
MOST_CAUSES = 2
"""Encoders, cameras and markers that may have faults at once which only the body shows: a log of
another body is more likely than three sensors that fail together."""
_PROMISING = 3
_UNITS = (
    (np.deg2rad(1.0), "deg", "its angles in degrees, not rad"),
    (np.rad2deg(1.0), "rad", "its angles in rad, not degrees"),
)
_PARTS = 8
_RIDGE = 1e-3


@dataclass(frozen=True, eq=False)
class LogMisfit:
    """A log that does not fit the body: the share of its sightings off, after the likeliest faults,
    and how many there are; the explanation that wins, what to type then, the share off with it, and
    the nats it wins; change (M,M) makes the angles meant from those read, None where joints are not
    the cause; causes: sensors that would be wrong at once; is_open: images leave open which
    sensors are wrong.
    """

    off: float
    sightings: int
    explanation: str | None = None
    advice: str | None = None
    off_explained: float | None = None
    nats: float = 0.0
    change: Array | None = None
    causes: int = 0
    is_open: bool = False


@dataclass(frozen=True, eq=False)
class LogReading:
    """A way to read a log, in words and as the log read so;
    change (M,M) makes the angles meant from those read.
    """

    words: str
    advice: str
    log: "SightingLog"
    change: Array | None = None


@one_thread("scipy.linalg")
def find_misfit(
    features: Features,
    body: BodyModel,
    settings: EstimationSettings,
    delay: str | Mapping[str, float] = "auto",
) -> LogMisfit | None:
    """Return how a log does not fit the body; None where it fits, or too little is seen to tell.

    `delay`: as in `estimation.estimate_from_features`.
    """
    stamped = correction.shift_features(features, _known_delays(features, body, delay))
    log = select_sightings(stamped, body, settings)
    if log is None:
        return None
    plain = fit_unknowns(log, usual_offsets(log))
    readings = _list_log_readings(log, stamped, body, settings)
    promising = _select_promising_readings(log, readings)
    if plain.off <= MAX_SHARE_OFF and not promising:
        return None
    fault = _likeliest_fault(log, plain)
    if fault.off > MAX_SHARE_OFF:
        fault = min(
            fault, _with_measured_delay(features, body, settings, delay), key=lambda one: one.nats
        )
    tried = [(fit_unknowns(one.log, usual_offsets(one.log)), one) for one in promising]
    fitting = sorted(
        (one for one in tried if one[0].off <= MAX_SHARE_OFF), key=lambda one: one[0].nats
    )
    # all readings together are as likely as one fault
    margin = EVIDENCE_THRESHOLD_NATS + float(np.log(len(readings)))
    if fitting and fitting[0][0].nats < fault.nats - margin:
        return _explain_misfit(fitting, plain, fault, log.count)
    if fault.off <= MAX_SHARE_OFF or _has_moved(features, body):
        return None
    return _unexplained_misfit(log, plain.off, describe_moved_joints(features, body))


def from_many_faults(
    found: Estimate,
    features: Features,
    body: BodyModel,
    settings: EstimationSettings,
    delay: str | Mapping[str, float],
) -> LogMisfit | None:
    """Return that a log does not fit where more than MOST_CAUSES
    sensors would have faults that only the body shows.

    Encoders that jump at one moment have one cause. Images of an arm that hardly moves determine
    few numbers, and as many causes as these explain them, whichever they are.
    """
    causes = {
        (fault.since, fault.until) if fault.kind == FaultKind.JUMPING else fault.name
        for fault in found.faults
        if fault.form.by_body
    }
    log = select_sightings(
        correction.shift_features(features, _known_delays(features, body, delay)), body, settings
    )
    if log is None:
        return None
    is_open = _leaves_causes_open(found, log)
    if len(causes) <= MOST_CAUSES and not is_open:
        return None
    off = fit_unknowns(log, usual_offsets(log)).off
    unexplained = _unexplained_misfit(log, off, describe_moved_joints(features, body))
    return replace(unexplained, causes=len(causes), is_open=is_open)


def _leaves_causes_open(found: Estimate, log: SightingLog) -> bool:
    """Whether others may as well be wrong as those that are named: what images show of an arm that
    hardly moves is explained by at least two causes, or by a camera or marker that has moved.

    Errors that last are one cause, and offsets where they are as large; a pose explains all that
    such images show. The arm hardly moves where images of one posture, which do not determine all
    offsets, determine as many as those of the log.
    """
    seen = count_determined_offsets(log)
    if seen == len(found.joints.names) or seen > count_determined_offsets(hold_still(log)):
        return False
    lasting = found.settings.get(LASTING_ERROR, {"std": 0.0, "nats": 0.0})
    has_moved = any(fault.kind == FaultKind.MOVED for fault in found.faults)
    if has_moved or lasting["std"] > OFFSET_STD:
        return True
    offsets = [fault for fault in found.faults if fault.form.offset and fault.form.needs_images]
    causes = len(offsets) + (lasting["nats"] > EVIDENCE_THRESHOLD_NATS)
    return bool(offsets) and causes >= max(seen, 2)


def misfit_sentence(misfit: LogMisfit) -> str:
    """The verdict on a log that does not fit."""
    off = (
        f": {misfit.off:.0%} of {misfit.sightings} sightings are more than 3 σ off"
        if misfit.off > MAX_SHARE_OFF
        else ""
    )
    text = f"this log does not fit this body{off}"
    if misfit.causes or misfit.is_open:
        causes = (
            "more than one encoder or the camera would have to be wrong, and images of an arm that "
            "hardly moves leave open which"
            if misfit.is_open
            else f"{misfit.causes} sensors would have to be wrong at once"
        )
        text = f"{text}{' and' if off else ':'} {causes}"
    if misfit.explanation is None and misfit.is_open:
        return f"{text}; record a log in which the arm moves"
    if misfit.explanation is None:
        return f"{text}; no swapped joints, sign, unit or camera explains it"
    if misfit.off_explained is None:
        return f"{text}; likely {misfit.explanation}: {misfit.advice}"
    likelier = (
        f"it fits with {misfit.explanation} ({misfit.off_explained:.0%} off, {misfit.nats:.0f} "
        "nats likelier)"
    )
    return f"{text}; {likelier}: {misfit.advice}"


def with_doubt(found: Estimate, features: Features, misfit: LogMisfit) -> Estimate:
    """An estimate from encoders alone, as that of a log that
    does not fit: without faults, and with the doubt in it.

    Where other angles explain the log, their difference from those read adds to the covariance;
    else FAR rad do, as of an encoder with a fault.
    """
    angles = found.joints.values
    text = misfit_sentence(misfit)
    if misfit.change is None:
        doubt = PRIOR_STD_RAD**2 * np.eye(angles.shape[1])
    else:
        apart = angles @ (misfit.change - np.eye(angles.shape[1])).T
        doubt = apart[:, :, None] * apart[:, None, :]
    tracks = {
        name: Health(len(track.t), 0, {"does not fit the body": len(track.t)})
        for name, track in features.tracks.items()
        if name not in found.used
    }
    own = {"text": text, "off": misfit.off, "explanation": misfit.explanation}
    return replace(
        found,
        cov=found.cov + doubt,
        faults=(),
        bias=None,
        used={**found.used, **tracks},
        settings={**found.settings, MISFIT: own},
        findings=(*found.findings, Finding("lost", text)),
    )


def _with_measured_delay(
    features: Features,
    body: BodyModel,
    settings: EstimationSettings,
    delay: str | Mapping[str, float],
) -> FittedUnknowns:
    """The log with its likeliest fault after camera delays are measured and corrected."""
    timely = correction.correct_camera_delays(features, body, delay).features
    log = select_sightings(timely, body, settings)
    return (
        FittedUnknowns(float("inf"), 1.0)
        if log is None
        else _likeliest_fault(log, fit_unknowns(log, usual_offsets(log)))
    )


def _known_delays(
    features: Features, body: BodyModel, given: str | Mapping[str, float]
) -> dict[str, float]:
    """Delays (s) that are given, or else the body's."""
    names = correction.list_track_cameras([*features.tracks, *body.senses])
    return {**correction.read_learned_delays(body), **correction.select_fixed_delays(given, names)}


def _list_log_readings(
    log: SightingLog, features: Features, body: BodyModel, settings: EstimationSettings
) -> list[LogReading]:
    """The ways to read the log that are compared."""
    names = body.joints
    eye = np.eye(len(body.joints))
    found = []
    for i, j in combinations(range(len(names)), 2):
        order = np.arange(len(names))
        order[[i, j]] = j, i
        words = f"the columns of {names[i]} and {names[j]} swapped"
        advice = "name the joints in the order of their columns"
        found.append(LogReading(words, advice, log.changed(eye[order]), eye[order]))
    for j, name in enumerate(names):
        flip = np.diag(np.where(np.arange(len(names)) == j, -1.0, 1.0))
        advice = "correct the sign in the driver, or fit a body from a log like this one"
        found.append(LogReading(f"the sign of {name} flipped", advice, log.changed(flip), flip))
    for factor, unit, words in _UNITS:
        # jumps and whole turns are those of angles in rad, so the readings are converted first
        converted = select_sightings(_scale_joint_readings(features, factor), body, settings)
        if converted is not None:
            found.append(
                LogReading(
                    words, f'type [body] unit = "{unit}" in robot.toml', converted, factor * eye
                )
            )
    return [*found, *_swapped_cameras(log)]


def _scale_joint_readings(features: Features, factor: float) -> Features:
    """The features with all joint readings times a factor."""
    joints = features.joints
    return (
        features
        if joints is None
        else replace(features, joints=replace(joints, values=factor * joints.values))
    )


def _swapped_cameras(log: SightingLog) -> Iterator[LogReading]:
    """Yield the log with the images of two cameras swapped, where both see the same features."""
    models = {track.name: track.model for track in log.tracks}
    cameras = dict.fromkeys(camera_of_track(name) for name in models)
    for one, other in combinations(cameras, 2):
        swapped = {
            name: models[partner]
            for name in models
            for partner in models
            if {camera_of_track(name), camera_of_track(partner)} == {one, other}
            and name.split("/")[-1] == partner.split("/")[-1]
        }
        if swapped:
            words = f"the images of {one} and {other} swapped"
            yield LogReading(
                words, "name each camera's topic in [topics] camera", log.seen_by(swapped)
            )


def _select_promising_readings(
    log: SightingLog, readings: Sequence[LogReading]
) -> list[LogReading]:
    """The likeliest readings that are likelier than the log
    as it is, with wide errors: unknowns are not fitted yet.
    """
    plain = wide_nats(log)
    each = [(wide_nats(reading.log), number) for number, reading in enumerate(readings)]
    return [readings[number] for nats, number in sorted(each)[:_PROMISING] if nats < plain]


def _likeliest_fault(log: SightingLog, plain: FittedUnknowns) -> FittedUnknowns:
    """The log with the likeliest fault, or two where one is not enough; `plain`: without any."""
    usual = usual_offsets(log)
    single = [(fit_unknowns(log, (*usual, one)), one) for one in possible_faults(log)]
    best = min([plain, *(fit for fit, _ in single)], key=lambda one: one.nats)
    if best.off <= MAX_SHARE_OFF:
        return best
    first = min(single, key=lambda one: one[0].nats)[1]
    each = [*possible_faults(log), *constant_offsets(log)]
    others = [one for one in each if (one.kind, one.joint) != (first.kind, first.joint)]
    # two joints that wander explain any place in an image
    others = [one for one in others if first.kind != WALK or one.kind != WALK]
    return min(
        [best, *(fit_unknowns(log, (*usual, first, one)) for one in others)],
        key=lambda one: one.nats,
    )


def _explain_misfit(
    fitting: Sequence[tuple[FittedUnknowns, LogReading]],
    plain: FittedUnknowns,
    fault: FittedUnknowns,
    sightings: int,
) -> LogMisfit:
    """The misfit with the readings that win; several where none of them wins over the others."""
    best = fitting[0][0]
    indistinct_models = [
        one for fit, one in fitting if fit.nats < best.nats + EVIDENCE_THRESHOLD_NATS
    ]
    words = ALTERNATIVE_SEPARATOR.join(one.words for one in indistinct_models)
    advice = (
        indistinct_models[0].advice
        if len(indistinct_models) == 1
        else "the log cannot tell which; check the driver"
    )
    change = indistinct_models[0].change
    return LogMisfit(
        max(plain.off, fault.off),
        sightings,
        words,
        advice,
        best.off,
        fault.nats - best.nats,
        change,
    )


def _unexplained_misfit(log: SightingLog, off: float, moved: str) -> LogMisfit:
    """The misfit of a log that no other reading of its columns explains; joints that the body is
    not learned over may, as `describe_moved_joints` names them, or another camera.
    """
    if moved:
        advice = "fit a body that is learned over it"
        return LogMisfit(off, log.count, f"because {moved} as while the body was learned", advice)
    if min(_predictable_share(track) for track in log.tracks) < MIN_PREDICTABLE_SHARE:
        return LogMisfit(off, log.count)
    words = (
        "another camera, marker or body, as the joints explain the images, but not as this body "
        "does"
    )
    return LogMisfit(off, log.count, words, "fit a body from a log of this one")


def _has_moved(features: Features, body: BodyModel) -> bool:
    """Whether a camera or marker with kinematics, moved since
    the body was learned, explains most of the sightings.
    """
    from ..body.kinematic.model import can_show_changes
    from ..body.kinematic.moved_share import moved_share_off

    return can_show_changes(body) and moved_share_off(features, body) <= MAX_SHARE_OFF


def _predictable_share(track: TrackSightings) -> float:
    """Share of a track's variance predicted by a regression
    on squares of the angles, of parts not learned from.
    """
    own = track.x - track.x.mean(axis=0)
    own = own / np.maximum(own.std(axis=0), 1e-6)
    upper = np.triu_indices(own.shape[1])
    terms = np.column_stack(
        [np.ones(len(own)), own, (own[:, :, None] * own[:, None, :])[:, *upper]]
    )
    parts = np.arange(len(own)) * _PARTS // len(own)
    wrong = np.zeros_like(track.y)
    for part in range(_PARTS):
        held = parts == part
        known = parts != part
        square = terms[known].T @ terms[known] + _RIDGE * np.eye(terms.shape[1])
        fit = np.linalg.solve(square, terms[known].T @ track.y[known])
        wrong[held] = track.y[held] - terms[held] @ fit
    spread = np.square(track.y - track.y.mean(axis=0)).mean()
    return float(1.0 - np.square(wrong).mean() / max(spread, 1e-12))
