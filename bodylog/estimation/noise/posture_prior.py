"""A weak prior of joints without encoder readings, which images alone may not determine."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...body_model import ForwardModel
from ...motion import START_STD, Stationary
from ...types import Array
from ..measurements.records import Evidence
from .noise_model import NoiseModel


@dataclass(frozen=True, eq=False)
class PosturePrior:
    """joints (M,) bool without an encoder · mean (M,) rad
    · variance density (M,) rad²·s of its pseudo-readings.
    """

    joints: Array
    mean: Array
    density: Array

    def fill_encoder_rows(self, t: Array, encoders: Array, var: Array) -> tuple[Array, Array]:
        """Encoder rows (E,M) and variances with a pseudo-reading
        at each instant, weighted by the time step.
        """
        encoders = encoders.copy()
        var = var.copy()
        steps = np.diff(t)[:, None]
        encoders[1:], var[1:] = self.add_pseudo_readings(encoders[1:], var[1:], steps)
        return encoders, var

    def add_pseudo_readings(
        self, encoders: Array, var: Array, dt: Array | float
    ) -> tuple[Array, Array]:
        """Encoder rows (…,M) and variances with a pseudo-reading after dt (…,1) s."""
        filled = np.where(self.joints, self.mean, encoders)
        return filled, np.where(self.joints, self.density / dt, var)


def learn_posture_prior(
    evidence: Evidence, process: Array, start: Array, order: int = 2
) -> PosturePrior | None:
    """The prior of joints without encoder readings
    in a log, from the samples of its tracks' models.
    """
    encoders = evidence.encoders
    read: Array = np.zeros(len(process), bool)
    if encoders is not None:
        read = np.asarray(np.isfinite(encoders.values).any(axis=0))
    models = {one.name: one.model for one in evidence.sightings}
    return build_posture_prior(~read, models, process, start, order)


def build_posture_prior(
    silent: Array, models: Mapping[str, ForwardModel], process: Array, start: Array, order: int = 2
) -> PosturePrior | None:
    """The prior of the `silent` joints (M,) bool; None if there are none or no model has samples.

    The density of pseudo-readings is such that a filter's `compute_steady_variance`
    equals the variance of the explored angles. The mean is that of the
    explored angles, or the start if only touch was measured.
    """
    known = _measure_sample_statistics(models)
    if not silent.any() or known is None:
        return None
    mean, std = known
    power = 1.0 / (2 * order)
    density = (np.square(std) * np.sin(np.pi * power) / process**power) ** (1.0 / (1.0 - power))
    silent = silent & (density > 0)
    if not silent.any():
        return None
    seen = any(name != "touch" for name in models)
    return PosturePrior(silent, mean if seen else start, density)


def build_stationary_motion(
    models: Mapping[str, ForwardModel], start: Array, precision: NoiseModel
) -> Stationary:
    """The motion of joints while their encoders are silent.

    Derivatives have the log's own mean squares, if known, or a belief's prior ones. Angles have
    those of the explored angles, or more: the log's own, or those that the derivatives need.
    """
    known = _measure_sample_statistics(models)
    order = precision.order
    mean, std = (start, np.full(len(start), START_STD[0])) if known is None else known
    rest = np.repeat(np.square(START_STD[1:order])[:, None], len(start), axis=1)
    var = np.stack([np.square(std), *rest])
    if precision.moments is not None:
        var = np.concatenate([np.maximum(var[:1], precision.moments[:1]), precision.moments[1:]])
    bursts = precision.burst_factor
    var[1:] = np.minimum(bursts * var[1:], var[1:].max(axis=1, keepdims=True))
    if order == 3:
        # a flat spectrum up to some frequency has the
        # narrowest angles for its rates and accelerations
        var[0] = np.maximum(var[0], 9.0 / 5.0 * var[1] ** 2 / var[2])
    return Stationary(mean, var, precision.process * bursts)


def _measure_sample_statistics(models: Mapping[str, ForwardModel]) -> tuple[Array, Array] | None:
    """Mean and standard deviation (M,) rad of the models' samples, or None without any."""
    distinct = {id(model): model for model in models.values()}.values()
    samples: list[Array] = [getattr(model, "samples", np.empty(0)) for model in distinct]
    known = [one for one in samples if len(one) > 1]
    if not known:
        return None
    explored = np.concatenate(known)
    return explored.mean(axis=0), explored.std(axis=0)
