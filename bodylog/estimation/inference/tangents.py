"""Tangents of frames at their linearisation points, which are computed again only where a point
moved; the prior of a log, and the points where linearisation begins.
"""

from copy import copy

import numpy as np

from ...body_model import ForwardModel
from ...motion import START_STD
from ...types import Array
from ..measurements.long_arrays import find_finite_rows, index_true_rows
from ..measurements.records import Sighting, interpolate_values, mix_rows
from ..noise.correlated_noise import (
    ErrorCorrelation,
    compute_shared_model_factors,
    count_directions,
    inflate_variances,
    read_correlation_length,
)
from ..noise.noise_model import NoiseModel
from .filter_pass import FilterDynamics, FilterReadings
from .filter_problem import FilterProblem


class Tangents:
    """Linearisation points (F,M) rad of each sighting's frames, and the tangents there."""

    def __init__(self, sightings: tuple[Sighting, ...], points: tuple[Array, ...]) -> None:
        """Tangents at points (F,M) that are yet to be computed.

        resting: moves below so many rad are ignored · whole: for the smoother of a whole log ·
        model_var (F,D): the models' own variances · var (F,D): of the frames, with the models' own.
        """
        self._sightings = sightings
        self.points = points
        self.resting = 0.0
        self.whole = False
        self._stale: tuple[Array, ...] = tuple(np.ones(len(x), bool) for x in points)
        seen = [find_finite_rows(sighting.values) for sighting in sightings]
        self._seen = tuple(index_true_rows(rows) for rows in seen)
        self._precision: NoiseModel | None = None
        self._intercept: tuple[Array, ...] = tuple(
            np.full(sighting.values.shape, np.nan) for sighting in sightings
        )
        self._jac = tuple(
            np.zeros((*y.shape, x.shape[1])) for x, y in zip(points, self._intercept, strict=True)
        )
        self.model_var = tuple(np.zeros(y.shape) for y in self._intercept)
        self.var = tuple(np.ones(y.shape) for y in self._intercept)
        # the misfit of the kernel is each model's own
        common = [
            sighting.common / getattr(sighting.model, "misfit", 1.0) for sighting in sightings
        ]
        counted = [int(rows.sum()) for rows in seen]
        models = [
            sighting.model
            for sighting, share, count in zip(sightings, common, counted, strict=True)
            if share * count > 0
        ]
        distinct = (
            count_directions(models, np.median(np.concatenate(points), axis=0)) if models else 1
        )
        self._repeated = compute_shared_model_factors(counted, common, distinct)

    def write_stale_tangents(self, problem: FilterProblem, readings: FilterReadings) -> bool:
        """Write tangents whose point or noise changed into the readings; return whether any did.

        At the point x° a frame s, predicted as g with the Jacobian J, reads y = s − g + J x°.
        """
        changed = False
        for index, events in enumerate(problem.timeline.sightings):
            stale = self._stale[index]
            if stale.any():
                self._linearise_frames(index, stale)
                _write_frames(readings.y, index, events, self._compute_y(index), stale)
                _write_frames(readings.jac, index, events, self._jac[index], stale)
                changed = True
            elif self._precision is problem.precision:
                continue
            var = self._compute_variances(index, problem.precision, self.whole)
            differs = np.any(np.abs(var / self.var[index] - 1.0) > 1e-9, axis=1)  # beyond rounding
            self.var[index][differs] = var[differs]
            _write_frames(readings.var, index, events, var, differs)
            changed = changed or bool(differs.any())
        self._precision = problem.precision
        return changed

    def write_all_tangents(self, problem: FilterProblem, readings: FilterReadings) -> None:
        """Write tangents computed before into other readings of the same log."""
        for index, events in enumerate(problem.timeline.sightings):
            _write_frames(readings.y, index, events, self._compute_y(index))
            _write_frames(readings.jac, index, events, self._jac[index])
            _write_frames(readings.var, index, events, self.var[index])

    def find_written_frames(
        self, problem: FilterProblem, readings: FilterReadings, index: int
    ) -> Array:
        """Which frames (F,) of a sighting are tangents in the readings, and no lines over beliefs."""
        jac = self._jac[index]
        written = readings.jac[problem.timeline.sightings[index], index, : jac.shape[1]]
        return np.asarray((written == jac).all(axis=(1, 2)))

    def compute_smoother_variances(self, problem: FilterProblem, readings: FilterReadings) -> Array:
        """Variances (E,T,D) of the readings' frames by the problem's noise, for a smoother."""
        var = readings.var.copy()
        for index, events in enumerate(problem.timeline.sightings):
            own = self._compute_variances(index, problem.precision, whole=True)
            _write_frames(var, index, events, own)
        return var

    def predict_from_tangents(self, index: int, x: Array) -> tuple[Array, Array, Array]:
        """Independent rows of one sighting's frames at angles
        x (F,M): mean, Jacobian and the model's variance.
        """
        jac = self._jac[index]
        var = self.model_var[index]
        mean = self._intercept[index] + np.einsum("fdm,fm->fd", jac, x)
        far = (np.abs(x - self.points[index]) > self.resting).any(axis=1)
        if far.any():
            jac = jac.copy()
            var = var.copy()
            mean[far], jac[far], var[far] = _predict_independent_rows(
                self._sightings[index], x[far], far
            )
        return mean, jac, var

    def _linearise_frames(self, index: int, stale: Array) -> None:
        """Compute the stale (F,) bool tangents of one sighting."""
        x = self.points[index][stale]
        mean, jac, var = _predict_independent_rows(self._sightings[index], x, stale)
        self._intercept[index][stale] = mean - np.einsum("fdm,fm->fd", jac, x)
        self._jac[index][stale] = jac
        self.model_var[index][stale] = var

    def _compute_y(self, index: int) -> Array:
        """Readings (F,D) of the angles by one sighting's frames: s − g + J x°."""
        return self._sightings[index].independent_rows.values - self._intercept[index]

    def _compute_variances(self, index: int, precision: NoiseModel, whole: bool) -> Array:
        """Variances (F,D) of one sighting's frames, inflated such that correlated frames together
        do not count more than they inform.
        """
        sighting = self._sightings[index]
        var = precision.scale.get(sighting.name, 1.0) * sighting.independent_rows.var
        seen = self._seen[index]
        var[seen] = inflate_variances(
            correlate_errors(precision, sighting.name, sighting.model, whole),
            sighting.t[seen],
            sighting.values[seen],
            self.points[index][seen],
            self._jac[index][seen],
            var[seen],
            self.model_var[index][seen],
            self._repeated[index] if whole else 1.0,
        )
        return var

    def copy_tangents(self, sightings: tuple[Sighting, ...]) -> "Tangents":
        """An independent copy; for other sightings of
        the same frames, new tangents at the same points.
        """
        if sightings is not self._sightings:
            return Tangents(sightings, self.points)
        other = copy(self)
        other._precision = None
        other._intercept, other._jac, other.model_var, other.var = (
            tuple(part.copy() for part in parts)
            for parts in (self._intercept, self._jac, self.model_var, self.var)
        )
        return other

    def move_points(self, problem: FilterProblem, means: Array) -> None:
        """Move to the angles of states (E,K) that are farther away than `resting`."""
        angles = means[:, : len(problem.start)]
        wanted = [angles[events] for events in problem.timeline.sightings]
        # a row of frames for each joint: numpy is slow along short axes
        moves = [
            np.ascontiguousarray((new - old).T)
            for new, old in zip(wanted, self.points, strict=True)
        ]
        self._stale = tuple(np.abs(move).max(axis=0) > self.resting for move in moves)
        choices = zip(self._stale, wanted, self.points, strict=True)
        self.points = tuple(np.where(stale[:, None], new, old) for stale, new, old in choices)


def correlate_errors(
    precision: NoiseModel, name: str, model: ForwardModel, whole: bool = False
) -> ErrorCorrelation:
    """When errors of a track's frames correlate, for a filter or the smoother of a `whole` log."""
    near = precision.correlation_px.get(name, 0.0)
    return ErrorCorrelation(
        precision.process, read_correlation_length(model), near, whole, precision.order
    )


def _predict_independent_rows(
    sighting: Sighting, x: Array, some: Array
) -> tuple[Array, Array, Array]:
    """Mean, Jacobian and the model's variance of the
    independent rows of some (F,) bool of a sighting's frames.
    """
    mix = sighting.independent_rows.mix
    return mix_rows(mix if mix is None else mix[some], sighting.model.predict(x))


def _write_frames(
    a: Array, index: int, events: Array, rows: Array, some: Array | slice = slice(None)
) -> None:
    """Write some of a sighting's frames (F,D,…) into its part of a (E,T,…)."""
    a[events[some], index, : rows.shape[1]] = rows[some]


OFFSET_STD = 0.01
"""rad: prior standard deviation of an encoder offset;
with 0.003 and 0.03 errors of drawn logs stay within .4 %.
"""


def build_state_prior(start: Array, dynamics: FilterDynamics) -> tuple[Array, Array]:
    """State z (K,) and covariance p (K,K) at the
    angles `start` (M,) rad, before any measurement.
    """
    var = np.repeat(np.square(START_STD[: dynamics.order]), len(start))
    if dynamics.drift is not None:
        var = np.append(var, np.where(dynamics.drift > 0, OFFSET_STD**2, 0.0))
    return np.concatenate([start, np.zeros(dynamics.size - len(start))]), np.diag(var)


def begin_along_path(problem: FilterProblem) -> Tangents:
    """Tangents at the initial path, or at the encoders' readings."""
    encoders = problem.evidence.encoders
    sightings = problem.evidence.sightings
    path = problem.path or (None if encoders is None else (encoders.t, encoders.values))
    return Tangents(
        sightings,
        tuple(_interpolate_path(path, problem.start, sighting.t) for sighting in sightings),
    )


def _interpolate_path(path: tuple[Array, Array] | None, start: Array, at: Array) -> Array:
    """Angles (N,M) rad at times `at` (N,) s, interpolated on the path (t, angles); the start
    angles (M,) where it is unknown.
    """
    x = np.repeat(start[None], len(at), axis=0)
    known = x if path is None else interpolate_values(*path, at)
    return np.where(np.isfinite(known), known, x)
