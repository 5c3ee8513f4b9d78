"""Landmarks on links: natural points whose places are
unknown, seen by one camera while the joints move.

Landmark j lies at the unknown place X_j of link l(j). A
row of sightings at image time t in image row v shows it at

    u, v = π(lens, camera · FK_l(q(t − τ + ρ (v/H − ½)) + δ) · X_j)

with the camera's delay τ of that log, its row time ρ (s from the first to the last row of an image,
H px high), and the joints' zeros δ. The unknowns that landmarks share are the rig's θ, then one
delay per log, then the row time.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..types import Array
from .camera import project_points
from .chain import Chain, cross_products
from .joint_motion import JointCurve
from .rig import Rig
from .rotations import left_jacobian, rotation_from_vector

DELAY_STD_S = 0.3
"""Prior std of a camera's delay."""
ROW_TIME_STD_S = 0.04
"""Prior std of the time between an image's first and last row."""
MOVED_STD = 0.1
"""m, rad: prior std of each part of a camera's move."""


@dataclass(frozen=True, eq=False)
class LandmarkBody:
    """A rigid part of the robot that can bear landmarks: its
    uppermost link, and the chain to it from the camera's.

    centre (3,) m and size m: where on it points are expected,
    from the origins of its links and of what hangs on it.
    """

    link: str
    chain: Chain
    centre: Array
    size: float


@dataclass(frozen=True, eq=False)
class LandmarkSightings:
    """Pieces of corner tracks, or landmarks found again,
    all logs together, each one's rows by log and time.

    piece (R,) from 0, ascending · log (R,) · t (R,) s, image
    times in their log · uv (R,2) px · height of images, px.
    """

    piece: Array
    log: Array
    t: Array
    uv: Array
    height: float

    @cached_property
    def begins(self) -> Array:
        """The first row (K,) of each piece."""
        return np.flatnonzero(np.diff(self.piece, prepend=-1))

    @property
    def count(self) -> int:
        """The number of pieces."""
        return len(self.begins)

    @property
    def lengths(self) -> Array:
        """The number of rows (K,) of each piece."""
        return np.diff(np.append(self.begins, len(self.piece)))

    def sums(self, values: Array) -> Array:
        """Sums (K,…) of rows (R,…) over each piece."""
        return np.asarray(np.add.reduceat(values, self.begins, axis=0))

    def take(self, pieces: Array) -> "LandmarkSightings":
        """The pieces with these numbers (k,), ascending, numbered from 0."""
        number = np.full(self.count, -1)
        number[pieces] = np.arange(len(pieces))
        rows = number[self.piece] >= 0
        return LandmarkSightings(
            number[self.piece[rows]], self.log[rows], self.t[rows], self.uv[rows], self.height
        )

    def thinned(self, every: int) -> "LandmarkSightings":
        """Every n-th row of each piece, beginning with its first."""
        place = np.arange(len(self.piece)) - self.begins[self.piece]
        rows = place % every == 0
        return LandmarkSightings(
            self.piece[rows], self.log[rows], self.t[rows], self.uv[rows], self.height
        )


@dataclass(frozen=True, eq=False)
class LandmarkBelief:
    """What earlier logs tell of the unknowns φ: mean (P,) and covariance (P,P)."""

    mean: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class LandmarkModel:
    """A rig with one camera and no markers, the bodies that
    bear landmarks, and the motion of each log's joints.

    Its unknowns φ (P,) are the rig's θ, one delay (s) per log, and the row time (s). belief: their
    prior where earlier logs tell of them; else they are independent, as the rig doubts them.
    placements: of each log, where the camera stands, 0 as in θ; of each other number 6 unknowns
    follow, by which its pose differs; empty where it stands in all alike.
    changes: whether 6 + M more follow, by which the camera's pose and the joints' zeros differ from
    those of the logs that placed the landmarks.
    """

    rig: Rig
    bodies: tuple[LandmarkBody, ...]
    motions: tuple[JointCurve, ...]
    belief: LandmarkBelief | None = None
    changes: bool = False
    placements: tuple[int, ...] = ()

    @cached_property
    def prior_precision(self) -> Array:
        """The inverse (P,P) of the prior's covariance."""
        std = self.prior[1]
        if self.belief is None:
            return np.diag(std**-2.0)
        scaled = self.belief.covariance / std / std[:, None]
        return np.asarray(np.linalg.inv(scaled) / std / std[:, None])

    @cached_property
    def prior(self) -> tuple[Array, Array]:
        """Prior mean (P,) and standard deviation (P,) of φ."""
        if self.belief is not None:
            return self.belief.mean, np.sqrt(np.diag(self.belief.covariance))
        mean, std = self.rig.prior
        logs = len(self.motions)
        moves = 6 * max(self.placements, default=0)
        return (
            np.concatenate([mean, np.zeros(logs + 1 + moves)]),
            np.concatenate(
                [std, np.full(logs, DELAY_STD_S), [ROW_TIME_STD_S], np.full(moves, MOVED_STD)]
            ),
        )

    @property
    def of_delays(self) -> slice:
        """The logs' delays in φ."""
        return slice(self.of_row_time - len(self.motions), self.of_row_time)

    @property
    def of_row_time(self) -> int:
        """The row time in φ."""
        return len(self.rig.prior[0]) + len(self.motions)

    @property
    def of_moves(self) -> slice:
        """The poses of placements other than the first in φ, less that of the first."""
        begin = self.of_row_time + 1
        return slice(begin, begin + 6 * max(self.placements, default=0))

    def of_placement(self, placement: int) -> slice:
        """The six of these of one placement, numbered from 1."""
        begin = self.of_moves.start + 6 * (placement - 1)
        return slice(begin, begin + 6)

    def rows_by_placement(self, log: Array) -> Iterator[tuple[int, Array]]:
        """Yield each placement and the rows, whose logs are (R,), that show it."""
        placement = np.array(self.placements or [0] * len(self.motions))[log]
        for number in np.unique(placement).tolist():
            yield number, np.flatnonzero(placement == number)

    @property
    def of_camera_change(self) -> slice:
        """The change of the camera's pose in φ; empty where there are no changes."""
        begin = self.of_moves.stop
        return slice(begin, begin + 6 if self.changes else begin)

    @property
    def of_changes(self) -> slice:
        """The changes of the joints' zeros in φ; empty where there are none."""
        begin = self.of_camera_change.stop
        return slice(begin, begin + len(self.rig.joints) if self.changes else begin)

    def changed(self, phi: Array, placement: int = 0) -> Array:
        """The rig's θ with the changes in it, and the camera at one of its placements."""
        theta = phi[: len(self.rig.prior[0])].copy()
        if placement:
            theta[:6] += phi[self.of_placement(placement)]
        if self.changes:
            theta[:6] += phi[self.of_camera_change]
            theta[self.rig.of_joints] += phi[self.of_changes]
        return theta

    def joints_at(self, phi: Array, seen: LandmarkSightings) -> tuple[Array, Array, Array]:
        """Joint angles and speeds (R,M) when each row was
        exposed, and its row's share (R,) of the image, −½ to ½.
        """
        share = seen.uv[:, 1] / seen.height - 0.5
        exposed = seen.t - phi[self.of_delays][seen.log] + phi[self.of_row_time] * share
        joints = len(self.rig.joints)
        angles = np.empty((len(exposed), joints))
        speeds = np.empty((len(exposed), joints))
        for log, motion in enumerate(self.motions):
            rows = seen.log == log
            angles[rows], speeds[rows] = motion.at(exposed[rows])
        return angles, speeds, share

    def frames(self, phi: Array, angles: Array, body: int, log: Array) -> tuple[Array, Array]:
        """Rotation (R,3,3) and place (R,3) m of a body in the camera at joint angles (R,M) of the
        logs with numbers (R,)."""
        poses = self.bodies[body].chain.at(self.rig.angles(self.changed(phi), angles))
        rotation = np.empty_like(poses.rotation)
        place = np.empty_like(poses.place)
        for placement, rows in self.rows_by_placement(log):
            camera = self.rig.camera_pose(0, self.changed(phi, placement))
            rotation[rows] = camera[:3, :3] @ poses.rotation[rows]
            place[rows] = poses.place[rows] @ camera[:3, :3].T + camera[:3, 3]
        return rotation, place

    def predict(
        self, phi: Array, seen: LandmarkSightings, body: Array, places: Array
    ) -> "Prediction":
        """Predict the rows of pieces on the bodies with numbers (K,), at places (K,3) m on them."""
        return _predict_images(self, phi, seen, body, places)


@dataclass(frozen=True, eq=False)
class Prediction:
    """image (R,2) px · by_place (R,2,3) px/m · by_shared
    (R,2,P) by φ · by_joints (R,2,M) px/rad · depth (R,) m.
    """

    image: Array
    by_place: Array
    by_shared: Array
    by_joints: Array
    depth: Array


def _predict_images(
    model: LandmarkModel, phi: Array, seen: LandmarkSightings, body: Array, places: Array
) -> Prediction:
    rig = model.rig
    rows = len(seen.piece)
    theta = model.changed(phi)
    angles, speeds, share = model.joints_at(phi, seen)
    image = np.empty((rows, 2))
    depth = np.empty(rows)
    by_place = np.empty((rows, 2, 3))
    by_joints = np.empty((rows, 2, len(rig.joints)))
    by_shared = np.zeros((rows, 2, len(phi)))
    anchor = rig.cameras[0].anchor
    body_of_row = body[seen.piece]
    groups = [
        (int(number), placement, rows[body_of_row[rows] == number])
        for placement, rows in model.rows_by_placement(seen.log)
        for number in np.unique(body)
    ]
    for number, placement, at in groups:
        pose = model.changed(phi, placement)[:6]
        turn = rotation_from_vector(pose[3:])
        chain = model.bodies[number].chain
        poses = chain.at(rig.angles(theta, angles[at]))
        linked = np.einsum("nij,nj->ni", poses.rotation, places[seen.piece[at]]) + poses.place
        turned = (linked @ anchor[:3, :3].T + anchor[:3, 3]) @ turn.T
        seen_at, by_point, by_lens = project_points(turned + pose[:3], theta[6:12])
        to_link = by_point @ (turn @ anchor[:3, :3])
        image[at] = seen_at
        depth[at] = turned[:, 2] + pose[2]
        by_place[at] = to_link @ poses.rotation
        by_joints[at] = to_link @ chain.slopes(poses, linked[:, None])[:, 0]
        by_shared[at, :, :3] = by_point
        # of a turn dw the point moves by dw × p, and aᵀ (dw × p) = (p × a)ᵀ dw
        by_turn = cross_products(turned[:, None], by_point)
        by_shared[at, :, 3:6] = (by_turn.reshape(-1, 3) @ left_jacobian(pose[3:])).reshape(-1, 2, 3)
        by_shared[at, :, 6:12] = by_lens
        if placement:
            by_shared[at, :, model.of_placement(placement)] = by_shared[at, :, :6]
    by_shared[:, :, rig.of_joints] = by_joints
    by_time = np.einsum("nim,nm->ni", by_joints, speeds)
    delays = model.of_delays.start + seen.log
    by_shared[np.arange(rows), :, delays] = -by_time
    by_shared[:, :, model.of_row_time] = by_time * share[:, None]
    if model.changes:
        by_shared[:, :, model.of_camera_change] = by_shared[:, :, :6]
        by_shared[:, :, model.of_changes] = by_joints
    return Prediction(image, by_place, by_shared, by_joints, depth)


def join_landmark_tracks(
    pieces: Sequence[tuple[Array, Array, Array]], height: float
) -> LandmarkSightings:
    """Join the logs' tracks: of each log (piece (R,), t (R,) s, uv (R,2) px)."""
    numbers = []
    logs = []
    offset = 0
    for log, (piece, _, _) in enumerate(pieces):
        numbers.append(piece + offset)
        logs.append(np.full(len(piece), log))
        offset += int(piece[-1]) + 1 if len(piece) else 0
    t = np.concatenate([part[1] for part in pieces])
    uv = np.concatenate([part[2] for part in pieces])
    return LandmarkSightings(np.concatenate(numbers), np.concatenate(logs), t, uv, height)
