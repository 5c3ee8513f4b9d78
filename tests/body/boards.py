"""Corners of a board on an arm's tool, as a camera sees them in still poses."""

import numpy as np

from bodylog.types import Features, Series
from tests.body.kinematic_arms import OFFSETS, bend_places
from tests.kinematics import robots
from tests.kinematics.robots import JOINTS

RARE = 7


def image(q, rig=None, board=None):
    """Places (N,12,2) px of the corners; `board`: unknowns (6,) of its pose on the tool."""
    rig = robots.board() if rig is None else rig
    theta = rig.prior[0].copy()
    theta[rig.of_carrier(0)] = 0.0 if board is None else board
    theta[rig.of_joints] = [OFFSETS.get(name, 0.0) for name in JOINTS]
    return rig.see(rig.sights[0], theta, q).image + bend_places(q, 2.0)[:, None]


def features(q, seed=1, camera="", turned=None, board=None) -> Features:
    """Still poses with a board on the tool: corners hidden at random, one of them nearly always."""
    draw = np.random.default_rng(seed)
    places = image(q, board=board) + draw.normal(0.0, 0.1, (len(q), 12, 2))
    places[draw.random((len(q), 12)) < 0.2] = np.nan
    places[4:, RARE] = np.nan
    t = np.arange(len(q), dtype=float)
    ns = (t * 1e9).astype(np.int64)
    names = tuple(f"{camera}board.{k}" for k in range(12))
    tracks = {name: Series(t, places[:, k], ("u", "v"), "px", ns) for k, name in enumerate(names)}
    read = q if turned is None else q + turned
    joints = Series(t, read, JOINTS, "rad", ns)
    boards = {f"{camera}board": (names, robots.board().sights[0].points)}
    return Features(joints, tracks, None, (), (), {}, (), (640, 480), poses=True, boards=boards)
