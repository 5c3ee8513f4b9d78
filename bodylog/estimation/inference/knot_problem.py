"""A log told in few instants: its pictures, and the encoder readings that must be weighed one by one."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ...types import Array
from ..measurements.timeline import Timeline
from .filter_records import Dynamics, KnotReadings, Pooled, Readings
from .folds import Fold, fold_for
from .pooling import Blocks, blocks, kept, loud, pooled

if TYPE_CHECKING:
    from .problem import Problem


@dataclass(frozen=True, eq=False)
class KnotProblem:
    """The problem on few instants, which events (B,) of the log they are, what is said in between, and all of it."""

    problem: "Problem"
    events: Array
    blocks: Blocks
    readings: KnotReadings

    @property
    def fold(self) -> Fold:
        """Its stretches."""
        return fold_for(len(self.events))

    def pooled(self, dynamics: Dynamics) -> Pooled:
        """What is said in between, folded."""
        return pooled(self.blocks, dynamics, self.fold, self.problem.more)

    def of(self, problem: "Problem") -> "KnotProblem":
        """The same log with another process or other pixels, told as before."""
        few = replace(self, problem=replace(problem, timeline=self.problem.timeline))
        return replace(few, readings=replace(self.readings, pooled=few.pooled(problem.dynamics)))


def tile(brief: KnotProblem, var: Array, processes: Array) -> KnotReadings:
    """The log in brief for processes (M,G), side by side each stretch, whose frames have variances var (L,T,D,C,G)."""
    told, g = brief.readings, processes.shape[-1]
    dt, said, said_var, y, jac = (
        np.repeat(part, g, axis=-1) for part in (told.dt, told.encoders, told.encoder_var, told.y, told.jac)
    )
    between = brief.pooled(replace(brief.problem.dynamics, process=processes))
    anew = None if told.anew is None else np.repeat(told.anew, g, axis=-1)
    return KnotReadings(dt, said, said_var, y, jac, var.reshape(*var.shape[:-2], dt.shape[-1]), between, anew=anew)


def knot_problem(problem: "Problem", gated: Array | None = None) -> KnotProblem:
    """The log in brief; `gated` are instants (E,) known to have a reading that the gate weighs less."""
    line, (said, var) = problem.timeline, encoder_rows(problem)
    alone = loud(said) if gated is None else loud(said) | gated
    alone[np.concatenate([*line.sightings, np.empty(0, int)])] = True
    alone[problem.resets_at(line.t)[0]] = True
    wanted = alone.copy()
    wanted[fold_for(len(line.t)).lasts()] = True
    events = kept(wanted)
    sightings, none = tuple(np.searchsorted(events, frames) for frames in line.sightings), np.empty(0, int)
    few = replace(problem, timeline=Timeline(line.t[events], none, sightings, none, none))
    between, fold = blocks(line.t, said, var, events, alone), fold_for(len(events))
    rest = heard(few, fold, np.where(alone[:, None], said, np.nan)[events], var[events])
    told = pooled(between, few.dynamics, fold, few.more)
    leaps = KnotReadings(*rest, pooled=told, anew=forgotten(few, fold))
    return KnotProblem(few, events, between, leaps)


def full(problem: "Problem", fold: Fold) -> Readings:
    """Everything at every instant but the frames' linearisation, folded."""
    more = None if problem.more is None else fold.fold(problem.more, 1.0)
    return Readings(*heard(problem, fold, *encoder_rows(problem)), anew=forgotten(problem, fold), more=more)


def forgotten(problem: "Problem", fold: Fold) -> Array | None:
    """Joints (L,M,C) bool of which nothing is known any more by then; None if that never happens."""
    events, joints = problem.resets_at(problem.timeline.t)
    if not len(events):
        return None
    anew = np.zeros((fold.length, len(problem.start), fold.count), bool)
    fold.put(anew, events, joints)
    return anew


def heard(
    problem: "Problem", fold: Fold, said: Array, said_var: Array
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """The parts of `Readings`: encoder rows (E,M) with variances, and room for the frames."""
    line, m = problem.timeline, len(problem.start)
    shape = (fold.length, len(problem.evidence.sightings), 2)
    y, var = np.full((*shape, fold.count), np.nan), np.ones((*shape, fold.count))
    jac = np.zeros((*shape, m, fold.count))
    dt = fold.fold(np.diff(line.t, prepend=line.t[0]), 0.0)
    return dt, fold.fold(said, np.nan), fold.fold(said_var, 1.0), y, jac, var


def encoder_rows(problem: "Problem", until: int | None = None) -> tuple[Array, Array]:
    """Readings (E,M) rad, NaN where silent, and their variances (E,M); of joints without an encoder, their habit.

    Of the first instants `until` some one alone, if that is given.
    """
    t, at = problem.timeline.t[:until], problem.timeline.encoders
    encoders, told = np.full((len(t), len(problem.start)), np.nan), problem.evidence.encoders
    var = np.tile(problem.precision.encoder, (len(t), 1))
    if told is not None:
        rows = int(np.searchsorted(at, len(t)))
        encoders[at[:rows]] = told.values[:rows]
        if told.relative is not None:
            var[at[:rows]] *= told.relative[:rows]
    return (encoders, var) if problem.habit is None else problem.habit.fill(t, encoders, var)
