"""Sudden motion: a filter must follow a joint that starts to move after a long rest.

The evidence has one acceleration density for rest and motion. If rest prevails, the density may be so small that the
filter lags, and the gate rejects every further reading as an outlier.
"""

import numpy as np

from ...types import Array
from ..inference.conditioning import GATE
from ..measurements.long_arrays import median_step

WITHIN = 0.8
"""Share of the gate for innovations by lasting accelerations; the rest is for the readings' noise."""
RAISED = 2.0
"""Factor on a density per step."""
LATE = 1.5
"""Median time steps: readings farther apart show no acceleration."""
MEMORY = 1.5
"""Width, in 1/√β readings, of the three means whose second difference estimates an acceleration.

Their noise moves innovations by at most one standard deviation.
"""


def followed(t: Array, y: Array, alone: Array, noise: float, process: float) -> float:
    """The density (rad²/s³), at least `process`, that keeps innovations of readings y (N,) at t (N,) s in the gate.

    alone (N-2,) bool: second differences that are not motion · noise: variance (rad²) of one reading.
    """
    steps = np.diff(t)
    step = median_step(t) if len(t) > 2 else 0.0
    if step <= 0.0:
        return process
    late = steps > LATE * step
    # readings without their jumps and what they moved in pauses, summed
    bends = np.where(alone | late[1:] | late[:-1], 0.0, np.diff(y, 2))
    summed = np.cumsum(np.cumsum(np.cumsum(bends)))
    summed = np.concatenate([np.zeros(4), summed])
    while (lag := _lag(summed, step, noise, process)) > WITHIN * GATE:
        process *= max(RAISED, np.sqrt(lag / (WITHIN * GATE)))
    return process


def _lag(summed: Array, step: float, noise: float, process: float) -> float:
    """Largest innovation, in standard deviations, from accelerations that last as long as the filter's memory.

    summed (N,) rad: cumulated readings. A filter with steady gains α, β has innovations of a Δt²/β under an
    acceleration a, and of variance noise/(1 − α) otherwise (Kalata 1984, "The tracking index").
    """
    index = np.sqrt(process * step**3 / noise)
    rest = (4.0 + index - np.sqrt(8.0 * index + index * index)) / 4.0
    beta = 2.0 * (1.0 + rest * rest) - 4.0 * rest
    width = max(1, round(MEMORY / np.sqrt(beta)))
    means = (summed[width:] - summed[:-width]) / width
    if len(means) <= 2 * width:
        return 0.0
    bends = means[2 * width :] - 2.0 * means[width:-width] + means[: -2 * width]
    return float(np.abs(bends).max() / width**2 / beta / np.sqrt(noise) * rest)
