"""Encoders that drift, are off or freeze: named or not, since when, by how much, and what is left of the error."""

from collections import Counter
from functools import cache

import numpy as np

from tests.estimation.conftest import JOINTS, draw
from tests.validation import figures, logs

SINCE, LENGTH, COUNT = 8.0, 16.0, 10
"""s: from when encoders are wrong, and the log's length; logs a row."""
QUIET, LOUD = {"encoder_std": 0.001, "pixel_std": 0.5, "camera_hz": 30.0}, {"encoder_std": 0.01, "camera_hz": 20.0}


def stepped(size):
    """An offset from SINCE on."""
    return lambda t: size * (t >= SINCE)


def ramp(rate):
    """A drift from SINCE on, rad/s."""
    return lambda t: rate * np.maximum(t - SINCE, 0.0)


KINDS = {
    **{f"{joint}, frozen": (joint, None, QUIET) for joint in JOINTS},
    **{f"pan, off by {size:g} rad": ("pan", stepped(size), LOUD) for size in (0.05, 0.1, -0.2)},
    "elbow, off by 0.1 rad": ("elbow", stepped(0.1), LOUD),
    **{f"{joint}, drifting by 0.02 rad/s": (joint, ramp(0.02), LOUD) for joint in ("pan", "elbow")},
    "pan, drifting by 0.005 rad/s": ("pan", ramp(0.005), LOUD),
}


def table():
    """A row for each fault."""
    head = ("encoder", f"named alone, of {COUNT}", "named since, s after it began", "size less the true one, rad",
            "`filter`, after it began, mrad: all, worst", "whole log", "sound log, the same seconds",
            "NEES of pan, lift, elbow")  # fmt: skip
    return figures.table(head, [row(name, *kind) for name, kind in KINDS.items()])


def row(name, joint, error, how):
    """The figures of one fault over the worlds."""
    worlds = [draw(seed, duration=LENGTH, **how) for seed in range(COUNT)]
    runs = [figures.found(logs.with_encoders(logs.of(world), wrong(joint, error)), world.body) for world in worlds]
    right = [run for run in runs if [fault.name for fault in run.faults] == [joint]]
    since = [run.faults[0].since - SINCE for run in right]
    after = [run.within(SINCE) for run in runs]
    cells = (
        f"{len(right)}{others(runs, joint)}",
        f"{np.median(since):.2f}, {max(since):.2f} at most" if since else "–",
        "–" if error is None or not right else sizes(right, error),
        f"{figures.mrad(after)}, {1e3 * max(run.rmse for run in after):.3g}",
        figures.mrad(runs),
        figures.mrad(sound(tuple(how.items()))),
        figures.mean_nees(after),
    )
    return (name, *cells)


@cache
def sound(how):
    """The same seconds of the same logs before their encoders are made wrong."""
    worlds = [draw(seed, duration=LENGTH, **dict(how)) for seed in range(COUNT)]
    return [figures.found(logs.of(world), world.body).within(SINCE) for world in worlds]


def wrong(joint, error):
    """What makes a joint's encoder wrong; without an error it repeats its last reading."""

    def change(t, values, names):
        column = names.index(joint)
        values[t >= SINCE, column] = values[np.searchsorted(t, SINCE), column] if error is None else (
            values[t >= SINCE, column] + error(t[t >= SINCE]))  # fmt: skip
        return values

    return change


def others(runs, joint):
    """What else was named, and how often."""
    counts = Counter(" and ".join(fault.name for fault in run.faults) or "none" for run in runs)
    counts.pop(joint, None)
    return "".join(f"; {count} {name}" for name, count in sorted(counts.items()))


def sizes(runs, error):
    """How far sizes are from what the encoder is off by at the end."""
    off = np.array([run.faults[0].size for run in runs]) - error(np.array(LENGTH))
    return f"{np.median(off):+.4f}, {np.abs(off).max():.4f} at most"
