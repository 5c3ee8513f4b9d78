"""Cameras that were pushed after the exploration: named or not, and the angles of a log by where they are now."""

from functools import partial

import numpy as np

from bodylog.findings import log_estimate
from bodylog.settings import Settings
from tests.body.changed_arms import DEGREE, explored, explored_without_urdf, run
from tests.validation import figures

BODIES = 4
PUSHES = ((0.0, 0.0), (0.3, 0.003), (1.0, 0.01), (2.0, 0.02))
"""Degrees and m, each about and along an axis of its own for every body."""


def judge(found, truth):
    """Root mean square error (mrad) and NEES."""
    at = found.joints.t
    off = found.joints.values - np.column_stack([np.interp(at, truth.t, column) for column in truth.values.T])
    return 1e3 * np.sqrt(np.square(off).mean()), float((off**2 / np.einsum("nii->ni", found.cov)).mean())


def push(rng, degrees, metres):
    """A change of a camera's pose (6,): m, rad."""
    ways = rng.normal(size=(2, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    return np.concatenate([metres * ways[0], degrees * DEGREE * ways[1]])


LEARNED = {"URDF": explored, "found axes": lambda seed: explored_without_urdf(run(seed, 16.0, 0.003))}


def row(chain, degrees, metres):
    """The row of one size, by bodies on this chain."""
    rng, named, others, before, after = np.random.default_rng(5), 0, 0, [], []
    for seed in range(BODIES):
        body, draw = LEARNED[chain](seed), partial(run, 3000 + seed, camera=push(rng, degrees, metres))
        truth, features = draw(encoder=0.0).joints, draw()
        before.append(judge(log_estimate.infer(features, body, Settings()), truth))
        found, _ = log_estimate.infer_with_changes(features, body, Settings())
        after.append(judge(found, truth))
        camera = [fault for fault in found.faults if "camera" in fault.names]
        named += bool(camera)
        others += len(found.faults) - len(camera)
    each = (f"{np.median(one):.2f}; {np.max(one):.2f}" for one in (*zip(*before, strict=True), *zip(*after, strict=True)))
    return (chain, f"{degrees:g}°, {1e3 * metres:g} mm", f"{named}", f"{others}", *each)


def table():
    """One row for each body and size of a push."""
    pushed = f"push ({BODIES} runs of 10 s)"
    camera = "camera named, alone or with others"
    titles = ("body", pushed, camera, "others named", "as learned: mrad", "NEES", "where it is now: mrad", "NEES")
    return figures.table(titles, [row(chain, *one) for chain in LEARNED for one in PUSHES])
