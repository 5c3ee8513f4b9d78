"""The estimate of one log, with the checks around it:
whether it fits the body, and what changed since learning.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import degrees, nan
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ..body_model import BodyModel
from ..checks import log_context, require_tracks
from ..fault_kinds import OFF_FROM_START_S
from ..robot import effector_poses
from ..settings import Settings
from ..types import (
    ALTERNATIVE_SEPARATOR,
    HARDWARE_ERRORS,
    LASTING_ERROR,
    Estimate,
    Fault,
    FaultKind,
    Features,
    Finding,
    Recording,
    Series,
)
from .faults import unseen_findings

if TYPE_CHECKING:
    from ..body.kinematic import change
    from ..body.kinematic.change import Change
    from ..estimation.measurements.arm_errors import ArmErrors

DIFFERING_SIGMA = 3.0
"""Standard deviations by which two sizes of one
offset must differ, in addition to a tenth of it.
"""
EXPLAINED_SHARE = 0.5
"""Share of the variance of errors that last below which a moved camera explains them: 0.27 was left
of one that had turned by 1°, before an arm whose errors of 3 mrad last, and 0.66 of none that had
moved, before an arm with new errors of 2 mrad.
"""


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
            found, learned = infer_with_changes(features, learned, settings)
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


def infer_with_changes(
    features: Features, body: BodyModel, settings: Settings
) -> tuple[Estimate, BodyModel]:
    """`infer`, with changes of joint zeros, cameras and markers among the faults, and by the body
    with cameras and markers where they are in this log; returns that body, too.

    Without effect for a body without the joints' axes, and with `bias = "off"`; where the estimate
    allows for a load, under which joints bend as if their zeros had changed, only cameras and
    markers count. Play and errors of encoders that last are those for which the estimate allows, or
    those of the exploration. A camera that has moved looks like faults from some time on, too: all
    images tell where it is now, if an estimate by that needs fewer of them, or less of an error.
    """
    from ..body.kinematic.model import can_show_changes

    found = infer(features, body, settings)
    if settings.estimate.bias == "off" or not can_show_changes(body):
        return found, body
    if any(_measure_needs(found)):
        every = _find_changes(_usable_tracks(features, _drop_faults_of_images(found)), body, {})
        if every.body is not body and all(one.since is None for one in every.changes):
            again = infer(features, every.body, settings)
            if _needs_less(again, found):
                return _with_changes(again, every), every.body
    if _has_later_faults_of_images(found):
        return found, body  # they begin before they are found, so no stretch is without them
    errors = _list_errors(found)
    offsets = _list_offset_joints(found) if not errors.get("load") else []
    changes = _find_changes(_usable_tracks(features, found), body, errors, offsets)
    if changes.body is not body:
        return _with_changes(infer(features, changes.body, settings), changes), changes.body
    if errors.get("load") and changes.changes:
        return found, body
    return _with_changes(found, changes), body


def _find_changes(
    features: Features, body: BodyModel, errors: Mapping[str, Any], offsets: Sequence[str] = ()
) -> "change.FoundChanges":
    """Changes since the body was learned, beside errors and offsets of an explained log."""
    from ..body.kinematic import change
    from ..estimation.measurements.arm_errors import with_links

    arm = _list_arm_errors(errors, body)
    return change.find_changes(with_links(features, arm.play), body, arm.lasting, offsets)


def _drop_faults_of_images(found: Estimate) -> Estimate:
    """The estimate without faults that images alone show."""
    kept = (fault for fault in found.faults if not _is_shown_by_images(fault))
    return replace(found, faults=tuple(kept))


def _has_later_faults_of_images(found: Estimate) -> bool:
    """Whether images alone show a fault from some time after the start on."""
    return any(
        _is_shown_by_images(fault) and fault.since >= OFF_FROM_START_S for fault in found.faults
    )


def _is_shown_by_images(fault: Fault) -> bool:
    """Whether images alone show a fault, with the body's encoders."""
    return fault.form.needs_images or fault.kind == FaultKind.DISPLACED


def _list_errors(found: Estimate) -> Mapping[str, Any]:
    """Errors of the hardware for which an estimate allows, or by which it widens its error bars."""
    widened = found.settings.get(LASTING_ERROR)
    # without evidence of the log's own it is the exploration's, which the body holds
    by_default = {"lasting": widened} if widened and widened["nats"] else {}
    errors: Mapping[str, Any] = found.settings.get(HARDWARE_ERRORS, by_default)
    return errors


def _needs_less(again: Estimate, found: Estimate) -> bool:
    """Whether an estimate needs fewer faults than another one; if that one has none, less of a
    load; if it has no load either, errors that last of less than EXPLAINED_SHARE of the variance.
    """
    after = _measure_needs(again)
    before = _measure_needs(found)
    if before.faults:
        return after.faults < before.faults
    if before.bend:
        return after.faults == 0 and after.bend < before.bend
    has_cause = after.faults > 0 or after.bend > 0.0
    return not has_cause and after.lasting < EXPLAINED_SHARE * before.lasting


class _Needs(NamedTuple):
    """How many faults only the body shows, how far (rad) a load bends joints at most, and the
    variance (rad²) of encoders' errors that last.
    """

    faults: int
    bend: float
    lasting: float


def _measure_needs(found: Estimate) -> _Needs:
    """What an estimate needs beside its body."""
    errors = _list_errors(found)
    load = errors.get("load")
    lasting = errors.get("lasting")
    faults = sum(fault.form.by_body for fault in found.faults)
    bend = max(load["rad"].values(), default=0.0) if load else 0.0
    return _Needs(faults, bend, lasting["std"] ** 2 if lasting else 0.0)


def _with_changes(found: Estimate, changes: "change.FoundChanges") -> Estimate:
    """The estimate with changes among its faults, and with their doubt."""
    faults, findings = merge_changes_and_faults(changes.changes, found)
    return replace(
        found, cov=found.cov + changes.doubt, faults=faults, findings=(*found.findings, *findings)
    )


def _list_arm_errors(explained: Mapping[str, Any], body: BodyModel) -> "ArmErrors":
    """Play and errors of encoders that last: those of an explained log, else of the exploration."""
    from ..estimation.measurements.arm_errors import read_arm_errors

    arm = read_arm_errors(body)
    if play := explained.get("play"):
        arm = replace(arm, play={name: (one["rad"], one["std"]) for name, one in play.items()})
    if lasting := explained.get("lasting"):
        size = (lasting["std"], lasting["seconds"])
        arm = replace(arm, lasting=dict.fromkeys(body.joints, size))
    return arm


def _usable_tracks(features: Features, found: Estimate) -> Features:
    """Used tracks with corrected times, up to the
    first fault that is not a constant encoder offset.
    """
    from ..estimation.timing import correction

    delays = found.settings.get("delay", {})
    timely = (
        correction.shift_features(features, delays) if isinstance(delays, Mapping) else features
    )
    seen = [
        fault.since
        for fault in found.faults
        if fault.sense == "vision" and fault.since >= OFF_FROM_START_S
    ]
    later = [
        fault.since
        for fault in found.faults
        if fault.sense == "encoders" and not _is_constant_offset(fault)
    ] + seen
    end = min(later, default=float("inf"))
    tracks = {}
    for name, track in timely.tracks.items():
        if name in found.used and found.used[name].used:
            early = track.t < end
            std = None if track.std is None else track.std[early]
            some = (
                track.t[early],
                track.values[early],
                track.names,
                track.unit,
                track.source_ns[early],
                std,
            )
            tracks[name] = Series(*some)
    return replace(timely, tracks=tracks)


def _list_offset_joints(found: Estimate) -> list[str]:
    """Joints whose encoders an estimate holds to be off from the start on."""
    constant = [fault for fault in found.faults if _is_constant_offset(fault)]
    return [name for fault in constant for name in fault.names]


def _is_constant_offset(fault: Fault) -> bool:
    """Whether a fault is an encoder's offset from the start on."""
    constant = fault.sense == "encoders" and fault.kind in (FaultKind.DRIFTING, FaultKind.OFFSET)
    return constant and fault.since < OFF_FROM_START_S


def merge_changes_and_faults(
    changes: "Sequence[Change]", found: Estimate
) -> tuple[tuple[Fault, ...], tuple[Finding, ...]]:
    """Merge the estimate's faults with the changes, and return a remark on each."""
    start = float(found.joints.t[0]) if len(found.joints.t) else 0.0
    own = [_change_as_fault(one, start) for one in changes]
    findings = list[Finding]()
    kept = []
    for fault in found.faults:
        same = next(
            (one for one in own if set(one.names) & set(fault.names) and one.sense == "encoders"),
            None,
        )
        moved = next((one for one in own if one.sense == "vision"), None)
        if not _is_constant_offset(fault) or (same is None and moved is None):
            kept.append(fault)
        elif same is None and moved is not None:
            text = (
                f"{moved.name} explains the filter's offset of {fault.name} ({fault.size:.4g} "
                "rad) better"
            )
            findings.append(Finding("info", text))
        elif same is not None:
            findings += _differing_size_findings(same, fault)
    findings += [Finding("info", _describe_change(one)) for one in changes]
    lasting = {fault.name for fault in kept if fault.sense == "encoders"}
    return (*kept, *(one for one in own if not lasting.intersection(one.names))), tuple(findings)


def _change_as_fault(one: "Change", start: float) -> Fault:
    """The change as a fault; an encoder's offset has the opposite sign of its joint's zero, and
    a marker's displacement has no size where no length is known.
    """
    name = ALTERNATIVE_SEPARATOR.join((one.name, *one.alternatives))
    since = start if one.since is None else one.since
    if one.kind == "joint":
        size, std = (nan, None) if one.alternatives else (-float(one.value[0]), float(one.std[0]))
        return Fault("encoders", name, FaultKind.OFFSET, since, size, one.unit, std)
    assert one.shift is not None
    if one.alternatives or (one.kind == "marker" and one.length_unit != "m"):
        return Fault(
            "vision", name, FaultKind.MOVED, since, nan, "rad" if one.kind == "camera" else "m"
        )
    if one.kind == "camera":
        assert one.turn is not None
        return Fault("vision", name, FaultKind.MOVED, since, one.turn[0], "rad", one.turn[1])
    return Fault(
        "vision", name, FaultKind.MOVED, since, one.shift[0], "m", one.shift[1], *(one.turn or ())
    )


def _differing_size_findings(same: Fault, fault: Fault) -> Iterable[Finding]:
    """Yield a remark where the filter's size of an offset differs."""
    if same.std is None or fault.size != fault.size:
        return
    if abs(same.size - fault.size) > DIFFERING_SIGMA * same.std + 0.1 * abs(same.size):
        by_body = f"relative to the body's zeros {same.size:.4g} ± {same.std:.2g} rad"
        yield Finding(
            "info", f"{same.name}: by the filter its offset is {fault.size:.4g} rad, {by_body}"
        )


def _describe_change(one: "Change") -> str:
    """A change in words, with the evidence for it."""
    sure = f"{one.nats:.0f} nats likelier than no change"
    if one.kind == "joint":
        factor, unit = (degrees(1.0), "°") if one.unit == "rad" else (1e3, " mm")
        value = -factor * one.value[0]
        std = factor * one.std[0]
        return f"{one.name}: reads {value:+.2f} ± {std:.2f}{unit} relative to the body, {sure}"
    assert one.shift is not None
    factor, unit = (
        (1e3, " mm") if one.length_unit == "m" else (100.0, " % of the marker's distance")
    )
    place = f"{factor * one.shift[0]:.1f} ± {factor * one.shift[1]:.1f}{unit}"
    turn = (
        ""
        if one.turn is None
        else f" and turned by {degrees(one.turn[0]):.2f} ± {degrees(one.turn[1]):.2f}°"
    )
    return f"{one.name}: moved by {place}{turn}, {sure}"
