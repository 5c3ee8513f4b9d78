"""Joints' scales as unknowns: how sure they are, and how often they are right, of sets of still poses."""

import numpy as np

from bodylog.kinematics import identifiability
from tests.kinematics import robots
from tests.kinematics.robots import JOINTS
from tests.kinematics.scaled_joints import scaled, solve
from tests.validation import figures

POSES, PIXEL, WRONG = 120, 0.3, 0.03
"""Poses of a set, px of noise, and by what share a joint reads too little."""
KINDS = {
    "lift reads 3 % too little": (1, 40),
    "elbow reads 3 % too little": (2, 40),
    "all scales are right": (None, 20),
}


def table():
    """A row for each joint whose scale is wrong."""
    head = ("sets of poses", f"median σ of {', '.join(JOINTS)}", "the wrong scale: found, within 2 σ",
            "others: beyond 2 σ of 0")  # fmt: skip
    return figures.table(head, [row(name, *kind) for name, kind in KINDS.items()])


def row(name, wrong, count):
    """The figures of some sets."""
    found = [of_set(seed, wrong) for seed in range(count)]
    std = np.median([[one.std if one.identifiable else np.inf for one in scales] for scales in found], axis=0)
    stds = ", ".join("–" if np.isinf(one) else f"{100.0 * one:.1f} %" for one in std)
    put = [scales[wrong] for scales in found if wrong is not None]
    hits = (sum(one.identifiable and one.value > 2.0 * one.std for one in put),
            sum(abs(one.value - WRONG) < 2.0 * one.std for one in put))  # fmt: skip
    rest = [one for scales in found for m, one in enumerate(scales) if m != wrong and one.identifiable]
    false = sum(abs(one.value) > 2.0 * one.std for one in rest)
    return f"{name} ({count})", stds, f"{hits[0]}, {hits[1]} of {len(put)}" if put else "–", f"{false} of {len(rest)}"


def of_set(seed, wrong):
    """Scales found from one set of poses; zeros unknown, the camera known to a centimetre."""
    rig = scaled(robots.rig())
    theta = robots.truth(rig, {"elbow": 0.02}, seed)
    theta[rig.of_scales] = WRONG * (np.arange(len(JOINTS)) == wrong)
    found = solve(rig, robots.seen(rig, theta, robots.angles(POSES, seed), PIXEL, seed))
    return identifiability.joint_scales(found.rig, found.theta, found.covariance)
