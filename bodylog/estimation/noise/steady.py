"""A filter in its steady state: readings with noise of density R (rad² s), motion with white noise of density q.

The poles are those of a Butterworth filter. The variance is √2 R^¾ q^¼ for white acceleration (rad²/s³), and
2 R^⅚ q^⅙ for white jerk (rad²/s⁵).
"""

import numpy as np

from ...types import Array


def steady_variance(density: Array, process: Array, order: int) -> Array:
    """Variance (M,) rad² of the filtered angle for motion of an order."""
    power = 1.0 / (2 * order)
    return np.asarray(density ** (1.0 - power) * process**power / np.sin(np.pi * power))


def steady_density(var: Array, process: Array, order: int) -> Array:
    """Density R (M,) of readings that hold an angle at the variance (M,) rad²."""
    power = 1.0 / (2 * order)
    return np.asarray((var * np.sin(np.pi * power) / process**power) ** (1.0 / (1.0 - power)))
