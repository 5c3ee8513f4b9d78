"""Filter and smoother of a log whose encoders are never silent: one banded solve, noise and offsets by evidence."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...body_model import BodyModel
from ...settings import Estimation
from ...types import Array, Estimate, Fault
from ..faults import encoder_offset
from ..inference.assemble import Assumed, assemble, initial_states
from ..inference.beliefs import Instants, given_all, given_past
from ..inference.motion_model import MotionModel
from ..inference.offsets import Offsets, evidence, offsets
from ..inference.problem import Problem
from ..inference.solver import Solved, solve
from ..noise.encoder_noise import Learned
from ..noise.noise_model import NoiseModel
from ..noise.own_noise import OwnNoise, own_noise
from . import results
from .results import Beliefs

IMAGED = 0.7
"""Factor on the white jerk learned from encoders alone, for logs with images.

The evidence of all senses is greatest at 0.5 to 0.6 in simulated reaches and at 0.6 to 0.7 in simulated babble.
"""


@dataclass(frozen=True, eq=False)
class Answer:
    """Offsets with the solution, the motion, nats of the orders tried, variance factors of tracks."""

    found: Offsets
    motion: Learned
    orders: Mapping[int, float]
    scale: Mapping[str, float]


def possible(problem: Problem, settings: Estimation) -> bool:
    """Whether encoders are never silent, so that no re-acquisition is needed, and noise is learned from the log."""
    led = (
        problem.path is not None or problem.resets is not None or problem.stepwise or problem.posture_prior is not None
    )
    # set variances and images still need the sweeps: with images, error bars here are up to a tenth too wide
    other = bool(settings.typed) or bool(problem.evidence.sightings)
    return settings.precision == "auto" and problem.precision.white is not None and not led and not other


def estimate(
    method: str, body: BodyModel, problem: Problem, settings: Estimation, faults: tuple[Fault, ...]
) -> Estimate:
    """The filtered or smoothed belief; DidNotConverge if the solver does not converge."""
    smooth = method == "smoother"
    answer = solved(body, problem, settings, smooth)
    at = (given_all if smooth else given_past)(answer.found.solved)
    walk = answer.found.walk if answer.found.walk.any() else None
    known = replace(
        problem, precision=replace(problem.precision, drift=walk), alternatives=_named(answer.found.alternatives)
    )
    drifting = () if walk is None else encoder_offset.faults(known, body.joints, at.offset, at.offset_var, faults)
    beliefs = Beliefs(
        _states(at, walk), at.cov, at.nats, at.before, at.before_cov, at.error, answer.scale,
        _plain(answer, body, problem.precision), drifting,
    )  # fmt: skip
    return results.estimate(method, body, problem.evidence, problem.timeline, beliefs)


def solved(body: BodyModel, problem: Problem, settings: Estimation, smooth: bool) -> Answer:
    """Solve the log, with noise, the motion's order and offsets by its evidence."""
    explored = np.array(body.noise.encoder, float)
    assert problem.precision.white is not None
    noise = own_noise(problem.evidence, problem.precision.white, explored)
    if problem.evidence.sightings and noise.jerk is not None:
        noise = replace(noise, jerk=replace(noise.jerk, process=IMAGED * noise.jerk.process))
    walk = np.zeros(len(explored)) if problem.precision.drift is None else np.array(problem.precision.drift, float)
    first = noise.preferred if noise.jerk is None or not problem.evidence.sightings else noise.jerk
    found, motion, orders = _ordered(problem, noise, first, explored, walk, smooth)
    given = Offsets(found, walk, np.zeros(len(walk)))
    if settings.bias == "auto" and any(one.name != "touch" for one in problem.evidence.sightings):
        given = offsets(found, walk, encoder_offset.smallest_fault(problem.evidence.encoders), smooth)
    return Answer(given, motion, orders, noise.scale)


def _ordered(
    problem: Problem, noise: OwnNoise, first: Learned, explored: Array, walk: Array, smooth: bool
) -> tuple[Solved, Learned, dict[int, float]]:
    """The log solved for the order of motion with the greater evidence, that motion, and the orders' nats."""
    solution = _solution(problem, noise, first, explored, walk, smooth)
    if noise.jerk is None:
        return solution, first, {}
    if not problem.evidence.sightings:
        return solution, first, {2: -noise.acceleration.evidence, 3: -noise.jerk.evidence}
    other = noise.acceleration
    orders = {3: evidence(solution), 2: evidence(solution, MotionModel(2, other.process, walk if walk.any() else None))}
    if orders[2] < orders[3]:
        return _solution(problem, noise, other, explored, walk, smooth), other, orders
    return solution, first, orders


def _solution(problem: Problem, noise: OwnNoise, motion: Learned, explored: Array, walk: Array, smooth: bool) -> Solved:
    log = assemble(problem.evidence, problem.timeline, problem.start, _assumed(noise, motion, explored, walk))
    return solve(log, initial_states(log), smooth)


def _assumed(noise: OwnNoise, motion: Learned, explored: Array, walk: Array) -> Assumed:
    model = MotionModel(motion.order, motion.process, walk if walk.any() else None)
    return Assumed(motion.encoder, model, noise.scale, explored)


def _states(at: Instants, walk: Array | None) -> Array:
    """Angles, rates and, if there are any, offsets (E,·)."""
    parts = [at.states[:, :, 0], at.states[:, :, 1]]
    return np.concatenate(parts if walk is None else [*parts, np.where(walk > 0.0, at.states[:, :, -1], 0.0)], axis=1)


def _named(alternatives: Mapping[int, tuple[int, ...]]) -> dict[int, tuple[int, ...]]:
    return {joint: others for joint, others in alternatives.items() if others}


def _plain(answer: Answer, body: BodyModel, white: NoiseModel) -> dict[str, Any]:
    """Plain numbers for the estimate's settings: `nats` for hypotheses, `live` for a live filter."""
    drift = answer.found.walk.tolist() if answer.found.walk.any() else None
    won = {f"offset/{name}": float(gain) for name, gain in zip(body.joints, answer.found.won, strict=True)}
    if len(answer.orders) > 1:
        won["order/3"] = answer.orders[2] - answer.orders[3]
    return {
        "order": answer.motion.order, "encoder": answer.motion.encoder.tolist(), "drift": drift,
        "process": answer.motion.process.tolist(), "scale": dict(answer.scale),
        "nats": {name: gain for name, gain in won.items() if np.isfinite(gain) and gain != 0.0},
        "live": white.plain(),
    }  # fmt: skip
