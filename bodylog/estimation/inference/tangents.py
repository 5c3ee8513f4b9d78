"""Where frames are linearised: predicted anew only as far as their points still move."""

from typing import TYPE_CHECKING

import numpy as np

from ...types import Array
from ..measurements.records import Sighting
from ..noise.correlated_noise import PAST, WHOLE, ErrorCorrelation, directions, reach, repeated, variances
from ..noise.noise_model import NoiseModel
from .filter_records import Readings
from .folds import Fold

if TYPE_CHECKING:
    from .problem import Problem

RESTING = 1e-9
"""rad: a frame whose point of linearisation is moved less keeps its tangent, for beliefs move by a tenth of that."""
SAME = 1e-9
"""Relative change of a frame's variance that does not count."""


class Tangents:
    """Where each sighting's frames are linearised, (F,M) rad each; frames that rest are not predicted anew."""

    def __init__(self, sightings: tuple[Sighting, ...], points: tuple[Array, ...]) -> None:
        """Start from points (F,M), all to be drawn; moves below `resting` rad are not followed · share: PAST, WHOLE."""
        self._sightings, self.points, self.resting, self.share = sightings, points, RESTING, PAST
        self._stale: tuple[Array, ...] = tuple(np.ones(len(x), bool) for x in points)
        seen = [np.all(np.isfinite(sighting.values), axis=1) for sighting in sightings]
        self._seen = tuple(_rows(some) for some in seen)
        self._weighed: NoiseModel | None = None
        self._y = tuple(np.full((len(x), 2), np.nan) for x in points)
        self._jac = tuple(np.zeros((len(x), 2, x.shape[1])) for x in points)
        self._model_var = tuple(np.zeros((len(x), 2)) for x in points)
        self._var = tuple(np.ones((len(x), 2)) for x in points)
        # what no kernel can follow is each model's own
        common = [one.common / getattr(one.model, "misfit", 1.0) for one in sightings]
        counted = [int(some.sum()) for some in seen]
        models = [one.model for one, share, count in zip(sightings, common, counted, strict=True) if share * count > 0]
        told = directions(models, np.median(np.concatenate(points), axis=0)) if models else 1
        self._repeated = repeated(counted, common, told)

    def draw(self, problem: "Problem", fold: Fold, readings: Readings) -> Array:
        """Write stale tangents into the readings: y = s − g + J x°, var as alike frames have it.

        Which stretches (C,) now read otherwise.
        """
        touched = np.zeros(fold.count, bool)
        for index, (sighting, events) in enumerate(zip(self._sightings, problem.timeline.sightings, strict=True)):
            stale = self._stale[index]
            if stale.any():
                self._predict(index, sighting, stale)
                fold.put(readings.y[:, index], events[stale], self._y[index][stale])
                fold.put(readings.jac[:, index], events[stale], self._jac[index][stale])
                touched |= fold.sees(events[stale])
            elif self._weighed is problem.precision:
                continue
            var = self._variances(index, sighting, problem.precision, self.share)
            other = np.logical_or(*(np.abs(var / self._var[index] - 1.0) > SAME).T)
            self._var[index][other] = var[other]
            fold.put(readings.var[:, index], events[other], var[other])
            touched |= fold.sees(events[other])
        self._weighed = problem.precision
        return touched

    def weighed(self, problem: "Problem", fold: Fold, readings: Readings, share: float) -> Array:
        """Variances (L,T,D,C) of readings, those of frames as the problem's precision and a share have them."""
        var = readings.var.copy()
        for index, (sighting, events) in enumerate(zip(self._sightings, problem.timeline.sightings, strict=True)):
            fold.put(var[:, index], events, self._variances(index, sighting, problem.precision, share))
        return var

    def model_var(self, index: int) -> Array:
        """The model's own variance (F,D) where one sighting's frames are linearised."""
        return self._model_var[index]

    def _predict(self, index: int, sighting: Sighting, stale: Array) -> None:
        x = self.points[index][stale]
        mean, jac, self._model_var[index][stale] = sighting.model.predict(x)
        self._y[index][stale] = sighting.values[stale] - mean + np.einsum("fdm,fm->fd", jac, x)
        self._jac[index][stale] = jac

    def _variances(self, index: int, sighting: Sighting, precision: NoiseModel, share: float) -> Array:
        """Variances (F,D), of alike frames such that together they say no more than they know."""
        var, seen = precision.scale.get(sighting.name, 1.0) * sighting.var, self._seen[index]
        # a belief by the past alone errs by far more than models do, and pays for what is no noise in its rates
        often, stated = (self._repeated[index], precision.stated) if share == WHOLE else (1.0, 1.0)
        near = precision.near.get(sighting.name, 0.0)
        like = ErrorCorrelation(precision.process, reach(sighting.model), near, share, stated)
        var[seen] = variances(
            like, sighting.t[seen], sighting.values[seen], self.points[index][seen], self._jac[index][seen], var[seen],
            self._model_var[index][seen], often,
        )  # fmt: skip
        return var

    def write(self, problem: "Problem", fold: Fold, readings: Readings) -> None:
        """What is drawn by now, written into other readings of the same log."""
        for index, events in enumerate(problem.timeline.sightings):
            fold.put(readings.y[:, index], events, self._y[index])
            fold.put(readings.jac[:, index], events, self._jac[index])
            fold.put(readings.var[:, index], events, self._var[index])

    def again(self) -> "Tangents":
        """The same, to be moved on by itself."""
        other = Tangents(self._sightings, self.points)
        other._stale, other.share = self._stale, self.share
        for name in ("_y", "_jac", "_model_var", "_var"):
            for mine, copied in zip(getattr(self, name), getattr(other, name), strict=True):
                copied[:] = mine
        return other

    def follow(self, problem: "Problem", fold: Fold, means: Array) -> None:
        """Move to the angles of folded states (L,K,C) where they are further away than rest allows."""
        wanted = [fold.pick(means[:, : len(problem.start)], events) for events in problem.timeline.sightings]
        pairs = list(zip(wanted, self.points, strict=True))
        # a row of frames for each joint: numpy is slow along short axes
        moves = [np.abs(np.ascontiguousarray((new - old).T)).max(axis=0) for new, old in pairs]
        self._stale = tuple(move > self.resting for move in moves)
        self.points = tuple(
            np.where(stale[:, None], new, old) for stale, (new, old) in zip(self._stale, pairs, strict=True)
        )


def _rows(some: Array) -> Array | slice:
    """How to take the rows some (F,) bool, without a copy if that is all."""
    return slice(None) if some.all() else np.flatnonzero(some)
