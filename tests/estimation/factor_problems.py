"""Short drawn logs as factor problems."""

import numpy as np

from bodylog.estimation.factors.encoder_error import JointNoise
from bodylog.estimation.factors.factor_problem import FactorProblem, Noise
from bodylog.estimation.measurements.records import Sighting
from tests.estimation.conftest import Linear

JOINTS = 2
ENCODER_S = 0.01
IMAGE_S = 0.05


def noise(rng, lasting=True, at_link=False):
    error = rng.uniform(1e-3, 3e-3, JOINTS) if lasting else None
    white = rng.uniform(0.5e-6, 2e-6, JOINTS)
    process = rng.uniform(0.5, 5.0, JOINTS)
    seconds = np.full(JOINTS, rng.uniform(0.2, 2.0))
    place = np.full(JOINTS, at_link)
    return Noise(JointNoise(white, process, error, seconds, place, ~np.zeros(JOINTS, bool)), (1.3,))


def drawn(rng, columns=(), images=9, model=None):
    """A short log of smooth motion: readings between and at the images' times, one of them missing."""
    knots = IMAGE_S * np.arange(images) + 2e-3 * rng.random(images)
    t = np.sort(np.append(ENCODER_S * np.arange(int(images * IMAGE_S / ENCODER_S)) + 1e-3, knots[3]))
    rate = rng.uniform(-1.0, 1.0, JOINTS)
    values = np.outer(t, rate) + 0.2 * np.sin(np.outer(t, rng.uniform(1, 3, JOINTS)))
    values += 1e-3 * rng.standard_normal(values.shape)
    values[7, 0] = np.nan
    at = np.column_stack([np.interp(knots, t[np.isfinite(c)], c[np.isfinite(c)]) for c in values.T])
    model = model or Linear(rng.normal(0.0, 400.0, (2, JOINTS)), rng.normal(0.0, 10.0, 2))
    seen = model.predict(at)[0] + 0.3 * rng.standard_normal((images, 2))
    var = np.full(seen.shape, 0.09)
    sighting = Sighting("effector", model, knots, seen, var, (knots * 1e9).astype(np.int64))
    return FactorProblem(
        knots, t, values, rng.uniform(0.5, 2.0, values.shape), np.array([0.1, -0.1]), (sighting,), columns
    )
