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
from ..noise.noise_model import PAPER
from . import results
from .grid import RATE, Sense, at_instants, on_grid

PROCESS = 0.001
"""rad² per step: motion, as printed."""


def estimate(features: Features, body: BodyModel, settings: Estimation) -> Estimate:
    """The belief on the paper's grid of 20 Hz, or `rate`; EvidenceError without encoders."""
    # faults are reported, but their readings are used as in the paper
    evidence = screened(features, body, replace(settings, senses=_encoders(body, settings)), repairs=False)
    assert evidence.encoders is not None
    line = timeline(evidence, settings.rate or RATE)
    s, _ = on_grid(evidence.encoders.t, evidence.encoders.values, line.t[line.outputs])
    noise = PAPER[1]
    x, var, nats = static(s, start(evidence, settings, body.joints), noise)
    cov, moved = (v[:, :, None] * np.eye(s.shape[1]) for v in (var, var + PROCESS))
    read = Sense("encoders", s, None, np.full(s.shape, noise))
    beliefs = at_instants(line, evidence, read, x, cov, moved, nats, {"process": PROCESS, "encoder": noise})
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


def static(s: Array, x: Array, noise: float) -> tuple[Array, Array, Array]:
    """Belief and variance (N,M) after each row of s (N,M), NaN where silent, of variance `noise`, and nats (N,)."""
    var, n = np.full(len(x), noise), len(s)
    after, after_var, nats = np.empty(s.shape), np.empty(s.shape), np.empty(n)
    present = np.isfinite(s)
    for k in range(n):
        var = var + PROCESS
        total, nu = var + noise, np.where(present[k], s[k] - x, 0.0)
        nats[k] = 0.5 * (np.log(2 * np.pi * total) + nu**2 / total)[present[k]].sum()
        gain = present[k] * var / total
        x, var = x + gain * nu, (1.0 - gain) * var
        after[k], after_var[k] = x, var
    return after, after_var, nats
