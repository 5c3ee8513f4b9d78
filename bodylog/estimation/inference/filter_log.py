"""The filter of a whole log: belief over angles and rates, Gauss–Newton to convergence at every
instant.

Under the Laplace approximation this is an iterated extended Kalman filter. Each sweep linearises
all frames, and filters all stretches of the log side by side from the ends of their predecessors.
Sweeps repeat until neither the linearisation points nor the starts move: the fixed point is the
sequential filter's solution. Where encoders do not determine the arm, sweeps may not converge: the
filter then takes one instant after the other, which is slower but robust.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ...types import Array
from ..noise.correlated_noise import ErrorCorrelation, LastFrame, PendingFrame, correlation_length
from ..noise.posture_prior import build_stationary_motion
from .filter_problem import FilterProblem, Fold, choose_fold, encoder_rows, fold_readings
from .reacquisition import LONG_SILENCE_S
from .scan import (
    CONVERGED_MOVE,
    MAX_SWEEPS,
    ROUGHLY_CONVERGED_MOVE,
    DidNotConverge,
    FilterReadings,
    TraceDetail,
    filter_stretches,
    measure_farthest_move,
    require_finite,
)
from .sequential import Line, SequentialFilter, State
from .solution import Solution
from .tangents import Tangents, hand_over_starts, initial_tangents, stretch_priors


def solve_by_gauss_newton(
    problem: FilterProblem,
    warm: Solution | None = None,
    at: str = "posterior",
    rest: float = CONVERGED_MOVE,
) -> Solution:
    """The sequential filter's fixed point; frames are linearised
    at the `posterior` (iterated) or the `prior` mean.

    `warm` is a solution of the same log to start from;
    `rest`: tolerance on starts, in standard deviations.
    """
    fold = choose_fold(len(problem.timeline.t))
    tangents, z, p = initial_sweep(problem, fold, warm)
    tangents.resting = rest
    tangents.whole = False
    readings = fold_readings(problem, fold)
    trace = None
    move = np.inf
    tangents.write(problem, fold, readings)
    for _ in range(MAX_SWEEPS):
        moved = tangents.draw(problem, fold, readings)
        if trace is not None and move < rest and not moved:
            return Solution(fold, readings, tangents, trace)
        trace = filter_stretches(readings, problem.dynamics, z, p, into=trace)
        tangents.follow(problem, fold, trace.prior if at == "prior" else trace.z)
        next_z, next_p = hand_over_starts(z, p, trace.z[-1], trace.end_p)
        move = require_finite(measure_farthest_move(z, p, next_z, next_p))
        z = next_z
        p = next_p
    raise DidNotConverge(f"filter: no rest after {MAX_SWEEPS} sweeps, last move {move:.2g}")


def initial_sweep(
    problem: FilterProblem, fold: Fold, warm: Solution | None
) -> tuple[Tangents, Array, Array]:
    """Tangents and starts to begin with: from the encoders alone, or from the solution `warm`."""
    if warm is None:
        return initial_tangents(problem, fold)
    return warm.tangents.again(problem.evidence.sightings), *starts_from_solution(
        problem, fold, warm
    )


def starts_from_solution(
    problem: FilterProblem, fold: Fold, known: Solution
) -> tuple[Array, Array]:
    """Each stretch's start z (K,C), p (K,K,C) from a
    solution of the same log; new offsets from the prior.
    """
    z, p = stretch_priors(problem, fold)
    lasts = fold.lasts()
    k = min(len(z), known.trace.z.shape[1])
    z[:k, 1:] = known.fold.pick(known.trace.z, lasts)[:, :k].T
    if known.fold == fold:
        p[:k, :k, 1:] = known.trace.end_p[:k, :k, :-1]
    return z, p


@dataclass(frozen=True, eq=False)
class SequentialPath:
    """The filtered log: points (E,M) rad of linearisation,
    starts z (K,C), p (K,K,C) of a fold's stretches.

    resets: times (R,) s of resets and their joints (R,M), or None · held (E,M) bool: joints silent
    for long · adrift: by instant where images hardly determined some joints, the lines of its
    tracks, and nats · moments (O,M): mean squares of the angles, from their usual mean, and of
    their derivatives, where encoders were read.
    """

    points: Array
    z: Array
    p: Array
    resets: tuple[Array, Array] | None
    held: Array
    adrift: dict[int, State]
    moments: Array | None


def find_initial_path(problem: FilterProblem, lost: bool = False) -> FilterProblem:
    """Add resets, and a path to linearise along first where
    encoders do not give one, or the belief is `lost`.
    """
    line = problem.timeline.t
    confirmed, resets = _encoders_confirm_start(problem)
    confirmed = confirmed and not lost
    if confirmed and not _has_long_silence(problem, line[-1:]):
        return replace(problem, resets=resets)
    problem = _with_stationary(problem)
    whole = _step_through_log(problem, False, ROUGHLY_CONVERGED_MOVE, _single_stretch(len(line)))
    stepwise = (
        not confirmed
        or _has_long_silence(problem, line[:0])
        or len(whole.adrift) > 0
        or problem.is_undetermined
    )
    problem = replace(problem, path=(line, whole.points), resets=whole.resets, stepwise=stepwise)
    if problem.precision.learned is None:  # noise is not to be learned from the log
        return problem
    return _with_stationary(
        replace(problem, precision=replace(problem.precision, moments=whole.moments))
    )


def loses_encoder(problem: FilterProblem, solution: Solution) -> bool:
    """Whether the belief rejects an encoder for longer than LONG_SILENCE_S."""
    if problem.evidence.encoders is None:
        return False
    t = problem.evidence.encoders.t[:, None]
    read = np.isfinite(problem.evidence.encoders.values)
    # NaN where a smoother has removed a reading as an outlier
    d = np.abs(solution.fold.unfold(solution.trace.encoder_d)[problem.timeline.encoders])
    accepted = d <= solution.readings.gate
    confirmed = np.maximum.accumulate(np.where(accepted, t, t[0]), axis=0)
    return bool((read & ~accepted & (t - confirmed > LONG_SILENCE_S)).any())


def _encoders_confirm_start(problem: FilterProblem) -> tuple[bool, tuple[Array, Array] | None]:
    """Whether each encoder soon confirms the belief that
    its first reading starts; and the resets until then.
    """
    encoders = problem.evidence.encoders
    line = problem.timeline.t
    soon = (
        np.zeros((0, 1))
        if encoders is None
        else encoders.values[encoders.t <= line[0] + LONG_SILENCE_S]
    )
    often = np.isfinite(soon).sum(axis=0) > 1
    lost = dict[float, Array]()
    unsure = bool(often.any())
    for state in _iterate_states(
        problem,
        False,
        CONVERGED_MOVE,
        int(np.searchsorted(line, line[0] + LONG_SILENCE_S, "right")),
    ):
        if state.lost is not None:
            lost[state.t] = state.lost
        unsure = unsure and not np.isfinite(state.borne)[often].all()
        if not unsure:
            break
    return not unsure, _stack_resets(lost)


def _stack_resets(lost: dict[float, Array]) -> tuple[Array, Array] | None:
    return (np.array(list(lost)), np.array(list(lost.values()))) if lost else None


def _with_stationary(problem: FilterProblem) -> FilterProblem:
    """The problem with the stationary motion of joints whose encoders are silent for long."""
    models = {sighting.name: sighting.model for sighting in problem.evidence.sightings}
    return replace(
        problem, stationary=build_stationary_motion(models, problem.start, problem.precision)
    )


def filter_sequentially(problem: FilterProblem, whole: bool = False) -> Solution:
    """The filter's solution; for the `whole` log in
    one single stretch, and all that the smoother needs.
    """
    events = len(problem.timeline.t)
    keep = TraceDetail.MEANS if whole else TraceDetail.BELIEFS
    fold = _single_stretch(events) if whole else choose_fold(events)
    found = _step_through_log(problem, whole, CONVERGED_MOVE, fold)
    tangents = Tangents(
        problem.evidence.sightings, tuple(found.points[rows] for rows in problem.timeline.sightings)
    )
    tangents.whole = whole
    readings = fold_readings(replace(problem, resets=found.resets), fold, found.held)
    tangents.draw(problem, fold, readings)
    for at, state in found.adrift.items():
        write_lines(np.array([at]), state.lines or {}, fold, readings)
    trace = filter_stretches(readings, problem.dynamics, found.z, found.p, keep)
    fold.put(
        trace.nats,
        np.array([*found.adrift], int),
        np.array([state.nats for state in found.adrift.values()]),
    )
    return Solution(fold, readings, tangents, trace)


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


def write_lines(at: Array, lines: Mapping[int, Line], fold: Fold, readings: FilterReadings) -> None:
    """Write the lines of tracks at one instant (1,) into the readings."""
    for track, line in lines.items():
        for folded, row in (
            (readings.y, line.y),
            (readings.jac, line.jac),
            (readings.var, line.var),
        ):
            fold.put(folded[:, track, : len(row)], at, row[None])


def _single_stretch(events: int) -> Fold:
    """One single stretch."""
    return Fold(events, events, 1)


def _has_long_silence(problem: FilterProblem, end: Array) -> bool:
    """Whether an encoder is silent for long; `end` (0 or 1,) s: end of the log, if that counts."""
    encoders = problem.evidence.encoders
    line = problem.timeline.t
    if encoders is None:
        return len(end) > 0
    known = [
        np.concatenate([line[:1], encoders.t[np.isfinite(column)], end])
        for column in encoders.values.T
    ]
    return max(float(np.diff(times).max(initial=0.0)) for times in known) > LONG_SILENCE_S


def _step_through_log(
    problem: FilterProblem, whole: bool, rest: float, fold: Fold
) -> SequentialPath:
    """Filter the log, each frame linearised until it moves less than `rest` standard deviations."""
    line = problem.timeline.t
    m = len(problem.start)
    size = problem.dynamics.order * len(problem.start)
    points = np.empty((len(line), m))
    means = np.empty((len(line), size))
    var = np.empty((len(line), size))
    held = np.zeros((len(line), m), bool)
    read = np.zeros(len(line), bool)
    lost = dict[float, Array]()
    adrift = dict[int, State]()
    z, p = stretch_priors(problem, fold)
    for k, state in enumerate(_iterate_states(problem, whole, rest, len(line))):
        if (k + 1) % fold.length == 0 and k + 1 < len(line):
            z[:, (k + 1) // fold.length] = state.z
            p[..., (k + 1) // fold.length] = state.p
        means[k] = state.z[:size]
        var[k] = state.p.diagonal()[:size]
        points[k] = means[k, :m] if state.point is None else state.point
        read[k] = state.t > line[0] + LONG_SILENCE_S and min(state.borne) == state.t
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
    return SequentialPath(points, z, p, _stack_resets(lost), held, adrift, moments)


def _iterate_states(
    problem: FilterProblem, whole: bool, rest: float, events: int
) -> Iterator[State]:
    """The states after the first `events` instants."""
    steps = SequentialFilter(problem.dynamics, problem.posture_prior, rest)
    more = problem.process_factor
    readings, var = (
        part.tolist() for part in encoder_rows(replace(problem, posture_prior=None), events)
    )
    state = steps.first(problem.start)
    sights = frames_by_instant(problem, whole, events)
    for k, t in enumerate(problem.timeline.t[:events].tolist()):
        try:
            state = steps.step(
                state, t, readings[k], var[k], sights.get(k, {}), None if more is None else more[k]
            )
        except np.linalg.LinAlgError as error:
            raise np.linalg.LinAlgError(f"at {t:.3f} s {error}") from None
        yield state


def frames_by_instant(
    problem: FilterProblem, whole: bool, before: int
) -> dict[int, dict[int, PendingFrame]]:
    """Frames by instant, and by track, of the first `before` instants."""
    found: dict[int, dict[int, PendingFrame]] = {}
    precision = problem.precision
    line = problem.timeline
    for track, (sighting, events) in enumerate(
        zip(problem.evidence.sightings, line.sightings, strict=True)
    ):
        scale = precision.scale.get(sighting.name, 1.0)
        near = precision.near.get(sighting.name, 0.0)
        like = ErrorCorrelation(
            precision.process,
            correlation_length(sighting.model),
            near,
            whole,
            order=precision.order,
        )
        values, var, mix = sighting.independent_rows
        for row in np.flatnonzero(
            np.isfinite(sighting.values[: np.searchsorted(events, before)]).all(axis=1)
        ):
            t = float(sighting.t[row])
            own = None if mix is None else mix[row]
            frame = PendingFrame(
                sighting.model, t, values[row], scale * var[row], like, LastFrame(), own
            )
            found.setdefault(int(events[row]), {})[track] = frame
    return found
