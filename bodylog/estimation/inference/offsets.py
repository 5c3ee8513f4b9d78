"""Encoder offsets that the log's evidence asks for, added one after the other."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ...types import Array
from ..faults.threshold import NATS
from .assemble import NEVER, before
from .banded import factored
from .convergence import DidNotConverge
from .knots import BEFORE
from .motion_model import MotionModel
from .offset_evidence import OffsetScore, offset_score
from .posed import Chain, energy, posed
from .solver import Log, Solved, distance, solve

WALKS = (1e-4, 1e-5, 1e-3, 1e-7)
"""rad²/s: random-walk variances tried; the last one is a constant offset, as of a joint homed differently."""
CLIP = 4.0
"""Standard deviations: bound on an image's innovation in the offset score, also for outliers."""
SIGMAS = 4.0
"""Standard deviations that an offset must reach somewhere."""


@dataclass(frozen=True, eq=False)
class Offsets:
    """The solved log · walk (M,) rad²/s, 0 for none · nats gained (M,) · joints whose offset explains it as well."""

    solved: Solved
    walk: Array
    won: Array
    alternatives: Mapping[int, tuple[int, ...]] = field(default_factory=dict)


def offsets(solved: Solved, walk: Array, least: Array | float, smooth: bool) -> Offsets:
    """Add an encoder offset wherever that gains NATS nats; `walk` (M,) of the offsets given already.

    least (M,) or () rad: smallest offset to add.
    """
    found = Offsets(solved, walk, np.zeros(len(walk)))
    while (walk := found.walk) is not None:
        score = offset_score(clipped(found.solved))
        tried = [_best(score, j, least) if walk[j] == 0.0 else (-np.inf, 0.0) for j in range(len(walk))]
        gains = np.array([gain for gain, _ in tried])
        won = np.where(walk > 0.0, found.won, gains)
        best = int(gains.argmax())
        if gains[best] < NATS:
            return replace(found, won=won)
        near = [j for j in np.flatnonzero(gains > gains[best] - NATS)]
        # of those with equal evidence the one with the smallest walk: others follow the body model's errors
        joint = min(near, key=lambda j: (tried[j][1], -gains[j]))
        more = walk.copy()
        more[joint] = tried[joint][1]
        try:
            other = with_walks(found.solved, more, smooth)
        except DidNotConverge:
            return replace(found, won=won)
        if nats(found.solved) - nats(other) < NATS:
            return replace(found, won=won)
        alternatives = tuple(int(j) for j in near if j != joint)
        found = Offsets(other, more, won, {**found.alternatives, int(joint): alternatives})
    return found


def _best(score: OffsetScore, joint: int, least: Array | float) -> tuple[float, float]:
    """Most nats gained by an offset of a joint above the least size, and its random-walk variance."""
    ways = []
    for walk in WALKS:
        gain, mean, var = score.won(joint, walk)
        floor = np.broadcast_to(least, (joint + 1,))[joint] if np.ndim(least) == 0 else np.asarray(least)[joint]
        certain = np.abs(mean) > np.maximum(floor, SIGMAS * np.sqrt(np.maximum(var, 0.0)))
        ways.append((gain if certain.any() else -np.inf, walk))
    return max(ways)


def nats(solved: Solved) -> float:
    """Free energy of the whole log, filtered."""
    return float(solved.forth.nats.sum() + sum(sight.nats.sum() for sight in solved.sights))


def clipped(solved: Solved) -> Solved:
    """The same log, where outlier images have innovations of CLIP standard deviations instead of no weight."""
    extras = [one.extra for one in solved.log.images]
    for one, sight in zip(solved.log.images, solved.sights, strict=True):
        far = np.sqrt(distance(sight.innovation, sight.total)[0] / len(sight.total))
        one.extra = np.einsum("ddf->df", sight.total) * (np.maximum(far / CLIP, 1.0) - 1.0)
    rows = solved.log.rows()
    for one, extra in zip(solved.log.images, extras, strict=True):
        one.extra = extra
    return replace(solved, factor=factored(posed(solved.log.chain, solved.bridge, rows, solved.nominal)[0]))


def evidence(solved: Solved, motion: MotionModel | None = None) -> float:
    """Laplace's free energy (nats) of the log with a solution's linearisation, optionally for another motion."""
    log, nominal = solved.log, solved.nominal
    if motion is None:
        return energy(log.chain, solved.bridge, log.rows(), nominal)
    chain, nominal = moved_by(log, nominal, motion)
    return energy(chain, chain.bridge(), log.rows(), nominal)


def moved_by(log: Log, nominal: Array, motion: MotionModel) -> tuple[Chain, Array]:
    """The log's chain and nominal states (K,B) for another motion."""
    old, m, knots = log.chain.motion, log.chain.motion.joints, nominal.shape[1]
    mean, cov = before(motion, log.chain.mean[:, 0], BEFORE)
    states, kept = np.zeros((m, motion.states, knots)), min(motion.order, old.order)
    states[:, :kept] = nominal[: m * old.states].reshape(m, old.states, knots)[:, :kept]
    nominal = np.concatenate([states.reshape(-1, knots), nominal[m * old.states :]])
    return replace(log.chain, motion=motion, mean=mean, cov=cov), nominal


def with_walks(solved: Solved, walk: Array, smooth: bool) -> Solved:
    """Solve the log again with offsets of random walk `walk` (M,) rad²/s, 0 for none."""
    log, old = solved.log, solved.log.chain.motion
    motion = MotionModel(old.order, old.process, np.maximum(walk, NEVER**2) if walk.any() else None)
    chain, nominal = moved_by(log, solved.nominal, motion)
    for one in log.images:
        one.extra = np.zeros_like(one.extra)
    fresh: Log = replace(log, chain=replace(chain, slots=replace(chain.slots, var=log.slots_var)))
    return solve(fresh, nominal, smooth)
