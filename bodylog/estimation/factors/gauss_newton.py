"""Rounds of linearising and solving: the smoother about
the smoothed path, the filter about the filtered one.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from ...types import Array
from ..faults.threshold import EVIDENCE_THRESHOLD_NATS
from ..inference.filter_pass import ROUGHLY_CONVERGED_MOVE
from ..measurements.arm_errors import LEAST_PLAY, NOISE_SIGMAS, follow_slack
from ..measurements.records import interpolate_values
from .columns import Path, Play
from .elimination import Eliminated, Marginals, System, eliminate_states, filter_knots, smooth_knots
from .factor_problem import FactorProblem, Linearised, Noise, build_system, linearise_problem

ROUNDS = 12
"""Rounds at most. Smoothers settle after 2 to 4; with 25, a filter moves angles of a drawn log with
play by 1.4e-4 standard deviations at most.
"""
GUESSED_STD = 1e-3
"""rad: how well the readings tell the motors' angles, before a solution tells it."""


@dataclass(frozen=True, eq=False)
class Solution:
    """A solved problem: how it was linearised, its factors, and the beliefs."""

    linear: Linearised
    system: System
    eliminated: Eliminated
    beliefs: Marginals

    @property
    def nats(self) -> float:
        """−ln p of all measurements, about this path."""
        return self.eliminated.nats


def guess_path(problem: FactorProblem) -> Path:
    """The readings at the knots, the start where there are none."""
    read = interpolate_values(problem.t, problem.values, problem.knots)
    angles = np.where(np.isfinite(read), read, problem.start)
    rates = (
        np.gradient(angles, problem.knots, axis=0) if len(angles) > 1 else np.zeros(angles.shape)
    )
    unsure = np.full(len(problem.start), NOISE_SIGMAS * GUESSED_STD)
    halves = _list_half_plays(problem, [column.mean for column in problem.columns])
    return Path(problem.knots, angles, rates, angles, follow_slack(angles, halves, unsure))


def _list_half_plays(problem: FactorProblem, sizes: Iterable[float]) -> Array:
    """Half of each joint's play (M,) rad, by the columns' sizes."""
    half = np.full(len(problem.start), LEAST_PLAY)
    for column, size in zip(problem.columns, sizes, strict=True):
        if isinstance(column, Play):
            half[column.joint] = max(size, LEAST_PLAY)
    return half


def path_from_beliefs(problem: FactorProblem, noise: Noise, beliefs: Marginals) -> Path:
    """The path that beliefs give."""
    joints = noise.joints
    states = beliefs.split_joints(joints)
    angles = states[..., 0]
    links = angles + (0.0 if joints.error is None else states[..., -1] * joints.at_link)
    unsure = NOISE_SIGMAS * np.sqrt(np.median(beliefs.list_angle_variances(joints), axis=0))
    halves = _list_half_plays(problem, beliefs.sizes[-1].tolist())
    slack = follow_slack(angles, halves, unsure)
    path = Path(problem.knots, angles, states[..., 1], links, slack)
    for c, column in enumerate(problem.columns):
        if column.bends:
            links = links + column.moves_links(path) * beliefs.sizes[:, c, None]
    return replace(path, links=links)


def solve_problem(
    problem: FactorProblem,
    noise: Noise,
    path: Path | None = None,
    causal: bool = False,
    rounds: int = ROUNDS,
) -> Solution:
    """Linearise and solve until the links rest, or what is measured is evidently less likely than
    in a round before; `causal`: by what was known at each knot.

    Rounds of a filter may lead away from its solution: where images tell more of a motor than its
    encoder does, a link that lies otherwise within its play moves the motor, which moves the link.
    """
    path = guess_path(problem) if path is None else path
    best: Solution | None = None
    for _ in range(rounds):
        linear = linearise_problem(problem, path, noise)
        system = build_system(linear)
        eliminated = eliminate_states(system)
        beliefs = filter_knots(system, eliminated) if causal else smooth_knots(system, eliminated)
        found = Solution(linear, system, eliminated, beliefs)
        if best is not None and found.nats > best.nats + EVIDENCE_THRESHOLD_NATS:
            return best
        if best is None or found.nats < best.nats:
            best = found
        after = path_from_beliefs(problem, noise, beliefs)
        var = beliefs.list_angle_variances(noise.joints)
        moved = np.square(after.links - path.links) / var
        if np.sqrt(moved.max()) < ROUGHLY_CONVERGED_MOVE:
            break
        path = after
    return found
