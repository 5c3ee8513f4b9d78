"""Linearisation points of frames; only frames whose point moved are predicted again."""

from copy import copy
from typing import TYPE_CHECKING

import numpy as np

from ...types import Array
from ..measurements.records import Sighting, mixed
from ..noise.correlated_noise import PAST, WHOLE, ErrorCorrelation, directions, reach, repeated, variances
from ..noise.noise_model import NoiseModel
from .filter_records import Readings
from .folds import Fold

if TYPE_CHECKING:
    from .problem import Problem


class Tangents:
    """Linearisation points (F,M) rad of each sighting's frames, and the tangents there."""

    def __init__(self, sightings: tuple[Sighting, ...], points: tuple[Array, ...]) -> None:
        """Start from points (F,M), all stale; moves below `resting` rad are ignored · share: PAST, WHOLE."""
        self._sightings, self.points, self.resting, self.share = sightings, points, 0.0, PAST
        self._stale: tuple[Array, ...] = tuple(np.ones(len(x), bool) for x in points)
        seen = [np.all(np.isfinite(sighting.values), axis=1) for sighting in sightings]
        # without a copy if that is all
        self._seen = tuple(slice(None) if some.all() else np.flatnonzero(some) for some in seen)
        self._weighed: NoiseModel | None = None
        self._y: tuple[Array, ...] = tuple(np.full(one.values.shape, np.nan) for one in sightings)
        self._jac = tuple(np.zeros((*y.shape, x.shape[1])) for x, y in zip(points, self._y, strict=True))
        self._model_var = tuple(np.zeros(y.shape) for y in self._y)
        self._var = tuple(np.ones(y.shape) for y in self._y)
        # the misfit of the kernel is each model's own
        common = [one.common / getattr(one.model, "misfit", 1.0) for one in sightings]
        counted = [int(some.sum()) for some in seen]
        models = [one.model for one, share, count in zip(sightings, common, counted, strict=True) if share * count > 0]
        distinct = directions(models, np.median(np.concatenate(points), axis=0)) if models else 1
        self._repeated = repeated(counted, common, distinct)

    def draw(self, problem: "Problem", fold: Fold, readings: Readings) -> bool:
        """Write stale tangents into the readings: y = s − g + J x°, with the variances of correlated frames.

        Returns whether any changed.
        """
        changed = False
        for index, (sighting, events) in enumerate(zip(self._sightings, problem.timeline.sightings, strict=True)):
            stale = self._stale[index]
            if stale.any():
                self._predict(index, sighting, stale)
                _put(fold, readings.y, index, events, self._y[index], stale)
                _put(fold, readings.jac, index, events, self._jac[index], stale)
                changed = True
            elif self._weighed is problem.precision:
                continue
            var = self._variances(index, sighting, problem.precision, self.share)
            other = np.logical_or.reduce((np.abs(var / self._var[index] - 1.0) > 1e-9).T)  # rounding
            self._var[index][other] = var[other]
            _put(fold, readings.var, index, events, var, other)
            changed = changed or bool(other.any())
        self._weighed = problem.precision
        return changed

    def weighed(self, problem: "Problem", fold: Fold, readings: Readings, share: float) -> Array:
        """Variances (L,T,D,C) of readings, with frames as in the problem's noise model and a share."""
        var = readings.var.copy()
        for index, (sighting, events) in enumerate(zip(self._sightings, problem.timeline.sightings, strict=True)):
            _put(fold, var, index, events, self._variances(index, sighting, problem.precision, share))
        return var

    def model_var(self, index: int) -> Array:
        """The model's own variance (F,D) where one sighting's frames are linearised."""
        return self._model_var[index]

    def _predict(self, index: int, sighting: Sighting, stale: Array) -> None:
        x, (values, _, mix) = self.points[index][stale], sighting.independent
        predicted = mixed(mix if mix is None else mix[stale], sighting.model.predict(x))
        mean, jac, self._model_var[index][stale] = predicted
        self._y[index][stale] = values[stale] - mean + np.einsum("fdm,fm->fd", jac, x)
        self._jac[index][stale] = jac

    def _variances(self, index: int, sighting: Sighting, precision: NoiseModel, share: float) -> Array:
        """Variances (F,D), inflated such that correlated frames together do not count more than they inform."""
        var, seen = precision.scale.get(sighting.name, 1.0) * sighting.independent.var, self._seen[index]
        # a filtered belief errs by far more than models do
        often, stated = (self._repeated[index], precision.stated) if share == WHOLE else (1.0, 1.0)
        near = precision.near.get(sighting.name, 0.0)
        like = ErrorCorrelation(precision.process, reach(sighting.model), near, share, stated, precision.order)
        var[seen] = variances(
            like, sighting.t[seen], sighting.values[seen], self.points[index][seen], self._jac[index][seen], var[seen],
            self._model_var[index][seen], often,
        )  # fmt: skip
        return var

    def write(self, problem: "Problem", fold: Fold, readings: Readings) -> None:
        """Write all tangents into other readings of the same log."""
        for index, events in enumerate(problem.timeline.sightings):
            for folded, own in ((readings.y, self._y), (readings.jac, self._jac), (readings.var, self._var)):
                _put(fold, folded, index, events, own[index])

    def again(self, sightings: tuple[Sighting, ...]) -> "Tangents":
        """An independent copy; for other sightings of the same frames, new tangents at the same points."""
        if sightings is not self._sightings:
            return Tangents(sightings, self.points)
        other = copy(self)
        other._weighed = None
        other._y, other._jac, other._model_var, other._var = (
            tuple(part.copy() for part in parts) for parts in (self._y, self._jac, self._model_var, self._var)
        )
        return other

    def follow(self, problem: "Problem", fold: Fold, means: Array) -> None:
        """Move to the angles of folded states (L,K,C) that are farther away than `resting`."""
        wanted = [fold.pick(means[:, : len(problem.start)], events) for events in problem.timeline.sightings]
        # a row of frames for each joint: numpy is slow along short axes
        moves = [np.ascontiguousarray((new - old).T) for new, old in zip(wanted, self.points, strict=True)]
        self._stale = tuple(np.abs(move).max(axis=0) > self.resting for move in moves)
        choices = zip(self._stale, wanted, self.points, strict=True)
        self.points = tuple(np.where(stale[:, None], new, old) for stale, new, old in choices)


def _put(fold: Fold, a: Array, index: int, events: Array, rows: Array, some: Array | slice = slice(None)) -> None:
    """Write some of a sighting's frames (F,D,…) into its part of the folded a (L,T,…,C)."""
    fold.put(a[:, index, : rows.shape[1]], events[some], rows[some])
