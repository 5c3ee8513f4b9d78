"""Filter and smoother of a log whose encoders are never silent: one banded solve, with noise by evidence."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...body_model import BodyModel
from ...settings import Estimation
from ...types import Array, Estimate, Fault
from ..faults import encoder_offset
from ..inference.assemble import assemble, initial_states
from ..inference.beliefs import Instants, given_all, given_past
from ..inference.motion_model import MotionModel
from ..inference.problem import Problem
from ..inference.solver import solve
from ..measurements.records import Encoders
from ..noise.encoder_noise import FEWEST, Learned, floor, learn
from ..noise.noise_model import NoiseModel
from . import results
from .results import Beliefs


@dataclass(frozen=True, eq=False)
class OwnNoise:
    """Learned for motion of order 2 and of order 3; None if readings are too few."""

    acceleration: Learned
    jerk: Learned | None

    @property
    def preferred(self) -> Learned:
        """The motion with the greater evidence."""
        if self.jerk is None or self.jerk.evidence < self.acceleration.evidence:
            return self.acceleration
        return self.jerk


def own_noise(encoders: Encoders, white: Learned, encoder: Array) -> OwnNoise:
    """Learn from the log; noise under `white` acceleration is known; `encoder` (M,) rad²: for silent joints."""
    white = replace(white, process=np.maximum(white.process, floor(encoders.t, white.encoder, 2)))
    counts = np.isfinite(encoders.values).sum(axis=0)
    if ((counts > 0) & (counts <= FEWEST)).any():
        return OwnNoise(white, None)
    smooth = learn(encoders, encoder, np.zeros(len(counts)), 3)
    return OwnNoise(white, replace(smooth, process=np.maximum(smooth.process, floor(encoders.t, smooth.encoder, 3))))


def possible(problem: Problem, settings: Estimation) -> bool:
    """Whether encoders are never silent, so that no re-acquisition is needed, and noise is learned from the log."""
    led = (
        problem.path is not None or problem.resets is not None or problem.stepwise or problem.posture_prior is not None
    )
    # the banded solve takes neither variances that are set nor images
    other = bool(settings.typed) or bool(problem.evidence.sightings)
    return settings.precision == "auto" and problem.precision.white is not None and not led and not other


def estimate(
    method: str, body: BodyModel, problem: Problem, settings: Estimation, faults: tuple[Fault, ...]
) -> Estimate:
    """The filtered or smoothed belief; DidNotConverge if the solver does not converge."""
    smooth, encoders, white = method == "smoother", problem.evidence.encoders, problem.precision.white
    assert encoders is not None and white is not None
    noise, walk = own_noise(encoders, white, np.array(body.noise.encoder, float)), problem.precision.drift
    model = MotionModel(noise.preferred.order, noise.preferred.process, walk)
    log = assemble(encoders, problem.timeline, problem.start, noise.preferred.encoder, model)
    at = (given_all if smooth else given_past)(solve(log, initial_states(log), smooth))
    drifting = () if walk is None else encoder_offset.faults(problem, body.joints, at.offset, at.offset_var, faults)
    beliefs = Beliefs(
        _states(at, walk), at.cov, at.nats, at.before, at.before_cov, at.error, {},
        _plain(noise, walk, problem.precision), drifting,
    )  # fmt: skip
    return results.estimate(method, body, problem.evidence, problem.timeline, beliefs)


def _states(at: Instants, walk: Array | None) -> Array:
    """Angles, rates and, if there are any, offsets (E,·)."""
    parts = [at.states[:, :, 0], at.states[:, :, 1]]
    return np.concatenate(parts if walk is None else [*parts, np.where(walk > 0.0, at.states[:, :, -1], 0.0)], axis=1)


def _plain(noise: OwnNoise, walk: Array | None, white: NoiseModel) -> dict[str, Any]:
    """Plain numbers for the estimate's settings: `nats` for hypotheses, `live` for a live filter."""
    motion, jerk = noise.preferred, noise.jerk
    won = 0.0 if jerk is None else jerk.evidence - noise.acceleration.evidence
    return {
        "order": motion.order, "encoder": motion.encoder.tolist(), "drift": None if walk is None else walk.tolist(),
        "process": motion.process.tolist(), "scale": {},
        "nats": {"order/3": won} if won != 0.0 and np.isfinite(won) else {},
        "live": white.plain(),
    }  # fmt: skip
