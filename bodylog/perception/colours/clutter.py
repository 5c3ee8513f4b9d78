"""Select the arm's blob among several of one colour: the one whose place the joints predict.

A thing that stands still while the joints move is foreign. A smooth function of the joints is
fitted to all other candidate places in rounds: each round keeps, in every image, the candidate
nearest to the prediction, within a shrinking gate. Several starts are tried, and the one that
explains most held-out motion wins.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ...types import Array, Series
from ..tracking import joint_motion
from ..tracking.target_selection import link_blobs
from .blob_measurement import MASS, U, V

_REACH = 3.0
_ROUNDS = 12
_RUNS = (0.5, 0.9)
_SAME = 0.8
_VAGUE = 0.04
_STEADY = 0.3
_DIFFERENT = 0.2
_SAME_PLACE = 0.008
_SPREAD = 0.3
_OFTEN = 0.02
_FEWEST = 20
_SEEDS = 4
_NEAR = 1.0
_FAR = 0.08
_RARELY = 0.05
_COMPARED = 3000
_STRETCH = 300
"""Images of a long log on which starts are compared, and how many of them follow one another."""
_AT_ONCE = 1024
EXPLAINED = 0.25
"""Least share of held-out motion that the joints explain of a thing on the arm."""


class BlobChoice(NamedTuple):
    """The arm's candidate in each image (N,), -1 for none.

    place (N,2) px, `spread` (N,) px and radius (N,) px are predicted from the joints; `explained`
    is the share (0..1) of its held-out motion that the joints explain, `beyond_chance` of what
    time-shifted angles leave; `delay` s is the lag of the camera's timestamps.
    """

    number: Array
    place: Array
    spread: Array
    radius: Array
    explained: float
    beyond_chance: float
    delay: float


class _CandidateRows(NamedTuple):
    """Candidates as rows: image (R,), number in the image (R,), place (R,2) px, area (R,) px²."""

    frame: Array
    which: Array
    place: Array
    area: Array

    def only(self, kept: Array) -> "_CandidateRows":
        return _CandidateRows(*(column[kept] for column in self))


def choose_arm_blobs(
    t: Array, found: Array, joints: Series | None, width: float
) -> BlobChoice | None:
    """The arm's blobs among those found (N,candidates,FIELDS)
    at t (N,) s; None where the joints explain none.
    """
    q = joint_motion.moving_postures(joints, t)
    rows = _candidate_rows(found)
    if not q.shape[1] or len(np.unique(rows.frame)) < _FEWEST:
        return None
    still = _still_places(rows, q, width)
    best = _empty_choice(q)
    if len(t) > _COMPARED:
        start = _start_of_part(t, found, q, width)
        best = (
            _follow_joints(t, rows, still, start, q, width) if len(start.frame) >= _FEWEST else best
        )
    if best.beyond_chance < EXPLAINED:
        best = _best_of_starts(t, found, still, q, width)
    if best.beyond_chance < EXPLAINED:
        return None
    late = _delay_of_choice(t, rows, best, joints, width)
    if late:
        again = _follow_joints(
            t,
            rows,
            still,
            _chosen_rows(rows, best.number),
            joint_motion.moving_postures(joints, t, late),
            width,
        )
        best = max(best, again._replace(delay=late), key=_worth_of_choice)
    return best


def _start_of_part(t: Array, found: Array, q: Array, width: float) -> _CandidateRows:
    """The rows that the best start ends with on stretches of a long log."""
    stretches = np.linspace(0, len(t) - _STRETCH, _COMPARED // _STRETCH).astype(int)
    part = np.unique(stretches[:, None] + np.arange(_STRETCH))
    rows = _candidate_rows(found[part])
    best = _best_of_starts(
        t[part], found[part], _still_places(rows, q[part], width), q[part], width
    )
    start = _chosen_rows(rows, best.number)
    return start._replace(frame=part[start.frame])


def _best_of_starts(t: Array, found: Array, still: Array, q: Array, width: float) -> BlobChoice:
    """The choice that explains most, of all starts; `still` (R,) numbers places of still things."""
    rows = _candidate_rows(found)
    best = _empty_choice(q)
    for start in _rows_to_start_from(t, found, rows.only(still < 0), q, width):
        known = best.beyond_chance and _share_near_places(start, best.place, width) > _SAME
        if known or len(start.frame) < _FEWEST:
            continue
        best = max(best, _follow_joints(t, rows, still, start, q, width), key=_worth_of_choice)
    return best


def _candidate_rows(found: Array) -> _CandidateRows:
    frame, which = np.nonzero(np.isfinite(found[:, :, U]))
    row = found[frame, which]
    return _CandidateRows(frame, which, row[:, [U, V]], row[:, MASS])


def _share_near_places(rows: _CandidateRows, place: Array, width: float) -> float:
    """The share of rows near the places that another start found already."""
    return float((np.hypot(*(rows.place - place[rows.frame]).T) < _SAME_PLACE * width).mean())


def _worth_of_choice(choice: BlobChoice) -> float:
    return choice.beyond_chance * np.count_nonzero(choice.number >= 0)


def _still_places(rows: _CandidateRows, q: Array, width: float) -> Array:
    """For each row the number of the place where something
    stands still while the joints move, else -1: (R,).
    """
    still = np.full(len(rows.frame), -1)
    left = np.ones(len(rows.frame), bool)
    number = 0
    cell = max(3.0, _SAME_PLACE * width)
    most = max(5.0, _OFTEN * len(q))
    moved = np.sqrt(q.var(axis=0).sum())
    while left.any():
        column, line = np.floor(rows.place[left] / cell).astype(int).T
        cells = column * (np.ptp(line) + 1) + line - line.min()
        _, inverse, counts = np.unique(cells, return_inverse=True, return_counts=True)
        if counts.max() < most / 4:
            break
        middle = np.median(rows.place[left][inverse == counts.argmax()], axis=0)
        away = np.hypot(*(rows.place - middle).T)
        there = left & (away < cell)
        frames = np.unique(rows.frame[there])
        stands = len(frames) >= most and np.median(away[there]) < _STEADY * cell
        if stands and np.sqrt(q[frames].var(axis=0).sum()) > _SPREAD * moved:
            still[there] = number
            number += 1
        left &= ~there
    return still


def _rows_to_start_from(
    t: Array, found: Array, moving: _CandidateRows, q: Array, width: float
) -> Iterator[_CandidateRows]:
    """Rows to start from: runs through time that the joints
    explain, the best runs alone, then all that moves.
    """
    packed = np.full(found.shape, np.nan)
    rank = np.arange(len(moving.frame)) - np.searchsorted(moving.frame, moving.frame)
    packed[moving.frame, rank] = found[moving.frame, moving.which]
    scored = []
    for frames, table in link_blobs(t, packed, width):
        if len(frames) >= _FEWEST:
            place = table[:, [U, V]]
            share = joint_motion.explained_share(q[frames], place, width)
            scored.append((share, _CandidateRows(frames, 0 * frames, place, table[:, MASS])))
    for least in _RUNS:
        if runs := [run for share, run in scored if share > least]:
            yield _CandidateRows(*(np.concatenate(columns) for columns in zip(*runs, strict=True)))
    best = sorted(scored, key=lambda one: -one[0] * len(one[1].frame))
    yield from (run for share, run in best[:_SEEDS] if share)
    yield moving


def _follow_joints(
    t: Array, rows: _CandidateRows, still: Array, start: _CandidateRows, q: Array, width: float
) -> BlobChoice:
    """The nearest candidate in each image to a function of the angles, fitted from some rows on."""
    allowed = rows.only(still < 0)
    chosen = start
    last = -1
    usual = _usual_residual(q, chosen, width)
    for _ in range(_ROUNDS):
        place, spread = _predict_places(t, chosen, usual, q, width)
        reach = np.hypot(2 * usual, spread)
        chosen = _nearest_rows(
            allowed, place, np.where(spread < max(_VAGUE * width, usual), reach, 0.0)
        )
        if len(chosen.frame) < _FEWEST:
            return _empty_choice(q)
        off = np.hypot(*(chosen.place - place[chosen.frame]).T)
        usual = max(joint_motion.assumed_noise_px(width), float(np.median(off)))
        if len(chosen.frame) <= last:
            allowed = rows.only(~_rows_at_still_things(rows, still, place, width))
        last = len(chosen.frame)
    radius, chosen = _rows_of_right_size(q, chosen)
    if len(chosen.frame) < _FEWEST:
        return _empty_choice(q)
    for _ in range(2):
        place, spread = _predict_places(t, chosen, usual, q, width)
        reach = np.hypot(2 * usual, spread)
        fitting = allowed.only(_of_predicted_size(allowed, radius))
        chosen = _nearest_rows(
            fitting, place, np.where(spread < max(_VAGUE * width, usual), reach, 0.0)
        )
    number = np.full(len(q), -1)
    number[chosen.frame] = chosen.which
    share = joint_motion.explained_share(q[chosen.frame], chosen.place, width)
    beyond = joint_motion.beyond_chance(q, chosen.frame, chosen.place, width)
    near = float(np.median(np.hypot(*(chosen.place - place[chosen.frame]).T)))
    return BlobChoice(number, place, np.hypot(near, spread), radius, share, beyond, 0.0)


def _rows_of_right_size(q: Array, chosen: _CandidateRows) -> tuple[Array, _CandidateRows]:
    """The radius (N,) px predicted from the joints, and the
    rows that have it: larger ones are two things in one.
    """
    radius = np.sqrt(chosen.area / np.pi)
    usual = float(np.median(radius))
    kept = np.flatnonzero(np.abs(radius / usual - 1) < 0.5)
    predicted = np.full(len(q), usual)
    for _ in range(3):
        some = kept[joint_motion.thin_indices(len(kept), 300)]
        noise = np.full(len(some), 0.05 * usual)
        fitted = joint_motion.Regression.fit(
            q[chosen.frame[some]], radius[some, None], noise, 0.5 * usual
        )
        predicted = np.maximum(fitted.predict(q)[0][:, 0], 0.3 * usual)
        kept = np.flatnonzero(_of_predicted_size(chosen, predicted))
        if len(kept) < _FEWEST:
            break
    return predicted, chosen.only(kept)


def _of_predicted_size(rows: _CandidateRows, radius: Array) -> Array:
    """Which rows (R,) have the area that radius (N,) px predicts for their images."""
    return np.abs(rows.area / (np.pi * radius[rows.frame] ** 2) - 1) < _DIFFERENT


def _usual_residual(q: Array, start: _CandidateRows, width: float) -> float:
    """The usual residual (px) of rows in held-out time."""
    order = np.argsort(start.frame, kind="stable")
    rest = joint_motion.held_out_place_residuals(q[start.frame[order]], start.place[order], width)
    return max(joint_motion.assumed_noise_px(width), float(np.median(np.hypot(*rest.T))))


def _empty_choice(q: Array) -> BlobChoice:
    unknown = np.full(len(q), np.nan)
    return BlobChoice(
        np.full(len(q), -1), np.full((len(q), 2), np.nan), unknown, unknown, 0.0, 0.0, 0.0
    )


def _predict_places(
    t: Array, chosen: _CandidateRows, std: float, q: Array, width: float
) -> tuple[Array, Array]:
    """The place (N,2) px and spread (N,) px in each image, from the joints and nearby residuals."""
    noise = np.full(len(chosen.frame), std)
    place, spread = joint_motion.fit_regression(
        q[chosen.frame], chosen.place, noise, width
    ).predict(q)
    return place + _nearby_residuals(t, chosen.frame, chosen.place - place[chosen.frame]), spread


def _nearby_residuals(t: Array, frame: Array, rest: Array) -> Array:
    """The median residual (n,2) px within _NEAR s of each image: (N,2); 0 where there are few."""
    low = np.searchsorted(t[frame], t - _NEAR)
    high = np.searchsorted(t[frame], t + _NEAR, side="right")
    left = np.zeros((len(t), 2))
    count = high - low
    for number in np.unique(count[count >= 5]).tolist():
        images = np.flatnonzero(count == number)
        for start in range(0, len(images), _AT_ONCE):
            some = images[start : start + _AT_ONCE]
            left[some] = np.median(rest[low[some, None] + np.arange(number)], axis=1)
    return left


def _nearest_rows(rows: _CandidateRows, place: Array, spread: Array) -> _CandidateRows:
    """The row of each image nearest to its place (N,2) px, if within _REACH spreads (N,) px."""
    away = np.hypot(*(rows.place - place[rows.frame]).T)
    order = np.lexsort((away, rows.frame))
    first = order[np.unique(rows.frame[order], return_index=True)[1]]
    return rows.only(first[away[first] <= _REACH * spread[rows.frame[first]]])


def _rows_at_still_things(rows: _CandidateRows, still: Array, place: Array, width: float) -> Array:
    """Which rows (R,) lie where something stands also when the arm's thing is expected far off."""
    foreign = np.zeros(len(still), bool)
    for number in range(int(still.max(initial=-1)) + 1):
        there = still == number
        far = np.hypot(*(place - np.median(rows.place[there], axis=0)).T) > _FAR * width
        occupied = np.count_nonzero(far[np.unique(rows.frame[there])])
        if occupied > _RARELY * np.count_nonzero(far):
            foreign |= there
    return foreign


def _chosen_rows(rows: _CandidateRows, number: Array) -> _CandidateRows:
    return rows.only(rows.which == number[rows.frame])


def _delay_of_choice(
    t: Array, rows: _CandidateRows, choice: BlobChoice, joints: Series | None, width: float
) -> float:
    chosen = _chosen_rows(rows, choice.number)
    return joint_motion.camera_delay_s(joints, t[chosen.frame], chosen.place, width)
