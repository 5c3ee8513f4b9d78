"""A camera's delay in an exploration log, by the likelihood of the body's own Gaussian process.

A track's curve y at t + τ is a draw of the process at the encoder angles of t: y + τ ẏ has its mean
m and, with noise, its covariance K. So τ = −ẏᵀK⁻¹(y − m) / ẏᵀK⁻¹ẏ, by Gauss–Newton. Position and
speed are interpolated from the same images, so their noise e, ė adds tr(K⁻¹ E[e ėᵀ]) and tr(K⁻¹ E[ė
ėᵀ]) to the two sums, which are subtracted. Residuals of the learned mean are a weaker test: where
paths hardly cross, the mean absorbs the delay.
"""

from collections.abc import Callable, Sequence

import numpy as np

from ...types import Array
from ..measurements.long_arrays import MIN_READINGS, median_by_pivot
from ..measurements.records import Encoders, Sighting
from ..measurements.track_curve import (
    BLUNDER_MEDIANS,
    MAX_CURVE_MEANS,
    Curve,
    interpolate_curve,
    track_curve,
)
from .delay_profile import Delay, climb_profile

Prior = Callable[[Array], tuple[Array, Array]]
"""The prior of a track at angles (B,M) rad: mean (D,) px and covariance (D,B,B) px²."""


def measure_delay_by_likelihood(
    encoders: Encoders, seen: Sequence[Sighting], priors: Sequence[Prior]
) -> Delay | None:
    """The delay of one camera's tracks; None where they are too short."""
    curves = [
        (curve, *prior(curve.x))
        for track, prior in zip(seen, priors, strict=True)
        if (curve := track_curve(encoders, track, MAX_CURVE_MEANS // len(seen))) is not None
    ]

    def likelihood_step(late: float) -> tuple[float, float, None] | None:
        parts = [_delay_sums(curve, mean, cov, late) for curve, mean, cov in curves]
        # tracks beside the same encoders have correlated errors
        pull, weight = np.sum(parts, axis=0) / len(parts) if parts else (0.0, 0.0)
        return None if weight <= 0.0 else (-float(pull / weight), weight**-0.5, None)

    found = climb_profile(likelihood_step)
    return None if found is None else found[0]


def _delay_sums(curve: Curve, mean: Array, cov: Array, late: float) -> tuple[float, float]:
    """ẏᵀK⁻¹(y − m) and ẏᵀK⁻¹ẏ of a curve delayed by `late`
    s, less their noise; zeros where too little is left.
    """
    place, speed, value, slope, first, sound = interpolate_curve(curve, late)
    off = np.linalg.norm(place - curve.predicted, axis=1)
    if sound.sum() < MIN_READINGS:
        return 0.0, 0.0
    # positions far from the learned mean are blunders, too
    rows = np.flatnonzero(sound & (off <= BLUNDER_MEDIANS * median_by_pivot(off[sound])))
    noise = curve.noise + np.einsum("bdm,bm->bd", np.square(curve.jac[rows]), curve.encoder[rows])
    placed, moved = (
        _scatter_weights(part[rows], first[rows], len(curve.t)) for part in (value, slope)
    )
    cross = moved @ placed.T
    own = moved @ moved.T
    pull = 0.0
    weight = 0.0
    for d, prior in enumerate(cov):
        known = prior[np.ix_(rows, rows)] + np.diag(noise[:, d])
        inverse = np.linalg.inv(known)
        blur = curve.blur[d] / curve.images
        lean = inverse @ speed[rows, d]
        pull += lean @ (place[rows, d] - mean[d]) - blur * float(np.sum(inverse * cross))
        weight += lean @ speed[rows, d] - blur * float(np.sum(inverse * own))
    return float(pull), float(weight)


def _scatter_weights(weights: Array, first: Array, count: int) -> Array:
    """Weights (B,4) of the four images from `first` (B,) on as a matrix (B,count)."""
    found = np.zeros((len(weights), count))
    found[np.arange(len(weights))[:, None], first[:, None] + np.arange(4)] = weights
    return found
