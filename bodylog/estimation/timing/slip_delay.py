"""A camera's delay where joints stick and slip: images show each slip as late as they are.

No curve through the images follows a slip. So readings predict each image at its time less a delay,
and the probability of the delays of a grid gives their mean and standard error.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...kinematics.calibration import CHI_SQUARE_MEDIANS
from ...types import Array
from ..factors.whole_log import LEARNED_S
from ..faults.jumping import average_between_slips
from ..faults.threshold import EVIDENCE_THRESHOLD_NATS
from ..inference.filter_pass import GATE_SIGMA
from ..measurements.long_arrays import MIN_READINGS, find_finite_rows, measure_median_step
from ..measurements.records import Encoders, Sighting
from .delay_profile import MAX_DELAY_S, Delay

COARSE_STEP_S = 0.01
"""s: between the delays that are tried first."""
FINE_STEP_S = 0.001
"""s: between those about the most probable of them."""


def measure_delay_by_slips(encoders: Encoders, seen: Sequence[Sighting]) -> Delay | None:
    """The delay of one camera's tracks; None of too few images. The first LEARNED_S are used."""
    tracks = [_select_early_images(one) for one in seen]
    if sum(len(one.t) for one in tracks) < MIN_READINGS:
        return None
    still = [average_between_slips(encoders.t, y) for y in encoders.values.T]
    encoders = replace(encoders, values=np.stack(still, axis=1))
    coarse = np.arange(-MAX_DELAY_S, MAX_DELAY_S + COARSE_STEP_S, COARSE_STEP_S)
    squares = np.stack([_measure_squares(encoders, tracks, late) for late in coarse.tolist()])
    # most images are of joints that stand still
    usual = max(float(np.median(squares, axis=1).min()), 1.0)
    misfits = _sum_misfits(squares, usual)
    likely = coarse[misfits < misfits.min() + EVIDENCE_THRESHOLD_NATS]
    fine = np.arange(likely[0] - COARSE_STEP_S, likely[-1] + COARSE_STEP_S, FINE_STEP_S)
    squares = np.stack([_measure_squares(encoders, tracks, late) for late in fine.tolist()])
    misfits = _sum_misfits(squares, usual)
    weights = np.exp(misfits.min() - misfits)
    weights /= weights.sum()
    mean = float(weights @ fine)
    variance = float(weights @ np.square(fine - mean))
    # a slip is between two readings
    variance += (measure_median_step(encoders.t) ** 2 + FINE_STEP_S**2) / 12.0
    return Delay(mean, variance**0.5)


def _select_early_images(sighting: Sighting) -> Sighting:
    """The images of the first LEARNED_S, where something is seen."""
    rows = find_finite_rows(sighting.values) & (sighting.t <= sighting.t[0] + LEARNED_S)
    return sighting.select_rows(rows)


def _measure_squares(encoders: Encoders, tracks: Sequence[Sighting], late: float) -> Array:
    """Squared residuals (F,) of images over their variance, over the median of a sum of as many
    squares of standard normal numbers, for a delay of `late` s.
    """
    found = []
    for one in tracks:
        mean, slope, var = one.model.predict(encoders.interpolate_at(one.t - late))
        noise = one.var + var + np.square(slope) @ encoders.variance
        squares = (np.square(one.values - mean) / noise).sum(axis=1)
        found.append(squares / CHI_SQUARE_MEDIANS[one.values.shape[1]])
    return np.concatenate(found)


def _sum_misfits(squares: Array, usual: float) -> Array:
    """Nats (D,) against each delay by squared residuals (D,F), of which `usual` is the median; each
    counts up to GATE_SIGMA.
    """
    return np.asarray(0.5 * np.minimum(squares / usual, GATE_SIGMA**2).sum(axis=1))
