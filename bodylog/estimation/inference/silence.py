"""The smoother of a log whose encoders fall silent.

Frames that leave silent joints open are linearised over the smoothed belief. Over a
filter's, which is wide at the end of a silence, lines are coarse and may lead to
another posture. The smoother begins with the readings on both sides of a silence,
without its frames; then lines and path follow from each other until the path converges
(iterated posterior linearisation: García-Fernández, Svensson & Särkkä 2017). Two
postures may look the same and both converge, so a silence starts several times, through
the cubature points of its widest belief, and each path counts by its evidence.
A long silence has too many such paths. Where single postures look the same in it, the
smoother keeps the filter's lines, which are over a belief that holds all of them.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from ...types import Array
from ..noise.correlated_noise import LastFrame, PendingFrame
from .filter_log import filter_sequentially, group_frames_by_instant, write_track_lines
from .filter_pass import MAX_SWEEPS, ROUGHLY_CONVERGED_MOVE, TraceDetail, filter_readings
from .filter_problem import FilterProblem
from .leave_one_out import remove_readings
from .reacquisition import find_joints_left_open
from .sequential import linearise_over_belief
from .solution import Smooth, Solution, assemble_smooth
from .tangents import build_state_prior

BRIEF_SILENCE_S = 5.0
"""s: a longer silence starts once, as evidence of 40 sines with 10 s does not tell postures apart.
Readings within as long on either side weigh the paths of a shorter one."""

Frames = Mapping[int, Mapping[int, PendingFrame]]


def smooth_across_silence(problem: FilterProblem) -> Smooth:
    """Smooth along the filter's own lines, and open frames along lines over the smoothed belief.

    Residuals of lines last, so in the last pass they count as often as their silence has frames.
    Counted so before, images weigh too little to leave a wrong posture.
    """
    t = problem.timeline.t
    alone = _find_open_instants(problem)
    hidden = (alone[events] for events in problem.timeline.sightings)
    without_frames = remove_readings(problem, (np.array(False), *hidden))
    solution = _undo_resets(problem, filter_sequentially(without_frames, whole=True))
    for frames in _split_frames_by_silence(problem, alone):
        starts, sights = _start_from_cubature_points(problem, solution, frames)
        found = [_converge_belief(problem, start, sights) for start in starts]
        x, cov = _mix_beliefs(*map(np.stack, zip(*found, strict=True)))
        seconds = t[max(frames)] - t[min(frames)]
        count = len(frames) * BRIEF_SILENCE_S / max(seconds, BRIEF_SILENCE_S)
        _write_lines_over_beliefs(solution, frames, x, cov, count)
    return _smooth_readings(problem, solution)


def _find_open_instants(problem: FilterProblem) -> Array:
    """Instants (E,) bool of silences that images leave open, so that the filter's lines are too
    coarse: those that are short, or in which a continuum of postures looks the same.
    """
    t = problem.timeline.t
    alone = np.full(len(t), problem.is_undetermined(missing=1))
    held = problem.left_open
    if held is None:
        return alone
    undetermined = find_joints_left_open(t, problem.evidence, missing=1)
    for begin, end in _list_runs(np.asarray(held.any(axis=1))):
        is_short = t[end - 1] - t[begin] <= BRIEF_SILENCE_S
        alone[begin:end] |= is_short or undetermined[begin:end].any()
    return alone


def _list_runs(which: Array) -> list[tuple[int, int]]:
    """First and end index of each run of instants `which` (E,) bool."""
    edges = np.flatnonzero(np.diff(which, prepend=False, append=False))
    return [(int(begin), int(end)) for begin, end in edges.reshape(-1, 2)]


def _undo_resets(problem: FilterProblem, solution: Solution) -> Solution:
    """The solution without resets of joints after their
    silence, of which a smoother knows both sides.
    """
    reset = solution.readings.reset
    held = problem.left_open
    if reset is None or held is None:
        return solution
    return replace(solution, readings=replace(solution.readings, reset=reset & ~held))


def _split_frames_by_silence(problem: FilterProblem, alone: Array) -> Iterator[Frames]:
    """The frames of each run of instants `alone` (E,) bool, by instant and by track."""
    every = group_frames_by_instant(problem, True, len(alone)) if alone.any() else {}
    for begin, end in _list_runs(alone):
        frames = {k: every[k] for k in range(begin, end) if k in every}
        if frames:
            yield frames


def _start_from_cubature_points(
    problem: FilterProblem, solution: Solution, frames: Frames
) -> tuple[list[Solution], Frames]:
    """A silence started through each cubature point, or once, and its frames by instant from
    there.
    """
    t = problem.timeline.t
    at = list(frames)
    begin = t[at[0]]
    end = t[at[-1]]
    first, last = np.searchsorted(t, [begin - BRIEF_SILENCE_S, end + BRIEF_SILENCE_S])
    silent = replace(
        solution, readings=solution.readings.select_instants(first, last).copy_tracks()
    )
    sights = {k - first: frames[k] for k in at}
    if end - begin > BRIEF_SILENCE_S:
        return [silent], sights
    x, cov, _ = _smooth_frames(problem, silent, sights)
    widest = int(np.linalg.det(cov).argmax())
    starts = []
    for point in _compute_cubature_points(x[widest], cov[widest]).T:
        through = _with_point_reading(silent, at[widest] - first, point, problem.precision.encoder)
        start = replace(silent, readings=silent.readings.copy_tracks())
        _write_lines_over_beliefs(start, sights, *_smooth_frames(problem, through, sights)[:2])
        starts.append(start)
    return starts, sights


def _compute_cubature_points(x: Array, cov: Array) -> Array:
    """The mean x (M,) and the cubature points of cov (M,M), in columns (M,1+2M)."""
    var, axes = np.linalg.eigh(cov)
    steps = axes * np.sqrt(len(x) * np.maximum(var, 0.0))
    return np.asarray(x[:, None] + np.hstack([np.zeros((len(x), 1)), steps, -steps]))


def _with_point_reading(solution: Solution, at: int, point: Array, var: Array) -> Solution:
    """The solution with encoders that read a point (M,) at an instant, with variances var (M,)."""
    readings = solution.readings
    encoders = readings.encoders.copy()
    noise = readings.encoder_var.copy()
    encoders[at] = point
    noise[at] = var
    return replace(
        solution, readings=replace(readings, encoders=encoders, encoder_var=noise, gate=np.inf)
    )


def _converge_belief(
    problem: FilterProblem, solution: Solution, frames: Frames
) -> tuple[Array, Array, Array]:
    """Belief x (F,M), cov (F,M,M) whose lines lead to itself, and its nats (), along the readings
    of a silence.
    """
    before = np.array(np.inf)
    for _ in range(MAX_SWEEPS):
        x, cov, nats = _smooth_frames(problem, solution, frames)
        std = np.sqrt(np.einsum("fii->fi", cov))
        if (np.abs(x - before) < ROUGHLY_CONVERGED_MOVE * std).all():
            break
        _write_lines_over_beliefs(solution, frames, x, cov)
        before = x
    return x, cov, nats


def _mix_beliefs(x: Array, cov: Array, nats: Array) -> tuple[Array, Array]:
    """Mean (F,M) and covariance (F,M,M) of C beliefs, weighed by their nats (C,)."""
    share = np.exp(nats.min() - nats)
    share /= share.sum()
    mean = np.einsum("c,cfm->fm", share, x)
    off = x - mean
    return mean, np.einsum("c,cfmn->fmn", share, cov + off[..., None] * off[..., None, :])


def _smooth_frames(
    problem: FilterProblem, solution: Solution, frames: Frames
) -> tuple[Array, Array, Array]:
    """Smoothed beliefs x (F,M), cov (F,M,M) at the frames of a silence, and nats () of its
    readings.
    """
    path = _smooth_readings(problem, solution)
    at = np.array(list(frames))
    m = len(problem.start)
    return path.z[at, :m], path.cov[at, :m, :m], path.trace.nats.sum()


def _write_lines_over_beliefs(
    solution: Solution, frames: Frames, x: Array, cov: Array, count: float = 1.0
) -> None:
    """Write lines of frames at F instants over beliefs x (F,M) of cov (F,M,M) into a solution's
    readings; residuals count as noise `count` times.
    """
    last = dict[int, LastFrame]()
    for (k, sights), mean, spread in zip(frames.items(), x, cov, strict=True):
        sights = {
            track: replace(sight, memory=last.get(track, sight.memory))
            for track, sight in sights.items()
        }
        lines = {
            track: linearise_over_belief(sight, mean, spread, count)
            for track, sight in sights.items()
        }
        last |= {track: line.memory for track, line in lines.items()}
        write_track_lines(k, lines, solution.readings)


def _smooth_readings(problem: FilterProblem, solution: Solution) -> Smooth:
    """The smoothed log of a solution's readings."""
    start = build_state_prior(problem.start, problem.dynamics)
    trace = filter_readings(solution.readings, problem.dynamics, *start, TraceDetail.MEANS)
    return assemble_smooth(solution.readings, solution.tangents, trace, problem.dynamics)
