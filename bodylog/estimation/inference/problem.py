"""A log to be filtered."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ...types import Array
from ..measurements.records import Evidence
from ..measurements.timeline import Timeline, list_track_sets
from ..noise.noise_model import NoiseModel
from ..noise.posture_prior import PosturePrior
from .filter_records import GATE_SIGMA, FilterDynamics, Stationary
from .reacquisition import extend_open_silence, joints_left_open


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

    def resets_at(self, t: Array) -> tuple[Array, Array]:
        """Indices of resets among the instants t (E,) s, and their joints (R,M) bool."""
        if self.resets is None:
            return np.empty(0, int), np.empty((0, len(self.start)), bool)
        times, joints = self.resets
        here = np.isin(times, t)
        return np.searchsorted(t, times[here]), joints[here]

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
    def undetermined(self) -> bool:
        """Whether images give no more numbers than
        there are joints whose encoders are never read.
        """
        numbers = sum(s.values.shape[1] for s in self.evidence.sightings if s.name != "touch")
        return self.posture_prior is not None and numbers <= self.posture_prior.joints.sum()

    @property
    def held(self) -> Array | None:
        """Silent joints (E,M) bool that images leave open
        at each instant; None if none ever is silent.
        """
        if self.stationary is None or self.evidence.encoders is None:
            return None
        return joints_left_open(self.timeline.t, self.evidence)

    @property
    def more(self) -> Array | None:
        """Factor on the process variance (E,M), or None: fewer
        tracks are in view, or a smoother is beside a silence.

        Beside a silence it is that of the silent joints, as this determines how well rates and
        accelerations are known at both ends; a smoother's own is that of least error in the angles.
        """
        fewer = self.precision.fewer
        usual = self.precision.process
        held = self.held
        if (
            self.stationary is not None
            and held is not None
            and self.precision.likeliest is not None
        ):
            return np.where(
                extend_open_silence(self.timeline.t, held), self.stationary.process / usual, 1.0
            )
        if not fewer:
            return None
        found, which = list_track_sets(self.evidence.sightings, self.timeline.t)
        return np.stack([fewer.get(view, usual) / usual for view in found])[which]
