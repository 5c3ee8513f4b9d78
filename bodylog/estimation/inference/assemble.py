"""Turn a gathered log and its noise model into a `Log` for the solver; initial states from encoders alone."""

from dataclasses import dataclass, replace

import numpy as np

from ...types import Array
from ..measurements.records import Evidence
from ..measurements.timeline import Timeline
from .banded import factored
from .bridge import Slots
from .images import Images
from .initial_path import OFFSET_STD
from .interior import predicted
from .knots import BEFORE, Knots
from .mixture import inlier, raised
from .motion_model import MotionModel
from .posed import Chain, posed
from .solver import Log, distance, points

START_STD = (1.0, 1.0, 3.0)
"""rad, rad/s, rad/s²: prior standard deviations of the joints before the first reading."""
NEVER = 1e-6
"""rad, and 1e-12 rad²/s: offset of a joint without one, where other joints have offset states."""


@dataclass(frozen=True, eq=False)
class Assumed:
    """Encoder variances (M,) rad² · motion · scale {track: variance factor} · explored (M,) rad²: see `Log`."""

    encoder: Array
    motion: MotionModel
    scale: dict[str, float]
    explored: Array


def assemble(evidence: Evidence, line: Timeline, start: Array, assumed: Assumed) -> Log:
    """The log as knots, slots and images, not solved yet."""
    motion = assumed.motion
    visual = [events for one, events in zip(evidence.sightings, line.sightings, strict=True)]
    knots = Knots.of(line.t, np.unique(np.concatenate([*visual, np.empty(0, int)])), motion.order)
    y, var = _readings(evidence, line, assumed.encoder)
    slots = Slots(knots.steps(), knots.fold(y, np.nan), knots.fold(var, 1.0))
    chain = Chain(motion, knots, slots, *before(motion, start, BEFORE))
    # by name, so that the result does not depend on the order of tracks
    shown = [one for one in zip(evidence.sightings, line.sightings, strict=True) if np.isfinite(one[0].values).any()]
    tracks = sorted(shown, key=lambda track: track[0].name)
    images = tuple(
        Images.of(one, events, knots, assumed.scale.get(one.name, 1.0), one.name != "touch") for one, events in tracks
    )
    density = (1.0 / (2.0 * np.pi), *(_density(one) for one in images))
    return Log(chain, images, assumed.explored, slots.var, density)


def _readings(evidence: Evidence, line: Timeline, encoder: Array) -> tuple[Array, Array]:
    """Encoders' readings (E,M) rad at the log's instants, NaN where silent, and their variances."""
    found, y = evidence.encoders, np.full((len(line.t), len(encoder)), np.nan)
    var = np.tile(encoder, (len(line.t), 1))
    if found is not None:
        y[line.encoders] = found.values
        if found.relative is not None:
            var[line.encoders] *= found.relative
    return y, var


def _density(one: Images) -> float:
    """Density of outliers among a track's images: uniform over the range of nine tenths of its places."""
    if not len(one.events):
        return 1.0
    low, high = np.quantile(one.y, [0.05, 0.95], axis=1)
    return float(1.0 / np.prod(high - low + np.sqrt(np.median(one.pixel, axis=1))))


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
    """Nominal states (K,B) from encoders alone; images far from these start as outliers."""
    chain = log.chain
    k, knots = chain.motion.joints * chain.motion.states, chain.knots.count
    bridge, nominal = chain.bridge(), np.zeros((k, knots))
    nominal[:: chain.motion.states] = chain.mean[:, :1]
    factor = factored(posed(chain, bridge, [], nominal)[0])
    about, nominal = nominal, nominal + factor.solution()
    past, cov = factor.filtered() if log.images else (about, np.empty(0))
    past = about + past
    for one, density in zip(log.images, log.density[1:], strict=True):
        one.follow(points(chain, one, nominal))
        row = replace(one.rows([], log.encoder), reads=None)
        h, index = row.of_states(chain.motion)
        belief = np.concatenate([cov, past[:, None]], axis=1)[..., one.knots]
        var = one.pixel + one.model
        innovation, total = predicted(belief, h, index, row.y, var)
        weight = inlier(*distance(innovation, total), len(total), density)[0]
        own = np.einsum("ddf->df", total)
        one.extra = raised(np.zeros_like(own), own, np.minimum(2.0 * weight, 1.0))
    return np.concatenate([nominal, np.zeros((log.errors, knots))])
