"""The paper's baseline: a Kalman filter on the encoders
alone, with a static model and fixed variances.
"""

from dataclasses import replace

import numpy as np

from ...body_model import BodyModel
from ...errors import UsageError
from ...settings import EstimationSettings
from ...types import Array, Capabilities, Estimate, Features
from ..faults.screening import screen_measurements
from ..measurements.gather import choose_initial_angles
from ..measurements.timeline import build_timeline
from ..noise.noise_model import PAPER_VARIANCES
from . import results
from .contract import Method
from .grid import GRID_RATE_HZ, GridSense, hold_beliefs_at_instants, place_on_grid

STEP_VARIANCE_RAD2 = 0.001
"""rad² per step: motion, as printed."""


def estimate_by_kalman_filter(
    features: Features, body: BodyModel, settings: EstimationSettings
) -> Estimate:
    """The belief on the paper's grid of 20 Hz, or `rate`; EvidenceError without encoders."""
    # faults are reported, but their readings are used as in the paper
    evidence = screen_measurements(
        features, body, replace(settings, senses=_choose_encoders(body, settings)), repairs=False
    )
    assert evidence.encoders is not None
    line = build_timeline(evidence, settings.rate or GRID_RATE_HZ)
    s, _ = place_on_grid(evidence.encoders.t, evidence.encoders.values, line.t[line.outputs])
    noise = PAPER_VARIANCES[1]
    x, var, nats = filter_static_angles(s, choose_initial_angles(evidence, settings), noise)
    eye = np.eye(s.shape[1])
    cov = var[:, :, None] * eye
    moved = (var + STEP_VARIANCE_RAD2)[:, :, None] * eye
    read = GridSense("encoders", s, None, np.full(s.shape, noise))
    beliefs = hold_beliefs_at_instants(
        line, evidence, read, x, cov, moved, nats, {"process": STEP_VARIANCE_RAD2, "encoder": noise}
    )
    return results.build_estimate("kalman", evidence, line, beliefs)


def _choose_encoders(body: BodyModel, settings: EstimationSettings) -> tuple[str, ...]:
    """The encoders allowed by the settings, by joint or all."""
    other = [name for name in settings.senses or () if name not in ("encoders", *body.joints)]
    if other:
        raise UsageError(
            f"method: kalman hears encoders alone, but {', '.join(other)} is asked for; type "
            "--with encoders, "
            "or --method filter"
        )
    return settings.senses or ("encoders",)


def filter_static_angles(s: Array, x: Array, noise: float) -> tuple[Array, Array, Array]:
    """Belief and variance (N,M) after each row of s (N,M),
    NaN where silent, of variance `noise`, and nats (N,).
    """
    var = np.full(len(x), noise)
    n = len(s)
    after = np.empty(s.shape)
    after_var = np.empty(s.shape)
    nats = np.empty(n)
    present = np.isfinite(s)
    for k in range(n):
        var = var + STEP_VARIANCE_RAD2
        total = var + noise
        nu = np.where(present[k], s[k] - x, 0.0)
        nats[k] = 0.5 * (np.log(2 * np.pi * total) + nu**2 / total)[present[k]].sum()
        gain = present[k] * var / total
        x = x + gain * nu
        var = (1.0 - gain) * var
        after[k] = x
        after_var[k] = var
    return after, after_var, nats


METHODS = {
    "kalman": Method(
        estimate_by_kalman_filter,
        Capabilities(moves=False, density=False, repairs=False, from_paper=True),
        senses=frozenset({"encoders"}),
        heeds=frozenset(),
    )
}
