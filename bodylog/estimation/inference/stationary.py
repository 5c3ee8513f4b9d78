"""Motion of a joint whose encoder is silent for long: a
stationary process, so that its variance stays bounded.

The angle keeps to its usual mean, and angle, rate and acceleration to their usual variances v₀, v₁,
v₂; noise enters with the density q of the motion. These determine the process: x‴ = −d (v₁/v₀) x −
(v₂/v₁) x′ − d x″ + w with d = q / 2(v₂ − v₁²/v₀), or x″ = −(v₁/v₀) x − (q/2v₁) x′ + w. Over short
times it is white jerk or acceleration.
"""

import numpy as np

from ...types import Array


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
