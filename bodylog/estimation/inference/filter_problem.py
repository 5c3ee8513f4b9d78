"""A log to be filtered, and its readings at each instant."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ...motion import Stationary
from ...types import Array
from ..measurements.records import Evidence
from ..measurements.timeline import Timeline, list_track_sets
from ..noise.noise_model import NoiseModel
from ..noise.posture_prior import PosturePrior
from .filter_pass import GATE_SIGMA, FilterDynamics, FilterReadings
from .reacquisition import extend_open_silence, find_joints_left_open, find_silent_joints


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

    def is_undetermined(self, missing: int = 0) -> bool:
        """Whether images give no more numbers than there are joints whose encoders are never read.

        missing: numbers by which they are too few, at least.
        """
        if self.posture_prior is None:
            return False
        numbers = sum(s.values.shape[1] for s in self.evidence.sightings if s.name != "touch")
        return bool(numbers + missing <= self.posture_prior.joints.sum())

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
        """Factor on the process variance (E,M), or None: fewer tracks are in view, an encoder is
        silent, or a smoother is beside a silence that images leave open.

        Beside such a silence it is that of the silent joints, as this determines how well rates and
        accelerations are known at both ends; a smoother's own is that of least error in the angles.
        """
        precision = self.precision
        usual = precision.process
        factor = None
        if precision.process_by_view:
            views, which = list_track_sets(self.evidence.sightings, self.timeline.t)
            fewer = precision.process_by_view
            factor = np.stack([fewer.get(view, usual) / usual for view in views])[which]
        held = self.left_open
        if held is None or self.stationary is None or self.evidence.encoders is None:
            return factor
        silent = find_silent_joints(self.timeline.t, self.evidence)
        # images reject a motion that is faster than its process variance allows
        faster = precision.burst_factor
        if precision.filter_process is None:
            return np.where(silent, faster, 1.0 if factor is None else factor)
        beside = extend_open_silence(self.timeline.t, held)
        return np.where(beside, self.stationary.process / usual, np.where(silent, faster, 1.0))


def lay_out_readings(problem: FilterProblem, held: Array | None = None) -> FilterReadings:
    """Readings of all instants, with room for the frames' tangents.

    held (E,M) bool: joints silent for long; by default those that images leave open.
    """
    m = len(problem.start)
    t = problem.timeline.t
    dt = np.diff(t, prepend=t[0])
    encoders, encoder_var = build_encoder_rows(problem)
    sizes = [sighting.values.shape[1] for sighting in problem.evidence.sightings]
    frames = (len(t), len(sizes), max(sizes, default=2))
    held = problem.left_open if held is None else held
    moves = None
    if held is not None and problem.stationary is not None and held.any():
        moves = problem.dynamics.compute_silent_moves(dt, held)
    return FilterReadings(
        dt,
        encoders,
        encoder_var,
        np.full(frames, np.nan),
        np.zeros((*frames, m)),
        np.ones(frames),
        reset=_mark_restarting_joints(problem),
        process_factor=problem.process_factor,
        moves=moves,
        gate=problem.gate,
    )


def _mark_restarting_joints(problem: FilterProblem) -> Array | None:
    """Joints (E,M) bool that restart from a wide prior at an instant; None if none does."""
    if problem.resets is None:
        return None
    times, joints = problem.resets
    t = problem.timeline.t
    here = np.isin(times, t)
    if not here.any():
        return None
    reset = np.zeros((len(t), len(problem.start)), bool)
    reset[np.searchsorted(t, times[here])] = joints[here]
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
