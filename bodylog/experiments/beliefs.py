"""Our default's belief about a log, with the truth."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .. import pipeline
from ..body_model import BodyModel
from ..settings import EstimationSettings, Settings
from ..types import Array, Estimate
from .lab import ObservedLog


@dataclass(frozen=True, eq=False)
class BeliefWithTruth:
    """A belief over time: t (N,) s · x (N,M) rad · true (N,M) rad."""

    t: Array
    x: Array
    true: Array

    def error(self, since: float) -> Array:
        """Belief minus truth (K,M) rad from `since` s on."""
        return np.asarray((self.x - self.true)[self.t >= since])

    def rmse(self, since: float) -> float:
        """Root mean square error over all joints (rad) from `since` s on."""
        return float(np.sqrt(np.mean(self.error(since) ** 2)))

    def at(self, t: Array) -> Array:
        """The belief (K,M) rad at times t (K,) s, linearly interpolated."""
        return np.column_stack([np.interp(t, self.t, column) for column in self.x.T])


def believe_by_default(
    observed: ObservedLog, body: BodyModel, senses: tuple[str, ...] | None = None, **settings: Any
) -> BeliefWithTruth:
    """Our default's belief."""
    return belief_with_truth(
        estimate_with_settings(observed, body, EstimationSettings(senses=senses, **settings)),
        observed,
    )


def estimate_with_settings(
    observed: ObservedLog, body: BodyModel, settings: EstimationSettings
) -> Estimate:
    """The estimate by these settings."""
    return pipeline.infer(observed.features, body, replace(Settings(), estimate=settings))


def belief_with_truth(found: Estimate, observed: ObservedLog) -> BeliefWithTruth:
    """An estimate as a belief with the truth."""
    return BeliefWithTruth(
        found.joints.t, found.joints.values, observed.true(found.joints.names, found.joints.t)
    )


def add_encoder_noise(observed: ObservedLog, std: float, seed: int) -> ObservedLog:
    """The same log with more noise (rad) on its encoders."""
    joints = observed.features.joints
    assert joints is not None
    noise = std * np.random.default_rng([seed, 11]).standard_normal(joints.values.shape)
    return replace(
        observed,
        features=replace(observed.features, joints=replace(joints, values=joints.values + noise)),
    )
