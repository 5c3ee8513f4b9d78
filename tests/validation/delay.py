"""How far measured camera delays are from the true one, in standard errors, over drawn logs."""

from dataclasses import replace

import numpy as np

from bodylog.estimation.faults.threshold import EVIDENCE_THRESHOLD_NATS
from bodylog.estimation.timing.correction import measure_camera_delays
from tests.estimation.conftest import draw
from tests.estimation.spoilt_logs import delayed
from tests.validation import figures, logs

DELAYS = (-0.1, -0.05, -0.02, -0.005, 0.0, 0.005, 0.02, 0.05, 0.1)
"""s: one log after the other."""
COUNT, BODIES = 200, 20
"""Logs a row, and the explorations whose bodies they take in turn."""
LARGE = 0.05
"""s: what is found in every log."""


def table():
    """A row for each kind of log: standard error, error over it, and how many delays are taken out."""
    head = ("log", "standard error, ms", "error over standard error, RMS", "greatest",
            f"found, of {LARGE:g} s and more", "found, of 0 s")  # fmt: skip
    return figures.table(head, [row(name, list(pairs())) for name, pairs in KINDS.items()])


def row(name, pairs):
    """Delays put on logs, measured."""
    runs = []
    for k, (log, body) in enumerate(pairs):
        given = DELAYS[k % len(DELAYS)]
        runs += [(given, one) for one in measure_camera_delays(delayed(log.features, given), body).values()]
    given, std, seconds, nats = np.transpose([(g, one.std_error, one.seconds, one.nats) for g, one in runs])
    off, large, none = (seconds - given) / std, np.abs(given) >= LARGE, given == 0.0
    share = (f"{(nats[rows] > EVIDENCE_THRESHOLD_NATS).sum()} of {rows.sum()}" for rows in (large, none))
    cells = (f"{1e3 * np.median(std):.2g}", f"{figures.rms(off):.2f}", f"{np.abs(off).max():.1f}")
    return (f"{name} ({len(pairs)})", *cells, *share)


def simulated(scenario, seconds, cameras=1):
    """Logs of a scenario, the bodies of other explorations."""
    bodies = (logs.learned(BODIES + seed % BODIES, cameras) for seed in range(COUNT))
    return zip((logs.drawn(scenario, seed, seconds, cameras) for seed in range(COUNT)), bodies, strict=True)


def sines(camera_hz, encoder_std=0.02, count=COUNT):
    """Slow sines of 20 s, the model known."""
    return ((logs.of(w), w.body) for w in (draw(s, camera_hz=camera_hz, encoder_std=encoder_std) for s in range(count)))


def one_of_two(camera, pairs):
    """Logs of two cameras, of which one is looked at."""
    name = logs.TRACKS[camera]
    for log, body in pairs:
        features = replace(log.features, tracks={name: log.features.tracks[name]})
        yield replace(log, features=features), replace(body, senses={name: body.senses[name]})


KINDS = {
    "reaches of 10 s": lambda: simulated("reach", 10.0),
    "reaches of 10 s, second camera": lambda: one_of_two(1, simulated("reach", 10.0, 2)),
    "babble of 40 s, the body of another": lambda: simulated("babble", 40.0),
    "reaches of 30 s, pan's encoder drifting": lambda: simulated("drift", 30.0),
    "slow sines of 20 s, images at 5 Hz": lambda: sines(5.0),
    "the same, images at 12 Hz": lambda: sines(12.0),
    "the same, images at 30 Hz": lambda: sines(30.0),
    "the same, images at 30 Hz, encoders of 0.001 rad": lambda: sines(30.0, 0.001),
}
