"""Evidence for an encoder offset, to first order about a solved log, for every random-walk variance.

With readings y − b the log's nats, minimised over the states, are quadratic in b: F(b) = F − sᵀb + ½ bᵀ I b. An
offset is constant within each span; a prior of variance Q gains ½ sᵀ(I + Q⁻¹)⁻¹s − ½ ln|1 + Q I| nats.
"""

from dataclasses import dataclass, replace

import numpy as np

from ...types import Array
from .bridge import Bridge, Information, bridge, information
from .initial_path import OFFSET_STD
from .motion_model import MotionModel
from .small import outer
from .solver import Solved

SPAN, MOST = 0.5, 240
"""s: least span within which an offset is constant; most spans."""
APART = 6.0
"""s between spans that are solved for at once, and treated as independent."""


@dataclass(frozen=True, eq=False)
class OffsetScore:
    """t (N,) s: begins of spans · score s (M,N) per rad · information I (M,N,N) per rad² of each joint's offset."""

    t: Array
    score: Array
    information: Array

    def won(self, joint: int, walk: float) -> tuple[float, Array, Array]:
        """Nats that an offset of a joint with random walk `walk` rad²/s gains, its mean (N,) rad and variance."""
        prior = OFFSET_STD**2 + walk * (np.minimum.outer(self.t, self.t) - self.t[0])
        linear, score = self.information[joint], self.score[joint]
        both = np.eye(len(score)) + prior @ linear
        mean = np.linalg.solve(both, prior @ score)
        var = np.diagonal(np.linalg.solve(both, prior))
        return 0.5 * float(score @ mean - np.linalg.slogdet(both)[1]), mean, var


def offset_score(solved: Solved) -> OffsetScore:
    """Score and information of all encoders' offsets."""
    chain = solved.log.chain
    begins, span = _spans(chain.knots.t, chain.knots.events)
    up, down = (
        bridge(chain.motion, replace(chain.slots, encoders=chain.slots.encoders + sign)) for sign in (1.0, -1.0)
    )
    # by each joint's own unit offset
    each = replace(up, shift=0.5 * (up.shift - down.shift), pull=0.5 * (up.pull - down.pull))
    low, high = _ends(chain.motion, solved.nominal)
    linear = information(each, np.zeros_like(low), np.zeros_like(high))
    slope, bend = _direct(up, down, solved.bridge, each, (low, high), linear.after)
    low, high = _ends(chain.motion, solved.factor.solution())
    slope = slope - (linear.pull_before * low + linear.pull_after * high).sum(axis=0)
    count = len(begins)
    score = np.stack([np.bincount(span, row, count) for row in slope])
    known = np.stack([np.diag(np.bincount(span, row, count)) for row in bend])
    known -= np.stack([_through(solved, joint, linear, span, begins) for joint in range(len(slope))])
    return OffsetScore(begins, score, 0.5 * (known + known.swapaxes(1, 2)))


def _spans(t: Array, events: Array) -> tuple[Array, Array]:
    """Begins (N,) s of spans, and the span of each interval (B−1,)."""
    width = max(SPAN, float(t[-1] - t[0]) / MOST)
    which = np.floor((t[events] - t[0]) / width).astype(int)
    found, span = np.unique(which, return_inverse=True)
    return t[0] + width * found, span


def _ends(motion: MotionModel, states: Array) -> tuple[Array, Array]:
    """States (S,M,B−1) at both ends of all intervals, of (K,B) at the knots."""
    m, s = motion.joints, motion.states
    whole = states[: m * s].reshape(m, s, -1).swapaxes(0, 1)
    return whole[..., :-1], whole[..., 1:]


def _direct(
    up: Bridge, down: Bridge, own: Bridge, each: Bridge, ends: tuple[Array, Array], inverse: Array
) -> tuple[Array, Array]:
    """−dF/db and d²F/db² (M,B−1) at fixed states, for readings y − b."""
    low, high = ends
    miss = own.shift + (own.move * low[None]).sum(axis=1) - high
    slope = (each.shift * (inverse * miss[None]).sum(axis=1)).sum(axis=0) - (each.pull * low).sum(axis=0)
    slope = slope + 0.5 * (up.nats - down.nats)
    bend = (outer(each.shift, each.shift) * inverse).sum(axis=(0, 1)) + up.nats + down.nats - 2.0 * own.nats
    return slope, bend


def _through(solved: Solved, joint: int, linear: Information, span: Array, begins: Array) -> Array:
    """hᵀ Λ⁻¹ h (N,N): effect of one joint's offsets through the states, for neighbouring spans only."""
    from scipy.linalg.lapack import dpbtrs

    (k, knots), count = solved.nominal.shape, len(begins)
    before, after, s = linear.pull_before, linear.pull_after, solved.log.chain.motion.states
    first = joint * s
    width = float(begins[1] - begins[0]) if count > 1 else APART
    groups = min(max(3, int(np.ceil(APART / width))), count)
    right = np.zeros((knots, k, groups))
    at, group = np.arange(knots - 1), span % groups
    for state in range(s):
        right[at, first + state, group] += before[state, joint]
        right[at + 1, first + state, group] += after[state, joint]
    found, _ = dpbtrs(solved.factor.band, right.reshape(knots * k, groups), lower=0)
    found = found.reshape(knots, k, groups)[:, first : first + s]
    gathered = np.zeros((count, groups))
    np.add.at(gathered, span, np.einsum("sb,bsg->bg", before[:, joint], found[:-1]))
    np.add.at(gathered, span, np.einsum("sb,bsg->bg", after[:, joint], found[1:]))
    whole, here = np.zeros((count, count)), np.arange(count)
    for shift in range(-((groups - 1) // 2), groups // 2 + 1):
        there = here + shift
        sound = (there >= 0) & (there < count)
        whole[here[sound], there[sound]] = gathered[here[sound], there[sound] % groups]
    return whole
