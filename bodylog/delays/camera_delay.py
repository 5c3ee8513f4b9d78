"""Learn a body with camera delays corrected: the body and the delays are estimated in turn."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import degrees, log, sqrt
from typing import Any

import numpy as np

from .. import body
from ..body.gp.model import GP, se_kernel
from ..body.kinematic.learn import Robotics
from ..body.learning import Keep, LearnedBody
from ..body.senses import encoder_function
from ..body_model import BodyModel, ForwardModel
from ..errors import EvidenceError
from ..estimation.faults.threshold import MIN_DELAY_S
from ..estimation.measurements.arm_errors import LEAST_NEES, ArmErrors, read_arm_errors
from ..estimation.measurements.track import camera_of_track
from ..estimation.timing import correction
from ..estimation.timing.delay_profile import Delay
from ..perception.tracking import joint_motion
from ..settings import Settings
from ..types import TRACK_AXES, Array, Features, Finding, Score
from . import gp_likelihood
from .gp_likelihood import ExploredLog, Prior
from .tracker_delay import measure_tracker_delays, measure_turning_delays

MAX_TURNS = 5
"""Most bodies learned, each from images corrected by the delays of the last one."""
SHARED_DELAY_SIGMA = 4.0
"""Standard errors within which a log without a significant delay may share another log's."""
MAX_ERROR_RATIO = 0.95
"""Largest ratio of held-out errors after and before a
correction; above it, the delay was the arm's shape.
"""

SAME_LASTING = 0.3
"""Share by which σ and τ of errors that last may still differ: of 20 time constants that an
exploration has, σ is known to a sixth and τ to a third.
"""

Delays = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class _Turn:
    """A body learned from logs delayed by `late`, the delays left
    in each log, and the delays and errors the body keeps.

    rest: what the logs show of errors: play in all, and what is left of row times · started:
    cameras whose delay was corrected.
    """

    found: LearnedBody
    late: Sequence[Delays]
    residuals: Sequence[Mapping[str, Delay]]
    own: Delays
    errors: ArmErrors
    rest: ArmErrors
    started: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False)
class _Exploration:
    """The features of each log and how a body is learned from them; fixed: given delays (s)."""

    features: Sequence[Features]
    settings: Settings
    provenance: Mapping[str, Any]
    known: BodyModel | None
    keep: Keep
    fixed: Delays


def learn_with_delays(
    features: Sequence[Features],
    settings: Settings,
    provenance: Mapping[str, Any],
    known: BodyModel | None,
    robot: Robotics | None = None,
) -> LearnedBody:
    """Learn a body from features with each camera's
    delay corrected, as given or as measured in each log.

    The body keeps the delays of the logs with the smallest
    standard errors. UsageError for an unknown camera.
    """
    keep: Keep = "explained" if robot is None else "all"
    if all(found.poses for found in features):
        found = body.learn_body(features, settings, provenance, known, keep)
        return body.with_kinematics(features, settings, found, robot, known)
    cameras = correction.list_track_cameras([name for found in features for name in found.tracks])
    fixed = correction.select_fixed_delays(settings.time.delay, cameras)
    measured = _measure_trackers(features, settings, robot, fixed)
    fixed_here = {**fixed, **{name: 0.0 for delays in measured for name in delays}}
    tracked = [
        {name: one for name, one in delays.items() if correction.is_significant(one)}
        for delays in measured
    ]
    features = [
        correction.shift_features(found, {name: one.seconds for name, one in delays.items()})
        for found, delays in zip(features, tracked, strict=True)
    ]
    turn = _alternate_until_converged(
        _Exploration(features, settings, provenance, known, keep, fixed_here)
    )
    timely = [
        correction.shift_features(found, delays, turn.errors)
        for found, delays in zip(features, turn.late, strict=True)
    ]
    still_late = any(
        correction.is_significant(rest) for one in turn.residuals for rest in one.values()
    )
    # a late camera makes its tracks vague: the finding on the delay says so
    learned = replace(turn.found, vague={}) if still_late else turn.found
    learned = _with_tracker_delays(learned, tracked)
    found = body.with_kinematics(timely, settings, learned, robot, known)
    errors = replace(turn.errors, held_out=_misstated_tracks(found.scores))
    about_errors = (
        *_delay_findings(turn, fixed),
        *_error_findings(errors),
        *errors.warn_of_narrow_bars(),
    )
    if errors:
        origin = {**found.model.provenance, **errors.as_provenance()}
        found = replace(found, model=replace(found.model, provenance=origin))
    findings = (*_tracker_findings(tracked), *about_errors, *found.findings)
    return replace(found, findings=findings)


def _measure_trackers(
    features: Sequence[Features], settings: Settings, robot: Robotics | None, fixed: Delays
) -> list[dict[str, Delay]]:
    """Delays of trackers in each log, by kinematics or by what joints that turn can do."""
    tracks = [one for found in features for one in found.tracks.items()]
    trackers = {camera_of_track(name) for name, one in tracks if one.unit == TRACK_AXES[3][1]}
    free = sorted(trackers - set(fixed))
    if not free:
        return [{} for _ in features]
    if robot is None:
        return measure_turning_delays(features, settings, free)
    return measure_tracker_delays(features, settings, robot, free)


def _with_tracker_delays(found: LearnedBody, tracked: Sequence[Mapping[str, Delay]]) -> LearnedBody:
    """The body with each tracker's delay of the log with the smallest error."""
    surest: dict[str, Delay] = {}
    for delays in tracked:
        for name, one in delays.items():
            if name not in surest or one.std_error < surest[name].std_error:
                surest[name] = one
    if not surest:
        return found
    known = found.model.provenance.get("delay", {})
    late = {**known, **{name: round(one.seconds, 6) for name, one in surest.items()}}
    model = replace(found.model, provenance={**found.model.provenance, "delay": late})
    return replace(found, model=model)


def _tracker_findings(tracked: Sequence[Mapping[str, Delay]]) -> Iterator[Finding]:
    """Yield a remark on each tracker's delay in each log."""
    for k, delays in enumerate(tracked):
        late = {name: one.seconds for name, one in delays.items()}
        errors = {name: one.std_error for name, one in delays.items()}
        for finding in correction.report_delays(late, errors, {}, {}):
            log = f"log {k + 1}: " if len(tracked) > 1 else ""
            yield replace(finding, text=f"{log}{finding.text}")


def measure_log_delays(
    features: Features, settings: Settings
) -> tuple[dict[str, Delay], dict[str, Delay]]:
    """Delays of a log's cameras relative to its encoders, by a body learned from the log itself.

    The second ones are unclear: their correction does not
    make the body better. EvidenceError without a body.
    """
    start = _coarse_delays(features)
    explored = _Exploration([features], settings, {}, None, "explained", {})
    try:
        turn = _alternate_until_converged(
            replace(explored, features=[correction.shift_features(features, start)])
        )
    except EvidenceError:
        if not any(start.values()):
            raise
        start = {}
        turn = _alternate_until_converged(explored)
    found = dict[str, Delay]()
    unclear = dict[str, Delay]()
    for name, rest in turn.residuals[0].items():
        late = start.get(name, 0.0) + turn.late[0].get(name, 0.0) + rest.seconds
        clear = name in turn.started or not correction.is_significant(rest)
        (found if clear else unclear)[name] = Delay(late, rest.std_error)
    return found, unclear


def _coarse_delays(features: Features) -> dict[str, float]:
    """Delays (s) by camera to start from, to about 0.05 s; 0 where they are unclear."""
    found = dict[str, list[float]]()
    for name, track in features.tracks.items():
        seen = np.isfinite(track.values).all(axis=1)
        if (
            name.rpartition("/")[2] != "hand"
            and seen.sum() > 1
            and features.picture_size is not None
        ):
            late = joint_motion.camera_delay_s(
                features.joints, track.t[seen], track.values[seen], features.picture_size[0]
            )
            found.setdefault(camera_of_track(name), []).append(late)
    return {name: float(np.median(late)) for name, late in found.items()}


def _alternate_until_converged(explored: _Exploration) -> _Turn:
    """The last turn of learning and correcting by turns."""
    features = explored.features
    known = explored.known
    fixed = explored.fixed

    def learn_turn(late: Sequence[Delays], own: Delays, errors: ArmErrors) -> _Turn:
        timely = [
            correction.shift_features(found, delays, errors)
            for found, delays in zip(features, late, strict=True)
        ]
        origin = {**explored.provenance, **({"delay": dict(own)} if own else {})}
        found = body.learn_body(
            timely, explored.settings, origin, known, explored.keep, lasting=errors.lasting
        )
        sure = replace(
            found.model, senses={n: s for n, s in found.model.senses.items() if n not in found.poor}
        )
        motors = [
            replace(one, joints=correction.shift_features(all_of, delays).joints)
            for one, all_of, delays in zip(timely, features, late, strict=True)
        ]
        residuals, rest = _remaining_errors(motors, sure, known, errors)
        return _Turn(found, late, residuals, own, errors, rest)

    own = (
        {}
        if known is None
        else {k: v for k, v in correction.read_learned_delays(known).items() if k not in fixed}
    )
    started = set[str]()
    given = {name: delay for name, delay in fixed.items() if delay}
    turn = learn_turn(
        [{**own, **fixed} for _ in features],
        {**own, **given},
        replace(read_arm_errors(known), held_out={}),
    )
    for _ in range(MAX_TURNS - 1):
        surest = _surest_logs(turn.residuals, fixed, started)
        errors = _add_measured_errors(turn.errors, turn.rest)
        if not surest and errors == turn.errors:
            break
        after = learn_turn(*_add_measured_delays(turn, surest), errors)
        moved = errors.play or errors.rows
        grown = set(surest) - started or bool(moved) > bool(turn.errors.play or turn.errors.rows)
        cameras = correction.list_track_cameras(after.found.model.senses)
        judged = surest if errors == turn.errors else cameras
        least = MAX_ERROR_RATIO if grown else 1.0
        if errors.lasting != turn.errors.lasting:
            # what lasts moves no measurement, and makes error bars true
            if _misstated_bars(after) > _misstated_bars(turn):
                break
        elif _held_out_error(after, judged) > least * _held_out_error(turn, judged):
            if not turn.errors.has_all_of(turn.rest) and turn.rest.lasting:
                # what looked like play or a row time may last instead
                lasting = replace(turn.errors, lasting=dict(turn.rest.lasting))
                after = learn_turn(turn.late, turn.own, lasting)
                turn = min(turn, after, key=_misstated_bars)
            break
        turn = after
        started = started | set(surest)
    return replace(turn, started=frozenset(started))


def _add_measured_errors(own: ArmErrors, rest: ArmErrors) -> ArmErrors:
    """The errors that were taken out and what is left of
    them; the same where that is less than a standard error.
    """
    play = dict(rest.play)
    if play.keys() == own.play.keys() and all(
        abs(size - own.play[name][0]) < std for name, (size, std) in play.items()
    ):
        play = dict(own.play)
    rows = dict(own.rows)
    for name, more in rest.rows.items():
        before = rows.get(name)
        if before is None:
            rows[name] = more
        elif abs(more.seconds) > more.std:
            rows[name] = replace(before, seconds=before.seconds + more.seconds, std=more.std)
    if not own.has_all_of(rest):
        return ArmErrors(play, rows)  # a body learned without them takes them for what lasts
    same = _compare_lasting(own.lasting, rest.lasting)
    return ArmErrors(play, rows, dict(own.lasting if same else rest.lasting))


def _compare_lasting(
    one: Mapping[str, tuple[float, float]], other: Mapping[str, tuple[float, float]]
) -> bool:
    """Whether errors {joint: (σ rad, τ s)} differ by less than an exploration tells."""
    both = zip(sorted(one.items()), sorted(other.items()), strict=False)
    pairs = [(a, b) for (_, first), (_, second) in both for a, b in zip(first, second, strict=True)]
    return one.keys() == other.keys() and all(
        abs(a - b) < SAME_LASTING * max(a, b) for a, b in pairs
    )


def _error_findings(errors: ArmErrors) -> Iterator[Finding]:
    """Yield remarks on the play and the row times that were taken out."""
    for name, (size, std) in errors.play.items():
        text = f"{name}: {degrees(size):.2f} ± {degrees(std):.2f}° of play"
        yield Finding("info", f"{text}; the body is learned over the angles of the links")
    if errors.lasting:
        sizes = ", ".join(f"{name} {1e3 * std:.2g}" for name, (std, _) in errors.lasting.items())
        seconds = max(seconds for _, seconds in errors.lasting.values())
        text = f"encoders: errors last {seconds:.2g} s, mrad: {sizes}"
        yield Finding("info", f"{text}; the body's noise and error bars allow for them")
    for name, one in errors.rows.items():
        apart = f"{1e3 * abs(one.seconds) * one.span:.0f} ± {1e3 * one.std * one.span:.0f} ms"
        yield Finding(
            "info", f"{name}: rows {one.span:.0f} px apart are exposed {apart} apart; corrected"
        )


def _delay_findings(turn: _Turn, fixed: Delays) -> Iterator[Finding]:
    """Yield remarks on the delays corrected in each
    log, and on `fixed` ones that the log contradicts.
    """
    for k, (delays, residual) in enumerate(zip(turn.late, turn.residuals, strict=True)):
        sure = {name: residual[name].std_error for name in turn.started if name in residual}
        for finding in correction.report_delays(delays, sure, residual, fixed):
            yield (
                replace(finding, text=f"log {k + 1}: {finding.text}")
                if len(turn.late) > 1
                else finding
            )


def _add_measured_delays(turn: _Turn, surest: Mapping[str, int]) -> tuple[Sequence[Delays], Delays]:
    """The logs' delays and the body's, with this turn's measurements added."""
    late = [dict(delays) for delays in turn.late]
    for name, at in surest.items():
        for delays, residual in zip(late, turn.residuals, strict=True):
            delays[name] = round(
                delays.get(name, 0.0) + _step_of_log(residual.get(name), turn.residuals[at][name]),
                6,
            )
    return late, {**turn.own, **{name: late[at][name] for name, at in surest.items()}}


def _held_out_error(turn: _Turn, cameras: Iterable[str]) -> float:
    """Root mean square held-out error (px) of some cameras' tracks together."""
    kinds = (score.name.partition("rmse/held_out/") for score in turn.found.scores)
    seen = [found and camera_of_track(track) in cameras for _, found, track in kinds]
    return sqrt(
        sum(score.value**2 for score, counts in zip(turn.found.scores, seen, strict=True) if counts)
    )


def _misstated_bars(turn: _Turn) -> float:
    """How far (in logarithms) squared held-out errors are from the stated variances, on average."""
    found = [one.value for one in turn.found.scores if one.name.startswith("nis/held_out/")]
    return abs(log(max(sum(found) / len(found), 1e-9)))


def _misstated_tracks(scores: Iterable[Score]) -> dict[str, float]:
    """Squared held-out errors over their stated variance
    {track}, where these are too large for sound ones.
    """
    named = ((one.name.partition("nis/held_out/"), one.value) for one in scores)
    return {track: value for (_, found, track), value in named if found and value > LEAST_NEES}


def _remaining_errors(
    timely: Sequence[Features], model: BodyModel, known: BodyModel | None, errors: ArmErrors
) -> tuple[Sequence[Mapping[str, Delay]], ArmErrors]:
    """Each log's remaining delays, the play, what lasts of encoder errors
    and what is left of row times, by a body learned with the logs and these errors.

    timely: with readings of the motors.
    """
    explored = [_explored_log(one, model, known) for one in timely]
    logs = [one for one in explored if one is not None]
    measured, rest = gp_likelihood.measure_arm_errors(logs, model.joints, errors)
    if any(one.reference is not None for one in timely):
        rest = ArmErrors(rows=rest.rows)  # a reference has the angles of the links
    delays = iter(measured)
    return [{} if one is None else next(delays) for one in explored], rest


def _explored_log(
    timely: Features, model: BodyModel, known: BodyModel | None
) -> ExploredLog | None:
    """A log's readings, and its tracks with their priors; None if it has no moving joints."""
    tracks = {name: sense for name, sense in model.senses.items() if name != "encoders"}
    angled = encoder_function.with_true_angles(timely, known)
    encoders, seen = correction.gather_sound_measurements(angled, replace(model, senses=tracks))
    if encoders is None or timely.poses:
        return None
    return gp_likelihood.ExploredLog(
        encoders,
        {name: [(one, _process_prior(one.model)) for one in some] for name, some in seen.items()},
    )


def _process_prior(model: ForwardModel) -> Prior:
    """The prior of a learned Gaussian process."""
    assert isinstance(model, GP)

    def prior(x: Array) -> tuple[Array, Array]:
        groups = zip(model.scales, model.amplitude, strict=True)
        kernels = [se_kernel(x / scales, x / scales, amplitude) for scales, amplitude in groups]
        outputs = range(len(model.mean))
        return model.mean, np.stack(
            [model.share[d] * kernels[d if len(kernels) > 1 else 0] for d in outputs]
        )

    return prior


def _surest_logs(
    residuals: Sequence[Mapping[str, Delay]], fixed: Delays, started: set[str]
) -> dict[str, int]:
    """The log with the smallest error of each camera with
    a delay, significant unless the camera is `started`.
    """
    found = {}
    for name in sorted({name for residual in residuals for name in residual} - set(fixed)):
        least = 0.0 if name in started else MIN_DELAY_S
        known = [k for k, residual in enumerate(residuals) if name in residual]
        if late := [k for k in known if correction.is_significant(residuals[k][name], least)]:
            found[name] = min(late, key=lambda k: residuals[k][name].std_error)
    return found


def _step_of_log(residual: Delay | None, surest: Delay) -> float:
    """A log's own step (s), or that of the surest
    log if its own is not significant but consistent.
    """
    if residual is not None and correction.is_significant(residual):
        return residual.seconds
    if residual is None or abs(residual.seconds - surest.seconds) < SHARED_DELAY_SIGMA * (
        residual.std_error + surest.std_error
    ):
        return surest.seconds
    return 0.0
