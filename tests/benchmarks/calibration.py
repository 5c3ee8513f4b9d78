"""Calibrations side by side on the same splits of real robots: `python -m tests.benchmarks.calibration DIR [ROBOT …]`.

Ours, a plain bundle adjustment with joint zeros, and OpenCV's hand-eye methods. Each learns from the same images and
predicts the same withheld ones. DIR has the robots' folders as docs/real.md lists them. To enter a method, give a
function from `Split` to `Solution`, and add it to METHODS.
"""

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from shutil import copy
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from scipy.optimize import least_squares

from bodylog import pipeline
from bodylog.body.kinematic.placements import Calibration
from bodylog.kinematics import urdf
from bodylog.kinematics.chain import Chain, chain_between
from bodylog.kinematics.rotations import invert_transform, make_transform
from bodylog.kinematics.weights import collect_weights
from bodylog.robot import calibration
from bodylog.settings import Settings
from bodylog.sources import CharucoSource
from bodylog.types import Array
from tests.kinematics.motoman import LEFT_ARM, left_arm_urdf

ZERO_STD = np.radians(5.0)
"""Prior std of a joint's zero in the plain adjustment; without one, the first joint and the base are one unknown."""
KNEE_PX = 1.0
KNEE_MM = 1.0
HAND_EYE = ("TSAI", "PARK", "HORAUD", "ANDREFF", "DANIILIDIS")


@dataclass(frozen=True, eq=False)
class Sightings:
    """Joints q (N,M) rad and points seen (N,C,2) px, NaN where not."""

    q: Array
    image: Array

    def rows(self, chosen: Array) -> "Sightings":
        """Some images."""
        return Sightings(self.q[chosen], self.image[chosen])


@dataclass(frozen=True, eq=False)
class Split:
    """One robot: table and settings for ours · chain from the camera's link to the marker's · points (C,3) m of it.

    learn, test: sightings · size: of images, px · still: camera in its link (4,4) where the URDF has it, else None.
    """

    table: Path
    settings: Settings
    rows: Array
    chain: Chain
    points: Array
    learn: Sightings
    test: Sightings
    size: tuple[int, int]
    camera: Array | None = None


@dataclass(frozen=True, eq=False)
class Solution:
    """Camera in its link and marker in its link (4,4) m · lens fx, fy, cx, cy, k1, k2 · zeros (M,) rad.

    bend: of angles (N,M) rad, how far gravity turns the joints; None where nothing is known of it.
    """

    camera: Array
    marker: Array
    lens: Array
    zeros: Array
    bend: Callable[[Array], Array] | None = None

    def angles(self, q: Array) -> Array:
        """Angles (N,M) rad for readings q (N,M)."""
        return q + self.zeros + (0.0 if self.bend is None else self.bend(q))


def project(split: Split, found: Solution, q: Array) -> Array:
    """Points (N,C,2) px at joints q (N,M) rad."""
    arm = split.chain.at(found.angles(q))
    points = split.points @ found.marker[:3, :3].T + found.marker[:3, 3]
    linked = points @ arm.rotation.transpose(0, 2, 1) + arm.place[:, None]
    seen = (linked - found.camera[:3, 3]) @ found.camera[:3, :3]
    flat = seen[..., :2] / seen[..., 2:]
    fx, fy, cx, cy, k1, k2 = found.lens
    square = np.square(flat).sum(axis=-1, keepdims=True)
    flat = flat * (1.0 + k1 * square + k2 * square**2)
    return flat * np.array([fx, fy]) + np.array([cx, cy])


def adjust(split: Split) -> Solution:
    """A plain bundle adjustment: soft L1 of all corners, camera, lens, marker and zeros unknown together."""
    first = hand_eye("PARK")(split) if len(split.points) > 1 else _from_urdf(split)
    data = split.learn

    def unpacked(x: Array) -> Solution:
        camera = first.camera @ make_transform(cv2.Rodrigues(x[3:6])[0], x[:3])
        marker = first.marker @ make_transform(cv2.Rodrigues(x[9:12])[0], x[6:9])
        lens = first.lens * np.array([*np.exp(x[12:14]), 1, 1, 1, 1]) + np.array([0, 0, *(100.0 * x[14:16]), *x[16:18]])
        return Solution(camera, marker, lens, x[18:])

    seen = np.isfinite(data.image)
    # a point has no turn, and a lens and zeros are never quite free
    doubt = np.full(18 + data.q.shape[1], 1e3)
    doubt[12:18] = [0.4, 0.4, 0.3, 0.3, 0.2, 0.2]
    doubt[18:] = ZERO_STD

    def residual(x: Array) -> Array:
        off = (project(split, unpacked(x), data.q) - data.image)[seen]
        return np.concatenate([off, x / doubt])

    found = least_squares(residual, np.zeros(len(doubt)), loss="soft_l1", f_scale=KNEE_PX, x_scale="jac", max_nfev=300)
    return unpacked(found.x)


def _from_urdf(split: Split) -> Solution:
    """The URDF's camera, a lens by the images' width, and the marker at the origin of its link."""
    width, height = split.size
    lens = np.array([width, width, width / 2, height / 2, 0.0, 0.0])
    return Solution(split.camera, np.eye(4), lens, np.zeros(split.learn.q.shape[1]))


def hand_eye(method: str) -> Callable[[Split], Solution]:
    """OpenCV's calibrateCamera, then one of its calibrateHandEye methods, and the mean of the board's places."""

    def solve(split: Split) -> Solution:
        data = split.learn
        seen = [np.isfinite(image[:, 0]) for image in data.image]
        kept = [k for k, there in enumerate(seen) if there.sum() >= 6]
        points = [split.points[seen[k]].astype(np.float32) for k in kept]
        images = [data.image[k][seen[k]].astype(np.float32) for k in kept]
        flags = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
        _, matrix, distortion, turns, places = cv2.calibrateCamera(points, images, split.size, None, None, flags=flags)
        boards = [make_transform(cv2.Rodrigues(w)[0], v[:, 0]) for w, v in zip(turns, places, strict=True)]
        # the chain goes from the camera's link to the board's: OpenCV wants the camera's link in the board's
        arm = split.chain.at(data.q[kept])
        hands = [invert_transform(make_transform(r, p)) for r, p in zip(arm.rotation, arm.place, strict=True)]
        turn, place = cv2.calibrateHandEye(
            [one[:3, :3] for one in hands], [one[:3, 3] for one in hands],
            [one[:3, :3] for one in boards], [one[:3, 3] for one in boards],
            method=getattr(cv2, f"CALIB_HAND_EYE_{method}"),
        )  # fmt: skip
        camera = make_transform(turn, place[:, 0])
        placed = np.array([hand @ camera @ board for hand, board in zip(hands, boards, strict=True)])
        left, _, right = np.linalg.svd(placed[:, :3, :3].sum(axis=0))
        marker = make_transform(left @ right, np.median(placed[:, :3, 3], axis=0))
        fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
        lens = np.array([fx, fy, cx, cy, *distortion.ravel()[:2]])
        return Solution(camera, marker, lens, np.zeros(data.q.shape[1]))

    return solve


def learn_calibration(split: Split, rows: Array) -> Calibration:
    """`bodylog fit` on some rows of a split's table, and the calibration of its body."""
    with TemporaryDirectory() as folder:
        head, *lines = split.table.read_text().splitlines()
        log = Path(folder) / "learn.csv"
        log.write_text("\n".join([head, *(lines[k] for k in rows)]) + "\n")
        for picture in split.table.parent.glob("*.[pj][np]g"):
            copy(picture, folder)
        pipeline.fit([log], Path(folder) / "body.npz", split.settings)
        return calibration.load_calibration(Path(folder) / "body.npz")


def ours(split: Split) -> Solution:
    """The calibration of the rows to learn from; the withheld images predicted by it alone."""
    found = learn_calibration(split, split.rows)
    lens = found.lenses[0]
    zeros = {one.joint: one.value for one in found.zeros if one.identifiable}
    joints = np.array([zeros.get(name, 0.0) for name in split.chain.joints])
    given = {one.joint: one.value for one in found.compliances if one.identifiable}
    compliance = np.array([given.get(name, 0.0) for name in split.chain.joints])
    weights = collect_weights(urdf.load_urdf(Path(split.settings.kinematics.urdf)), split.chain.joints, {})
    return Solution(
        found.cameras[0].pose, found.markers[0].pose, np.array([*lens.focal, *lens.centre, *lens.distortion]), joints,
        lambda q: compliance * weights.torques(q),
    )  # fmt: skip


METHODS: Mapping[str, Callable[[Split], Solution]] = {
    "bodylog": ours,
    "bundle adjustment": adjust,
    **{f"calibrateHandEye {name}": hand_eye(name) for name in HAND_EYE},
}


def reprojection_px(split: Split, found: Solution) -> float:
    """RMS distance, px, of the withheld points from where they are predicted."""
    off = project(split, found, split.test.q) - split.test.image
    return float(np.sqrt(np.nanmean(np.square(off).sum(axis=-1))))


def scatter_mm(split: Split, found: Solution) -> float:
    """RMS distance, mm, of the board's places in its link from their mean, over the withheld images."""
    fx, fy, cx, cy, k1, k2 = found.lens
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    arm = split.chain.at(found.angles(split.test.q))
    places = []
    for row, image in enumerate(split.test.image):
        seen = np.isfinite(image[:, 0])
        _, turn, place = cv2.solvePnP(split.points[seen], image[seen], matrix, np.array([k1, k2, 0.0, 0.0]))
        hand = invert_transform(make_transform(arm.rotation[row], arm.place[row]))
        places.append((hand @ found.camera @ make_transform(cv2.Rodrigues(turn)[0], place[:, 0]))[:3, 3])
    return 1e3 * float(np.sqrt(np.mean(np.square(np.array(places) - np.mean(places, axis=0)).sum(axis=1))))


def board_split(table: Path, robot: Path, source: CharucoSource, every: int, links: tuple[str, str]) -> Split:
    """A camera in hand before a resting board; every so many images are withheld, the second one first."""
    settings = replace(Settings(), features={"board": source})
    settings = replace(settings, kinematics=replace(Settings().kinematics, urdf=str(robot)))
    _, features = pipeline.observe(table, settings)
    chain = chain_between(urdf.load_urdf(robot), *links)
    names, points = features.boards["board"]
    columns = [features.joints.names.index(name) for name in chain.joints]
    there = [k for k, name in enumerate(names) if name in features.tracks]
    image = np.stack([features.tracks[names[k]].values for k in there], axis=1)
    whole = Sightings(features.joints.values[:, columns], image)
    rows = np.arange(len(whole.q))
    withheld = rows % every == every - 1
    size = features.picture_size
    assert size is not None
    return Split(
        table, settings, rows[~withheld], chain, points[there], whole.rows(~withheld), whole.rows(withheld), size
    )


def franka(folder: Path) -> Split:
    """Even images to learn from, odd ones withheld."""
    source = CharucoSource("5x7", 0.034, 0.028, "6x6_250")
    here = folder / "franka"
    return board_split(here / "A" / "poses.csv", here / "panda.urdf", source, 2, ("panda_link7", "panda_link0"))


def panda(folder: Path) -> Split:
    """Every fifth image is withheld."""
    source = CharucoSource("10x14", 0.07, 0.04, "4x4_1000")
    here = folder / "panda"
    table = here / "real_new" / "poses.csv"
    return board_split(table, here / "panda.urdf", source, 5, ("panda_link7", "panda_link0"))


def nao(folder: Path) -> Split:
    """250 poses to learn from, 500 withheld; one point on the hand, which has no pose for calibrateHandEye."""
    here = folder / "nao"
    settings = replace(Settings(), kinematics=replace(Settings().kinematics, urdf=str(here / "nao.urdf")))
    settings = replace(settings, fit=replace(settings.fit, without=("published",)))
    chain = chain_between(urdf.load_urdf(here / "nao.urdf"), "CameraBottom_optical_frame", "l_wrist")

    def read(name: str) -> Sightings:
        _, features = pipeline.observe(here / name, settings)
        columns = [features.joints.names.index(joint) for joint in chain.joints]
        return Sightings(features.joints.values[:, columns], features.tracks["marker"].values[:, None])

    learn = read("left_train.csv")
    rows = np.arange(len(learn.q))
    point = np.zeros((1, 3))
    return Split(
        here / "left_train.csv", settings, rows, chain, point, learn, read("left_test.csv"), (640, 480), np.eye(4)
    )


@dataclass(frozen=True, eq=False)
class TrackedPoints:
    """Points (N,3) m of one target that a tracker measures at joints q (N,M) rad · robot: its URDF · learn, test: rows."""

    robot: Path
    q: Array
    points: Array
    learn: Array
    test: Array

    def chain(self, links: tuple[str, str] = ("base", "flange")) -> Chain:
        """From the link where the tracker stands to that with the target."""
        return chain_between(urdf.load_urdf(self.robot), *links).over(tuple(LEFT_ARM))

    def withheld_mm(self, chain: Chain, frame: Array, target: Array, zeros: Array) -> float:
        """RMS distance, mm, of the withheld points from where they are predicted."""
        off = place_points(chain, frame, target, self.q[self.test] + zeros) - self.points[self.test]
        return 1e3 * float(np.sqrt(np.mean(np.square(off).sum(axis=1))))


def place_points(chain: Chain, frame: Array, target: Array, q: Array) -> Array:
    """Where a tracker with its frame (4,4) at a chain's start sees a target (3,) m of its end, at q (N,M) rad: (N,3) m."""
    arm = chain.at(q)
    return (arm.rotation @ target + arm.place - frame[:3, 3]) @ frame[:3, :3]


def motoman(table: Path, folder: Path) -> TrackedPoints:
    """Every third pose is withheld; poses without a reading of the tracker are left out after that."""
    robot = folder / "motoman.urdf"
    robot.write_text(left_arm_urdf())
    read = np.genfromtxt(table, delimiter=",", names=True)
    q = np.column_stack([read[name] for name in LEFT_ARM])
    points = np.column_stack([read[f"leica_{axis}"] for axis in "xyz"])
    rows = np.flatnonzero(np.isfinite(points).all(axis=1))
    return TrackedPoints(robot, q, points, rows[rows % 3 != 2], rows[rows % 3 == 2])


def track_with_bodylog(data: TrackedPoints) -> float:
    """`bodylog fit` on the rows to learn from; the withheld points by the printed calibration alone, in mm."""
    log = data.robot.parent / "learn.csv"
    head = ",".join([*LEFT_ARM, *(f"leica_{axis}" for axis in "xyz")])
    both = np.column_stack([data.q, data.points])[data.learn]
    np.savetxt(log, both, delimiter=",", header=head, comments="", fmt="%.9f")
    settings = replace(Settings(), kinematics=replace(Settings().kinematics, urdf=str(data.robot)))
    pipeline.fit([log], data.robot.parent / "body.npz", settings)
    found = calibration.load_calibration(data.robot.parent / "body.npz")
    zeros = {one.joint: one.value for one in found.zeros if one.identifiable}
    tracker, target = found.trackers[0], found.markers[0]
    chain = data.chain((tracker.link, target.link))
    return data.withheld_mm(chain, tracker.pose, target.pose[:3, 3], np.array([zeros.get(name, 0.0) for name in LEFT_ARM]))


def track_by_adjustment(data: TrackedPoints) -> float:
    """Soft L1 of all points in mm, the tracker's frame, the target and zeros unknown together; withheld, in mm."""
    chain = data.chain()
    arm = chain.at(data.q[data.learn])
    seen = data.points[data.learn]
    left, _, right = np.linalg.svd((arm.place - arm.place.mean(axis=0)).T @ (seen - seen.mean(axis=0)))
    turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    first = make_transform(turn, arm.place.mean(axis=0) - turn @ seen.mean(axis=0))

    def unpacked(x: Array) -> tuple[Array, Array, Array]:
        return first @ make_transform(cv2.Rodrigues(x[3:6])[0], x[:3]), x[6:9], x[9:]

    def residual(x: Array) -> Array:
        frame, target, zeros = unpacked(x)
        off = 1e3 * (place_points(chain, frame, target, data.q[data.learn] + zeros) - seen)
        return np.concatenate([off.ravel(), x[9:] / ZERO_STD])

    found = least_squares(residual, np.zeros(9 + len(LEFT_ARM)), loss="soft_l1", f_scale=KNEE_MM, x_scale="jac", max_nfev=300)
    return data.withheld_mm(chain, *unpacked(found.x))


def print_motoman(folder: Path) -> None:
    """Print a row for each method that points in space allow, and why others have none."""
    with TemporaryDirectory() as own:
        data = motoman(folder / "motoman" / "leica_left_hand_6x6x6.csv", Path(own))
        best = track_with_bodylog(data)
        for name, figure in (("bodylog", best), ("bundle adjustment", track_by_adjustment(data))):
            print(f"| motoman | {name} | – | – | {figure:.2f} | {figure / best:.2f} |", flush=True)
    print("| motoman | calibrateHandEye | – | – | a point has no turn, and it needs poses | – |")
    print("| motoman | its cameras | their place is not in the data | – | – | – |")


ROBOTS: Mapping[str, Callable[[Path], Split]] = {"franka": franka, "panda": panda, "nao": nao}


def main(folder: Path, robots: list[str]) -> None:
    """Print a row for each robot and method, with the ratio to ours."""
    if robots != ["motoman"] and not hasattr(cv2, "calibrateHandEye"):
        wanted = "type: pip install --no-deps --target cv4 'opencv-python-headless<5', then PYTHONPATH=cv4"
        raise SystemExit(f"OpenCV {cv2.__version__} has no calibrateHandEye for Python; {wanted}")
    print("| robot | method | withheld, px | ratio | board's place, or withheld points, mm | ratio |")
    print("|---|---|---|---|---|---|")
    for robot in robots or [*ROBOTS, "motoman"]:
        if robot == "motoman":
            print_motoman(folder)
            continue
        split = ROBOTS[robot](folder)
        best: dict[str, float] = {}
        for name, method in METHODS.items():
            if len(split.points) == 1 and name.startswith("calibrateHandEye"):
                continue
            found = method(split)
            figures = {"px": reprojection_px(split, found)}
            if len(split.points) > 1:
                figures["mm"] = scatter_mm(split, found)
            best = best or figures
            cells = [f"{v:.2f} | {v / best[key]:.2f}" for key, v in figures.items()]
            print(f"| {robot} | {name} | {' | '.join([*cells, *['– | –'] * (2 - len(cells))])} |", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
