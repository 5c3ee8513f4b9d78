"""A weak posture prior for joints without encoder readings, which images alone may not determine."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...body_model import ForwardModel
from ...types import Array
from ..measurements.records import Evidence
from .steady import steady_density

LASTING = 4.0
"""Factor on the process variance of joints that images hardly determine.

Encoder noise shows tenths of a second of motion. Over seconds, lasting accelerations move an arm farther than white
ones.
"""
WIDER = 2.0
"""Prior standard deviation of a joint, in standard deviations of the explored angles."""


@dataclass(frozen=True, eq=False)
class PosturePrior:
    """joints (M,) bool without an encoder · mean (M,) rad · variance density (M,) rad²·s of its pseudo-readings."""

    joints: Array
    mean: Array
    density: Array

    def fill(self, t: Array, encoders: Array, var: Array) -> tuple[Array, Array]:
        """Encoder rows (E,M) and variances with a pseudo-reading at each instant, weighted by the time step."""
        encoders, var = encoders.copy(), var.copy()
        encoders[1:], var[1:] = self.read(encoders[1:], var[1:], np.diff(t)[:, None])
        return encoders, var

    def read(self, encoders: Array, var: Array, dt: Array | float) -> tuple[Array, Array]:
        """Encoder rows (…,M) and variances with a pseudo-reading after dt (…,1) s."""
        return np.where(self.joints, self.mean, encoders), np.where(self.joints, self.density / dt, var)

    def add_prior(self, readings: Array, var: Array, joints: Array, since: Array) -> tuple[Array, Array, Array]:
        """Readings (M,) rad and variances with a pseudo-reading of silent `joints` (M,) bool; and which joints.

        since (M,): s after the last one.
        """
        own = joints & self.joints & ~np.isfinite(readings)
        return np.where(own, self.mean, readings), np.where(own, self.density / since, var), own


def learn_prior(evidence: Evidence, process: Array, start: Array) -> PosturePrior | None:
    """The prior of joints without encoder readings in a log, from the samples of its tracks' models."""
    silent: Array = np.ones(len(process), bool)
    if evidence.encoders is not None:
        silent = np.all(~np.isfinite(evidence.encoders.values), axis=0)
    return prior_of(silent, {s.name: s.model for s in evidence.sightings}, process, start)


def adrift_prior(
    models: Mapping[str, ForwardModel], process: Array, start: Array, order: int = 2
) -> PosturePrior | None:  # fmt: skip
    """The prior of joints adrift; process (M,) of motion of an order is that with encoders."""
    return prior_of(np.ones(len(process), bool), models, LASTING * process, start, order)


def prior_of(
    silent: Array, models: Mapping[str, ForwardModel], process: Array, start: Array, order: int = 2
) -> PosturePrior | None:  # fmt: skip
    """The prior of the `silent` joints (M,) bool; None if there are none or no model has samples.

    Pseudo-readings hold a joint at a filter's steady variance, and their density is such that this equals the widened
    variance of the explored angles. The mean is that of the explored angles, or the start if only touch was measured.
    """
    distinct = {id(model): model for model in models.values()}
    known = [model.samples for model in distinct.values() if hasattr(model, "samples") and len(model.samples) > 1]
    if not silent.any() or not known:
        return None
    explored, seen = np.concatenate(known), any(name != "touch" for name in models)
    var = np.square(WIDER * explored.std(axis=0))
    density = steady_density(var, process, order)
    silent = silent & (density > 0)
    return PosturePrior(silent, explored.mean(axis=0) if seen else start, density) if silent.any() else None
