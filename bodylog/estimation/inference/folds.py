"""A long log folded into stretches that are filtered
in parallel: (E,…) in time order <-> (L,…,C).

A log's readings, folded into stretches for the filter.
"""

from dataclasses import dataclass, replace

import numpy as np

from ...types import Array
from .filter_records import FilterReadings
from .kernel import LANES
from .problem import FilterProblem

MIN_STRETCH_INSTANTS = 32
"""Least number of instants in a stretch: its end must not depend on its start."""


@dataclass(frozen=True)
class Fold:
    """`count` stretches C of `length` instants L each."""

    events: int
    length: int
    count: int

    def fold(self, a: Array, fill: float | Array) -> Array:
        """(E,…) -> (L,…,C), with `fill` after the last event."""
        padded = np.empty((self.length * self.count, *a.shape[1:]))
        padded[: self.events], padded[self.events :] = a, fill
        return np.ascontiguousarray(
            np.moveaxis(padded.reshape(self.count, self.length, *a.shape[1:]), 0, -1)
        )

    def unfold(self, a: Array) -> Array:
        """(L,…,C) -> (E,…)."""
        return np.moveaxis(a, -1, 0).reshape(-1, *a.shape[1:-1])[: self.events]

    def pick(self, a: Array, events: Array) -> Array:
        """Rows (F,…) of the folded a (L,…,C) at the given events."""
        rows: Array = a[events % self.length, ..., events // self.length]
        return rows

    def put(self, a: Array, events: Array, rows: Array) -> None:
        """Write rows (F,…) into the folded a (L,…,C) at the given events."""
        a[events % self.length, ..., events // self.length] = rows

    def lasts(self) -> Array:
        """Last event (C−1,) before each stretch but the first starts."""
        return np.arange(1, self.count) * self.length - 1


def choose_fold(events: int) -> Fold:
    """Fold with as many stretches as the kernel filters side by side, if the log is long enough."""
    count = min(LANES, max(1, events // MIN_STRETCH_INSTANTS))
    length = max(1, -(-events // count))
    return Fold(events, length, max(1, -(-events // length)))


def fold_readings(problem: FilterProblem, fold: Fold, held: Array | None = None) -> FilterReadings:
    """Readings of all instants, folded, without the frames'
    tangents; held (E,M) bool: joints silent for long.
    """
    more = None if problem.more is None else fold.fold(problem.more, 1.0)
    held = problem.held if held is None else held
    parts = _build_reading_parts(problem, fold, *encoder_rows(problem))
    found = FilterReadings(
        *parts, reset=_mark_restarting_joints(problem, fold), more=more, gate=problem.gate
    )
    if held is None or problem.stationary is None or not held.any():
        return found
    dt = np.diff(problem.timeline.t, prepend=problem.timeline.t[0])
    # other joints move by dt, with the process of a candidate
    move, shift, noise = (
        fold.fold(part, np.nan) for part in problem.dynamics.silent_moves(dt, held)
    )
    return replace(found, moves=(move, shift, noise))


def _mark_restarting_joints(problem: FilterProblem, fold: Fold) -> Array | None:
    """Joints (L,M,C) bool that restart from a wide prior at an instant; None if none does."""
    events, joints = problem.resets_at(problem.timeline.t)
    if not len(events):
        return None
    reset = np.zeros((fold.length, len(problem.start), fold.count), bool)
    fold.put(reset, events, joints)
    return reset


def _build_reading_parts(
    problem: FilterProblem, fold: Fold, values: Array, values_var: Array
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """The parts of `FilterReadings`: encoder rows (E,M) with variances, and room for the frames."""
    line = problem.timeline
    m = len(problem.start)
    sizes = [sighting.values.shape[1] for sighting in problem.evidence.sightings]
    shape = (fold.length, len(sizes), max(sizes, default=2))
    y = np.full((*shape, fold.count), np.nan)
    var = np.ones((*shape, fold.count))
    jac = np.zeros((*shape, m, fold.count))
    dt = fold.fold(np.diff(line.t, prepend=line.t[0]), 0.0)
    return dt, fold.fold(values, np.nan), fold.fold(values_var, 1.0), y, jac, var


def encoder_rows(problem: FilterProblem, until: int | None = None) -> tuple[Array, Array]:
    """Readings (E,M) rad, NaN where silent, and variances
    (E,M); the posture prior for joints without an encoder.

    Only of the first `until` instants, if given.
    """
    t = problem.timeline.t[:until]
    at = problem.timeline.encoders
    encoders = np.full((len(t), len(problem.start)), np.nan)
    found = problem.evidence.encoders
    var = np.tile(problem.precision.encoder, (len(t), 1))
    if found is not None:
        rows = int(np.searchsorted(at, len(t)))
        encoders[at[:rows]] = found.values[:rows]
        if found.relative is not None:
            var[at[:rows]] *= found.relative[:rows]
    return (
        (encoders, var)
        if problem.posture_prior is None
        else problem.posture_prior.fill(t, encoders, var)
    )
