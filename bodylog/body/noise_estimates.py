"""Variances of encoders, motion and pixels by evidence on the logs, with standard errors."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..body_model import Noise
from ..types import Array
from .data.angle_smoother import WhiteMotion
from .gp.model import GP

_LEAST_ENCODER = 1e-12
_LEAST_PROCESS = 1e-9
_LEAST_PIXEL = 1e-6
_EXACT = 1e-6


def learn_noise(
    motions: Sequence[WhiteMotion], senses: Mapping[str, GP], floors: Mapping[str, Array]
) -> Noise:
    """Noise of joints (one white-acceleration motion each)
    and senses; floors {name: (n,D) unit²} as measured.
    """
    errors = dict[str, tuple[float, ...]]()
    # the standard error of an unknown variance is at most the variance
    errors["encoder"] = tuple(min(m.std_error[1], max(m.encoder, _LEAST_ENCODER)) for m in motions)
    errors["process"] = tuple(min(m.std_error[0], 1e9) for m in motions)
    of_joints = Noise(
        encoder=tuple(max(m.encoder, _LEAST_ENCODER) for m in motions),
        senses={},
        process=tuple(max(m.process, _LEAST_PROCESS) for m in motions),
        std_error=errors,
    )
    return replace_sense_noise(
        of_joints,
        {n: gp.noise + floors[n].mean(axis=0) for n, gp in senses.items()},
        {n: len(floors[n]) for n in senses},
    )


def replace_sense_noise(
    noise: Noise, variances: Mapping[str, Array], counts: Mapping[str, int]
) -> Noise:
    """The noise with variances {name: (D,) unit²} of some
    senses, each known from so many sightings.
    """
    known = {name: np.maximum(value, _LEAST_PIXEL) for name, value in variances.items()}
    senses = {name: _tuple_of_floats(value) for name, value in known.items()}
    errors = {n: _tuple_of_floats(v * np.sqrt(2.0 / counts[n])) for n, v in known.items()}
    return replace(
        noise, senses={**noise.senses, **senses}, std_error={**noise.std_error, **errors}
    )


def pool_noise(new: Noise, old: Noise) -> Noise:
    """Pool the noise of two logs: each variance is the
    mean of both, weighted by their numbers of readings.

    A sense of only one of them, or without standard errors in one, keeps the other's value.
    """
    count = {
        name: _half_degrees_of_freedom(new, old, name)
        for name in ("encoder", *new.senses, *old.senses)
    }
    encoder = _weighted_mean_variance(new.encoder, old.encoder, count["encoder"])
    process = _weighted_mean_variance(new.process, old.process, count["encoder"])
    both = [name for name in new.senses if name in old.senses]
    senses = {
        name: _weighted_mean_variance(new.senses[name], old.senses[name], count[name])
        for name in both
    }
    errors = {
        part: _std_error_of_mean(new, old, part, count["encoder"])
        for part in ("encoder", "process")
    }
    errors |= {name: _std_error_of_mean(new, old, name, count[name]) for name in both}
    return Noise(
        encoder,
        {**old.senses, **new.senses, **senses},
        process,
        {**old.std_error, **new.std_error, **errors},
    )


def _variance_by_name(noise: Noise, name: str) -> Array:
    return np.array(getattr(noise, name) if name in ("encoder", "process") else noise.senses[name])


def _half_degrees_of_freedom(new: Noise, old: Noise, name: str) -> Array:
    """Half the degrees of freedom (2,D) of new and old,
    from their standard errors; all new where unknown.
    """
    if name not in new.std_error or name not in old.std_error:
        return np.array([[1.0], [0.0]])
    both = np.stack([_variance_by_name(noise, name) for noise in (new, old)])
    errors = np.array([new.std_error[name], old.std_error[name]])
    return np.asarray(np.square(both / np.maximum(errors, _EXACT * both)))


def _weighted_mean_variance(
    new: tuple[float, ...], old: tuple[float, ...], weights: Array
) -> tuple[float, ...]:
    return _tuple_of_floats((weights * np.array([new, old])).sum(axis=0) / weights.sum(axis=0))


def _std_error_of_mean(new: Noise, old: Noise, name: str, weights: Array) -> tuple[float, ...]:
    """Standard error of the mean; that of a nearly unknown variance is at most the variance."""
    if name not in new.std_error or name not in old.std_error:
        return new.std_error.get(name, ())
    errors = np.stack(
        [np.minimum(noise.std_error[name], _variance_by_name(noise, name)) for noise in (new, old)]
    )
    return _tuple_of_floats(np.sqrt(np.square(weights * errors).sum(axis=0)) / weights.sum(axis=0))


def _tuple_of_floats(values: Array) -> tuple[float, ...]:
    return tuple(float(v) for v in values)
