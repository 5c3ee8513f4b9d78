"""The smoother of a log whose encoders fall silent.

Frames that leave silent joints open are linearised over the smoothed belief. Over a filter's, which is wide at the end
of a silence, lines are coarse and may lead to another posture. The smoother begins with the readings on both sides of a
silence, without its frames; then lines and path follow from each other until the path converges (iterated posterior
linearisation: García-Fernández, Svensson & Särkkä 2017).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...types import Array
from ..noise.correlated_noise import LastFrame, PendingFrame
from .convergence import ROUGHLY, SWEEPS
from .initial_path import priors
from .instant import line_over
from .leave_one_out import without
from .problem import Problem
from .scan import Keep, scan
from .solution import Smooth, Solution, completed
from .walk import frames_by_instant, walk, write


def smoothed(problem: Problem) -> Smooth:
    """Smooth along the filter's own tangents, and open frames along lines over the smoothed belief.

    Residuals of lines last, so in the last pass they count as often as there are frames. Counted so before, images
    weigh too little to leave a wrong posture.
    """
    hidden, m, before = _open(problem), len(problem.start), np.array(np.inf)
    solution = walk(without(problem, (np.array(False), *hidden)), whole=True)
    solution, frames = _across_silences(problem, solution), _frames(problem, hidden)
    at = list(frames)
    for _ in range(SWEEPS):
        path = _passed(problem, solution)
        x, cov = path.z[at, :m, 0], path.cov[at, :m, :m, 0]
        if (np.abs(x - before) < ROUGHLY * np.sqrt(np.einsum("eii->ei", cov))).all():
            break
        _draw(solution, frames, x, cov)
        before = x
    if not frames:
        return path
    _draw(solution, frames, x, cov, float(len(frames)))
    return _passed(problem, solution)


def _open(problem: Problem) -> tuple[Array, ...]:
    """Frames (F,) bool of each sighting that leave silent joints open."""
    open_at = np.zeros(len(problem.timeline.t), bool)
    if problem.held is not None:
        open_at |= problem.held.any(axis=1)
    return tuple(open_at[events] for events in problem.timeline.sightings)


def _across_silences(problem: Problem, solution: Solution) -> Solution:
    """The solution without resets of joints after their silence, of which a smoother knows both sides."""
    reset, held = solution.readings.reset, problem.held
    if reset is None or held is None:
        return solution
    return replace(solution, readings=replace(solution.readings, reset=reset & ~held[..., None]))


def _frames(problem: Problem, hidden: Sequence[Array]) -> dict[int, dict[int, PendingFrame]]:
    """The `hidden` frames by instant, and by track."""
    at = {k for events, some in zip(problem.timeline.sightings, hidden, strict=True) for k in events[some].tolist()}
    every = frames_by_instant(problem, True, len(problem.timeline.t)) if at else {}
    return {k: every[k] for k in sorted(at & every.keys())}


def _draw(
    solution: Solution, frames: Mapping[int, Mapping[int, PendingFrame]], x: Array, cov: Array, often: float = 1.0
) -> None:
    """Write lines of frames at F instants over beliefs x (F,M) of cov (F,M,M) into a solution's readings."""
    last = dict[int, LastFrame]()
    for (k, sights), mean, spread in zip(frames.items(), x, cov, strict=True):
        sights = {track: replace(sight, memory=last.get(track, sight.memory)) for track, sight in sights.items()}
        lines = {track: line_over(sight, mean, spread, often) for track, sight in sights.items()}
        last |= {track: line.memory for track, line in lines.items()}
        write(np.array([k]), lines, solution.fold, solution.readings)


def _passed(problem: Problem, solution: Solution) -> Smooth:
    """The smoothed log of a solution's readings, in one stretch."""
    trace = scan(solution.readings, problem.dynamics, *priors(problem, solution.fold), Keep.MEANS)
    ends = np.zeros((problem.dynamics.size, 1))
    return completed(solution.fold, solution.readings, solution.tangents, trace, ends, problem.dynamics)
