"""What explains a log: white noise alone, errors that last, play, and columns beside them, each by its evidence."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..faults.threshold import NATS
from .columns import Column, Path, Play, RowTime
from .gauss_newton import path_of, solve
from .noise import Learned, learn_noise
from .problem import FactorProblem, Noise

FIRST_STD = 1e-3
"""rad: σ of a lasting error with which the search begins."""
FIRST_S = 1.0
PLAY_STD = 0.01
"""rad: prior standard deviation of half a play, 1.1° of play."""
ROW_TIME_STD = 0.03
"""s: of a picture's row time; most pictures take less than 1/30 s."""


@dataclass(frozen=True)
class Explanation:
    """A log explained: its columns, and noise, path and sizes with most evidence.

    nats: gain over white noise alone · lasting: gain by errors that last, beside the columns · gains {column: nats}.
    """

    columns: tuple[Column, ...]
    learned: Learned
    nats: float
    lasting: float
    gains: Mapping[str, float]

    @property
    def lasts(self) -> bool:
        """Whether errors that last win over none, beside the columns."""
        return self.lasting > NATS

    @property
    def settled_columns(self) -> tuple[Column, ...]:
        """The columns about the sizes that the log gives, as its noise is what the log gives."""
        stds = np.sqrt(np.diag(self.learned.sizes_cov))
        each = zip(self.columns, self.learned.sizes.tolist(), stds.tolist(), strict=True)
        return tuple(replace(column, mean=size, std=std) for column, size, std in each)


def explain(problem: FactorProblem, noise: Noise, step_s: float) -> Explanation | None:
    """The most probable explanation of a log by errors of its hardware; None where white noise explains it as well.

    noise: white noise alone, with the offsets that are known · step_s: the encoders' usual step.
    """
    white = _learn(problem, noise, step_s)
    lasting = _best([_learn(problem, one, step_s) for one in _lasting(white.noise)])
    if white.nats - lasting.nats <= NATS:
        return None
    gains: dict[str, float] = {}
    play = tuple(Play("play", PLAY_STD, joint=j) for j in range(len(problem.start)))
    loose = replace(problem, columns=(*problem.columns, *play))
    stiff = _learn(loose, white.noise, step_s)
    loosely = _best([stiff, *(_learn(loose, one, step_s, stiff.path) for one in _lasting(white.noise))])
    without = white
    if lasting.nats - loosely.nats > NATS:
        gains["play"] = lasting.nats - loosely.nats
        problem, lasting, without = loose, loosely, stiff
    rolling = replace(problem, columns=(*problem.columns, RowTime("row time", ROW_TIME_STD)))
    rolled = _learn(rolling, lasting.noise, step_s, lasting.path)
    if lasting.nats - rolled.nats > NATS:
        gains["row time"] = lasting.nats - rolled.nats
        without = _learn(rolling, without.noise, step_s, without.path)
        problem, lasting = rolling, rolled
    gained = white.nats - lasting.nats
    return Explanation(problem.columns, lasting, gained, without.nats - lasting.nats, gains)


def _best(found: Sequence[Learned]) -> Learned:
    """The one with most evidence."""
    return min(found, key=lambda one: one.nats)


def _lasting(noise: Noise) -> tuple[Noise, Noise]:
    """The noise with errors that last, at the encoders and at the links."""
    joints = noise.joints
    given = np.zeros(len(joints.white)) if joints.error is None else joints.error
    error = np.where(joints.learned, FIRST_STD, given)
    seconds = np.where(joints.learned, FIRST_S, joints.seconds)
    own = replace(joints, error=error, seconds=seconds)
    at_link = replace(own, at_link=joints.learned)
    return replace(noise, joints=own), replace(noise, joints=at_link)


def _learn(problem: FactorProblem, noise: Noise, step_s: float, path: Path | None = None) -> Learned:
    """Noise by evidence, from the path that this noise gives."""
    solution = solve(problem, noise, path)
    return learn_noise(problem, noise, path_of(problem, noise, solution.beliefs), step_s)
