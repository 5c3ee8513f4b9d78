"""How far the shared unknowns may be off: errors that a
link's landmarks share, and a block sandwich, the larger.
"""

import numpy as np

from ..types import Array
from .landmark_adjustment import RESIDUAL_STD_PX, whiten_back
from .landmark_fit import LandmarkFit

COMMON_STD_PX = 0.7
"""Error that all landmarks of a link share at one instant:
highlights and silhouettes move alike (0.5 to 1 px).
"""
_LEAST_MOTION_PX = 0.05
"""Motion of a joint's corners by the error of its angle, below which that error is left out."""
_LEAST_TOLD = 1e-5
"""Share of an unknown's prior deviation below which what landmarks move it by is rounding. The zero
of a first joint before a camera of unknown pose moved by 3e-6 of it.
"""
BLOCK_S = 2.0
"""Blocks of sandwich and jackknife: rows within this time, of one link or of all."""
ZERO_FLOOR_PX = 1.0
"""Systematic error of a link in the image, which bounds what is known of the zero that moves it."""

DELAY_FLOOR_S = 0.001
"""Systematic error of a delay: rendered logs whose
delay is zero were given 0.2, 1.8 and -2.1 ms.
"""
ROW_TIME_FLOOR_S = 0.02
"""Systematic error of the row time by one log: noise of
encoders, whose smoothed curve errs alike for all landmarks of an image.

Rendered cameras without one were given 7, -3 and -16 ms with 0.005 rad of noise (-16 became 1 with
the true angles), and 0 and 0 with 0.0003; one of 60 ms 60.4. Real episodes: 51 to 88 ms of single
ones, 59 to 71 of four.
"""


SCATTER = 1.5
"""Factor on what landmarks leave open of zeros, pose, centre and distortion of a lens.

Eight episodes of one humanoid differ, in all pairs, by 3.2 times the model's variance in zeros, by
2.2 in pose and by 2.5 in centre and distortion; by 0.5 in the focal length, which has no factor.
"""


def unknowns_covariance(fit: LandmarkFit) -> Array:
    """Covariance (P,P) of φ; the prior's for unknowns that were not estimated.

    What the prior leaves open, and what landmarks do: of the latter the larger, for each unknown,
    of two. One is the residual model (each piece an Ornstein-Uhlenbeck process, one that a link's
    pieces share, and the errors of the smoothed joints), the other a sandwich over blocks of one
    link and BLOCK_S; of delays also jackknives over blocks of one link and of all. SCATTER and
    floors from the scatter of disjoint logs then widen it.
    """
    part = np.ix_(fit.free, fit.free)
    inverse = np.linalg.inv(fit.reduced.matrix[part])
    prior = (fit.model.prior_precision + fit.reduced.from_prior)[part]
    weighted, scores = _scores_of_rows(fit)
    flat = weighted.reshape(-1, weighted.shape[2])
    meat = flat.T @ flat + _shared_meat(fit, weighted) + _motion_meat(fit, weighted)
    modelled = inverse @ meat[part] @ inverse
    # a norm, as the variance of an unknown that no landmark tells of may round to less than nothing
    scatter = np.linalg.norm(_block_scores(fit, scores)[:, fit.free] @ inverse, axis=0)
    least = _LEAST_TOLD * fit.model.prior[1][fit.free]
    std = np.sqrt(np.maximum(np.diag(modelled), np.square(least)))
    widen = np.maximum(scatter / std, 1.0)
    late = np.isin(np.flatnonzero(fit.free), np.r_[fit.model.of_delays])
    widen[late] = np.maximum(widen, _scatter_without_blocks(fit, weighted, scores) / std)[late]
    widen[_scattering_unknowns(fit)[fit.free]] *= SCATTER
    result = np.diag(np.square(fit.model.prior[1]))
    result[part] = inverse @ prior @ inverse + modelled * widen * widen[:, None]
    return _with_floor(fit, result)


def _scattering_unknowns(fit: LandmarkFit) -> Array:
    """Mask (P,) of zeros, poses of the camera, centre and distortion of its lens."""
    model = fit.model
    result = np.zeros(len(fit.phi), bool)
    for part in (slice(6), slice(8, 12), model.rig.of_joints, model.of_moves):
        result[part] = True
    return result


def _scores_of_rows(fit: LandmarkFit) -> tuple[Array, Array]:
    """Weighted designs (R,2,P) and scores (R,P) of each row."""
    weighted = fit.reduced.rows * fit.reduced.weight[:, None, None]
    return weighted, np.einsum("nip,ni->np", weighted, fit.reduced.innovation)


def _shared_meat(fit: LandmarkFit, weighted: Array) -> Array:
    """Scatter (P,P) of the scores by the innovations that a link's rows of one image share."""
    groups = _group_rows(fit, 1e-4)
    sums = np.zeros((int(groups.max()) + 1, *weighted.shape[1:]))
    np.add.at(sums, groups, weighted)
    flat = sums.reshape(-1, weighted.shape[2])
    return np.asarray((COMMON_STD_PX / RESIDUAL_STD_PX) ** 2 * flat.T @ flat)


def _motion_meat(fit: LandmarkFit, weighted: Array) -> Array:
    """Scatter (P,P) of the scores by what the smoothed joints are off by at each instant."""
    seen = fit.seen
    result = np.zeros((len(fit.phi), len(fit.phi)))
    by_residual = whiten_back(weighted, seen, RESIDUAL_STD_PX)
    predicted = fit.model.predict(fit.phi, seen, fit.landmarks.body, fit.landmarks.places)
    for log, motion in enumerate(fit.model.motions):
        rows = np.flatnonzero(seen.log == log)
        if motion.error is None or not len(rows):
            continue
        t, number = np.unique(seen.t[rows], return_inverse=True)
        number = number.reshape(-1)
        order = np.argsort(number, kind="stable")
        begins = np.searchsorted(number[order], np.arange(len(t)))
        lags = t[:, None] - t
        for joint, std in enumerate(motion.error.std):
            moved = predicted.by_joints[rows, :, joint] * std
            if np.sqrt(np.square(moved).sum(axis=1).mean()) < _LEAST_MOTION_PX:
                continue
            scores = np.einsum("nip,ni->np", by_residual[rows], moved)
            sums = np.add.reduceat(scores[order], begins, axis=0)
            result += sums.T @ motion.error.correlation(joint, lags) @ sums
    return result


def _block_scores(fit: LandmarkFit, scores: Array) -> Array:
    """The scores' sums (G,P) over blocks of one link."""
    groups = _group_rows(fit, BLOCK_S)
    sums = np.zeros((int(groups.max()) + 1, scores.shape[1]))
    np.add.at(sums, groups, scores)
    return sums


def _scatter_without_blocks(fit: LandmarkFit, weighted: Array, scores: Array) -> Array:
    """Standard deviations (F,) of the free unknowns by jackknives: without each block of one link,
    and without each block of all, the larger.

    Without block g they move by (A − A_g)⁻¹ s_g, of the information A and the block's share A_g and
    score s_g. A sandwich, A⁻¹ s_g, is too small where blocks are few: the fit follows each. Delays
    need it: stamps of a camera that a recorder samples drift to and fro within seconds.
    """
    part = np.ix_(fit.free, fit.free)
    matrix = fit.reduced.matrix[part]
    largest = np.zeros(len(matrix))
    for by_link in (True, False):
        groups = _group_rows(fit, BLOCK_S, by_link)
        count = int(groups.max()) + 1
        variance = np.zeros(len(matrix))
        for number in range(count):
            rows = np.flatnonzero(groups == number)
            design = fit.reduced.rows[rows].reshape(-1, len(fit.phi))
            own = weighted[rows].reshape(-1, len(fit.phi)).T @ design
            moved = np.linalg.solve(matrix - own[part], scores[rows].sum(axis=0)[fit.free])
            variance += (count - 1.0) / count * np.square(moved)
        largest = np.maximum(largest, variance)
    return np.asarray(np.sqrt(largest))


def _group_rows(fit: LandmarkFit, width_s: float, by_link: bool = True) -> Array:
    """Numbers (R,) of the rows that have log, time in steps
    of width_s and, `by_link`, their link in common.
    """
    body = fit.landmarks.body[fit.seen.piece] * by_link
    keys = np.stack([fit.seen.log, body, np.floor(fit.seen.t / width_s)], axis=1)
    return np.asarray(np.unique(keys, axis=0, return_inverse=True)[1]).reshape(-1)


def _with_floor(fit: LandmarkFit, covariance: Array) -> Array:
    """Add the floors of delays and row time, and to each
    zero ZERO_FLOOR_PX by the pixels that a radian moves.
    """
    predicted = fit.model.predict(fit.phi, fit.seen, fit.landmarks.body, fit.landmarks.places)
    moved = np.sqrt(np.square(predicted.by_joints).sum(axis=1))
    result = covariance.copy()
    delays = np.arange(fit.model.of_delays.start, fit.model.of_delays.stop)
    result[delays, delays] += DELAY_FLOOR_S**2
    row = fit.model.of_row_time
    if fit.free[row]:  # what the row time is off by, the others follow
        along = result[:, row] / result[row, row]
        result += ROW_TIME_FLOOR_S**2 / len(fit.model.motions) * np.outer(along, along)
    for joint, index in enumerate(
        range(fit.model.rig.of_joints.start, fit.model.rig.of_joints.stop)
    ):
        seeing = moved[:, joint][moved[:, joint] > 0.0]
        if len(seeing):
            result[index, index] += (ZERO_FLOOR_PX / float(np.sqrt(np.square(seeing).mean()))) ** 2
    return result
