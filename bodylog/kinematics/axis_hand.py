"""What a weight at the hand does to an arm whose axes were found without a URDF: the hand holds the
marker before a camera that stands, or the camera before a marker that stands.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..types import Array
from .axis_chain import AxisChain
from .chain import cross_products

HAND_LENGTH = 0.1
"""Share of the marker's distance (m before a tracker) from joints of the hand that stood still to
what it holds: a wrist has a tenth of an arm's length. Over 14 logs of two generators the median
NEES is 0.8; with 0.15 and 0.2 it was 0.45 and 0.4, and without such joints up to 5.6.
"""
_ACROSS = np.eye(3)[np.array([[0, 0], [1, 1], [2, 2], [0, 1], [0, 2], [1, 2]])].sum(axis=1)
_GIVING = _ACROSS / np.linalg.norm(_ACROSS, axis=1)[:, None]
"""Six directions of the hand in which it may give way: those of a symmetric compliance (3,3)."""


@dataclass(frozen=True, eq=False)
class _AxisHand:
    """A hand of found axes, of which nothing tells which way a weight pulls.

    give_count: R, the number of ways in which it may give way, each as by a joint that stood still.
    """

    give_count: ClassVar[int]
    chain: AxisChain

    @property
    def is_upright(self) -> bool:
        """Whether it is known which way a weight pulls."""
        return False

    @property
    def still_joints(self) -> tuple[str, ...]:
        """Names (R,) of the ways in which the hand may give way."""
        return tuple(f"hand {number}" for number in range(self.give_count))


@dataclass(frozen=True, eq=False)
class MarkerHand(_AxisHand):
    """A hand that holds the marker. A weight pulls in one direction of the camera's axes, and the
    hand gives way in six.
    """

    give_count = len(_GIVING)

    def measure_levers(self, q: Array) -> Array:
        """How far each joint moves the marker along each of the camera's axes (N,M,3), and how far
        it moves the axis of the next joint (N,M,3), lengths per rad, at q (N,M) rad.

        Links bend under a weight, too: by levers between that of their own joint and the next.
        """
        seen = self.chain.place_axes(q)
        levers = cross_products(seen.axes, seen.marker[:, None] - seen.points)
        ahead = cross_products(seen.axes[:, :-1], seen.meet_next()[0] - seen.points[:, :-1])
        links = _pad_links(ahead, 1)
        return self.chain.arrange_by_joint(np.concatenate([levers, links], axis=2), q)

    def show_still_joints(self, q: Array) -> tuple[Array, Array]:
        """What each direction in which the hand gives way changes in images (N,D,R), px per rad,
        and how far the marker moves with it along each of the camera's axes (N,R,3), at q (N,M).
        """
        seen = self.chain.place_axes(q)
        moves = HAND_LENGTH * (seen.rotation @ _GIVING.T)
        return self.chain.project_into_image(seen.marker)[1] @ moves, moves.swapaxes(1, 2)


@dataclass(frozen=True, eq=False)
class CameraHand(_AxisHand):
    """A hand that holds the camera. A weight pulls in one direction of what stands, which is that
    of the camera's axes with all joints at `middle`; along each of three axes of the camera it may
    turn the camera about each of them.
    """

    give_count = 9

    def measure_levers(self, q: Array) -> Array:
        """As of `MarkerHand`: how far each joint moves the camera, in the axes of what stands, and
        the axis of the next joint towards it.
        """
        seen = self.chain.place_axes(q)
        levers = cross_products(seen.axes, -seen.points) @ seen.rotation
        ahead = cross_products(seen.axes[:, 1:], seen.meet_next()[1] - seen.points[:, 1:])
        links = _pad_links(ahead @ seen.rotation, 0)
        return self.chain.arrange_by_joint(np.concatenate([levers, links], axis=2), q)

    def show_still_joints(self, q: Array) -> tuple[Array, Array]:
        """As of `MarkerHand`: what turns of the camera change in images (N,D,R)."""
        seen = self.chain.place_axes(q)
        by_point = self.chain.project_into_image(seen.marker)[1]
        turned = cross_products(seen.marker[:, None], np.eye(3)[None]).swapaxes(1, 2)
        shown = np.repeat(by_point @ turned, 3, axis=2)
        return shown, HAND_LENGTH * np.tile(seen.rotation, (1, 3, 1))


def _pad_links(links: Array, end: int) -> Array:
    """Levers of links (N,K-1,3) with nothing for the joint at an end: the first (0) or last (1)."""
    return np.pad(links, ((0, 0), (1 - end, end), (0, 0)))
