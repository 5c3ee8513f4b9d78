"""The filter of a whole log: belief over angles and rates, Gauss–Newton to convergence at every
instant.

Under the Laplace approximation this is an iterated extended Kalman filter. Each sweep linearises
all frames and filters the log; sweeps repeat until no linearisation point moves. Where encoders do
not determine the arm, sweeps may not converge: the filter then takes one instant after the other,
which is slower but robust.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ...types import Array
from ..measurements.long_arrays import find_finite_rows
from ..noise.correlated_noise import LastFrame, PendingFrame
from ..noise.encoder_noise import measure_burst_factors
from ..noise.posture_prior import build_stationary_motion
from .filter_pass import (
    CONVERGED_MOVE,
    MAX_SWEEPS,
    ROUGHLY_CONVERGED_MOVE,
    DidNotConverge,
    FilterReadings,
    FilterTrace,
    TraceDetail,
    filter_readings,
)
from .filter_problem import FilterProblem, build_encoder_rows, lay_out_readings
from .reacquisition import LONG_SILENCE_S, find_joints_left_open
from .sequential import Line, SequentialFilter, State
from .solution import Solution
from .tangents import Tangents, begin_along_path, build_state_prior, correlate_errors

HARDLY_MOVED = 100.0
"""Process variance of the fastest joint's bursts over that of a joint's own beyond which its own
tells nothing of a silence: ten times the accelerations. Of 120 logs of sines, reaches and babble in
which all joints take part, none has a joint as slow beside the fastest; the most is 30.
"""


def solve_by_gauss_newton(
    problem: FilterProblem,
    warm: Solution | None = None,
    at: str = "posterior",
    rest: float = CONVERGED_MOVE,
) -> Solution:
    """Sweep over the log until the solution is the sequential filter's, or raise DidNotConverge.

    Frames are linearised at the `posterior` mean (iterated) or at the `prior` one. warm: a solution
    of the same log to start from · rest: tolerance on linearisation points, rad.
    """
    readings, tangents = begin_sweeps(problem, warm, rest)
    trace = None
    for _ in range(MAX_SWEEPS):
        moved = tangents.write_stale_tangents(problem, readings)
        if trace is not None and not moved:
            return Solution(readings, tangents, trace)
        trace = sweep_log(problem, readings, into=trace)
        tangents.move_points(problem, trace.prior if at == "prior" else trace.z)
    raise DidNotConverge(f"filter: no rest after {MAX_SWEEPS} sweeps")


def begin_sweeps(
    problem: FilterProblem, warm: Solution | None, resting: float, whole: bool = False
) -> tuple[FilterReadings, Tangents]:
    """Readings and tangents to begin with: those of a solution of the same log, `warm`, or else
    along a path.

    resting: tangents stay where points move by less, rad · whole: for a smoother.
    """
    sightings = problem.evidence.sightings
    tangents = warm.tangents.copy_tangents(sightings) if warm else begin_along_path(problem)
    tangents.resting = resting
    tangents.whole = whole
    readings = lay_out_readings(problem)
    tangents.write_all_tangents(problem, readings)
    return readings, tangents


def sweep_log(
    problem: FilterProblem,
    readings: FilterReadings,
    keep: TraceDetail = TraceDetail.BELIEFS,
    into: FilterTrace | None = None,
) -> FilterTrace:
    """Filter the readings from the prior; DidNotConverge if rounding leaves no number."""
    start = build_state_prior(problem.start, problem.dynamics)
    trace = filter_readings(readings, problem.dynamics, *start, keep, into)
    if not np.isfinite(trace.end_p).all():
        raise DidNotConverge("rounding leaves no number")
    return trace


@dataclass(frozen=True, eq=False)
class SequentialPath:
    """What a pass over the log, instant by instant, leaves behind.

    points (E,M) rad: where frames were linearised · resets: times (R,) s of resets and their joints
    (R,M), or None · held (E,M) bool: joints silent for long · adrift: states after the instants at
    which images hardly determined some joints · moments (O,M): mean squares of the angles, from
    their usual mean, and of their derivatives, where encoders were read.
    """

    points: Array
    resets: tuple[Array, Array] | None
    held: Array
    adrift: dict[int, State]
    moments: Array | None


def find_initial_path(problem: FilterProblem, lost: bool = False) -> FilterProblem:
    """Add resets, and a path to linearise along first where
    encoders do not give one, or the belief is `lost`.
    """
    t = problem.timeline.t
    confirmed, resets = _confirm_start_by_encoders(problem)
    confirmed = confirmed and not lost
    if confirmed and not _has_long_silence(problem, t[-1:]):
        return replace(problem, resets=resets)
    problem = _with_silent_motion(problem)
    path = _step_through_log(problem, False, ROUGHLY_CONVERGED_MOVE)
    stepwise = (
        not confirmed
        or _has_long_silence(problem, t[:0])
        or len(path.adrift) > 0
        or problem.is_undetermined()
    )
    problem = replace(problem, path=(t, path.points), resets=path.resets, stepwise=stepwise)
    if problem.precision.learned is None:  # noise is not to be learned from the log
        return problem
    precision = replace(problem.precision, moments=path.moments)
    return _with_silent_motion(replace(problem, precision=precision))


def loses_encoder(problem: FilterProblem, solution: Solution) -> bool:
    """Whether the belief rejects an encoder for longer than LONG_SILENCE_S."""
    if problem.evidence.encoders is None:
        return False
    t = problem.evidence.encoders.t[:, None]
    read = np.isfinite(problem.evidence.encoders.values)
    # NaN where a smoother has removed a reading as an outlier
    d = np.abs(solution.trace.encoder_d[problem.timeline.encoders])
    accepted = d <= solution.readings.gate
    confirmed = np.maximum.accumulate(np.where(accepted, t, t[0]), axis=0)
    return bool((read & ~accepted & (t - confirmed > LONG_SILENCE_S)).any())


def _confirm_start_by_encoders(problem: FilterProblem) -> tuple[bool, tuple[Array, Array] | None]:
    """Whether each encoder soon confirms the belief that
    its first reading starts; and the resets until then.
    """
    encoders = problem.evidence.encoders
    t = problem.timeline.t
    soon = t[0] + LONG_SILENCE_S
    first = np.zeros((0, 1)) if encoders is None else encoders.values[encoders.t <= soon]
    testable = np.isfinite(first).sum(axis=0) > 1
    lost = dict[float, Array]()
    unsure = bool(testable.any())
    instants = int(np.searchsorted(t, soon, "right"))
    for state in _iterate_states(problem, False, CONVERGED_MOVE, instants):
        if state.lost is not None:
            lost[state.t] = state.lost
        unsure = unsure and not np.isfinite(state.confirmed_t)[testable].all()
        if not unsure:
            break
    return not unsure, _stack_resets(lost)


def _stack_resets(lost: dict[float, Array]) -> tuple[Array, Array] | None:
    """Times (R,) s and joints (R,M) bool of resets, from the joints by time; None without any."""
    return (np.array(list(lost)), np.array(list(lost.values()))) if lost else None


def _with_silent_motion(problem: FilterProblem) -> FilterProblem:
    """The problem with the motion of joints whose encoders are silent for long: a stationary one
    where images leave them open.

    A joint is as fast as its bursts. One whose encoder froze or died may be as fast as any joint,
    as this shows nothing but what it did before; and so may one that hardly moved, where images
    determine it and show whether it moves.
    """
    precision = problem.precision
    encoders = problem.evidence.encoders
    if precision.learned is not None and encoders is not None:
        bursts = measure_burst_factors(encoders, precision.order)
        fastest = (precision.process * bursts).max() / precision.process
        undetermined = find_joints_left_open(problem.timeline.t, problem.evidence, missing=1)
        hardly_moved = (fastest > HARDLY_MOVED * bursts) & ~undetermined.any(axis=0)
        bursts = np.where(hardly_moved | problem.evidence.stopped_encoders, fastest, bursts)
        precision = replace(precision, burst_factor=bursts)
    models = {sighting.name: sighting.model for sighting in problem.evidence.sightings}
    stationary = build_stationary_motion(models, problem.start, precision)
    return replace(problem, precision=precision, stationary=stationary)


def filter_sequentially(problem: FilterProblem, whole: bool = False) -> Solution:
    """The filter's solution; for the `whole` log all that the smoother needs."""
    path = _step_through_log(problem, whole, CONVERGED_MOVE)
    points = tuple(path.points[at] for at in problem.timeline.sightings)
    tangents = Tangents(problem.evidence.sightings, points)
    tangents.whole = whole
    readings = lay_out_readings(replace(problem, resets=path.resets), path.held)
    tangents.write_stale_tangents(problem, readings)
    for event, state in path.adrift.items():
        write_track_lines(event, state.lines or {}, readings)
    start = build_state_prior(problem.start, problem.dynamics)
    keep = TraceDetail.MEANS if whole else TraceDetail.BELIEFS
    trace = filter_readings(readings, problem.dynamics, *start, keep)
    for event, state in path.adrift.items():
        trace.nats[event] = state.nats
    return Solution(readings, tangents, trace)


def filter_roughly(
    problem: FilterProblem, warm: Solution | None = None, rest: float = ROUGHLY_CONVERGED_MOVE
) -> Solution:
    """The filter's solution, roughly; instant by instant
    where sweeps do not converge, as after a silence.
    """
    try:
        return solve_by_gauss_newton(problem, warm, rest=rest)
    except DidNotConverge:
        return filter_sequentially(problem)


def write_track_lines(event: int, lines: Mapping[int, Line], readings: FilterReadings) -> None:
    """Write the lines of tracks at one instant into the readings."""
    for track, line in lines.items():
        rows = len(line.y)
        readings.y[event, track, :rows] = line.y
        readings.jac[event, track, :rows] = line.jac
        readings.var[event, track, :rows] = line.var


def _has_long_silence(problem: FilterProblem, end: Array) -> bool:
    """Whether an encoder is silent for long; `end` (0 or 1,) s: end of the log, if that counts."""
    encoders = problem.evidence.encoders
    if encoders is None:
        return len(end) > 0
    known = [
        np.concatenate([problem.timeline.t[:1], encoders.t[np.isfinite(column)], end])
        for column in encoders.values.T
    ]
    return max(float(np.diff(times).max(initial=0.0)) for times in known) > LONG_SILENCE_S


def _step_through_log(problem: FilterProblem, whole: bool, rest: float) -> SequentialPath:
    """Filter the log instant by instant, for the smoother of the `whole` log or not.

    Each frame is linearised until its point moves by less than `rest` rad.
    """
    t = problem.timeline.t
    m = len(problem.start)
    size = problem.dynamics.order * m
    points = np.empty((len(t), m))
    means = np.empty((len(t), size))
    var = np.empty((len(t), size))
    held = np.zeros((len(t), m), bool)
    read = np.zeros(len(t), bool)
    lost = dict[float, Array]()
    adrift = dict[int, State]()
    for k, state in enumerate(_iterate_states(problem, whole, rest, len(t))):
        means[k] = state.z[:size]
        var[k] = state.p.diagonal()[:size]
        points[k] = means[k, :m] if state.point is None else state.point
        read[k] = state.t > t[0] + LONG_SILENCE_S and min(state.confirmed_t) == state.t
        if state.held is not None:
            held[k] = state.held
        if state.lost is not None:
            lost[state.t] = state.lost
        if state.lines is not None:
            adrift[k] = state
    usual = problem.start if problem.stationary is None else problem.stationary.mean
    moments = None
    if read.any():
        squares = np.square(means[read] - np.pad(usual, (0, size - m)))
        moments = (squares.mean(axis=0) + var[read].min(axis=0)).reshape(-1, m)
    return SequentialPath(points, _stack_resets(lost), held, adrift, moments)


def _iterate_states(
    problem: FilterProblem, whole: bool, rest: float, events: int
) -> Iterator[State]:
    """The states after the first `events` instants."""
    sequential = SequentialFilter(problem.dynamics, problem.posture_prior, rest)
    factors = problem.process_factor
    readings, var = (
        part.tolist() for part in build_encoder_rows(replace(problem, posture_prior=None), events)
    )
    state = sequential.build_first_state(problem.start)
    frames = group_frames_by_instant(problem, whole, events)
    for k, t in enumerate(problem.timeline.t[:events].tolist()):
        factor = None if factors is None else factors[k]
        try:
            state = sequential.filter_instant(
                state, t, readings[k], var[k], frames.get(k, {}), factor
            )
        except np.linalg.LinAlgError as error:
            raise np.linalg.LinAlgError(f"at {t:.3f} s {error}") from None
        yield state


def group_frames_by_instant(
    problem: FilterProblem, whole: bool, before: int
) -> dict[int, dict[int, PendingFrame]]:
    """Frames by instant, and by track, of the first `before` instants."""
    frames: dict[int, dict[int, PendingFrame]] = {}
    precision = problem.precision
    for track, (sighting, events) in enumerate(
        zip(problem.evidence.sightings, problem.timeline.sightings, strict=True)
    ):
        scale = precision.scale.get(sighting.name, 1.0)
        like = correlate_errors(precision, sighting.name, sighting.model, whole)
        values, var, mix = sighting.independent_rows
        early = sighting.values[: np.searchsorted(events, before)]
        for row in np.flatnonzero(find_finite_rows(early)):
            t = float(sighting.t[row])
            own = None if mix is None else mix[row]
            frame = PendingFrame(
                sighting.model, t, values[row], scale * var[row], like, LastFrame(), own
            )
            frames.setdefault(int(events[row]), {})[track] = frame
    return frames
