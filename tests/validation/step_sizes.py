"""Encoders that step: the size found, and its error over its standard error."""

import numpy as np

from tests.estimation.conftest import draw
from tests.validation import figures, logs
from tests.validation.encoder_faults import LENGTH, LOUD, stepped, wrong

COUNT = 20
"""Logs a row."""


def table():
    """A row for each joint and size."""
    head = ("encoder", "a step, of all", "error of size, mrad: mean, RMS", "over its standard error: RMS", "greatest")
    return figures.table(head, [row(joint, size) for joint in ("pan", "elbow") for size in (0.02, 0.05, 0.1)])


def row(joint, size):
    """The figures of one size over the worlds; only faults of this encoder alone count."""
    found = []
    for seed in range(COUNT):
        world = draw(seed, duration=LENGTH, **LOUD)
        run = figures.found(logs.with_encoders(logs.of(world), wrong(joint, stepped(size))), world.body)
        found += run.faults if [fault.name for fault in run.faults] == [joint] else ()
    off = np.array([fault.size - size for fault in found])
    over = off / np.array([fault.std for fault in found])
    steps = sum(fault.kind == "jumping" for fault in found)
    sizes = f"{1e3 * off.mean():+.2g}, {1e3 * figures.rms(off):.2g}"
    name = f"{joint}, off by {size:g} rad ({len(found)} of {COUNT} named alone)"
    return (name, f"{steps} of {len(found)}", sizes, f"{figures.rms(over):.2f}", f"{np.abs(over).max():.1f}")
