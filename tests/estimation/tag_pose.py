"""A sense of six rows in one file: a tag's pose in the camera (m and rotation vector, rad), from its corners and size.

Four corners u (8,) of a tag of known size give the pose p that projects onto them, by Gauss–Newton; with A = ∂u/∂p and
A⁺ its pseudo-inverse weighted by W = Σᵤ⁻¹, the pose has covariance (AᵀWA)⁻¹, with correlated rows. A body that predicts
the corners predicts the pose: g(x) is the pose of the predicted corners, J = A⁺ Jᵤ, with variance diag(A⁺ Vᵤ A⁺ᵀ).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bodylog.body_model import BodyModel, ForwardModel
from bodylog.estimation.measurements.records import Measured, Sighting
from bodylog.kinematics.camera import project_points
from bodylog.kinematics.rotations import (
    cross_product_matrix,
    left_jacobian,
    nearest_rotation,
    rotation_from_vector,
    vector_from_rotation,
)
from bodylog.types import Array, Features, Health, Series

ROWS = ("x", "y", "z", "rx", "ry", "rz")
"""m, and rad."""
STEPS, STILL = 30, 1e-10
"""Most Gauss–Newton steps, and the size of the last one (m and rad)."""
SURE = 20.0
"""Nats by which a pose must explain its corners better than its mirror image about the line of sight."""


@dataclass(frozen=True, eq=False)
class PoseModel:
    """Predicts the pose of a tag whose four corners `models` predict.

    points (4,3) m on the tag · lens (6,) as in `kinematics.camera`.
    """

    models: tuple[ForwardModel, ...]
    points: Array
    lens: Array
    unit = "m, rad"

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the six rows."""
        return ROWS

    @property
    def reach(self) -> Array:
        """Correlation length (M,) or () rad of the model's errors."""
        return np.asarray(np.min([np.asarray(getattr(model, "reach", np.inf)) for model in self.models], axis=0))

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        """Predict at x (N,M) rad: mean (N,6) m and rad · Jacobian (N,6,M) · variance (N,6), sensor noise excluded."""
        corners, slopes, spreads = zip(*(model.predict(x) for model in self.models), strict=True)
        u, jac, var = (np.stack(parts, axis=1) for parts in (corners, slopes, spreads))
        poses, gains = zip(*(self._solved(one) for one in u), strict=True)
        gain = np.array(gains)
        slope = np.einsum("npk,nkm->npm", gain, jac.reshape(len(x), 8, -1))
        return np.array(poses), slope, np.einsum("npk,nk->np", np.square(gain), var.reshape(len(x), 8))

    def _solved(self, corners: Array) -> tuple[Array, Array]:
        """The pose (6,) of corners (4,2) px, and A⁺ (6,8)."""
        found = solved(corners, np.ones(8), self.points, self.lens)
        return found.pose, found.gain


@dataclass(frozen=True, eq=False)
class Solved:
    """A pose (6,) · its derivative by the corners' pixels, A⁺ (6,8) · covariance (6,6) · half the squared residuals."""

    pose: Array
    gain: Array
    cov: Array
    cost: float


class TagPose:
    """A tag with four corner tracks NAME.0 to NAME.3 on a board, seen by a camera with a lens."""

    def __init__(self, lens: Array) -> None:
        """Take lens (6,): ln f (px), ln of fv over fu, centre (px), k1, k2."""
        self._lens = lens

    def __call__(self, features: Features, body: BodyModel) -> Mapping[str, Measured]:
        """Read the tags whose corners are all tracked and predicted."""
        boards = features.boards.items()
        tags = (name for name, (tracks, _) in boards if len(tracks) == 4 and set(tracks) <= set(body.senses))
        return {f"{name}.pose": self._read(name, features, body) for name in tags}

    def _read(self, name: str, features: Features, body: BodyModel) -> Measured:
        """Read poses (N,6) and covariances (N,6,6) of a tag; NaN where corners are unseen or the pose is ambiguous."""
        tracks, points = features.boards[name]
        seen = [features.tracks[track] for track in tracks]
        corners, var = np.stack([one.values for one in seen], axis=1), _variances(seen, tracks, body)
        values, cov = np.full((len(corners), 6), np.nan), np.tile(np.eye(6), (len(corners), 1, 1))
        for row in np.flatnonzero(np.isfinite(corners).all(axis=(1, 2))):
            found = unambiguous(corners[row], var[row], points, self._lens)
            if found is not None:
                values[row], cov[row] = found.pose, found.cov
        model = PoseModel(tuple(body.senses[track] for track in tracks), points, self._lens)
        first, use = seen[0], int(np.isfinite(values[:, 0]).sum())
        own = np.einsum("ndd->nd", cov).copy()
        sighting = Sighting(f"{name}.pose", model, first.t, values, own, first.source_ns, cov=cov)
        return Measured(sighting, Health(len(values), use, {"out of view, or of two poses": len(values) - use}))


def _variances(seen: Sequence[Series], tracks: Sequence[str], body: BodyModel) -> Array:
    """Variances (N,8) px² of the corners: stated std plus the learned excess, else as learned."""
    parts = []
    for one, name in zip(seen, tracks, strict=True):
        learned = np.asarray(body.noise.senses.get(name, (1.0, 1.0)), float)
        beyond = getattr(body.senses[name], "noise", 0.0)
        parts.append(np.broadcast_to(learned if one.std is None else one.std**2 + beyond, one.values.shape))
    return np.concatenate(parts, axis=1)


def unambiguous(corners: Array, var: Array, points: Array, lens: Array) -> Solved | None:
    """The pose of corners (4,2) px with variances (8,); None where its mirror image explains them nearly as well."""
    best = solved(corners, var, points, lens)
    other = _descended(corners, var, points, lens, *_mirrored(best.pose))
    low, high = sorted((best, other), key=lambda one: one.cost)
    same = np.abs(low.pose - high.pose).max() < 1e-6
    return low if same or high.cost - low.cost > SURE else None


def solved(corners: Array, var: Array, points: Array, lens: Array) -> Solved:
    """The pose that projects points (4,3) m onto corners (4,2) px with variances (8,)."""
    return _descended(corners, var, points, lens, *_start(corners, points, lens))


def _descended(corners: Array, var: Array, points: Array, lens: Array, at: Array, turn: Array) -> Solved:
    """Gauss–Newton from a position (3,) m and a rotation (3,3)."""
    for _ in range(STEPS):
        image, slope = _projected(points, lens, at, turn)
        left, scaled = (corners - image).ravel(), slope / var[:, None]
        information = scaled.T @ slope
        step = np.linalg.solve(information, scaled.T @ left)
        at, turn = at + step[:3], rotation_from_vector(step[3:]) @ turn
        if np.abs(step).max() < STILL:
            break
    vector = vector_from_rotation(turn)
    # from a small rotation to a change of the rotation vector
    local = np.eye(6)
    local[3:, 3:] = np.linalg.inv(left_jacobian(vector))
    cov = local @ np.linalg.inv(information) @ local.T
    gain = local @ np.linalg.solve(information, scaled.T)
    return Solved(np.concatenate([at, vector]), gain, 0.5 * (cov + cov.T), float(0.5 * (left**2 / var).sum()))


def _projected(points: Array, lens: Array, at: Array, turn: Array) -> tuple[Array, Array]:
    """Image points (4,2) px and their derivatives (8,6) by the tag's position and rotation."""
    arms = points @ turn.T
    image, by_point, _ = project_points(arms + at, lens)
    slope = np.concatenate([by_point, by_point @ -cross_product_matrix(arms)], axis=2)
    return image, slope.reshape(-1, 6)


def _start(corners: Array, points: Array, lens: Array) -> tuple[Array, Array]:
    """Position (3,) m and rotation (3,3) from the homography of the tag's plane, without distortion."""
    focal = np.exp(lens[0]) * np.array([1.0, np.exp(lens[1])])
    flat, plane = (corners - lens[2:4]) / focal, points[:, :2]
    rows = [[x, y, 1.0, 0.0, 0.0, 0.0, -a * x, -a * y, -a] for (x, y), (a, _) in zip(plane, flat, strict=True)] + [
        [0.0, 0.0, 0.0, x, y, 1.0, -b * x, -b * y, -b] for (x, y), (_, b) in zip(plane, flat, strict=True)
    ]
    homography = np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3)
    homography = homography / (0.5 * np.linalg.norm(homography[:, :2], axis=0).sum())
    homography = homography * np.sign(homography[2, 2])
    first, second = homography[:, 0], homography[:, 1]
    return homography[:, 2], nearest_rotation(np.column_stack([first, second, np.cross(first, second)]))


def _mirrored(pose: Array) -> tuple[Array, Array]:
    """Position and rotation of the pose whose normal is mirrored about the line of sight."""
    at, turn = pose[:3], rotation_from_vector(pose[3:])
    sight = at / np.linalg.norm(at)
    return at, (2.0 * np.outer(sight, sight) - np.eye(3)) @ turn @ np.diag([-1.0, -1.0, 1.0])
