"""Linearisation points of frames; only frames whose point moved are predicted again.

Initial starts of a folded log's stretches and initial linearisation points of its frames.
"""

from copy import copy

import numpy as np

from ...motion import START_STD
from ...types import Array
from ..measurements.records import Sighting, interpolate_values, mix_rows
from ..noise.correlated_noise import (
    ErrorCorrelation,
    correlation_length,
    count_directions,
    inflate_variances,
    shared_model_factors,
)
from ..noise.noise_model import NoiseModel
from .filter_problem import FilterProblem, Fold
from .scan import FilterDynamics, FilterReadings


class Tangents:
    """Linearisation points (F,M) rad of each sighting's frames, and the tangents there."""

    def __init__(self, sightings: tuple[Sighting, ...], points: tuple[Array, ...]) -> None:
        """Start from points (F,M), all stale; moves below
        `resting` rad are ignored · whole: for a smoother.
        """
        self._sightings = sightings
        self.points = points
        self.resting = 0.0
        self.whole = False
        self._stale: tuple[Array, ...] = tuple(np.ones(len(x), bool) for x in points)
        seen = [np.all(np.isfinite(sighting.values), axis=1) for sighting in sightings]
        # without a copy if that is all
        self._seen = tuple(slice(None) if some.all() else np.flatnonzero(some) for some in seen)
        self._weighed: NoiseModel | None = None
        self._intercept: tuple[Array, ...] = tuple(
            np.full(one.values.shape, np.nan) for one in sightings
        )
        self._jac = tuple(
            np.zeros((*y.shape, x.shape[1])) for x, y in zip(points, self._intercept, strict=True)
        )
        self._model_var = tuple(np.zeros(y.shape) for y in self._intercept)
        self._var = tuple(np.ones(y.shape) for y in self._intercept)
        # the misfit of the kernel is each model's own
        common = [one.common / getattr(one.model, "misfit", 1.0) for one in sightings]
        counted = [int(some.sum()) for some in seen]
        models = [
            one.model
            for one, share, count in zip(sightings, common, counted, strict=True)
            if share * count > 0
        ]
        distinct = (
            count_directions(models, np.median(np.concatenate(points), axis=0)) if models else 1
        )
        self._repeated = shared_model_factors(counted, common, distinct)

    def draw(self, problem: FilterProblem, fold: Fold, readings: FilterReadings) -> bool:
        """Write stale tangents into the readings: y = s −
        g + J x°, with the variances of correlated frames.

        Returns whether any changed.
        """
        changed = False
        for index, (sighting, events) in enumerate(
            zip(self._sightings, problem.timeline.sightings, strict=True)
        ):
            stale = self._stale[index]
            if stale.any():
                self._predict(index, sighting, stale)
                _write_frames(fold, readings.y, index, events, self._y(index), stale)
                _write_frames(fold, readings.jac, index, events, self._jac[index], stale)
                changed = True
            elif self._weighed is problem.precision:
                continue
            var = self._variances(index, sighting, problem.precision, self.whole)
            # rounding
            other = np.logical_or.reduce((np.abs(var / self._var[index] - 1.0) > 1e-9).T)
            self._var[index][other] = var[other]
            _write_frames(fold, readings.var, index, events, var, other)
            changed = changed or bool(other.any())
        self._weighed = problem.precision
        return changed

    def weighed(
        self, problem: FilterProblem, fold: Fold, readings: FilterReadings, whole: bool
    ) -> Array:
        """Variances (L,T,D,C) of readings, frames as in the
        noise model, for a smoother (`whole`) or a filter.
        """
        var = readings.var.copy()
        for index, (sighting, events) in enumerate(
            zip(self._sightings, problem.timeline.sightings, strict=True)
        ):
            _write_frames(
                fold, var, index, events, self._variances(index, sighting, problem.precision, whole)
            )
        return var

    def model_var(self, index: int) -> Array:
        """The model's own variance (F,D) where one sighting's frames are linearised."""
        return self._model_var[index]

    def predicted(self, index: int, x: Array) -> tuple[Array, Array, Array]:
        """Independent rows of one sighting's frames at angles
        x (F,M): mean, Jacobian and the model's variance.
        """
        jac = self._jac[index]
        var = self._model_var[index]
        far = np.abs(x - self.points[index]) > self.resting
        mean = self._intercept[index] + np.einsum("fdm,fm->fd", jac, x)
        relinearised = far.any(axis=1)
        if relinearised.any():
            jac = jac.copy()
            var = var.copy()
            mean[relinearised], jac[relinearised], var[relinearised] = _independent_rows(
                self._sightings[index], x[relinearised], relinearised
            )
        return mean, jac, var

    def _predict(self, index: int, sighting: Sighting, stale: Array) -> None:
        x = self.points[index][stale]
        mean, self._jac[index][stale], self._model_var[index][stale] = predicted = (
            _independent_rows(sighting, x, stale)
        )
        self._intercept[index][stale] = mean - np.einsum("fdm,fm->fd", predicted[1], x)

    def _y(self, index: int) -> Array:
        """Readings (F,D) of the angles by one sighting's frames: s − g + J x°."""
        return self._sightings[index].independent_rows.values - self._intercept[index]

    def _variances(
        self, index: int, sighting: Sighting, precision: NoiseModel, whole: bool
    ) -> Array:
        """Variances (F,D), inflated such that correlated
        frames together do not count more than they inform.
        """
        var = precision.scale.get(sighting.name, 1.0) * sighting.independent_rows.var
        seen = self._seen[index]
        often = self._repeated[index] if whole else 1.0
        near = precision.near.get(sighting.name, 0.0)
        like = ErrorCorrelation(
            precision.process, correlation_length(sighting.model), near, whole, precision.order
        )
        var[seen] = inflate_variances(
            like,
            sighting.t[seen],
            sighting.values[seen],
            self.points[index][seen],
            self._jac[index][seen],
            var[seen],
            self._model_var[index][seen],
            often,
        )
        return var

    def write(self, problem: FilterProblem, fold: Fold, readings: FilterReadings) -> None:
        """Write all tangents into other readings of the same log."""
        for index, events in enumerate(problem.timeline.sightings):
            own = self._y(index), self._jac[index], self._var[index]
            for folded, rows in zip((readings.y, readings.jac, readings.var), own, strict=True):
                _write_frames(fold, folded, index, events, rows)

    def again(self, sightings: tuple[Sighting, ...]) -> "Tangents":
        """An independent copy; for other sightings of
        the same frames, new tangents at the same points.
        """
        if sightings is not self._sightings:
            return Tangents(sightings, self.points)
        other = copy(self)
        other._weighed = None
        other._intercept, other._jac, other._model_var, other._var = (
            tuple(part.copy() for part in parts)
            for parts in (self._intercept, self._jac, self._model_var, self._var)
        )
        return other

    def follow(self, problem: FilterProblem, fold: Fold, means: Array) -> None:
        """Move to the angles of folded states (L,K,C) that are farther away than `resting`."""
        wanted = [
            fold.pick(means[:, : len(problem.start)], events)
            for events in problem.timeline.sightings
        ]
        # a row of frames for each joint: numpy is slow along short axes
        moves = [
            np.ascontiguousarray((new - old).T)
            for new, old in zip(wanted, self.points, strict=True)
        ]
        self._stale = tuple(np.abs(move).max(axis=0) > self.resting for move in moves)
        choices = zip(self._stale, wanted, self.points, strict=True)
        self.points = tuple(np.where(stale[:, None], new, old) for stale, new, old in choices)


def _independent_rows(sighting: Sighting, x: Array, some: Array) -> tuple[Array, Array, Array]:
    """Mean, Jacobian and the model's variance of the
    independent rows of some (F,) bool of a sighting's frames.
    """
    mix = sighting.independent_rows.mix
    return mix_rows(mix if mix is None else mix[some], sighting.model.predict(x))


def _write_frames(
    fold: Fold, a: Array, index: int, events: Array, rows: Array, some: Array | slice = slice(None)
) -> None:
    """Write some of a sighting's frames (F,D,…) into its part of the folded a (L,T,…,C)."""
    fold.put(a[:, index, : rows.shape[1]], events[some], rows[some])


OFFSET_STD = 0.01
"""rad: prior standard deviation of an encoder offset;
with 0.003 and 0.03 errors of drawn logs stay within .4 %.
"""


def state_prior(start: Array, dynamics: FilterDynamics) -> tuple[Array, Array]:
    """State z (K,) and covariance p (K,K) at the
    angles `start` (M,) rad, before any measurement.
    """
    var = np.repeat(np.square(START_STD[: dynamics.order]), len(start))
    if dynamics.drift is not None:
        var = np.append(var, np.where(dynamics.drift > 0, OFFSET_STD**2, 0.0))
    return np.concatenate([start, np.zeros(dynamics.size - len(start))]), np.diag(var)


def stretch_priors(problem: FilterProblem, fold: Fold) -> tuple[Array, Array]:
    """The prior (K,C), (K,K,C) for every stretch."""
    z, p = state_prior(problem.start, problem.dynamics)
    return np.repeat(z[:, None], fold.count, axis=1), np.repeat(p[:, :, None], fold.count, axis=2)


def hand_over_starts(z: Array, p: Array, z_end: Array, p_end: Array) -> tuple[Array, Array]:
    """Starts for the next sweep: each stretch starts from its predecessor's end."""
    z = z.copy()
    p = p.copy()
    z[:, 1:] = z_end[:, :-1]
    p[:, :, 1:] = p_end[:, :, :-1]
    return z, p


def initial_tangents(problem: FilterProblem, fold: Fold) -> tuple[Tangents, Array, Array]:
    """Tangents at the initial path, or at the encoders'
    readings; each stretch's start z (K,C), p (K,K,C).
    """
    z, p = stretch_priors(problem, fold)
    t = problem.timeline.t
    encoders = problem.evidence.encoders
    sightings = problem.evidence.sightings
    path = problem.path or (None if encoders is None else (encoders.t, encoders.values))
    z[: len(problem.start), 1:] = _interpolate_path(path, problem.start, t[fold.lasts()]).T
    return (
        Tangents(
            sightings,
            tuple(_interpolate_path(path, problem.start, sighting.t) for sighting in sightings),
        ),
        z,
        p,
    )


def _interpolate_path(path: tuple[Array, Array] | None, start: Array, at: Array) -> Array:
    """Angles (N,M) at the times `at`, interpolated on the
    path (t, angles); the start angles where it is unknown.
    """
    x = np.repeat(start[None], len(at), axis=0)
    known = x if path is None else interpolate_values(*path, at)
    return np.where(np.isfinite(known), known, x)
