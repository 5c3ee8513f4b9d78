"""Joints that stick and slip by many times the noise of their encoders, alone and beside faults."""

from collections import Counter
from dataclasses import replace

import numpy as np

from tests.estimation.resting import Drawn, drawn
from tests.validation import figures, logs

SEEDS = (740, 741, 742)
MOTIONS = ("sines", "reach")
SIZES = (0.3, 0.5, 1.0, 2.0, 4.0)
"""degrees at once."""
ENCODERS = {"1 mrad": (0.0, 1e-3), "0.1 mrad": (0.0, 1e-4), "12 bit, 0.5 mrad": (1.5e-3, 5e-4)}
"""Steps and noise, rad."""
FAULT_S = 8.0


def table():
    """A row for each size and encoder, and for each fault beside slips of one degree."""
    cells = [f"`{method}`, mrad; NEES" for method in ("filter", "smoother")]
    rows = [row(f"{size:g}°", name, size, unharmed) for size in SIZES for name in ENCODERS]
    rows += [row(f"1°, {what}", "1 mrad", 1.0, fault) for what, fault in FAULTS.items()]
    logs_of_row = len(SEEDS) * len(MOTIONS)
    head = (f"slips ({logs_of_row} logs of 16 s)", "encoders", "raw, mrad", *cells, "faults named (`filter`)")
    return figures.table(head, rows)


def row(what, name, size, fault):
    """The figures of one size, encoder and fault."""
    step, noise = ENCODERS[name]
    how = Drawn("", step, noise, encoder_hz=100.0, camera_hz=20.0, pixel=0.3, slip=np.deg2rad(size))
    worlds = [drawn(seed, replace(how, motion=motion)) for seed in SEEDS for motion in MOTIONS]
    spoiled = [replace(world, features=fault(world.features)) for world in worlds]
    raw = [figures.rms(one.features.joints.values - one.truth.values) for one in spoiled]
    cells = []
    for method in ("smoother", "filter"):
        runs = [figures.found(logs.of(world), world.body, method) for world in spoiled]
        nees = [run.nees.mean() for run in runs]
        cells.insert(0, f"{figures.mrad(runs)}; {np.mean(nees):.2f}, at most {max(nees):.2f}")
    named = Counter(f"{one.name} {one.kind}" for run in runs for one in run.faults)
    told = ", ".join(f"{text}: {count}" for text, count in sorted(named.items()))
    return (what, name, f"{1e3 * figures.rms(raw):.3g}", *cells, told or "0")


def unharmed(features):
    """No fault."""
    return features


def drift(features):
    """Pan drifts by 0.02 rad/s."""
    return _with_readings(features, 0, lambda t: 0.02 * np.maximum(t - FAULT_S, 0.0))


def step(features):
    """Lift is off by 2°."""
    return _with_readings(features, 1, lambda t: np.where(t >= FAULT_S, np.deg2rad(2.0), 0.0))


def freeze(features):
    """Pan repeats its reading."""
    joints = features.joints
    values = joints.values.copy()
    values[joints.t >= FAULT_S, 0] = values[np.argmax(joints.t >= FAULT_S), 0]
    return replace(features, joints=replace(joints, values=values))


def move(features):
    """The camera moves by 5 px."""
    tracks = {
        name: replace(one, values=one.values + np.outer(one.t >= FAULT_S, [4.0, 3.0]))
        for name, one in features.tracks.items()
    }
    return replace(features, tracks=tracks)


def delay(features):
    """The camera is 40 ms late."""
    tracks = {name: replace(one, t=one.t + 0.04) for name, one in features.tracks.items()}
    return replace(features, tracks=tracks)


def _with_readings(features, joint, off):
    joints = features.joints
    values = joints.values.copy()
    values[:, joint] += off(joints.t)
    return replace(features, joints=replace(joints, values=values))


FAULTS = {
    "pan drifts by 20 mrad/s": drift,
    "lift is off by 2°": step,
    "pan freezes": freeze,
    "camera moves by 5 px": move,
    "camera 40 ms late": delay,
}
