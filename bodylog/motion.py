"""How joints move: the table of motion models, and white noise on time nodes, whose precision
is banded, so that solutions take linear time.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import factorial
from typing import Protocol

import numpy as np

from .types import Array

MAX_ORDER = 3
"""Most states of a joint, as NOISE_SHARES of kernels.py has them: angle, rate, acceleration."""


START_STD = (1.0, 1.0, 3.0)
"""rad, rad/s, rad/s²: prior standard deviations of joints before the first reading.

With (2, 3, 10) filters of 177 drawn logs err up to 4 % more, of (0.5, 0.3, 1) up to 5 % less, but
then a robot that moves at first is taken for still.
"""


class MotionModel(Protocol):
    """How a joint's states move: angle (rad) and rate, and for order 3 acceleration.

    Over short times it is white noise in the derivative `order`: its density, the process noise of
    a joint in rad²/s³ or rad²/s⁵, is learned from a log or set.
    """

    @property
    def order(self) -> int:
        """Number p of states: 2 or 3."""

    def transition(self, gap: Array) -> Array:
        """Matrices (K,p,p) that move the states over the gaps (K,) s."""

    def covariance(self, gap: Array) -> Array:
        """Covariance (K,p,p) that the states gain over the gaps (K,) s by unit process noise."""


@dataclass(frozen=True)
class WhiteNoise:
    """White noise in the derivative `order`: what the compiled filter knows.

    Other models go to it as matrices of each step.
    """

    order: int

    def transition(self, gap: Array) -> Array:
        """Taylor's series over the gaps."""
        return motion_transition(self.order, gap)

    def covariance(self, gap: Array) -> Array:
        """Covariance that integrated white noise gains over the gaps."""
        return motion_covariance(self.order, gap)


WHITE_ACCELERATION = "white-acceleration"
WHITE_JERK = "white-jerk"
MOTION_MODELS: dict[str, MotionModel] = {
    WHITE_ACCELERATION: WhiteNoise(2),
    WHITE_JERK: WhiteNoise(3),
}
"""Motion models by their names in `[estimate] motion`; a new one is a class and a line here."""
PROCESS_UNITS: Mapping[int, str] = {2: "rad²/s³", MAX_ORDER: "rad²/s⁵"}
"""Unit of process noise by the order of the motion."""


class Stationary:
    """Stationary motion of an order O, exactly discretised: of a joint whose encoder is silent
    for long, so that its variance stays bounded.

    The angle keeps to its usual mean, and angle, rate and acceleration to their usual variances
    v₀, v₁, v₂; noise enters with the density q of the motion. These determine the process:
    x‴ = −d (v₁/v₀) x − (v₂/v₁) x′ − d x″ + w with d = q / 2(v₂ − v₁²/v₀), or
    x″ = −(v₁/v₀) x − (q/2v₁) x′ + w. Over short times it is white jerk or acceleration.
    """

    def __init__(self, mean: Array, var: Array, process: Array) -> None:
        """Motion about mean (M,) rad with variances var (O,M)
        of the angles and their derivatives; process (M,).
        """
        order = len(var)
        rates = np.zeros((len(mean), len(var), len(var)))
        rates[:, range(order - 1), range(1, order)] = 1.0
        self.mean = mean
        self.process = process
        self._cov = np.zeros((order, order, len(mean)))
        self._cov[range(order), range(order)] = var
        if order == 2:
            rates[:, 1] = -np.stack([var[1] / var[0], 0.5 * process / var[1]], axis=1)
        else:
            self._cov[0, 2] = -var[1]
            self._cov[2, 0] = -var[1]
            damping = 0.5 * process / (var[2] - var[1] ** 2 / var[0])
            rates[:, 2] = -np.stack([damping * var[1] / var[0], var[2] / var[1], damping], axis=1)
        self._poles, self._axes = np.linalg.eig(rates)
        self._back = np.linalg.inv(self._axes)

    def step(self, dt: Array) -> tuple[Array, Array, Array]:
        """Move (O,O,M,B), shift (O,M,B) and noise (O,O,M,B) within dt (B,) s."""
        fade = np.exp(self._poles[..., None] * dt)
        cov = self._cov[..., None]
        mean = self.mean[:, None]
        move = np.einsum("jab,jbt,jbc->acjt", self._axes, fade, self._back).real
        noise = cov - np.einsum(
            "abjt,bcjt,dcjt->adjt", move, np.broadcast_to(cov, move.shape), move
        )
        shift = -move[:, 0] * mean
        shift[0] += mean
        return move, shift, 0.5 * (noise + noise.swapaxes(0, 1))


def motion_covariance(order: int, gap: Array) -> Array:
    """Covariance (K,p,p) of (angle, rate, …) after the
    gaps for unit white noise in the p-th derivative.
    """
    back = np.arange(order - 1, -1, -1)
    scale = np.array([factorial(int(b)) for b in back], float)
    power = back[:, None] + back + 1.0
    return np.asarray(gap[:, None, None] ** power / (power * scale[:, None] * scale))


def motion_transition(order: int, gap: Array) -> Array:
    """Transition (K,p,p) of (angle, rate, …) over the gaps."""
    lag = np.arange(order)[None, :] - np.arange(order)[:, None]
    coefficient = np.array(
        [[1.0 / factorial(int(k)) if k >= 0 else 0.0 for k in row] for row in lag]
    )
    return np.asarray(coefficient * gap[:, None, None] ** np.maximum(lag, 0))


def motion_precision(order: int, gap: Array) -> tuple[Array, Array]:
    """Precision of (angle, rate, …) on nodes with gaps
    (K-1,), unit density: diagonal (K,p,p), upper (K-1,p,p).
    """
    step = motion_transition(order, gap)
    grow = gap[:, None] ** (order - np.arange(order) - 0.5)
    unit = np.linalg.inv(motion_covariance(order, np.ones(1))[0])
    inverse = unit / (grow[:, :, None] * grow[:, None, :])
    diagonal = np.zeros((len(gap) + 1, order, order))
    diagonal[1:] += inverse
    leant = np.matmul(step.transpose(0, 2, 1), inverse)
    diagonal[:-1] += np.matmul(leant, step)
    return diagonal, -leant


def motion_log_determinant(order: int, gap: Array) -> float:
    """ln|precision| of all nodes but the first, unit density."""
    constant = np.linalg.slogdet(motion_covariance(order, np.ones(1))[0])[1]
    return float(-len(gap) * constant - order**2 * np.log(gap).sum())


def band_storage(diagonal: Array, upper: Array) -> Array:
    """Upper band storage (2p, K p) of the block-tridiagonal matrix, for LAPACK's pb routines."""
    count, order, _ = diagonal.shape
    band = np.zeros((2 * order, count * order))
    for i in range(order):
        for j in range(order):
            if j >= i:
                band[2 * order - 1 - (j - i), j::order] = diagonal[:, i, j]
            band[order - 1 - (j - i), order + j :: order] = upper[:, i, j]
    return band


def solve_banded_system(band: Array, right: Array) -> tuple[float, Array]:
    """ln|A| and A⁻¹ right (n,k) of a banded positive definite A."""
    from scipy.linalg.lapack import dpbtrf, dpbtrs

    factor, failed = dpbtrf(band, lower=0)
    if failed:
        raise np.linalg.LinAlgError("the motion prior is too stiff for these times")
    solved, _ = dpbtrs(factor, right, lower=0)
    return 2.0 * float(np.log(factor[-1]).sum()), np.asarray(solved)
