"""When columns hold: an arm picks things up and puts them down, and a camera's images may be
displaced for a while.

With the noise known, the gain of columns is a Schur complement. That of columns that hold between
two moments follows from those that hold from either moment on: the first minus the second.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, product

import numpy as np

from ...types import Array
from ..faults.threshold import PRIOR_STD_RAD
from ..measurements.long_arrays import measure_median_step
from ..measurements.track import group_tracks_by_camera
from .columns import Column, ImageShift, Path
from .elimination import Eliminated, compute_column_nats, eliminate_states
from .factor_problem import (
    FactorProblem,
    Linearised,
    Noise,
    add_at_knots,
    build_system,
    linearise_problem,
)
from .load import TAKEN_S, WIDE_BEND, LoadColumns

SEARCHED = 6
"""Windows that are narrowed: a moment that is off by a tenth of a second costs tens of nats, so the
most probable one of a few parts may be another.
"""
PARTS = 32
"""Parts of a log at whose ends a load is first tried to be taken or put down; the search then
narrows until it knows the images between which it was.
"""
LEAST_CARRIED_S = 1.0
"""s: no arm takes a load and puts it down in less."""


@dataclass(frozen=True)
class LinkShift(Column):
    """How far a link is from where its encoder reads it, rad, more and more from `since` to `until`
    s, and as far from then on: what an encoder that is off shows in images.
    """

    joint: int = 0
    since: float = -np.inf
    until: float = np.inf

    def moves_links(self, path: Path) -> Array:
        """A ramp to 1 at `until`, which is a step where that is `since`."""
        own = np.zeros(path.angles.shape)
        after = path.knots - self.since
        rise = self.until - self.since
        own[:, self.joint] = np.clip(after / rise, 0.0, 1.0) if rise > 0.0 else after >= 0.0
        return own


Moments = tuple[float, ...]
"""s: when a load is taken, put down, taken, …; the first is −∞ if it was there from the start."""
Window = tuple[float, float]
"""s: from when to when; infinite at an end of the log."""
Begin = Callable[[float], tuple[Column, ...]]
"""Columns of what begins at a moment (s) and lasts."""


def list_timed_loads(
    problem: FactorProblem, noise: Noise, path: Path, load: LoadColumns
) -> Iterator[tuple[LoadColumns, float]]:
    """Yield the load as carried from the first to the last image, then with one window of time
    after another in which that changes, each the most probable one.

    With each come −ln p of its windows before the log: each window is one of all that were tried.
    The list ends where one encoder that is off is as probable. noise, path: without the load.
    """
    yield load, 0.0
    linear = linearise_problem(problem, path, noise)
    eliminated = eliminate_states(build_system(linear))
    rival = _weigh_shifts(linear, eliminated)
    leads = tuple({one.group: one for one in reversed(load)}.values())

    def take_load(moment: float) -> tuple[Column, ...]:
        return tuple(replace(lead, moments=(moment,)) for lead in leads)

    moments: Moments = ()
    total = 0.0
    while (
        found := _change_moments(linear, eliminated, take_load, WIDE_BEND, moments, LEAST_CARRIED_S)
    ) is not None:
        moments, cost = found
        total += cost
        timed = tuple(replace(one, moments=moments) for one in load)
        alone = np.eye(len(timed))[None]
        if rival <= _weigh_columns(linear, eliminated, timed, alone, WIDE_BEND)[0] + total:
            return
        yield timed, total


def list_displaced_images(
    problem: FactorProblem, noise: Noise, path: Path
) -> Iterator[tuple[tuple[ImageShift, ...], float]]:
    """Yield how each camera's images are displaced in the most probable window of time, if the log
    is more probable with that, and −ln p of that window before the log.
    """
    linear = linearise_problem(problem, path, noise)
    eliminated = eliminate_states(build_system(linear))
    sightings = [one.sighting for one in problem.images]
    for camera, tracks in group_tracks_by_camera(sightings).items():
        own = [sightings[number].values for number in tracks]
        # they may lie anywhere among the places of their tracks
        std = float(np.nanstd(np.concatenate(own), axis=0).max())
        shift = ImageShift("displaced", std, camera=camera)
        shifts = tuple(replace(shift, axis=axis) for axis in range(own[0].shape[1]))
        begin = partial(_begin_shift, shifts)
        found = _change_moments(linear, eliminated, begin, std, ())
        if found is not None:
            (since, *until), cost = found
            end = until[0] if until else np.inf
            yield tuple(replace(one, until=end) for one in begin(since)), cost


def _begin_shift(shifts: tuple[ImageShift, ...], moment: float) -> tuple[ImageShift, ...]:
    """The shifts from a moment (s) on."""
    return tuple(replace(one, since=moment) for one in shifts)


def weigh_displacements(
    problem: FactorProblem, noise: Noise, path: Path, tried: Sequence[tuple[ImageShift, ...]]
) -> list[float]:
    """Nats by which a log is more probable with each displacement, of unknown size, by this
    noise."""
    linear = linearise_problem(problem, path, noise)
    eliminated = eliminate_states(build_system(linear))
    without = eliminated.nats - eliminated.logs
    gains = []
    for shifts in tried:
        alone = np.eye(len(shifts))[None]
        (nats,) = _weigh_columns(linear, eliminated, shifts, alone, shifts[0].std)
        gains.append(without - float(nats))
    return gains


def _change_moments(
    linear: Linearised,
    eliminated: Eliminated,
    begin: Begin,
    std: float,
    before: Moments,
    least: float = 0.0,
) -> tuple[Moments, float] | None:
    """The moments with the most probable window in which columns change, and −ln p of that window
    before the log; None if the log is about as likely without it, or with the columns all the time.

    begin: columns of what begins at a moment and lasts, of sizes 0 ± std · least: s of a window.
    """

    def weigh_windows(windows: Sequence[Window]) -> Array:
        tried = [_change_between(before, one) for one in windows]
        return _weigh_moments(linear, eliminated, begin, std, tried)

    knots = linear.problem.knots
    step = (knots[-1] - knots[0]) / PARTS
    inner = (knots[0] + step * np.arange(1, PARTS)).tolist()
    every = product([-np.inf, *inner], [*inner, np.inf])
    windows = [(a, b) for a, b in every if b - a > max(least, 0.5 * step)]
    cost = float(np.log(len(windows)))
    apart = _list_separate(windows, weigh_windows(windows), 1.5 * step)
    finest = measure_median_step(knots)
    narrow = sorted(_narrow_window(one, step, finest, least, weigh_windows) for one in apart)
    (without,) = _weigh_moments(linear, eliminated, begin, std, [before or (-np.inf,)])
    seen = _list_image_times(linear.problem)
    for nats, window in narrow:
        since, until = (_centre_between_images(moment, seen) for moment in window)
        # some images, and not all of them
        if since < until and np.isfinite([since, until]).any():
            changed = _change_between(before, (since, until))
            return (changed, cost) if without - nats > cost else None
    return None


def _narrow_window(
    window: Window,
    step: float,
    finest: float,
    least: float,
    weigh_windows: Callable[[Sequence[Window]], Array],
) -> tuple[float, Window]:
    """−ln p of the log with the most probable window of at least `least` s near one that is known
    to `step` s, and that window, known to `finest` s.
    """
    while step > finest:
        step /= 4.0
        near = (step * np.arange(-4, 5)).tolist()
        every = ((window[0] + a, window[1] + b) for a, b in product(near, near))
        tried = [(a, b) for a, b in every if b - a > least]
        window = tried[int(np.argmin(weigh_windows(tried)))]
    (nats,) = weigh_windows([window])
    return float(nats), window


def _list_separate(windows: Sequence[Window], nats: Array, apart: float) -> list[Window]:
    """The SEARCHED most probable windows of which none is within `apart` s of another."""
    found = list[Window]()
    for k in np.argsort(nats, kind="stable").tolist():
        if len(found) == SEARCHED:
            break
        own = windows[k]
        if not any(_are_near(own, other, apart) for other in found):
            found.append(own)
    return found


def _are_near(one: Window, other: Window, apart: float) -> bool:
    """Whether two windows begin and end within `apart` s of one another."""
    pairs = zip(one, other, strict=True)
    return all(a == b or abs(a - b) < apart for a, b in pairs)


def _list_image_times(problem: FactorProblem) -> Array:
    """Times (F,) s of all images, in order."""
    every = [problem.knots[images.knots] + images.ahead for images in problem.images]
    return np.sort(np.concatenate(every))


def _centre_between_images(moment: float, seen: Array) -> float:
    """The middle between the images before and after a moment (s): more is not known of it.
    Infinite before the first and after the last.
    """
    after = int(np.searchsorted(seen, moment))
    if after == 0:
        return -np.inf
    return float(seen[after - 1 : after + 1].mean()) if after < len(seen) else np.inf


def _change_between(moments: Moments, window: tuple[float, float]) -> Moments:
    """The moments with a load where the window (s) had none, and without where it had one."""
    return tuple(sorted(one for one in {*moments} ^ {*window} if one < np.inf))


def _weigh_moments(
    linear: Linearised, eliminated: Eliminated, begin: Begin, std: float, tried: Sequence[Moments]
) -> Array:
    """−ln p (W,) of the log with columns, of sizes 0 ± std, that are there as tried."""
    steps = sorted({one for moments in tried for one in moments})
    each = [begin(one) for one in steps]
    count = len(each[0])
    mixes = np.zeros((len(tried), count, count * len(steps)))
    for mix, moments in zip(mixes, tried, strict=True):
        for i, one in enumerate(moments):
            first = steps.index(one) * count
            mix[:, first : first + count] = np.eye(count) * (-1.0) ** i
    return _weigh_columns(linear, eliminated, tuple(chain(*each)), mixes, std)


def _weigh_shifts(linear: Linearised, eliminated: Eliminated) -> float:
    """−ln p of the log with the most probable shift of one encoder: a step, in one reading or as
    slow as a load is taken, or a steady drift to the end.
    """
    knots = linear.problem.knots
    step = (knots[-1] - knots[0]) / PARTS
    moments = (knots[0] + step * np.arange(PARTS)).tolist()
    rises = (0.0, TAKEN_S, np.inf)
    kinds = list(product(range(len(linear.problem.start)), moments, rises))
    cost = float(np.log(len(kinds)))
    nats = _weigh_each_shift(linear, eliminated, kinds)
    while step > measure_median_step(knots):
        joint, since, rise = kinds[int(np.argmin(nats))]
        step /= 4.0
        near = since + step * np.arange(-4, 5)
        kinds = [(joint, one, rise) for one in near[near < knots[-1] - step].tolist()]
        nats = _weigh_each_shift(linear, eliminated, kinds)
    return float(nats.min()) + cost


def _weigh_each_shift(
    linear: Linearised, eliminated: Eliminated, kinds: Sequence[tuple[int, float, float]]
) -> Array:
    """−ln p (W,) of the log with a shift of one encoder: joint, since when (s), and the s in which
    it rises, infinite to the end.
    """
    end = float(linear.problem.knots[-1])
    shifts = tuple(
        LinkShift("shift", 1.0, joint=j, since=since, until=since + rise if rise < np.inf else end)
        for j, since, rise in kinds
    )
    alone = np.eye(len(shifts))[:, None]
    return _weigh_columns(linear, eliminated, shifts, alone, PRIOR_STD_RAD)


def _weigh_columns(
    linear: Linearised, eliminated: Eliminated, more: tuple[Column, ...], mixes: Array, std: float
) -> Array:
    """−ln p (W,) of the log with each mix (W,B,C) of C more columns, of sizes 0 ± std."""
    schur = _extend_schur(linear, eliminated, more)
    known = len(eliminated.schur)
    count = mixes.shape[1]
    turns = np.zeros((len(mixes), known + count, len(schur)))
    turns[:, np.arange(known), np.arange(known)] = 1.0
    turns[:, known:, known:] = mixes
    precision = np.r_[eliminated.precision, np.full(count, std**-2)]
    return compute_column_nats(turns @ schur @ turns.swapaxes(1, 2), precision)


def _extend_schur(linear: Linearised, eliminated: Eliminated, more: tuple[Column, ...]) -> Array:
    """What is left of c, as in `Eliminated`, with more columns, which only images show."""
    from scipy.linalg.lapack import dtbtrs

    problem = linear.problem
    with_more = linearise_problem(replace(problem, columns=more), linear.path, linear.noise)
    means = np.array([column.mean for column in problem.columns])
    count, states, known = eliminated.right.shape
    right = np.zeros((count, states, len(more)))
    cross = np.zeros((known, len(more)))
    square = np.zeros((len(more), len(more)))
    for images, own, other, scale in zip(
        problem.images, linear.rows, with_more.rows, linear.noise.scales, strict=True
    ):
        moved = other.right[..., 1:]
        weighed = (images.believed[:, None] / (scale * own.var))[..., None] * moved
        add_at_knots(right, images.knots, own.slopes.swapaxes(1, 2) @ weighed)
        read = own.right.copy()
        read[..., 0] -= own.right[..., 1:] @ means
        cross += np.einsum("fdr,fdc->rc", read, weighed)
        square += np.einsum("fdb,fdc->bc", moved, weighed)
    solved, _ = dtbtrs(eliminated.band, right.reshape(-1, len(more)), uplo="U", trans="T")
    cross -= eliminated.right.reshape(-1, known).T @ solved
    square -= solved.T @ solved
    return np.block([[eliminated.schur, cross], [cross.T, square]])
