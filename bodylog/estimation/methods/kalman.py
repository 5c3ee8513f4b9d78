"""The paper's baseline: a Kalman filter on the encoders alone, with a static model and fixed variances."""

from dataclasses import replace

import numpy as np

from ...body_model import BodyModel
from ...errors import UsageError
from ...settings import Estimation
from ...types import Array, Estimate, Features
from ..faults.screening import screened
from ..measurements.gather import start
from ..measurements.timeline import timeline
from . import results
from .grid import RATE, at_instants, on_grid
from .results import Beliefs

PROCESS, NOISE = 0.001, 1.0
"""rad² per step and rad², as printed."""


def estimate(features: Features, body: BodyModel, settings: Estimation) -> Estimate:
    """The belief on the paper's grid of 20 Hz, or `rate`; EvidenceError without encoders."""
    # faults are reported, but their readings are used as in the paper
    evidence = screened(features, body, replace(settings, senses=_encoders(body, settings)), repairs=False)
    assert evidence.encoders is not None
    line = timeline(evidence, settings.rate or RATE)
    s, _ = on_grid(evidence.encoders.t, evidence.encoders.values, line.t[line.outputs])
    x, var, before, before_var, nats = static(s, start(evidence, settings, body.joints))
    held, z, every = at_instants(line, x, 1.0 / (settings.rate or RATE), nats)
    errors = np.full((len(line.t), s.shape[1]), np.nan)
    errors[line.outputs] = (s - before) / np.sqrt(before_var + NOISE)
    cov, before_cov = (v[held][:, :, None] * np.eye(s.shape[1]) for v in (var, before_var))
    used = {"process": PROCESS, "encoder": NOISE}
    beliefs = Beliefs(z, cov, every, before[held], before_cov, errors, {}, used)
    return results.estimate("kalman", body, evidence, line, beliefs)


def _encoders(body: BodyModel, settings: Estimation) -> tuple[str, ...]:
    """The encoders allowed by the settings, by joint or all."""
    other = [name for name in settings.senses or () if name not in ("encoders", *body.joints)]
    if other:
        raise UsageError(
            f"method: kalman hears encoders alone, but {', '.join(other)} is asked for; type --with encoders, "
            "or --method laplace"
        )
    return settings.senses or ("encoders",)


def static(s: Array, x: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Belief and variance (N,M) after, then before each row of s (N,M), NaN where silent, and nats (N,)."""
    var, n = np.full(len(x), NOISE), len(s)
    after, after_var, before, before_var = np.empty((4, n, len(x)))
    present = np.isfinite(s)
    for k in range(n):
        var = var + PROCESS
        before[k], before_var[k] = x, var
        gain = present[k] * var / (var + NOISE)
        x = x + gain * np.where(present[k], s[k] - x, 0.0)
        var = (1.0 - gain) * var
        after[k], after_var[k] = x, var
    total = before_var + NOISE
    nu = np.where(present, s - before, 0.0)
    nats = np.where(present, 0.5 * (np.log(2 * np.pi * total) + nu**2 / total), 0.0).sum(axis=1)
    return after, after_var, before, before_var, nats
