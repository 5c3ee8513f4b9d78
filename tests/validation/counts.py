"""Encoders that count: error bars at several rates, with noise that moves some readings to the next count."""

import numpy as np

from tests.estimation.resting import Drawn, drawn
from tests.validation import figures, logs

COUNT = 5
"""Logs a row."""
STEP = 1.5e-3
"""rad: of 12 bits."""
RATES = (50.0, 500.0)
MOTIONS = {"rest": "at rest", "slow": "slow sines", "reach": "reaches"}
NOISES = (0.0, 0.05, 0.2, 0.35)


def table():
    """A row for each motion and noise."""
    cells = [f"`{method}`, {rate:g} Hz" for rate in RATES for method in ("filter", "smoother")]
    rows = [row(motion, noise) for motion in MOTIONS for noise in NOISES]
    return figures.table(("arm", "noise, counts", *(f"{cell}: RMSE, mrad; NEES" for cell in cells)), rows)


def row(motion, noise):
    """The figures of one motion and noise."""
    found = []
    for rate in RATES:
        how = Drawn(motion, step=STEP, noise=noise * STEP, encoder_hz=rate, camera_hz=20.0, pixel=0.3)
        worlds = [drawn(700 + seed, how) for seed in range(COUNT)]
        for method in ("filter", "smoother"):
            runs = [figures.found(logs.of(world), world.body, method) for world in worlds]
            assert not any(run.faults for run in runs)
            nees = [run.nees.mean() for run in runs]
            found.append(f"{figures.mrad(runs)}; {np.mean(nees):.2f}, at most {max(nees):.2f}")
    return (f"{MOTIONS[motion]} ({COUNT})", f"{noise:g}", *found)
