"""Find the axes of a chain of turning joints from what a camera or tracker saw: Levenberg-Marquardt
from random axes, in the orders in which logs name the joints of a chain.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, permutations
from typing import NamedTuple

import numpy as np

from ..types import Array
from .axis_chain import AxisChain

SCOUTS = 80
"""Samples that starts and orders are compared by."""
COARSE = 10.0
"""Factor on the std of sightings there, which widens the way to the best axes."""
STARTS = 24
"""Random axes tried for each order. Where six or seven joints are in the right order, a tenth to a
third of the starts lead to the right axes."""
SHORT = 12
"""Steps of each start before the better ones go on."""
FINALISTS = 6
STEPS = 100
EXPLAINED = 2.0
"""Ratio of residuals to the noise of the Gaussian process below which no other order is tried: the
process learns how a real arm bends."""
MOST_PERMUTED = 3
"""Most joints of which all orders are tried; of more, those of limbs whose joints are named in turn
and, from the best of them, exchanges."""
_SETTLED = 1e-4
_STUCK = 1e9
_LEAST_STD = 1e-3
"""px or mm: nothing is seen more exactly."""


@dataclass(frozen=True, eq=False)
class AxisSightings:
    """Angles q (n,M) rad, and what was seen there: y (n,D) px or mm with std (n,D).

    lens (6,) and lens_std (6,): prior of the camera's; both (0,) for a tracker.
    """

    q: Array
    y: Array
    std: Array
    lens: Array
    lens_std: Array

    def choose_scouts(self) -> "AxisSightings":
        """SCOUTS evenly spaced rows, less certain by COARSE."""
        count = min(len(self.q), SCOUTS)
        rows = np.linspace(0, len(self.q) - 1, count).astype(int)
        std = COARSE * self.std[rows]
        return replace(self, q=self.q[rows], y=self.y[rows], std=std)


@dataclass(frozen=True, eq=False)
class _Descended:
    """A chain, its loss: half the squares of residuals and of
    deviations from the prior, both in std; and the residuals' mean square.
    """

    chain: AxisChain
    loss: float
    residual: float

    @property
    def explains(self) -> bool:
        """Whether the chain explains the sightings of `AxisSightings.choose_scouts`."""
        return self.residual < (EXPLAINED / COARSE) ** 2


def find_axes(data: AxisSightings, seed: int, known: AxisChain | None = None) -> AxisChain:
    """The chain that explains the sightings best, as far as it is found.

    known: a chain of the same joints before the same camera, tried first.
    """
    data = replace(data, std=np.maximum(data.std, _LEAST_STD))
    few = data.choose_scouts()
    draw = np.random.default_rng(seed)
    found = [] if known is None else [_descend(few, known, STEPS)]
    for order in _likely_orders(data.q.shape[1]):
        if any(one.explains for one in found):
            break
        drawn = [_draw_chain(data, np.array(order), draw) for _ in range(STARTS)]
        starts = sorted((_descend(few, one, SHORT) for one in drawn), key=lambda one: one.loss)
        found += [_descend(few, one.chain, STEPS) for one in starts[:FINALISTS]]
    best = _exchange_joints(few, min(found, key=lambda one: one.loss))
    return _descend(data, best.chain, STEPS).chain


def _likely_orders(joints: int) -> Iterator[tuple[int, ...]]:
    """Orders of joints from a camera to a marker, the likelier first.

    Logs name the joints of each limb in turn, or all by the alphabet, as those of a UR are. From
    the camera the way leads down one limb to the body, and up another one to the marker.
    """
    names = tuple(range(joints))
    if joints <= MOST_PERMUTED:
        yield from permutations(names)
        return
    limbs = [(names[:split], names[split:]) for split in range(joints)]
    ways = [way for one, other in limbs for way in (one[::-1] + other, other[::-1] + one)]
    yield from dict.fromkeys(ways)


def _draw_chain(data: AxisSightings, order: Array, draw: np.random.Generator) -> AxisChain:
    """Axes of any direction, about as far from the camera as the marker."""
    frames = np.array([np.linalg.qr(draw.normal(size=(3, 3)))[0] for _ in order])
    frames *= np.linalg.det(frames)[:, None, None]
    ahead = np.array([0.0, 0.0, 1.0])
    pivots = ahead + draw.normal(0.0, 0.3, (len(order), 3))
    return AxisChain(ahead, data.lens, frames, pivots, order, data.q.mean(axis=0))


def _exchange_joints(data: AxisSightings, best: _Descended) -> _Descended:
    """Exchange two joints as long as that makes the loss smaller."""
    while not best.explains:
        pairs = combinations(range(len(best.chain.order)), 2)
        others = [_descend(data, _exchange_two_joints(best.chain, *pair), STEPS) for pair in pairs]
        other = min(others, key=lambda one: one.loss, default=best)
        if other.loss > best.loss - 1.0:
            break
        best = other
    return best


def _exchange_two_joints(chain: AxisChain, i: int, j: int) -> AxisChain:
    """Two joints of the chain exchanged, each with its axis."""
    rows = np.arange(len(chain.order))
    rows[[i, j]] = [j, i]
    return replace(
        chain, frames=chain.frames[rows], pivots=chain.pivots[rows], order=chain.order[rows]
    )


def _descend(data: AxisSightings, chain: AxisChain, steps: int) -> _Descended:
    """The chain of least loss near this one (Levenberg-Marquardt)."""
    damping = 1e-2
    here = _linearise_loss(data, chain)
    for _ in range(steps):
        curvature = here.design.T @ here.design
        pull = here.design.T @ here.residual
        while damping < _STUCK:
            damped = curvature + damping * np.diag(curvature.diagonal() + 1.0)
            trial = chain.move_axes(np.linalg.solve(damped, pull))
            there = _linearise_loss(data, trial)
            if there.loss < here.loss:
                break
            damping *= 4.0
        else:
            break
        gained = here.loss - there.loss
        chain = trial
        here = there
        damping *= 0.2
        if gained < _SETTLED:
            break
    return _Descended(chain, here.loss, float(np.square(here.residual[: data.y.size]).mean()))


class _LinearLoss(NamedTuple):
    """A loss, its residuals (nD+L,) in std, and their derivatives (nD+L,P) by the unknowns."""

    loss: float
    residual: Array
    design: Array


def _linearise_loss(data: AxisSightings, chain: AxisChain) -> _LinearLoss:
    """The loss about a chain: half the squares of residuals and of deviations of the lens."""
    image, _, design = chain.see(data.q)
    residual = ((data.y - image) / data.std).ravel()
    prior = np.zeros((len(data.lens), design.shape[2]))
    prior[:, chain.of_lens] = np.diag(1.0 / data.lens_std)
    rows = (design / data.std[..., None]).reshape(len(residual), -1)
    residual = np.concatenate([residual, (data.lens - chain.lens) / data.lens_std])
    design = np.concatenate([rows, prior])
    return _LinearLoss(0.5 * float(residual @ residual), residual, design)
