"""A log reduced to knots: its images, and the encoder readings that need a gate; other readings are pooled."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ...types import Array
from ..measurements.timeline import Timeline
from .filter_records import Dynamics, KnotReadings, Pooled, Readings
from .folds import Fold, fold_for
from .pooling import Blocks, blocks, kept, moves, outlier_candidates, pooled

if TYPE_CHECKING:
    from .problem import Problem


@dataclass(frozen=True, eq=False)
class KnotProblem:
    """The problem at knots, which events (B,) of the log they are, the blocks in between, and the folded readings."""

    problem: "Problem"
    events: Array
    blocks: Blocks
    readings: KnotReadings

    @property
    def fold(self) -> Fold:
        """The stretches."""
        return fold_for(len(self.events))

    def pooled(self, dynamics: Dynamics) -> Pooled:
        """Readings between knots, pooled and folded."""
        return pooled(self.blocks, dynamics, self.fold, self.problem.more, self.problem.held)

    def of(self, problem: "Problem") -> "KnotProblem":
        """The same log with another process or other pixel variances."""
        few = replace(self, problem=replace(problem, timeline=self.problem.timeline))
        return replace(few, readings=replace(self.readings, pooled=few.pooled(problem.dynamics)))


def tile(knots: KnotProblem, var: Array, processes: Array) -> KnotReadings:
    """The knots' readings for processes (M,G), side by side in each stretch, with frame variances var (L,T,D,C,G)."""
    found, g = knots.readings, processes.shape[-1]
    dt, values, values_var, y, jac = (
        np.repeat(part, g, axis=-1) for part in (found.dt, found.encoders, found.encoder_var, found.y, found.jac)
    )
    between = knots.pooled(replace(knots.problem.dynamics, process=processes))
    reset = None if found.reset is None else np.repeat(found.reset, g, axis=-1)
    return KnotReadings(
        dt, values, values_var, y, jac, var.reshape(*var.shape[:-2], dt.shape[-1]), between, reset=reset
    )


def knot_problem(problem: "Problem", gated: Array | None = None) -> KnotProblem:
    """Reduce the log to knots; `gated`: instants (E,) with a reading that the gate is known to reject."""
    line, (values, var) = problem.timeline, encoder_rows(problem)
    alone = outlier_candidates(values) if gated is None else outlier_candidates(values) | gated
    alone[np.concatenate([*line.sightings, np.empty(0, int)])] = True
    alone[problem.resets_at(line.t)[0]] = True
    wanted = alone.copy()
    if (held := problem.held) is not None:
        alone |= held.any(axis=1)
        wanted = alone | np.append(alone[1:], False)
    wanted[fold_for(len(line.t)).lasts()] = True
    events = kept(wanted)
    sightings, none = tuple(np.searchsorted(events, frames) for frames in line.sightings), np.empty(0, int)
    few = replace(problem, timeline=Timeline(line.t[events], none, sightings, none, none))
    between, fold = blocks(line.t, values, var, events, alone), fold_for(len(events))
    rest = folded_readings(few, fold, np.where(alone[:, None], values, np.nan)[events], var[events])
    found = pooled(between, few.dynamics, fold, few.more, few.held)
    leaps = KnotReadings(*rest, pooled=found, reset=forgotten(few, fold), gate=problem.gate)
    return KnotProblem(few, events, between, leaps)


def full(problem: "Problem", fold: Fold, held: Array | None = None) -> Readings:
    """Readings of all instants, folded, without the frames' tangents; held (E,M) bool: joints silent for long."""
    more, held = None if problem.more is None else fold.fold(problem.more, 1.0), problem.held if held is None else held
    parts = folded_readings(problem, fold, *encoder_rows(problem))
    found = Readings(*parts, reset=forgotten(problem, fold), more=more, gate=problem.gate)
    if held is None or problem.stationary is None or not held.any():
        return found
    dt = np.diff(problem.timeline.t, prepend=problem.timeline.t[0])
    move, shift, noise = (fold.fold(part, part[0]) for part in moves(problem.dynamics, dt, held))
    return replace(found, moves=(move, shift, noise))


def forgotten(problem: "Problem", fold: Fold) -> Array | None:
    """Joints (L,M,C) bool that restart from a wide prior at an instant; None if none does."""
    events, joints = problem.resets_at(problem.timeline.t)
    if not len(events):
        return None
    reset = np.zeros((fold.length, len(problem.start), fold.count), bool)
    fold.put(reset, events, joints)
    return reset


def folded_readings(
    problem: "Problem", fold: Fold, values: Array, values_var: Array
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """The parts of `Readings`: encoder rows (E,M) with variances, and room for the frames."""
    line, m = problem.timeline, len(problem.start)
    sizes = [sighting.values.shape[1] for sighting in problem.evidence.sightings]
    shape = (fold.length, len(sizes), max(sizes, default=2))
    y, var = np.full((*shape, fold.count), np.nan), np.ones((*shape, fold.count))
    jac = np.zeros((*shape, m, fold.count))
    dt = fold.fold(np.diff(line.t, prepend=line.t[0]), 0.0)
    return dt, fold.fold(values, np.nan), fold.fold(values_var, 1.0), y, jac, var


def encoder_rows(problem: "Problem", until: int | None = None) -> tuple[Array, Array]:
    """Readings (E,M) rad, NaN where silent, and variances (E,M); the posture prior for joints without an encoder.

    Only of the first `until` instants, if given.
    """
    t, at = problem.timeline.t[:until], problem.timeline.encoders
    encoders, found = np.full((len(t), len(problem.start)), np.nan), problem.evidence.encoders
    var = np.tile(problem.precision.encoder, (len(t), 1))
    if found is not None:
        rows = int(np.searchsorted(at, len(t)))
        encoders[at[:rows]] = found.values[:rows]
        if found.relative is not None:
            var[at[:rows]] *= found.relative[:rows]
    return (encoders, var) if problem.posture_prior is None else problem.posture_prior.fill(t, encoders, var)
