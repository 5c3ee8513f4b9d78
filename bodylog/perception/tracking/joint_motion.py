"""The share of an image track's motion that the joints
explain: a smooth function of angles, on held-out time.
"""

from dataclasses import dataclass

import numpy as np

from ...types import Array, Series

# rad; of 0.7 to 4, the length with the least held-out error of a simulated arm's tip: medians over
# 42 arms of 3 to 7 joints that explore a quarter of a turn to three quarters each way
_LENGTH = 1.5
_AMPLITUDE = 0.3
"""Prior noise of places, as a share of the image width."""
_STILL = 0.005
_MOVES = 0.01
_FAR = 0.1
_BLOCKS = 8
_MOST = 400
_FEWEST = 20
_AT_ONCE = 4096
"""Angles predicted at once: a whole log's kernel with the samples would fill the memory."""
_DELAYS = np.arange(-0.3, 0.3001, 0.05)


@dataclass(frozen=True, eq=False)
class Regression:
    """Places y (n,D) as a smooth function of angles q
    (n,M): a Gaussian process with one fixed length scale.

    `std` (n,) is the noise of y and `amplitude` the prior deviation, both in the unit of y.
    """

    q: Array
    mean: Array
    factor: Array
    weights: Array
    amplitude: float

    @classmethod
    def fit(cls, q: Array, y: Array, std: Array, amplitude: float) -> "Regression":
        """Fit to samples, each weighted by its std (n,)."""
        precision = 1 / np.square(std)
        mean = (precision @ y) / precision.sum()
        factor = np.linalg.cholesky(_posture_kernel(q, q) + np.diag(np.square(std / amplitude)))
        weights = np.linalg.solve(factor.T, np.linalg.solve(factor, y - mean))
        return cls(q, mean, factor, weights, amplitude)

    def predict(self, q: Array) -> tuple[Array, Array]:
        """Mean (N,D) at angles q (N,M) and its standard deviation (N,), the noise excluded."""
        mean = np.empty((len(q), len(self.mean)))
        std = np.empty(len(q))
        for start in range(0, len(q), _AT_ONCE):
            some = slice(start, start + _AT_ONCE)
            across = _posture_kernel(q[some], self.q)
            known = np.linalg.solve(self.factor, across.T)
            mean[some] = self.mean + across @ self.weights
            std[some] = self.amplitude * np.sqrt(np.maximum(1 - (known**2).sum(axis=0), 0))
        return mean, std


def moving_postures(joints: Series | None, t: Array, delay: float = 0.0) -> Array:
    """Postures (N,M) rad of the joints that move,
    `delay` s before t (N,); M is 0 where no joint moves.
    """
    if joints is None or len(t) < 2:
        return np.zeros((len(t), 0))
    readings = [
        (joints.t[there], column[there])
        for column in joints.values.T
        if (there := np.isfinite(column)).any()
    ]
    columns = [np.interp(t - delay, at, angle) for at, angle in readings]
    moving = [
        part for column in columns if _angle_moves(column) for part in _posture_columns(column)
    ]
    return np.array(moving).reshape(-1, len(t)).T


def _posture_columns(angle: Array) -> list[Array]:
    """Columns (n,) in which like postures are near: an angle
    from its mean, or a wheel's place on the unit circle.
    """
    return [angle - angle.mean()] if np.ptp(angle) <= 2 * np.pi else [np.cos(angle), np.sin(angle)]


def _angle_moves(angle: Array) -> bool:
    """Whether angles (n,) rad move far, or steadily, unlike white noise (von Neumann's ratio 2)."""
    variance = float(angle.var())
    steadily = float(np.square(np.diff(angle)).mean()) < variance
    return variance > _FAR**2 or (variance > _MOVES**2 and steadily)


def explained_share(q: Array, y: Array, width: float) -> float:
    """The share (0..1) of the variance of places y (n,2) px
    that angles q (n,M) explain in held-out blocks of time.

    0 where the samples are too few, no joint moves, or the thing stands still.
    """
    if len(y) < _FEWEST or not q.shape[1] or stands_still(y, width):
        return 0.0
    rest = held_out_place_residuals(q, y, width)
    centred = y - np.median(y, axis=0)
    # no sample outweighs the usual one: a few foreign places must not decide
    total = (centred**2).sum(axis=1)
    lost = np.minimum((rest**2).sum(axis=1), 4 * max(float(total.mean()), 1e-9))
    return float(np.clip(1 - lost.sum() / max(float(total.sum()), 1e-9), 0.0, 1.0))


def stands_still(y: Array, width: float) -> bool:
    """Whether places y (n,2) px are those of a thing
    that stands still, apart from light and compression.
    """
    return float(np.hypot(*y.std(axis=0))) < max(1.0, _STILL * width)


def beyond_chance(q: Array, frames: Array, y: Array, width: float) -> float:
    """The share (0..1) that angles q (N,M) explain of
    places y (n,2) px in some frames (n,), beyond chance.

    Chance is what time-shifted angles explain: a slow path is a smooth function of any slow angles.
    """
    shifts = [round(len(q) * part) for part in (0.25, 0.5, 0.75)]
    chance = max(explained_share(np.roll(q, shift, axis=0)[frames], y, width) for shift in shifts)
    return max(0.0, (explained_share(q[frames], y, width) - chance) / (1 - min(chance, 0.99)))


def held_out_place_residuals(q: Array, y: Array, width: float) -> Array:
    """Residuals (n,2) px of places y (n,2) px, predicted
    from angles q (n,M) of the other blocks of time.
    """
    some = thin_indices(len(y), _MOST)
    kernel = _posture_kernel(q, q[some])
    label = np.arange(len(y)) * _BLOCKS // len(y)
    noise = np.square(assumed_noise_px(width) / (_AMPLITUDE * width))
    rest = np.empty(y.shape)
    for block in range(_BLOCKS):
        out = label == block
        kept = np.flatnonzero(label[some] != block)
        if not out.any():
            continue
        known = kernel[some[kept]][:, kept] + noise * np.eye(len(kept))
        mean = y[some[kept]].mean(axis=0)
        rest[out] = (
            y[out] - mean - kernel[out][:, kept] @ np.linalg.solve(known, y[some[kept]] - mean)
        )
    return rest


def camera_delay_s(joints: Series | None, t: Array, y: Array, width: float) -> float:
    """The delay (s) of the camera's timestamps t (n,), of
    places y (n,2) px, against the joints'; 0 if unclear.
    """
    some = thin_indices(len(t), _MOST // 2)
    errors = []
    for late in _DELAYS.tolist():
        q = moving_postures(joints, t[some], late)
        errors.append(
            np.median((held_out_place_residuals(q, y[some], width) ** 2).sum(axis=1))
            if q.shape[1]
            else np.inf
        )
    best = int(np.argmin(errors))
    return float(_DELAYS[best]) if errors[best] < 0.8 * errors[len(errors) // 2] else 0.0


def fit_regression(q: Array, y: Array, std: Array, width: float) -> Regression:
    """Fit a function of angles q (n,M) to at most _MOST
    of the places y (n,2) px with noise std (n,) px.
    """
    some = thin_indices(len(y), _MOST)
    return Regression.fit(
        q[some], y[some], np.hypot(std[some], assumed_noise_px(width)), _AMPLITUDE * width
    )


def thin_indices(count: int, most: int) -> Array:
    """At most `most` of `count` indices, evenly spaced."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))


def assumed_noise_px(width: float) -> float:
    """The noise (px) of a coarse place in images of that width."""
    return max(1.0, 0.004 * width)


def _posture_kernel(a: Array, b: Array) -> Array:
    # by differences: the expanded squares of far angles
    # lose all digits, and the matrix its Cholesky factor
    square = sum(np.square(np.subtract.outer(x, y)) for x, y in zip(a.T, b.T, strict=True))
    return np.asarray(np.exp(-0.5 / _LENGTH**2 * square))
