"""Inputs of the filter kernel: dynamics and the readings of each stretch.

The gate of the filter: readings too far from the belief to be Gaussian.

Motion of a joint whose encoder is silent for long: a
stationary process, so that its variance stays bounded.

The angle keeps to its usual mean, and angle, rate and acceleration to their usual variances v₀, v₁,
v₂; noise enters with the density q of the motion. These determine the process: x‴ = −d (v₁/v₀) x −
(v₂/v₁) x′ − d x″ + w with d = q / 2(v₂ − v₁²/v₀), or x″ = −(v₁/v₀) x − (q/2v₁) x′ + w. Over short
times it is white jerk or acceleration.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...motion import MOTION_MODELS, WHITE_ACCELERATION, MotionModel, WhiteNoise
from ...types import Array

GATE_SIGMA = 5.0
"""Standard deviations: a larger innovation d has its noise
inflated so that its weight falls as (GATE_SIGMA/d)⁴.
"""
FLAT_COST_NATS = 1.0
"""Nats from the gate's ½ GATE² to an outlier's cost anywhere:
one in a hundred in an image of 320×240 px costs 14.
"""


class Stationary:
    """Stationary motion of an order O, exactly discretised."""

    def __init__(self, mean: Array, var: Array, process: Array) -> None:
        """Motion about mean (M,) rad with variances var (O,M)
        of the angles and their derivatives; process (M,).
        """
        order = len(var)
        rates = np.zeros((len(mean), len(var), len(var)))
        rates[:, range(order - 1), range(1, order)] = 1.0
        self.mean, self.process, self._cov = mean, process, np.zeros((order, order, len(mean)))
        self._cov[range(order), range(order)] = var
        if order == 2:
            rates[:, 1] = -np.stack([var[1] / var[0], 0.5 * process / var[1]], axis=1)
        else:
            self._cov[0, 2] = self._cov[2, 0] = -var[1]
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


@dataclass(frozen=True, eq=False)
class FilterDynamics:
    """Process noise (M,) of joints, rad²/s³ or rad²/s⁵ ·
    random walk (M,) rad²/s of offsets, or None; or (M,C).

    is_prior (M,) bool: joints whose readings come from the posture prior; they do not count as
    evidence · motion: name of their motion model · stationary: motion of joints whose encoders are
    silent for long, or None. A state holds all joints' angles, rates[, accelerations][, encoder
    offsets].
    """

    process: Array
    drift: Array | None = None
    is_prior: Array | None = None
    motion: str = WHITE_ACCELERATION
    stationary: Stationary | None = None

    @property
    def model(self) -> MotionModel:
        """How joints move."""
        return MOTION_MODELS[self.motion]

    @property
    def order(self) -> int:
        """Number of states of a joint without its offset."""
        return self.model.order

    @property
    def size(self) -> int:
        """Length K of the state."""
        return len(self.process) * (self.order + (self.drift is not None))

    @property
    def offset(self) -> int | None:
        """Index of the first encoder offset in the state; None without offsets."""
        return None if self.drift is None else self.order * len(self.process)

    def silent_moves(self, dt: Array, held: Array) -> tuple[Array, Array, Array]:
        """Move (E,S,S,M), shift (E,S,M) and noise (E,S,S,M) of
        joints held (E,M) for dt (E,) s: a stationary process.

        The move of other joints is NaN.
        """
        assert self.stationary is not None
        m = len(self.process)
        order = self.order
        some = np.flatnonzero(held.any(axis=1))
        states = self.size // m
        move, noise = np.zeros((2, len(dt), states, states, m))
        shift = np.zeros((*move.shape[:-2], m))
        parts = move[:, :order, :order], shift[:, :order], noise[:, :order, :order]
        for whole, step in zip(parts, self.stationary.step(dt[some]), strict=True):
            whole[some] = np.moveaxis(step, -1, 0)
        if self.drift is not None:
            move[:, order, order], noise[:, order, order] = 1.0, self.drift * dt[:, None]
        np.moveaxis(move, -1, 1)[~held] = np.nan
        return move, shift, noise

    def with_moves(self, readings: "FilterReadings") -> "FilterReadings":
        """The readings with every joint's move, where the kernel does not know the motion model.

        Candidates, with process noise (M,C) of their own, get readings of their own.
        """
        if type(self.model) is WhiteNoise:
            return readings
        process = np.reshape(self.process, (len(self.process), -1))
        if (candidates := process.shape[1] // readings.dt.shape[1]) > 1:
            readings = readings.repeated(candidates)
        dt = readings.dt
        order, states = self.order, self.size // len(process)
        density = np.broadcast_to(process, (len(dt), len(process), dt.shape[1]))
        if readings.more is not None:
            density = density * readings.more
        shape = (len(dt), states, states, len(process), dt.shape[1])
        move, noise = np.zeros((2, *shape))
        steps = (
            np.moveaxis(part(dt.ravel()).reshape(*dt.shape, order, order), 1, -1)[..., None, :]
            for part in (self.model.transition, self.model.covariance)
        )
        move[:, :order, :order] = next(steps)
        noise[:, :order, :order] = next(steps) * density[:, None, None]
        if self.drift is not None:
            move[:, order, order] = 1.0
            noise[:, order, order] = self.drift[:, None] * dt[:, None]
        moves = move, np.zeros((len(dt), *shape[2:])), noise
        if readings.moves is not None:
            silent = np.isfinite(readings.moves[0][:, 0, 0])
            moves = tuple(  # type: ignore[assignment]
                np.where(np.expand_dims(silent, (*range(1, part.ndim - 2),)), part, usual)
                for part, usual in zip(readings.moves, moves, strict=True)
            )
        return replace(readings, moves=moves)


@dataclass(frozen=True, eq=False)
class FilterReadings:
    """Measurements, folded (L,…,C): dt s · encoders,
    var (L,M,C), NaN where silent · T tracks of D rows.

    A track's row r reads y (L,T,D,C) = jac (L,T,D,M,C) · x with variance var (L,T,D,C); NaN where
    unseen. reset (L,M,C) bool: joints that restart from a wide prior at an instant, or None. more
    (L,M,C): factor on the process variance before an instant, or None for 1. moves: move
    (L,S,S,M,C), shift (L,S,M,C), noise (L,S,S,M,C) of the states before an instant; NaN: by dt.
    gate: standard deviations beyond which innovations count as outliers.
    """

    dt: Array
    encoders: Array
    encoder_var: Array
    y: Array
    jac: Array
    var: Array
    reset: Array | None = field(default=None, kw_only=True)
    more: Array | None = field(default=None, kw_only=True)
    moves: tuple[Array, Array, Array] | None = field(default=None, kw_only=True)
    gate: float = field(default=GATE_SIGMA, kw_only=True)

    def between(self, first: int, last: int) -> "FilterReadings":
        """Those of some instants."""
        parts: dict[str, Any] = {
            k: part[first:last] for k, part in vars(self).items() if isinstance(part, np.ndarray)
        }
        if self.moves is not None:
            parts["moves"] = tuple(part[first:last] for part in self.moves)
        return replace(self, **parts)

    def repeated(self, count: int) -> "FilterReadings":
        """Each stretch `count` times side by side; what has as many columns already stays."""
        stretches = self.dt.shape[-1]
        parts: dict[str, Any] = {
            k: np.repeat(part, count, axis=-1)
            for k, part in vars(self).items()
            if isinstance(part, np.ndarray) and part.shape[-1] == stretches
        }
        if self.moves is not None:
            parts["moves"] = tuple(np.repeat(part, count, axis=-1) for part in self.moves)
        return replace(self, **parts)
