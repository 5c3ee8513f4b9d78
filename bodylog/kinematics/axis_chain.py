"""A chain of turning joints whose axes are unknown, before one camera or tracker: a product of
exponentials (Brockett 1984), with its derivatives by the joints and by all that is unknown.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..types import Array
from .camera import project_points, scale_points
from .chain import cross_products
from .rotations import cross_product_matrix, left_jacobian, rotation_from_vector

PLACE_STD = 1.0
"""Prior std of the marker's place and of the distance of each axis, in shares of the marker's
distance from the camera: arms are about as long as they are far. In m for points in space.
"""
TURN_STD = 1.0
"""rad: prior std of the direction of an axis, which may have any."""
PARALLEL = 0.1
"""rad: axes at a smaller angle cross far from the arm, if at all."""


@dataclass(frozen=True, eq=False)
class AxisChain:
    """K joints between a camera and a marker, all in the camera's axes.

    Lengths are shares of the marker's distance along the camera's axis with all joints at `middle`,
    which no image tells; of points in space they are m.
    place (3,) of the marker there · lens (6,), or (0,) of a tracker · frames (K,3,3): two
    directions across each axis and its own, in rows, from the camera on · pivots (K,3): a point of
    each axis · order (K,): the joint that turns about each axis · middle (M,) rad.
    """

    place: Array
    lens: Array
    frames: Array
    pivots: Array
    order: Array
    middle: Array

    @property
    def of_lens(self) -> slice:
        """The lens among the unknowns, behind the marker's place."""
        first = 3 if len(self.lens) == 0 else 2
        return slice(first, first + len(self.lens))

    @property
    def unknown_count(self) -> int:
        """P: the marker's place (2, or 3 for a tracker), the lens (6), and of each axis from the
        camera on two turns of its direction (rad) and two shifts across it.
        """
        return int(self.of_lens.stop) + 4 * len(self.order)

    def prior_std(self, lens_std: Array) -> Array:
        """Prior std (P,) of all unknowns, with that of the lens (6,), or (0,) of a tracker."""
        place = np.full(self.of_lens.start, PLACE_STD)
        axis = np.array([TURN_STD, TURN_STD, PLACE_STD, PLACE_STD])
        return np.concatenate([place, lens_std, np.tile(axis, len(self.order))])

    def see(self, q: Array) -> tuple[Array, Array, Array]:
        """Predict at q (N,M) rad: image (N,D) px or mm · slope (N,D,M)
        by the joints · design (N,D,P) by a small change of the unknowns.
        """
        turns = self._turns(q)
        point = np.broadcast_to(self.place, (len(q), 3))
        arms = [point] * len(turns)
        for k in range(len(turns) - 1, -1, -1):
            arms[k] = (turns[k] @ (point - self.pivots[k])[..., None])[..., 0]
            point = arms[k] + self.pivots[k]
        image, by_point, by_lens = self.project_into_image(point)
        outputs = image.shape[1]
        slope = np.zeros((*image.shape, q.shape[1]))
        design = np.zeros((*image.shape, self.unknown_count))
        design[..., self.of_lens] = by_lens
        # rows: derivatives by a shift of the arm, and by a turn about the axis' point
        rows = np.empty((len(q), 2 * outputs, 3))
        for k, (turn, arm) in enumerate(zip(turns, arms, strict=True)):
            rows[:, :outputs] = by_point
            rows[:, outputs:] = cross_products(arm[:, None], by_point)
            before = rows @ turn
            slope[..., self.order[k]] = rows[:, outputs:] @ self.frames[k, 2]
            # what moves an axis moves the arm behind it, which turns about the axis
            moved = rows - before
            first = self.of_lens.stop + 4 * k
            design[..., first : first + 2] = moved[:, outputs:] @ self._leans[k].T
            design[..., first + 2 : first + 4] = moved[:, :outputs] @ self.frames[k, :2].T
            by_point = before[:, :outputs]
        design[..., : self.of_lens.start] = by_point[..., : self.of_lens.start]
        return image, slope, design

    def project_into_image(self, points: Array) -> tuple[Array, Array, Array]:
        """Points (N,3) before the camera or tracker: image (N,D) px or mm · derivative by the point
        (N,D,3) · by the lens (N,D,6), or (N,D,0) of a tracker.
        """
        return project_points(points, self.lens) if len(self.lens) else scale_points(points)

    def place_axes(self, q: Array) -> "AxisPlaces":
        """Where axes and marker are at q (N,M) rad."""
        rotation = np.broadcast_to(np.eye(3), (len(q), 3, 3))
        shift = np.zeros((len(q), 3))
        axes = np.empty((len(q), len(self.order), 3))
        points = np.empty_like(axes)
        for k, turn in enumerate(self._turns(q)):
            axes[:, k] = rotation @ self.frames[k, 2]
            points[:, k] = rotation @ self.pivots[k] + shift
            rotation = rotation @ turn
            shift = points[:, k] - rotation @ self.pivots[k]
        return AxisPlaces(axes, points, rotation, rotation @ self.place + shift)

    def arrange_by_joint(self, by_axis: Array, q: Array) -> Array:
        """What is given for each axis from the camera on (N,K,L), for each joint of q (N,M):
        (N,M,L), zero for those that turn about no axis.
        """
        by_joint = np.zeros((*q.shape, by_axis.shape[2]))
        by_joint[:, self.order] = by_axis
        return by_joint

    def move_axes(self, step: Array) -> "AxisChain":
        """The chain with its unknowns changed by step (P,)."""
        place = self.place.copy()
        place[: self.of_lens.start] += step[: self.of_lens.start]
        each = step[self.of_lens.stop :].reshape(-1, 4)
        leans = np.einsum("kc,kci->ki", each[:, :2], self._leans)
        turns = [rotation_from_vector(lean) for lean in leans]
        frames = self.frames @ np.array(turns).transpose(0, 2, 1)
        pivots = self.pivots + np.einsum("kc,kci->ki", each[:, 2:], self.frames[:, :2])
        return replace(
            self, place=place, lens=self.lens + step[self.of_lens], frames=frames, pivots=pivots
        )

    def move_poses(self, camera: Array, marker: Array) -> tuple["AxisChain", Array, Array]:
        """The chain after its marker moved by `marker` (3,), and then its camera by `camera` (6,):
        p ↦ exp(w) p + v of all that it sees, v before w; and the derivatives by both, as steps
        (P,6) and (P,3) of the unknowns.
        """
        shift = camera[:3]
        turn = camera[3:]
        rotation = rotation_from_vector(turn)
        moved = replace(
            self,
            place=rotation @ (self.place + marker) + shift,
            frames=self.frames @ rotation.T,
            pivots=self.pivots @ rotation.T + shift,
        )
        turns = left_jacobian(turn)
        by_turn = moved._express_motion(cross_product_matrix(shift) @ turns, turns)
        by_shift = moved._express_motion(np.eye(3), np.zeros((3, 3)))
        axes = np.zeros((len(self.order), 3, 3))
        by_marker = moved._express_steps(rotation, axes, np.zeros((3, 3)))
        return moved, np.concatenate([by_shift, by_turn], axis=1), by_marker

    def _express_motion(self, shifts: Array, turns: Array) -> Array:
        """Steps of the unknowns (P,K) that move all that is seen by shifts (3,K) and by turns (3,K)
        about the camera.
        """
        place = shifts - cross_product_matrix(self.place) @ turns
        pivots = shifts - cross_product_matrix(self.pivots) @ turns
        return self._express_steps(place, pivots, turns)

    def _express_steps(self, place: Array, pivots: Array, turns: Array) -> Array:
        """Steps of the unknowns (P,K) that shift the marker by place (3,K) and the axes' points by
        pivots (n,3,K), and turn all axes by turns (3,K).

        No image tells the marker's distance: all lengths shrink where it would grow.
        """
        if len(self.lens):
            stretch = place[2] / self.place[2]
            place = place - self.place[:, None] * stretch
            pivots = pivots - self.pivots[..., None] * stretch
        steps = np.zeros((self.unknown_count, place.shape[1]))
        steps[: self.of_lens.start] = place[: self.of_lens.start]
        leans = self._leans @ turns
        shifts = self.frames[:, :2] @ pivots
        steps[self.of_lens.stop :] = np.concatenate([leans, shifts], axis=1).reshape(
            -1, place.shape[1]
        )
        return steps

    @cached_property
    def _leans(self) -> Array:
        """Unit turns (K,2,3) that lean each axis to its two sides."""
        return np.stack([self.frames[:, 1], -self.frames[:, 0]], axis=1)

    @cached_property
    def _rodrigues(self) -> tuple[Array, Array, Array]:
        """Parts (K,1,3,3) of each turn: constant, by its cosine and by its sine."""
        axis = self.frames[:, None, 2]
        along = axis[..., None] * axis[..., None, :]
        return along, np.eye(3) - along, cross_product_matrix(axis)

    def _turns(self, q: Array) -> Array:
        """The rotation (K,N,3,3) about each axis at q (N,M) rad (Rodrigues)."""
        angles = (q - self.middle)[:, self.order].T[..., None, None]
        along, across, sideways = self._rodrigues
        return np.asarray(along + np.cos(angles) * across + np.sin(angles) * sideways)


@dataclass(frozen=True, eq=False)
class AxisPlaces:
    """Axes from the camera on, and the marker, in the camera's axes at N postures: directions
    (N,K,3), a point of each (N,K,3), the rotation (N,3,3) of all, and the marker's place (N,3).
    """

    axes: Array
    points: Array
    rotation: Array
    marker: Array

    def meet_next(self) -> tuple[Array, Array]:
        """Where each axis but the last and the next one are nearest to each other: the point
        (N,K-1,3) of the next one, and that of its own. Parallel axes, within PARALLEL, are as near
        everywhere.
        """
        first = self.axes[:, :-1]
        second = self.axes[:, 1:]
        apart = self.points[:, 1:] - self.points[:, :-1]
        normal = cross_products(first, second)
        square = np.maximum(np.square(normal).sum(axis=-1, keepdims=True), PARALLEL**2)
        own = (cross_products(apart, second) * normal).sum(axis=-1, keepdims=True) / square
        ahead = (cross_products(apart, first) * normal).sum(axis=-1, keepdims=True) / square
        return self.points[:, 1:] + ahead * second, self.points[:, :-1] + own * first
