"""Variances of encoders, motion and pixels by evidence on the logs, with standard errors."""

from collections.abc import Mapping, Sequence

import numpy as np

from ..types import Array, Noise
from .gp import GP
from .smooth import Motion

_LEAST_ENCODER = 1e-12
_LEAST_PROCESS = 1e-9
_LEAST_PIXEL = 1e-6


def learned(motions: Sequence[Motion], senses: Mapping[str, GP], floors: Mapping[str, Array]) -> Noise:
    """Noise of the joints (white-acceleration motions, one each) and senses; floors {name: (n,D) unit²} as measured."""
    variances = {name: np.maximum(gp.noise + floors[name].mean(axis=0), _LEAST_PIXEL) for name, gp in senses.items()}
    errors = {name: _tuple(value * np.sqrt(2.0 / len(floors[name]))) for name, value in variances.items()}
    errors["encoder"] = tuple(m.std_error[1] for m in motions)
    errors["process"] = tuple(min(m.std_error[0], 1e9) for m in motions)
    return Noise(
        encoder=tuple(max(m.encoder, _LEAST_ENCODER) for m in motions),
        senses={name: _tuple(value) for name, value in variances.items()},
        process=tuple(max(m.process, _LEAST_PROCESS) for m in motions),
        std_error=errors,
    )


def _tuple(values: Array) -> tuple[float, ...]:
    return tuple(float(v) for v in values)
