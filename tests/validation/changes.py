"""Offsets since a body was learned with a URDF: named or not, and how true their standard deviations are."""

import numpy as np

from bodylog.body.kinematic import change
from tests.body.changed_arms import DEGREE, explored, run
from tests.kinematics.robots import JOINTS
from tests.validation import figures

BODIES, OFF, SOUND = 8, 4, 2
"""Bodies, and runs of each with an offset and without."""


def table():
    """Two rows: runs with an offset of one joint, and sound ones."""
    draw, named, alone, within, false = np.random.default_rng(7), [], 0, 0, 0
    for seed in range(BODIES):
        body = explored(seed)
        false += sum(bool(change.find_changes(run(1000 + 10 * seed + k), body).changes) for k in range(SOUND))
        for k in range(OFF):
            joint, size = JOINTS[draw.integers(4)], draw.uniform(1, 5) * draw.choice([-1, 1]) * DEGREE
            found = change.find_changes(run(2000 + 10 * seed + k, offset={joint: size}), body).changes
            right = [one for one in found if one.name == joint]
            named += right
            alone += len(right) == len(found) == 1
            within += sum(abs(one.value[0] - size) < 2 * one.std[0] for one in right)
    std = np.degrees([one.std[0] for one in named])
    size = f"{np.median(std):.2f}° ({std.min():.2f}° to {std.max():.2f}°)"
    off = f"{len(named)}", f"{alone}", size, f"{within} of {len(named)}"
    rows = [
        ("1° to 5° on one of four joints", f"{BODIES * OFF}", *off),
        ("sound", f"{BODIES * SOUND}", f"{false}", "–", "–", "–"),
    ]
    return figures.table(("encoders", "runs of 10 s", "named", "named alone", "median σ", "within 2 σ"), rows)
