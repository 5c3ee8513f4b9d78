"""A log to be filtered, and its readings folded into stretches that are filtered in parallel:
(E,…) in time order <-> (L,…,C).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ...motion import Stationary
from ...types import Array
from ..measurements.records import Evidence
from ..measurements.timeline import Timeline, list_track_sets
from ..noise.noise_model import NoiseModel
from ..noise.posture_prior import PosturePrior
from .reacquisition import extend_open_silence, find_joints_left_open
from .scan import GATE_SIGMA, FilterDynamics, FilterReadings


@dataclass(frozen=True, eq=False)
class FilterProblem:
    """One log to be filtered: evidence, instants, start of the belief, noise model.

    path: times (E,) s and angles (E,M) rad to linearise along first, if encoders do not give them ·
    posture_prior: of joints without an encoder · resets: times (R,) s at which joints (R,M) bool
    restart from a wide prior · stepwise: images alone determine the arm for long, where sweeps may
    converge to another posture · alternatives: joints with an offset that explains nearly as much ·
    stationary: motion of joints whose encoders are silent for long, if one ever is · gate: standard
    deviations beyond which innovations count as outliers.
    """

    evidence: Evidence
    timeline: Timeline
    start: Array
    precision: NoiseModel
    path: tuple[Array, Array] | None = None
    posture_prior: PosturePrior | None = None
    resets: tuple[Array, Array] | None = None
    stepwise: bool = False
    alternatives: Mapping[int, tuple[int, ...]] = field(default_factory=dict)
    stationary: Stationary | None = None
    gate: float = GATE_SIGMA

    @property
    def dynamics(self) -> FilterDynamics:
        """The dynamics of the state."""
        is_prior = None if self.posture_prior is None else self.posture_prior.joints
        return FilterDynamics(
            self.precision.process,
            self.precision.drift,
            is_prior,
            self.precision.motion,
            self.stationary,
        )

    @property
    def is_undetermined(self) -> bool:
        """Whether images give no more numbers than
        there are joints whose encoders are never read.
        """
        numbers = sum(s.values.shape[1] for s in self.evidence.sightings if s.name != "touch")
        return self.posture_prior is not None and numbers <= self.posture_prior.joints.sum()

    @property
    def left_open(self) -> Array | None:
        """Silent joints (E,M) bool that images leave open
        at each instant; None if none ever is silent.
        """
        if self.stationary is None or self.evidence.encoders is None:
            return None
        return find_joints_left_open(self.timeline.t, self.evidence)

    @property
    def process_factor(self) -> Array | None:
        """Factor on the process variance (E,M), or None: fewer
        tracks are in view, or a smoother is beside a silence.

        Beside a silence it is that of the silent joints, as this determines how well rates and
        accelerations are known at both ends; a smoother's own is that of least error in the angles.
        """
        fewer = self.precision.process_by_view
        usual = self.precision.process
        held = self.left_open
        if (
            self.stationary is not None
            and held is not None
            and self.precision.filter_process is not None
        ):
            return np.where(
                extend_open_silence(self.timeline.t, held), self.stationary.process / usual, 1.0
            )
        if not fewer:
            return None
        views, which = list_track_sets(self.evidence.sightings, self.timeline.t)
        return np.stack([fewer.get(view, usual) / usual for view in views])[which]


MAX_STRETCHES = 8
"""Stretches of a log that are filtered side by side. With 16, a filter is 5 to 10 % faster, but
noise learned on stretches half as long differs by 4 %, and a sound encoder was called jumping.
"""
MIN_STRETCH_INSTANTS = 32
"""Least number of instants in a stretch: its end must not depend on its start."""


@dataclass(frozen=True)
class Fold:
    """So many events, instants in time order, in C stretches of `length` instants L each."""

    events: int
    length: int

    @property
    def stretch_count(self) -> int:
        """Number C of stretches, of which the last one may not be full."""
        return max(1, -(-self.events // self.length))

    def fold_events(self, a: Array, fill: float) -> Array:
        """(E,…) -> (L,…,C), with `fill` after the last event."""
        padded = np.empty((self.length * self.stretch_count, *a.shape[1:]))
        padded[: self.events] = a
        padded[self.events :] = fill
        return np.ascontiguousarray(
            np.moveaxis(padded.reshape(self.stretch_count, self.length, *a.shape[1:]), 0, -1)
        )

    def unfold_events(self, a: Array) -> Array:
        """(L,…,C) -> (E,…)."""
        return np.moveaxis(a, -1, 0).reshape(-1, *a.shape[1:-1])[: self.events]

    def select_events(self, a: Array, events: Array) -> Array:
        """Rows (F,…) of the folded a (L,…,C) at the given events."""
        rows: Array = a[events % self.length, ..., events // self.length]
        return rows

    def write_events(self, a: Array, events: Array | int, rows: Array) -> None:
        """Write rows (F,…) into the folded a (L,…,C) at the given events, or at one."""
        a[events % self.length, ..., events // self.length] = rows

    @property
    def handover_events(self) -> Array:
        """Last event (C−1,) of every stretch that has a successor."""
        return np.arange(1, self.stretch_count) * self.length - 1


def choose_fold(events: int) -> Fold:
    """Fold with MAX_STRETCHES, or fewer if the log is short."""
    count = min(MAX_STRETCHES, max(1, events // MIN_STRETCH_INSTANTS))
    return Fold(events, max(1, -(-events // count)))


def fold_readings(problem: FilterProblem, fold: Fold, held: Array | None = None) -> FilterReadings:
    """Readings of all instants, folded, with room for the frames' tangents.

    held (E,M) bool: joints silent for long; by default those that images leave open.
    """
    m = len(problem.start)
    t = problem.timeline.t
    dt = np.diff(t, prepend=t[0])
    encoders, encoder_var = build_encoder_rows(problem)
    sizes = [sighting.values.shape[1] for sighting in problem.evidence.sightings]
    frames = (fold.length, len(sizes), max(sizes, default=2))
    process_factor = problem.process_factor
    readings = FilterReadings(
        fold.fold_events(dt, 0.0),
        fold.fold_events(encoders, np.nan),
        fold.fold_events(encoder_var, 1.0),
        np.full((*frames, fold.stretch_count), np.nan),
        np.zeros((*frames, m, fold.stretch_count)),
        np.ones((*frames, fold.stretch_count)),
        reset=_mark_restarting_joints(problem, fold),
        process_factor=None if process_factor is None else fold.fold_events(process_factor, 1.0),
        gate=problem.gate,
    )
    held = problem.left_open if held is None else held
    if held is None or problem.stationary is None or not held.any():
        return readings
    # other joints move by dt, with the process of a candidate
    move, shift, noise = (
        fold.fold_events(part, np.nan) for part in problem.dynamics.compute_silent_moves(dt, held)
    )
    return replace(readings, moves=(move, shift, noise))


def _mark_restarting_joints(problem: FilterProblem, fold: Fold) -> Array | None:
    """Joints (L,M,C) bool that restart from a wide prior at an instant; None if none does."""
    if problem.resets is None:
        return None
    times, joints = problem.resets
    t = problem.timeline.t
    here = np.isin(times, t)
    if not here.any():
        return None
    reset = np.zeros((fold.length, len(problem.start), fold.stretch_count), bool)
    fold.write_events(reset, np.searchsorted(t, times[here]), joints[here])
    return reset


def build_encoder_rows(problem: FilterProblem, until: int | None = None) -> tuple[Array, Array]:
    """Readings (E,M) rad, NaN where silent, and variances (E,M) rad² of the first `until` instants.

    Joints without an encoder have readings of the posture prior, if there is one.
    """
    t = problem.timeline.t[:until]
    at = problem.timeline.encoders
    values = np.full((len(t), len(problem.start)), np.nan)
    var = np.tile(problem.precision.encoder, (len(t), 1))
    encoders = problem.evidence.encoders
    if encoders is not None:
        rows = int(np.searchsorted(at, len(t)))
        values[at[:rows]] = encoders.values[:rows]
        var[at[:rows]] *= encoders.relative_variance[:rows]
    if problem.posture_prior is None:
        return values, var
    return problem.posture_prior.fill_encoder_rows(t, values, var)
