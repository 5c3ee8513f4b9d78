"""A camera's delay by regression on the encoders: both observe one motion.

Encoder readings of one frame interval are averaged to x̄ at t and predict a position g(x̄). The
track's curve y is there at t + τ: y(t + τ) = g(x̄) + J b(t) + e. Gauss–Newton gives τ and piecewise
linear encoder offsets b; those of encoders that are known to be off walk at random beside that, by
steps whose variance the evidence gives. Errors that last longer show in a jackknife over √N parts
of N positions; the larger standard error is taken.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from math import isqrt

import numpy as np

from ...kinematics.calibration import CHI_SQUARE_MEDIANS
from ...types import Array
from ..faults.threshold import (
    EVIDENCE_THRESHOLD_NATS,
    MIN_DELAY_S,
    PRIOR_STD_RAD,
    SIGNIFICANT_SIGMA,
)
from ..inference.filter_pass import CONVERGED_MOVE, MAX_SWEEPS, ROUGHLY_CONVERGED_MOVE
from ..measurements.long_arrays import MIN_READINGS
from ..measurements.records import Encoders, Sighting
from ..measurements.track_curve import (
    MAX_CURVE_MEANS,
    RegressionRows,
    build_regression_rows,
    build_track_curve,
)
from .delay_profile import Delay, climb_profile, measure_jackknife_error

HALF_WEIGHT_SQUARE = 4.0
"""Squared residuals over their variance that have half weight. With 1 to 16, delays of 8 drawn logs
are off by 0.80 to 0.86 ms, and by 0.95 to 1.02 ms where 5 % of the images are wrong by 30 px.
"""
LEAST_WEIGHT_SHARE = 0.61
"""Least share of the information that keeps its weight where one delay fits the log. The share is
0.72 for normal errors, 0.61 and more in 197 of 200 logs with a drifting encoder, 0.43 to 0.64 where
a clock steps by 0.3 s. A log with play, sag and correlated errors has 0.58, too; its halves agree.
"""


def measure_delay_by_regression(
    encoders: Encoders, seen: Sequence[Sighting], walking: tuple[int, ...]
) -> Delay | None:
    """The delay of one camera's tracks; None where motion is too small or too short.

    walking: joints whose encoders drift or have been shifted.

    A delay is as unsure as the halves of the log are evidently apart; where it is not evident so,
    as where a clock is set by as much, it changes, and is in doubt. Where much of the log has lost
    its weight, it is in doubt unless both halves show it.
    """
    whole = _regress_delay(encoders, seen, walking)
    if whole is None:
        return None
    delay, share = whole
    is_contradicted = share < LEAST_WEIGHT_SHARE
    middle = float(np.median(np.concatenate([one.t for one in seen])))
    halves = [
        _regress_delay(encoders, [one.select_span(*span) for one in seen], walking)
        for span in ((-np.inf, middle), (middle, np.inf))
    ]
    found = [half[0] for half in halves if half is not None]
    if len(found) < len(halves):
        doubt = "much of the log contradicts it, and half of the log shows no delay"
        return replace(delay, doubt=doubt) if is_contradicted else delay
    apart = Delay(
        abs(found[0].seconds - found[1].seconds),
        float(np.hypot(found[0].std_error, found[1].std_error)),
    )
    between = replace(delay, std_error=max(delay.std_error, 0.5 * apart.seconds))
    are_two = apart.nats > EVIDENCE_THRESHOLD_NATS and 0.5 * apart.seconds > MIN_DELAY_S
    each = " and ".join(f"{1e3 * one.seconds:.1f} ± {1e3 * one.std_error:.1f} ms" for one in found)
    text = f"the halves of the log show {each}"
    if are_two and between.nats <= EVIDENCE_THRESHOLD_NATS:
        return replace(between, doubt=text, changes=True)
    if is_contradicted and apart.seconds >= SIGNIFICANT_SIGMA * apart.std_error:
        return replace(delay, doubt=text)
    return between if are_two or is_contradicted else delay


def _regress_delay(
    encoders: Encoders, seen: Sequence[Sighting], walking: tuple[int, ...]
) -> tuple[Delay, float] | None:
    """The delay of one camera's tracks, and the share of the information that kept its weight."""
    curves = [
        curve
        for track in seen
        if (curve := build_track_curve(encoders, track, MAX_CURVE_MEANS // len(seen), walking))
        is not None
    ]

    def find_regression_step(
        late: float,
    ) -> tuple[float, float, tuple[RegressionRows, Array, Array, Array]] | None:
        each = [build_regression_rows(curve, late) for curve in curves]
        if sum(len(one.t) for one in each) < MIN_READINGS:
            return None
        rows = _join_regression_rows(each)
        if rows.misfit.size < 2 * rows.slopes.shape[-1]:
            return None
        step, weight, spread, prior = _fit_delay_step(rows, len(walking), curves[0].walks.shape[1])
        normal = _sum_normal_equations(rows, weight)[0] + np.diag(prior)
        lean = np.linalg.solve(normal, np.eye(rows.slopes.shape[-1])[0])
        # the inverse of the information in the track's speed
        # without noise; below the noise, nothing moved
        if not 0.0 < lean[0] * float(weight @ rows.own) < 1.0:
            return None
        pulled = _measure_pull_variance(rows, weight[:, None] * (rows.slopes @ lean))
        own = np.sqrt(spread * (pulled + np.square(lean) @ prior))
        return step, float(own), (rows, weight, lean, prior)

    found = climb_profile(find_regression_step)
    if found is None:
        return None
    delay, (rows, weight, lean, prior) = found
    information = np.square(rows.slopes @ lean).sum(axis=1)
    parts = isqrt(min(len(curve.t) for curve in curves))
    error = max(delay.std_error, _jackknife_parts(rows, weight, prior, parts))
    return Delay(delay.seconds, error), float(weight @ information / information.sum())


def _jackknife_parts(rows: RegressionRows, weight: Array, prior: Array, parts: int) -> float:
    """Standard error (s) of the delay by a jackknife over parts of the log."""
    bounds = np.linspace(0, len(rows.t), parts + 1).astype(int)
    sums = [
        _sum_normal_equations(rows.select_instants(slice(*ends)), weight[slice(*ends)])
        for ends in pairwise(bounds)
    ]
    normal, pull = (np.stack(each) for each in zip(*sums, strict=True))
    rest = normal.sum(axis=0) - normal + np.diag(prior)
    without = np.linalg.solve(rest, (pull.sum(axis=0) - pull)[..., None])[:, 0, 0]
    return float(measure_jackknife_error(without))


def _fit_delay_step(
    rows: RegressionRows, walking: int, steps: int
) -> tuple[float, Array, float, Array]:
    """The next step (s), robust weights (R,), the residual variance, 1 where noise is as stated,
    and what is known before the log of each slope's size (1+P,), of that variance: nothing of the
    delay and of offsets at knots, but the last slopes are `steps` of each of the offsets that walk.

    The variance of an offset's steps is the one under which they are as large as found, over the
    number of them that the log determines (MacKay 1992, Bayesian Interpolation, eq. 4.14).
    """
    weight = np.ones(len(rows.t))
    spread = 1.0
    size = rows.slopes.shape[-1]
    walks = slice(size - walking * steps, size)
    prior = np.zeros(size)
    prior[walks] = PRIOR_STD_RAD**-2.0
    for _ in range(MAX_SWEEPS):
        normal, pull = _sum_normal_equations(rows, weight)
        cov = np.linalg.inv(normal + np.diag(prior))
        beta = cov @ pull
        squares = np.square(rows.misfit - rows.slopes @ beta).sum(axis=1)
        usual = CHI_SQUARE_MEDIANS[rows.misfit.shape[1]]
        spread = float(np.median(squares)) / usual + np.finfo(float).tiny
        before = weight
        weight = 1.0 / (1.0 + squares / (HALF_WEIGHT_SQUARE * spread))
        known, found = (
            part[walks].reshape(walking, steps).sum(axis=1)
            for part in (1.0 - prior * np.diag(cov), np.square(beta))
        )
        last = prior.copy()
        prior[walks] = np.repeat(spread * known / np.maximum(found, CONVERGED_MOVE**2), steps)
        still = np.abs(prior - last) <= ROUGHLY_CONVERGED_MOVE * last
        if still.all() and np.abs(weight - before).max() < ROUGHLY_CONVERGED_MOVE:
            break
    return float(beta[0]), weight, spread, prior


def _measure_pull_variance(rows: RegressionRows, pull: Array) -> float:
    """Variance of the sum of misfits (R,2) times `pull` (R,D), for a residual variance of 1.

    Neighbouring misfits are interpolated from the same images, so their noise is correlated, and
    less than an image's. Residuals are less than misfits by the unknowns fitted.
    """
    by_image = np.einsum("rkde,rd->rke", rows.image, pull)
    count = int(rows.frames.max()) + 1
    each = (
        np.bincount(rows.frames.ravel(), column.ravel(), count)
        for column in np.moveaxis(by_image, -1, 0)
    )
    beside = np.square(pull).sum() - np.square(by_image.sum(axis=1)).sum()
    total = beside + sum(np.square(column).sum() for column in each)
    size = rows.misfit.shape[1]
    residual = (
        size
        - np.square(rows.image.sum(axis=1)).sum(axis=(1, 2))
        + np.square(rows.image).sum(axis=(1, 2, 3))
    )
    free = 1.0 - rows.slopes.shape[-1] / rows.misfit.size
    return float(total * size / (residual.mean() * free))


def _sum_normal_equations(rows: RegressionRows, weight: Array) -> tuple[Array, Array]:
    """Normal matrix and right side of the weighted
    regression, corrected for noise in the track's speed.
    """
    size = rows.slopes.shape[-1]
    heavy = (rows.slopes * weight[:, None, None]).reshape(-1, size).T
    normal = heavy @ rows.slopes.reshape(-1, size)
    pull = heavy @ rows.misfit.ravel()
    normal[np.diag_indices(size)] += 1e-9 * np.trace(normal) / size + np.finfo(float).tiny
    normal[0, 0] -= weight @ rows.own
    pull[0] += weight @ rows.cross
    return normal, pull


def _join_regression_rows(parts: Sequence[RegressionRows]) -> RegressionRows:
    """Rows of all curves in order of time."""
    if len(parts) == 1:
        return parts[0]
    counts = np.cumsum([0, *(part.frames.max(initial=0) + 1 for part in parts)])
    parts = [
        replace(part, frames=part.frames + count)
        for part, count in zip(parts, counts, strict=False)
    ]
    rows = RegressionRows(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in RegressionRows.__annotations__
        )
    )
    return rows.select_instants(np.argsort(rows.t, kind="stable"))
