"""BFGS in a few variables with bounds, from a given curvature (Nocedal & Wright 2006, ch. 6)."""

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

import numpy as np

from .types import Array

_STEPS = 200
_FARTHEST = 3.0
_ENOUGH = 1e-4
_SETTLED = 1e-6

Loss = Callable[[Array], tuple[float, Array]]


@dataclass(frozen=True, eq=False)
class Minimum:
    """Where (p,) a loss is least, the loss there, and its curvature (p,p) as the descent saw it."""

    at: Array
    loss: float
    curvature: Array


def minimise_with_bfgs(
    loss: Loss,
    first: Array,
    low: Array,
    high: Array,
    curvature: Array,
    settled: float | None = None,
    farthest: float = _FARTHEST,
) -> Minimum:
    """Minimise a loss (value, gradient (p,)) from `first`
    (p,); curvature (p,p): a positive definite guess.

    settled: what the slope along the last step promises at most; by default a millionth of the
    loss · farthest: most that a step changes a variable by.
    """
    guess = np.linalg.inv(curvature)
    here = first
    inverse = guess
    value, gradient = loss(here)
    for _ in range(_STEPS):
        step = _bounded_step(here, gradient, inverse, low, high, farthest)
        least = _SETTLED * max(1.0, abs(value)) if settled is None else settled
        if -float(step @ gradient) <= least:
            break
        found = _search_along_step(loss, here, value, gradient, step, low, high, least)
        if found is None:
            if inverse is guess:
                break
            inverse = guess
            continue
        there, value, slope = found
        inverse = _update_inverse_hessian(inverse, there - here, slope - gradient)
        here = there
        gradient = slope
    return Minimum(here, value, np.linalg.inv(inverse))


def _bounded_step(
    here: Array, gradient: Array, inverse: Array, low: Array, high: Array, farthest: float
) -> Array:
    """The quasi-Newton step; variables held by a bound stay."""
    held = ((here <= low) & (gradient > 0)) | ((here >= high) & (gradient < 0))
    if held.any():
        free = np.flatnonzero(~held)
        step = np.zeros(len(here))
        # inverse of the curvature of the free variables alone, so that the step still descends
        step[free] = -np.linalg.solve(np.linalg.inv(inverse)[np.ix_(free, free)], gradient[free])
    else:
        step = -(inverse @ gradient)
    return np.asarray(step * min(1.0, farthest / max(float(np.abs(step).max()), 1e-300)))


def _search_along_step(
    loss: Loss,
    here: Array,
    value: float,
    gradient: Array,
    step: Array,
    low: Array,
    high: Array,
    least: float,
) -> tuple[Array, float, Array] | None:
    """The first point along the step, shortened each time, with enough decrease, or None if what
    the slope promises is no more than `least`: a loss that is rounded may show less.
    """
    share = 1.0
    while -share * float(gradient @ step) > least:
        there = np.minimum(np.maximum(here + share * step, low), high)
        found, slope = loss(there)
        fall = float(gradient @ (there - here))
        if found <= value + _ENOUGH * fall:
            return there, found, slope
        # minimum of the parabola through both values and the first slope
        share *= (
            min(0.5, max(0.1, -0.5 * fall / (found - value - fall))) if np.isfinite(found) else 0.1
        )
    return None


def _update_inverse_hessian(inverse: Array, step: Array, bend: Array) -> Array:
    """N&W (6.17); unchanged where the curvature is negative."""
    along = float(step @ bend)
    if along <= 1e-12 * sqrt(float(step @ step) * float(bend @ bend)):
        return inverse
    turned = inverse @ bend
    cross = step[:, None] * turned
    return np.asarray(
        inverse
        - (cross + cross.T) / along
        + (1.0 + float(bend @ turned) / along) / along * step[:, None] * step
    )
