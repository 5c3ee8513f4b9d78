"""A forward model with kinematics and a camera as
its mean, and a Gaussian process on the residuals.
"""

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from ...body_model import UNUSED_URDF, BodyModel
from ...errors import ModelError
from ...kinematics.instant import Instant, compile_predictor
from ...kinematics.pose import Base, bend_still_joints, rise_in_base
from ...kinematics.rig import Rig, RigPrediction, Sight
from ...types import Array
from ..gp.model import GP, se_kernel

_ROWS = 2048
_STEP = 1e-4


@dataclass(frozen=True, eq=False)
class KinematicGP(GP):
    """One point of one marker before one camera; the fields
    of GP are those of the residual, whose mean is zero.

    rig: one camera, one marker, one sight of one point · theta (P,), of greatest posterior · root
    (P,p): θ's covariance is root rootᵀ · lean (D,p,n): weights with which the samples predict
    root's columns · drift (D,) px²: variance of an error that lasts longer than a log · base: the
    chain from the robot's root to the marker, or to a moving camera, if known.

    printed (P,): θ of the calibration, which has the least error without the process · resting
    (K+1,4,4): the fixed steps of the chain with the zeros of joints that stood still, as printed;
    None where none did.
    """

    rig: Rig
    theta: Array
    root: Array
    lean: Array
    drift: Array
    printed: Array
    base: Base | None = None
    resting: Array | None = None

    @classmethod
    def on(cls, plain: GP, rig: Rig, **unknowns: Any) -> Self:
        """Build the model on a residual process `plain`."""
        residual: dict[str, Any] = {field.name: getattr(plain, field.name) for field in fields(GP)}
        return cls(**residual, rig=rig, **unknowns)

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        """Predict at x (N,M) rad: mean (N,D) · Jacobian (N,D,M)
        per rad · variance (N,D), sensor noise excluded.
        """
        x = np.atleast_2d(x)
        if len(x) == 1:
            one = self.predict_one(x[0])
            return one[0][None], one[1][None], one[2][None]
        if len(x) > _ROWS:
            parts = [self.predict(x[start : start + _ROWS]) for start in range(0, len(x), _ROWS)]
            value, slope, spread = (np.concatenate(column) for column in zip(*parts, strict=True))
            return value, slope, spread
        value, slope, spread = super().predict(x)
        seen = self._seen(x)
        unknown = np.square(self._unknown(x, seen)).sum(axis=2)
        return value + seen.image[:, 0], slope + seen.slope[:, 0], spread + unknown + self.drift

    def predict_one(self, x: Array) -> tuple[Array, Array, Array]:
        """Predict at one x (M,) rad: mean (D,) · Jacobian (D,M) per rad · variance (D,)."""
        single, (image, by_joints, design) = self._singles[0], self._instant(x)
        kernel, tilt = single.kernel(x - self._origin)
        sums = self._rows.dot(kernel)
        own = len(single.rows)
        value, slope, spread = single.evaluate(sums[:own], tilt)
        unknown = design.dot(self.root)
        unknown -= sums[own:].reshape(unknown.shape)
        spread = spread + self.drift
        spread += np.einsum("dp,dp->d", unknown, unknown)
        return value + image, slope + by_joints, spread

    def means(self, x: Array) -> tuple[Array, Array]:
        """Predict at x (N,M) rad: mean (N,D) · Jacobian (N,D,M) per rad, without the variance."""
        value, slope = super().means(x)
        seen = self._seen(x)
        return value + seen.image[:, 0], slope + seen.slope[:, 0]

    def kinematics(self, x: Array) -> Array:
        """Predict at x (N,M) rad by the calibration alone: (N,D) px."""
        return self.kinematics_of_points(x, self.rig.sights[0].points)[:, 0]

    def kinematics_of_points(self, x: Array, points: Array) -> Array:
        """Predict points (C,3) m of the marker at x (N,M) rad by the calibration: (N,C,2) px."""
        sight = replace(self._printed_sight, points=points)
        return np.asarray(self.rig.see(sight, self.printed, np.atleast_2d(x)).image)

    def design(self, x: Array) -> Array:
        """Derivative by θ of kinematics and camera at x (N,M) rad: (N,D,P) px per unit of θ."""
        return np.asarray(self._seen(np.atleast_2d(x)).design[:, 0])

    def unknowns(self, x: Array) -> Array:
        """Effect (N,D,p), px, of one standard deviation of
        each direction of θ at x (N,M) rad, given the samples.
        """
        return self._unknown(x, self._seen(x))

    def covariance(self, x: Array) -> Array:
        """Covariance between all pairs of x (N,M) rad: (1,N,N) px², the outputs' mean."""
        leaning = self._unknown(x, self._seen(x)) / np.sqrt(self.share)[:, None]
        return np.asarray(
            super().covariance(x)
            + np.einsum("ndp,kdp->nk", leaning, leaning)[None] / len(self.share)
        )

    def slope_variance(self, x: Array) -> Array:
        """Variance of the Jacobian at x (N,M) rad: (N,D,M) per rad squared."""
        result = super().slope_variance(x)
        for m in range(x.shape[1]):
            step = _STEP * np.eye(x.shape[1])[m]
            above, below = (self._unknown(x + way, self._seen(x + way)) for way in (step, -step))
            result[..., m] += np.square((above - below) / (2.0 * _STEP)).sum(axis=2)
        return result

    def hand_levers(self, x: Array) -> Array | None:
        """How far the marker rises with each joint (N,M), m per rad, at x (N,M) rad: minus the torque
        of a unit weight there. None where the robot's root does not carry it.

        A URDF's root stands upright.
        """
        if self.base is None or self.base.camera:
            return None
        return rise_in_base(self.base, self.rig, self.theta, x)

    @property
    def still_joints(self) -> tuple[str, ...]:
        """Names (R,) of joints that stood still in the exploration and may carry the marker."""
        return () if self.base is None else self.base.still_joints

    def show_still_joints(self, x: Array) -> tuple[Array, Array]:
        """What each joint that stood still moves the marker's image by (N,D,R), px per rad or m,
        and how far the marker rises with it (N,R), m, at x (N,M) rad.
        """
        if self.base is None or self.base.hand is None:
            return np.zeros((len(x), len(self.drift), 0)), np.zeros((len(x), 0))
        moved, rise = bend_still_joints(self.base, self.rig, self.theta, x)
        first = self.rig.of_carrier(0).start
        return self.design(x)[:, :, first : first + 3] @ moved, rise

    @property
    def offsets(self) -> tuple[Array, Array]:
        """The joints' zeros (M,) rad or m, and their covariance (M,M)."""
        part = self.rig.of_joints
        return self.theta[part], np.asarray(self.root[part] @ self.root[part].T)

    @property
    def _printed_sight(self) -> Sight:
        """The sight with the zeros of joints that stood still."""
        sight = self.rig.sights[0]
        if self.resting is None:
            return sight
        return replace(sight, chain=replace(sight.chain, fixed=self.resting))

    @cached_property
    def _instant(self) -> Instant:
        return compile_predictor(self.rig, self.theta)

    @cached_property
    def _rows(self) -> Array:
        """The process's rows and below them lean's (D p,n), of a kernel of amplitude 1."""
        leaning = self.lean.reshape(-1, self.lean.shape[2]) * self.amplitude[0]
        return np.asfortranarray(np.concatenate([self._singles[0].rows, leaning]))

    def _seen(self, x: Array) -> RigPrediction:
        return self.rig.see(self.rig.sights[0], self.theta, x)

    def _unknown(self, x: Array, seen: RigPrediction) -> Array:
        """Effect (N,D,p), px, of one standard deviation
        of each direction of θ, given the samples.
        """
        scales = self.scales[0]
        kernel = se_kernel(x / scales, self.centres / scales, self.amplitude[0])
        return np.asarray(
            seen.design[:, 0] @ self.root - np.einsum("nk,dpk->ndp", kernel, self.lean)
        )


def can_show_changes(body: BodyModel) -> bool:
    """Whether a body can show changes: it was learned with a URDF, and its encoders read angles."""
    return "encoders" not in body.senses and any(
        isinstance(s, KinematicGP) for s in body.senses.values()
    )


def kinematic_senses(body: BodyModel, lacking: str) -> dict[str, KinematicGP]:
    """The senses with a URDF's chain; ModelError without
    any: what is lacking, and why the URDF given is not used.
    """
    senses = {name: sense for name, sense in body.senses.items() if isinstance(sense, KinematicGP)}
    if not senses:
        why = body.provenance.get(UNUSED_URDF)
        todo = f"as {why}" if why else "type: bodylog fit LOG --urdf ROBOT.urdf"
        raise ModelError(
            f"learned without a URDF, so without {lacking}{', ' if why else '; '}{todo}"
        )
    return senses
