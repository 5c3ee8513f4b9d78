"""A log to be filtered, and its solution."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ...types import Array
from ..measurements.records import Evidence
from ..measurements.timeline import Timeline
from ..noise.noise_model import NoiseModel
from ..noise.posture_prior import PosturePrior
from ..noise.visibility import views
from .filter_records import Dynamics


@dataclass(frozen=True, eq=False)
class Problem:
    """One log to be filtered: evidence, its instants, where the belief starts, the precisions.

    path: times (E,) s and angles (E,M) rad to linearise along first, where the encoders do not say · habit: where
    joints without an encoder are wont to be · anew: times (R,) s by which nothing is known any more of
    joints (R,M) bool · stepwise: pictures alone lead it for long, where sweeps may rest in another posture ·
    rivals: joints by number whose offsets explain nearly as much as that of another.
    """

    evidence: Evidence
    timeline: Timeline
    start: Array
    precision: NoiseModel
    path: tuple[Array, Array] | None = None
    habit: PosturePrior | None = None
    anew: tuple[Array, Array] | None = None
    stepwise: bool = False
    rivals: Mapping[int, tuple[int, ...]] = field(default_factory=dict)

    def resets_at(self, t: Array) -> tuple[Array, Array]:
        """Which of instants t (E,) s begin anew, and what joints (R,M) bool of them."""
        if self.anew is None:
            return np.empty(0, int), np.empty((0, len(self.start)), bool)
        times, joints = self.anew
        here = np.isin(times, t)
        return np.searchsorted(t, times[here]), joints[here]

    @property
    def dynamics(self) -> Dynamics:
        """How the state moves."""
        is_prior = None if self.habit is None else self.habit.joints
        return Dynamics(self.precision.process, self.precision.drift, is_prior)

    @property
    def more(self) -> Array | None:
        """How many times the process variance (E,M) moves joints where fewer tracks are in view; None if nowhere."""
        fewer, usual = self.precision.fewer, self.precision.process
        if not fewer:
            return None
        found, which = views(self.evidence.sightings, self.timeline.t)
        return np.stack([fewer.get(view, usual) / usual for view in found])[which]
