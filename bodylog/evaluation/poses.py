"""Figures of merit of the effector's pose: how far it
is from the truth, and whether its error bars are true.
"""

import numpy as np

from ..types import Array, Poses, Score

SAME_STAMP_S = 1e-6
"""s: stamps closer than this are the same but for rounding."""
MIN_DIRECTION_SHARE = 1e-9
"""Share of the greatest variance below which a direction has none."""
MAX_TRUTH_GAP_S = 0.2
"""s: truth with a greater gap around a time says nothing of that time."""


def score_poses(found: Poses, truth: Poses) -> tuple[Score, ...]:
    """Errors of place (m) and turn (rad), each beside
    its covariance; nothing where the two share no time.

    The truth is taken at its own stamps, the belief between
    its own. What has no turn, NaN, is scored by its place.
    """
    rows = _lies_within_truth(truth.t, found.t)
    if not rows.any():
        return ()
    t = truth.t[rows]
    cov = found.cov
    before = np.clip(np.searchsorted(found.t, t) - 1, 0, max(len(found.t) - 2, 0))
    place = np.column_stack([np.interp(t, found.t, column) for column in found.place.T])
    near = np.where(
        t - found.t[before] > found.t[np.minimum(before + 1, len(found.t) - 1)] - t,
        before + 1,
        before,
    )
    near = np.minimum(near, len(found.t) - 1)
    position = None if cov is None else cov[near, :3, :3]
    both = _score_pose_error("effector_position", truth.place[rows] - place, position, "m")
    turned = np.isfinite(truth.turn[rows]).all(axis=1)
    if turned.any():
        error = _small_turns(
            _interpolate_turns(found, t[turned], before[turned]), truth.turn[rows][turned]
        )
        both += _score_pose_error(
            "effector_rotation", error, None if cov is None else cov[near[turned], 3:, 3:], "rad"
        )
    return tuple(both)


def _lies_within_truth(t: Array, known: Array) -> Array:
    """Which times (N,) lie within the span of `known` (K,), and in no gap of it."""
    if not len(known):
        return np.zeros(len(t), bool)
    inside: Array = (t >= known[0] - SAME_STAMP_S) & (t <= known[-1] + SAME_STAMP_S)
    after = np.clip(np.searchsorted(known, t), 1, max(len(known) - 1, 1))
    gap = known[np.minimum(after, len(known) - 1)] - known[after - 1]
    return inside & (gap < MAX_TRUTH_GAP_S)


def _score_pose_error(name: str, error: Array, cov: Array | None, unit: str) -> list[Score]:
    found = [Score(f"rmse/{name}", float(np.sqrt(np.square(error).sum(axis=1).mean())), unit)]
    if cov is None:
        return found
    # few joints turn a thing about few axes: of the others neither error nor variance says anything
    values, vectors = np.linalg.eigh(cov)
    known = values > MIN_DIRECTION_SHARE * values[:, -1:]
    along = np.einsum("nik,ni->nk", vectors, error)
    square = np.where(known, np.square(along) / np.where(known, values, 1.0), 0.0).sum(axis=1)
    square /= np.maximum(known.sum(axis=1), 1)
    covered = float((np.square(error) <= 4.0 * np.einsum("nii->ni", cov)).mean() * 100.0)
    return [
        *found,
        Score(f"nees/{name}", float(square.mean()), "1"),
        Score(f"coverage_2sigma/{name}", covered, "%"),
    ]


def _interpolate_turns(found: Poses, t: Array, before: Array) -> Array:
    """Turns (N,4) at times between those of the belief, along the chord: they are close."""
    after = np.minimum(before + 1, len(found.t) - 1)
    span = found.t[after] - found.t[before]
    share = np.where(span > 0, (t - found.t[before]) / np.where(span > 0, span, 1.0), 0.0)[:, None]
    a = found.turn[before]
    b = found.turn[after]
    b = np.where((a * b).sum(axis=1, keepdims=True) < 0.0, -b, b)
    both = (1.0 - share) * a + share * b
    return np.asarray(both / np.linalg.norm(both, axis=1)[:, None])


def _small_turns(a: Array, b: Array) -> Array:
    """The small turns (N,3), rad, about the base's axes
    that lead from quaternions a to b (N,4): b a⁻¹.
    """
    av = -a[:, :3]
    aw = a[:, 3:]
    bv = b[:, :3]
    bw = b[:, 3:]
    vector = bw * av + aw * bv + np.cross(bv, av)
    scalar = bw * aw - (bv * av).sum(axis=1, keepdims=True)
    vector = np.where(scalar < 0.0, -vector, vector)
    length = np.linalg.norm(vector, axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(length, np.abs(scalar))
    return np.asarray(
        np.where(length > 1e-12, vector / np.maximum(length, 1e-12) * angle, 2.0 * vector)
    )
