"""How sure joints' zeros are, and how often they are right, by what sees the arm.

Each draw is an exploration of 15 s of its own by an arm of four joints, with 0.5° to 5° on one joint's readings.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from bodylog.body.data.pairs import smooth_all_joints
from bodylog.body.kinematic.residuals import fit_residual_kernel, solve_together
from bodylog.body.kinematic.sightings import gather_sightings
from bodylog.kinematics import urdf
from bodylog.kinematics.identifiability import Offset, joint_zeros
from bodylog.kinematics.links import CameraHint, MarkerTrack, find_links
from bodylog.kinematics.rotations import invert_transform, make_transform, rotation_from_vector
from bodylog.types import Features, Series
from tests.kinematics import robots
from tests.kinematics.robots import ARM, JOINTS
from tests.validation import figures

PIXEL, ENCODER, DEGREE = 0.2, 0.001, np.radians(1.0)
HALF = 0.04
CORNERS = np.array([[-HALF, -HALF, 0.0], [HALF, -HALF, 0.0], [HALF, HALF, 0.0], [-HALF, HALF, 0.0]])
KINDS = {
    "centre of a tag, camera unknown": (np.zeros((1, 3)), False, 1),
    "centre, camera known (CameraInfo, tf)": (np.zeros((1, 3)), True, 1),
    "centre, two cameras unknown": (np.zeros((1, 3)), False, 2),
    "corners of a tag of 8 cm, camera unknown": (CORNERS, False, 1),
    "corners, two cameras unknown": (CORNERS, False, 2),
    "board of 12 corners, camera unknown": (robots.board().sights[0].points, False, 1),
}


COUNT = 40
"""Draws of a kind."""


def table():
    """One row for each kind of sense."""
    head = ("seen", f"median σ of {', '.join(JOINTS)}", "within 2σ: of the joint put off", "of all joints")
    rows = [_row(name, [draw(seed, *kind) for seed in range(COUNT)]) for name, kind in KINDS.items()]
    return figures.table(head, rows)


def draw(seed: int, points: np.ndarray, known: bool, cameras: int) -> tuple[int, float, tuple[Offset, ...]]:
    """Which joint was put off, by how much (rad), and what was found of all."""
    random = np.random.default_rng(1000 + seed)
    joint, size = seed % 4, float(random.uniform(0.5, 5.0) * random.choice([-1.0, 1.0]) * DEGREE)
    poses = [robots.camera_pose(), exponential_pose(np.array([0.0, -0.7, 0.0])) @ robots.camera_pose()][:cameras]
    found, hints = _explored(random, points, poses, joint, size), {}
    for name, pose in zip(("", "side"), poses, strict=False):
        off = make_transform(rotation_from_vector(random.normal(0.0, 2.0 * DEGREE, 3)), random.normal(0.0, 0.02, 3))
        lens = np.array([np.log(600.0) + random.normal(0.0, 0.01), 0.0, 320.0, 240.0, 0.0, 0.0])
        lens[2:4] += random.normal(0.0, 5.0, 2)
        hint = CameraHint(size=(640, 480))
        hints[name] = replace(hint, link="base", pose=invert_transform(off @ pose), lens=lens) if known else hint
    return joint, size, _learned(found, hints)


def exponential_pose(turn: np.ndarray) -> np.ndarray:
    """A camera that looks from the side at what another sees: turned about a point 1.8 m before it."""
    there = make_transform(np.eye(3), np.array([0.0, 0.0, 1.8]))
    return there @ make_transform(rotation_from_vector(turn), np.zeros(3)) @ invert_transform(there)


def _explored(
    random: np.random.Generator, points: np.ndarray, poses: list[np.ndarray], joint: int, size: float
) -> Features:
    t = np.arange(0.0, 15.0, 0.01)
    speed, phase = random.uniform(0.5, 2.5, (4, 5)), random.uniform(0.0, 2.0 * np.pi, (4, 5))
    q = 0.2 * np.sin(speed[:, :, None] * t + phase[:, :, None]).sum(axis=1).T + np.array([0.0, -0.6, 0.9, 0.2])
    read = q + random.normal(0.0, ENCODER, q.shape) + size * (np.arange(4) == joint)
    frames = np.arange(5, len(t), 10)
    names = [f"tag.{k}" for k in range(len(points))] if len(points) > 1 else ["tag"]
    tracks, boards = {}, {}
    for name, pose in zip(("", "side/"), poses, strict=False):
        rig = robots.board()
        camera, sight = replace(rig.cameras[0], anchor=pose), replace(rig.sights[0], points=points)
        rig = replace(rig, cameras=(camera,), sights=(sight,))
        seen = rig.see(sight, rig.prior[0], q[frames]).image
        seen = seen + random.normal(0.0, PIXEL, seen.shape)
        std, ns = np.full((len(frames), 2), PIXEL), (t[frames] * 1e9).astype(np.int64)
        own = {name + one: Series(t[frames], seen[:, k], ("u", "v"), "px", ns, std) for k, one in enumerate(names)}
        tracks |= own
        if len(points) > 1:
            boards[f"{name}tag"] = tuple(own), points
    series = Series(t, read, JOINTS, "rad", (t * 1e9).astype(np.int64))
    return Features(series, tracks, None, (), (), {}, (), (640, 480), boards=boards)


def _learned(found: Features, hints: dict[str, CameraHint]) -> tuple[Offset, ...]:
    """The joints' zeros as `fit --urdf` learns them."""
    read = smooth_all_joints([found], None)
    shown = gather_sightings([found], list(found.tracks), read, 1, 2000)
    tracks = {}
    for name, one in shown.items():
        camera, _, marker = name.rpartition("/")
        tracks[name] = MarkerTrack(camera, marker, one.sighted, one.points)
    links = find_links(urdf.parse_urdf(ARM, "arm.urdf"), JOINTS, {}, tracks, hints, 5.0 * DEGREE)
    made = links.calibrated
    each = enumerate(shown.items())
    parts = {name: fit_residual_kernel(made.rig, k, made.theta, one, made.weights[k], read, 0) for k, (name, one) in each}
    both, std = solve_together(made.rig, made.theta, parts), made.rig.prior[1]
    return joint_zeros(made.rig, both.theta, std * (both.root @ both.root.T) * std[:, None])


def _row(name: str, found: list[tuple[int, float, tuple[Offset, ...]]]) -> tuple[str, ...]:
    sizes = [np.median([one[m].std if one[m].identifiable else np.inf for _, _, one in found]) for m in range(4)]
    stds = ", ".join("–" if np.isinf(one) else f"{np.degrees(one):.2f}°" for one in sizes)
    put, every = list(_within(found, True)), list(_within(found, False))
    return name, stds, f"{sum(put)} of {len(put)}", f"{sum(every)} of {len(every)}"


def _within(found: list[tuple[int, float, tuple[Offset, ...]]], put: bool) -> Iterator[bool]:
    for joint, size, one in found:
        for m, zero in enumerate(one):
            if zero.identifiable and (m == joint or not put):
                yield abs(zero.value + (size if m == joint else 0.0)) <= 2.0 * zero.std
