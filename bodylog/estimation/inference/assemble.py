"""Turn encoder readings and their noise model into a `Log` for the solver; initial states."""

from dataclasses import replace

import numpy as np

from ...types import Array
from ..measurements.records import Encoders
from ..measurements.timeline import Timeline
from .banded import factored
from .bridge import Slots
from .initial_path import OFFSET_STD
from .knots import BEFORE, Knots
from .motion_model import MotionModel
from .posed import Chain, posed
from .solver import Log

START_STD = (1.0, 1.0, 3.0)
"""rad, rad/s, rad/s²: prior standard deviations of the joints before the first reading."""
NEVER = 1e-6
"""rad, and 1e-12 rad²/s: offset of a joint without one, where other joints have offset states."""


def assemble(encoders: Encoders, line: Timeline, start: Array, var: Array, motion: MotionModel) -> Log:
    """The log of encoders with variances (M,) rad² as knots and slots, not solved yet."""
    if motion.walk is not None:
        # without any walk an offset's noise between knots is singular
        motion = replace(motion, walk=np.maximum(motion.walk, NEVER**2))
    knots, each = Knots.of(line.t, motion.order), np.tile(var, (len(line.t), 1))
    y = np.full(each.shape, np.nan)
    y[line.encoders] = encoders.values
    if encoders.relative is not None:
        each[line.encoders] *= encoders.relative
    slots = Slots(knots.steps(), knots.fold(y, np.nan), knots.fold(each, 1.0))
    return Log(Chain(motion, knots, slots, *before(motion, start, BEFORE)), slots.var)


def before(motion: MotionModel, start: Array, dt: float) -> tuple[Array, Array]:
    """Mean (M,S) and covariance (M,S,S) at dt (s) before the first instant, such that they grow to the prior there."""
    mean = np.zeros((motion.joints, motion.states))
    mean[:, 0] = start
    spread = np.moveaxis(motion.spread(np.array([dt]))[..., 0], -1, 0)
    var = np.maximum(np.square(START_STD[: motion.order]), 2.0 * np.einsum("jss->js", spread)[:, : motion.order])
    if motion.walk is not None:
        offset = np.where(motion.walk > NEVER**2, OFFSET_STD**2, NEVER**2)
        var = np.column_stack([var, offset])
    back = np.eye(motion.states)[..., None]
    motion.carry(back, np.array([-dt]))
    return mean, back[..., 0] @ (np.einsum("js,st->jst", var, np.eye(motion.states)) - spread) @ back[..., 0].T


def initial_states(log: Log) -> Array:
    """Smoothed states (K,B) at the knots, from which to solve the log."""
    chain, nominal = log.chain, np.zeros((log.chain.motion.joints * log.chain.motion.states, log.chain.knots.count))
    nominal[:: chain.motion.states] = chain.mean[:, :1]
    return nominal + factored(posed(chain, chain.bridge(), nominal)).solution()
