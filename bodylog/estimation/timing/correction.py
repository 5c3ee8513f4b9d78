"""Camera delays: image timestamps are corrected to
the encoders' clock, by given or measured delays.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite

import numpy as np

from ...body_model import BodyModel
from ...errors import ModelError, UsageError
from ...fault_kinds import FORMS
from ...settings import EstimationSettings
from ...types import Estimate, Fault, Features, Finding, Hypothesis, Series
from ..faults.encoder_faults import repair_readings
from ..faults.jumping import find_evident_slips
from ..faults.threshold import EVIDENCE_THRESHOLD_NATS, MIN_DELAY_S, SIGNIFICANT_SIGMA
from ..measurements.arm_errors import ArmErrors, read_arm_errors, shift_by_rows, with_links
from ..measurements.gather import gather_measurements
from ..measurements.records import Encoders, Sighting
from ..measurements.track import camera_of_track
from .delay_profile import MAX_DELAY_S, Delay
from .regression import measure_delay_by_regression
from .slip_delay import measure_delay_by_slips


@dataclass(frozen=True, eq=False)
class CorrectedFeatures:
    """Features with nonzero `delays` (s, by camera) subtracted,
    standard errors (s) of measured ones, and remarks.

    measured: every delay (s) that the log shows, by camera, and why it is not applied · unsure: the
    part (s) that is evident but in doubt, by camera.
    """

    features: Features
    delays: Mapping[str, float]
    errors: Mapping[str, float]
    measured: Mapping[str, Delay]
    unsure: Mapping[str, float]
    findings: tuple[Finding, ...] = ()
    hypotheses: tuple[Hypothesis, ...] = ()


def correct_camera_delays(
    features: Features, body: BodyModel, given: str | Mapping[str, float]
) -> CorrectedFeatures:
    """Subtract each camera's delay: as `given` {camera:
    s}, none if "off", else measured from the log.

    Unless the log contradicts it, a camera keeps the delay of the body's exploration log.
    UsageError for an unknown camera, ModelError for a body with invalid delays.
    """
    names = list_track_cameras([*features.tracks, *body.senses])
    learned = read_learned_delays(body)
    fixed = select_fixed_delays(given, names)
    delays = {name: fixed.get(name, learned.get(name, 0.0)) for name in ("joints", *names)}
    errors = dict[str, float]()
    residuals = measure_camera_delays(shift_features(features, delays), body)
    shown = {
        name: replace(
            rest, seconds=delays[name] + rest.seconds, doubt=_find_doubt(rest, name in fixed)
        )
        for name, rest in residuals.items()
    }
    free = {name: rest for name, rest in residuals.items() if name not in fixed}
    unsure = {
        name: float(np.hypot(rest.seconds, rest.std_error)) if rest.changes else rest.seconds
        for name, rest in free.items()
        if rest.doubt and is_evident(rest)
    }
    unapplied = tuple(report_unapplied_delays(free, delays))
    for name, rest in free.items():
        if not is_significant(rest):
            continue
        own = replace(rest, seconds=delays[name] + rest.seconds)
        if not delays[name] or own.nats > EVIDENCE_THRESHOLD_NATS:
            delays[name] = own.seconds
            errors[name] = own.std_error
        else:
            # a camera without its learned delay more likely has none than the measured rest
            delays[name] = 0.0
    weighed = tuple(
        Hypothesis(
            "camera late",
            name,
            rest.nats,
            EVIDENCE_THRESHOLD_NATS,
            name in free and is_significant(rest),
        )
        for name, rest in residuals.items()
    )
    delays = {name: delay for name, delay in delays.items() if delay}
    findings = (*report_delays(delays, errors, residuals, fixed), *unapplied)
    return CorrectedFeatures(
        shift_features(features, delays), delays, errors, shown, unsure, findings, weighed
    )


def measure_delays_left(
    features: Features, body: BodyModel, faults: Iterable[Fault]
) -> dict[str, dict[str, float]]:
    """What is left of each camera's delay beside offsets of encoders, as of `reconsider_delays`;
    nothing where no encoder is off.

    A delay is measured before faults are looked for, and an encoder that begins to drift at 5
    mrad/s moves it by 7 ms on a smoothly moving arm (root mean square of 16 drawn logs).
    """
    off = {
        name for fault in faults if FORMS[fault.sense, fault.kind].offset for name in fault.names
    }
    found = measure_camera_delays(features, body, off) if off else {}
    return {
        name: {"seconds": one.seconds, "std": one.std_error, "nats": one.nats}
        for name, one in found.items()
        if not one.doubt
    }


def reconsider_delays(
    timely: CorrectedFeatures,
    features: Features,
    body: BodyModel,
    given: str | Mapping[str, float],
    left: Mapping[str, Mapping[str, float]],
) -> CorrectedFeatures | None:
    """The delays again where play or other errors of the hardware
    had been taken for a part of them; None if all stay.

    left {camera: seconds, std, nats}: what is left of each delay with those errors accounted for. A
    delay is changed where what is left is evident, and where the whole of it no longer is.
    """
    fixed = select_fixed_delays(given, list_track_cameras([*features.tracks, *body.senses]))
    totals = {
        name: Delay(timely.delays.get(name, 0.0) + one["seconds"], one["std"])
        for name, one in left.items()
    }
    free = {
        name: total
        for name, total in totals.items()
        if name not in fixed and _is_changed(timely, name, total, left[name]["nats"])
    }
    if not free:
        return None
    found = {name: total for name, total in free.items() if is_significant(total)}
    delays = {name: seconds for name, seconds in timely.delays.items() if name not in free}
    errors = {name: error for name, error in timely.errors.items() if name not in free}
    delays |= {name: total.seconds for name, total in found.items()}
    errors |= {name: total.std_error for name, total in found.items()}
    explained = {
        name: replace(one, doubt="joints' errors explain it") for name, one in free.items()
    }
    text = "camera late beside errors of joints"
    weighed = (
        Hypothesis(text, name, total.nats, EVIDENCE_THRESHOLD_NATS, name in found)
        for name, total in free.items()
    )
    others = [one for one in timely.findings if one.text.partition(":")[0] not in free]
    return CorrectedFeatures(
        shift_features(features, delays),
        delays,
        errors,
        {**timely.measured, **explained, **found},
        {name: seconds for name, seconds in timely.unsure.items() if name not in free},
        (*others, *report_delays({name: delays[name] for name in found}, errors, {}, fixed)),
        (*timely.hypotheses, *weighed),
    )


def _is_changed(timely: CorrectedFeatures, camera: str, total: Delay, nats: float) -> bool:
    """Whether what is left of a delay, in all and in nats, changes what was measured of it.

    Errors of joints make a delay that seems to change needless, or leave it as doubtful as it is.
    """
    if camera in timely.measured and timely.measured[camera].changes:
        return not is_significant(total)
    return nats > EVIDENCE_THRESHOLD_NATS or (camera in timely.delays and not is_significant(total))


def _find_doubt(residual: Delay, is_fixed: bool) -> str:
    """Why the rest of a delay is not applied; "" if it is."""
    if is_fixed:
        return "the delay is given"
    if residual.doubt:
        return residual.doubt
    if abs(residual.seconds) < SIGNIFICANT_SIGMA * residual.std_error:
        return "it is not significant"
    if residual.nats <= EVIDENCE_THRESHOLD_NATS:
        return f"its evidence is {residual.nats:.1f} nats, of {EVIDENCE_THRESHOLD_NATS:g} needed"
    return "" if is_significant(residual) else f"it is less than {1e3 * MIN_DELAY_S:g} ms"


def report_unapplied_delays(
    residuals: Mapping[str, Delay], applied: Mapping[str, float]
) -> Iterator[Finding]:
    """Yield a remark on each rest of a delay that is not
    applied: a warning where its evidence is sufficient.
    """
    for name, rest in residuals.items():
        if doubt := _find_doubt(rest, False):
            sure = is_evident(rest)
            before = f"{applied[name]:.4f} s corrected; " if applied[name] else ""
            text = (
                f"{name}: {before}{describe_delay(rest.seconds, rest.std_error)}, not applied, "
                f"because {doubt}"
            )
            whole = applied[name] + rest.seconds
            advice = "" if rest.changes else f"; type --delay {name}={whole:.4f} to apply it"
            more = f"; error bars include it{advice}" if sure else ""
            yield Finding("warning" if sure else "info", text + more)


def select_fixed_delays(given: str | Mapping[str, float], names: Iterable[str]) -> dict[str, float]:
    """Delays (s) of joints and cameras that are given,
    not measured; UsageError for an unknown name.
    """
    known = ("joints", *names)
    if isinstance(given, str):
        return {} if given == "auto" else dict.fromkeys(known, 0.0)
    # delays of single topics are applied in recording/
    given = {name: late for name, late in given.items() if not name.startswith("joints/")}
    if unknown := [name for name in given if name not in known]:
        raise UsageError(
            f"delay: {unknown[0]!r} found, possible: {', '.join(known)}; type --delay "
            f"{known[-1]}=0.05"
        )
    return dict(given)


def list_track_cameras(tracks: Iterable[str]) -> tuple[str, ...]:
    """Names of the cameras of tracks and senses; the first one is called camera."""
    return tuple(dict.fromkeys(camera_of_track(name) for name in tracks if name != "encoders"))


def is_significant(delay: Delay, least: float = MIN_DELAY_S) -> bool:
    """Whether a delay is evident and not in doubt."""
    return not delay.doubt and is_evident(delay, least)


def is_evident(delay: Delay, least: float = MIN_DELAY_S) -> bool:
    """Whether a delay wins more than EVIDENCE_THRESHOLD_NATS
    and exceeds `least` s, in doubt or not, or evidently changes.
    """
    if delay.changes:
        return True
    return bool(delay.nats > EVIDENCE_THRESHOLD_NATS and abs(delay.seconds) > least)


def shift_features(
    features: Features, delays: Mapping[str, float], errors: ArmErrors | None = None
) -> Features:
    """Subtract delays (s) from the times of each camera's tracks and of the
    joints; with errors of an arm, move rows to when they were exposed, and joints to the links.
    """
    tracks = {}
    for name, track in features.tracks.items():
        camera = camera_of_track(name)
        rows = None if errors is None else errors.rows.get(camera)
        timed = track if rows is None else replace(track, t=shift_by_rows(track, rows))
        tracks[name] = _shift_series(timed, delays.get(camera, 0.0))
    joints = (
        None
        if features.joints is None
        else _shift_series(features.joints, delays.get("joints", 0.0))
    )
    shifted = replace(features, tracks=tracks, joints=joints)
    return shifted if errors is None else with_links(shifted, errors.play)


def measure_camera_delays(
    features: Features, body: BodyModel, walking: Collection[str] = ()
) -> dict[str, Delay]:
    """Measure each camera's delay relative to the encoders, where the log determines it.

    walking: joints whose encoders drift or have been shifted.
    """
    linked = with_links(features, read_arm_errors(body).play)
    encoders, seen = gather_sound_measurements(linked, body)
    joints = tuple(k for k, name in enumerate(body.joints) if name in walking)
    if encoders is None:
        return {}
    if any(len(find_evident_slips(encoders.t, y)) for y in encoders.values.T):
        found = {name: measure_delay_by_slips(encoders, tracks) for name, tracks in seen.items()}
    else:
        found = {
            name: measure_delay_by_regression(encoders, tracks, joints)
            for name, tracks in seen.items()
        }
    return {name: delay for name, delay in found.items() if delay is not None}


def gather_sound_measurements(
    features: Features, body: BodyModel
) -> tuple[Encoders | None, Mapping[str, Sequence[Sighting]]]:
    """Sound encoder readings and each camera's tracks; None if a joint is missing."""
    joints = features.joints
    seen = dict[str, list[Sighting]]()
    if joints is None or "encoders" in body.senses or not set(body.joints) <= set(joints.names):
        return None, {}
    found = gather_measurements(features, body, EstimationSettings(without=("touch",)))
    for sighting in found.sightings:
        if sighting.name in features.tracks:
            seen.setdefault(camera_of_track(sighting.name), []).append(sighting)
    if found.encoders is None:
        return None, seen
    return repair_readings(found.encoders, found.sightings, body.joints), seen


def restore_stamps(found: Estimate, features: Features) -> Estimate:
    """The estimate with the images' timestamps of `features`, whose times were corrected for it."""

    def restore_times(name: str, series: Series) -> Series:
        track = features.tracks.get(name)
        if track is None:
            return series
        order = np.argsort(track.source_ns, kind="stable")
        rows = np.searchsorted(track.source_ns, series.source_ns, sorter=order)
        return replace(series, t=track.t[order[rows]])

    errors = {name: restore_times(name, series) for name, series in found.errors.items()}
    predicted = {name: restore_times(name, series) for name, series in found.predicted.items()}
    return replace(found, errors=errors, predicted=predicted)


def add_delay_uncertainty(found: Estimate, timely: CorrectedFeatures) -> Estimate:
    """Add the uncertainty of measured delays to the
    covariance: a delay shifts the estimate along its rate.

    All cameras are measured against the same encoders, so their errors are correlated. A delay that
    has the evidence but is in doubt may be true: it counts as its own error.
    """
    errors = {**timely.errors, **timely.unsure}
    if not errors:
        return found
    cameras_measured = {camera_of_track(name) for name in timely.features.tracks}
    rate = found.rate.values
    var = sum(error**2 for error in errors.values()) / len(cameras_measured)
    return replace(found, cov=found.cov + var * rate[:, :, None] * rate[:, None, :])


def report_delays(
    delays: Mapping[str, float],
    errors: Mapping[str, float],
    residuals: Mapping[str, Delay],
    fixed: Mapping[str, float],
) -> Iterator[Finding]:
    """Yield a warning for each measured delay, and for each
    `fixed` one that the log contradicts (`residuals`).
    """
    for name in (name for name in {**delays, **residuals} if name != "joints"):
        delay = delays.get(name, 0.0)
        residual = residuals.get(name)
        if (
            name in fixed
            and residual is not None
            and (is_significant(residual) or residual.changes)
        ):
            own = replace(residual, seconds=delay + residual.seconds)
            given = f"--delay {name}={delay:g}" if delay else "not corrected"
            better = f"{own.seconds:.4f}" if own.nats > EVIDENCE_THRESHOLD_NATS else "0"
            remedy = residual.doubt if residual.changes else f"type --delay {name}={better}"
            advice = f"error bars are too small for that; {remedy}"
            yield Finding(
                "warning",
                f"{name}: {describe_delay(own.seconds, own.std_error)} ({given}): {advice}",
            )
        elif name in errors:
            advice = (
                f"type --delay {name}={delay:.4f} to confirm it, --delay off to keep the timestamps"
            )
            yield Finding(
                "warning", f"{name}: {describe_delay(delay, errors[name])}, corrected; {advice}"
            )
        elif name not in fixed and delay:
            yield Finding(
                "info", f"{name}: {describe_delay(delay)}, as in the exploration log, corrected"
            )


def describe_delay(seconds: float, error: float | None = None) -> str:
    """The delay of image timestamps in words, ± its standard error (s)."""
    about = "" if error is None else f" ± {error:.4f}"
    return (
        f"image timestamps {'lag' if seconds > 0 else 'lead'} the encoders by "
        f"{abs(seconds):.4f}{about} s"
    )


def _shift_series(series: Series, delay: float) -> Series:
    return replace(series, t=series.t - delay) if delay else series


def read_learned_delays(body: BodyModel) -> dict[str, float]:
    """Delays (s) by camera that a body was learned with;
    ModelError for anything else in its provenance.
    """
    found = body.provenance.get("delay", {})
    if not isinstance(found, Mapping) or not all(
        isinstance(delay, int | float) and isfinite(delay) and abs(delay) <= MAX_DELAY_S
        for delay in found.values()
    ):
        raise ModelError(f"provenance.delay: found {found!r}, possible: seconds by camera")
    return {str(name): float(delay) for name, delay in found.items()}
