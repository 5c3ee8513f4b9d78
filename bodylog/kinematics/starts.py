"""Starting points of the search for θ: the prior, resection from points
in images, alignment of points in space, or hand-eye calibration from a board.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ..types import MM_PER_M, Array
from .calibration import Sighted
from .rig import Carrier, Rig, RigCamera
from .rotations import invert_transform, make_transform, nearest_rotation, vector_from_rotation

_STEP = 0.1
"""m: step from the link's frame at which marker positions are tried."""
_KNOWN = 1.0
"""rad: a camera with a smaller prior std of rotation starts at its prior."""
_FEWEST = 6
_CORNERS = 4
_FARTHEST = 50.0
"""m: largest distance of a marker."""


def find_starts(rig: Rig, data: Sequence[Sighted]) -> tuple[Rig, list[Array]]:
    """Return the rig, with unknown poses anchored near a
    solution where one is found, and first values of θ (P,).
    """
    for index, camera in enumerate(rig.cameras):
        boards = [
            k for k in _sights_of_camera(rig, index) if rig.carriers[rig.sights[k].carrier].turns
        ]
        if boards and camera.doubt[3:6].max() >= _KNOWN:
            known = {k for k, one in enumerate(rig.carriers) if _is_placed(one)}
            known |= {
                rig.sights[k].carrier
                for before in range(index)
                for k in _sights_of_camera(rig, before)
            }
            placed = [k for k in boards if rig.sights[k].carrier in known]
            rig = (
                _place_by_known_board(rig, data, placed[0])
                if placed
                else _align_by_hand_eye(rig, data, boards[0])
            )
    first = list(_starts_from_prior(rig))
    for index, camera in enumerate(rig.cameras):
        seen = [
            k
            for k in _sights_of_camera(rig, index)
            if not rig.carriers[rig.sights[k].carrier].turns
        ]
        if (
            seen
            and len(seen) == len(_sights_of_camera(rig, index))
            and camera.doubt[3:6].max() >= _KNOWN
        ):
            first = _place_camera(rig, data, index, first)
    return rig, first


def _sights_of_camera(rig: Rig, camera: int) -> list[int]:
    return [k for k, sight in enumerate(rig.sights) if sight.camera == camera]


def _starts_from_prior(rig: Rig) -> Iterator[Array]:
    """Yield θ's prior mean, then θ with the points' places moved a step to each side."""
    mean = rig.prior[0]
    yield mean
    points = [rig.of_carrier(k) for k, one in enumerate(rig.carriers) if not one.turns]
    for axis in range(3 if points else 0):
        for step in (-_STEP, _STEP):
            moved = mean.copy()
            for place in points:
                moved[place][axis] += step
            yield moved


def _place_camera(
    rig: Rig, data: Sequence[Sighted], index: int, first: Sequence[Array]
) -> list[Array]:
    """Each θ with the camera's pose by resection from its own
    markers, or the tracker's by alignment of its own points.
    """
    camera = rig.cameras[index]
    found = []
    for theta in first:
        points = []
        images = []
        for k in _sights_of_camera(rig, index):
            sight = rig.sights[k]
            one = data[k]
            arm = sight.chain.at(one.q)
            place = rig.carrier_pose(sight.carrier, theta)[:3, 3]
            valid = np.isfinite(one.image[:, 0]).all(axis=1)
            points.append((arm.rotation @ place + arm.place)[valid])
            images.append(one.image[valid, 0])
        there = np.concatenate(points)
        seen = np.concatenate(images)
        pose = (
            align_points(there, seen / MM_PER_M)
            if camera.tracks_space
            else resect_pose(there, normalised_directions(seen, camera.lens))
        )
        if pose is not None and np.linalg.norm(pose[:3, 3]) < _FARTHEST:
            step = pose @ invert_transform(camera.anchor)
            placed = theta.copy()
            placed[rig.of_camera(index)][:6] = np.concatenate(
                [step[:3, 3], vector_from_rotation(step[:3, :3])]
            )
            found.append(placed)
    return found or list(first)


def align_points(points: Array, seen: Array) -> Array | None:
    """The pose (4,4) that takes points (n,3) m to where they were
    seen (n,3) m, whatever few of them are false; None for too few.

    Least squares by the singular values of the correlation (Kabsch 1976).
    """
    if len(points) < _FEWEST:
        return None
    weight = np.ones((len(points), 1))
    for _ in range(5):  # downweight false points
        share = weight / weight.sum()
        middle = (share * points).sum(axis=0)
        there = (share * seen).sum(axis=0)
        turn = nearest_rotation((share * (seen - there)).T @ (points - middle))
        size = np.linalg.norm(seen - there - (points - middle) @ turn.T, axis=1)
        far = size / max(3.0 * float(np.median(size)), 1e-12)
        weight = 1.0 / (1.0 + np.square(far))[:, None]
    return make_transform(turn, there - turn @ middle)


def normalised_directions(image: Array, lens: Array) -> Array:
    """Directions x/z, y/z of image points (…,2) px for a lens (6,), without distortion."""
    focal = np.exp(lens[0]) * np.array([1.0, np.exp(lens[1])])
    return np.asarray((image - lens[2:4]) / focal)


def resect_pose(points: Array, rays: Array) -> Array | None:
    """The pose (4,4) that projects points (n,3) m to
    directions (n,2); None for few or coplanar points.
    """
    centre = points.mean(axis=0)
    size = np.sqrt(np.square(points - centre).sum(axis=1).mean())
    if len(points) < _FEWEST or size < 1e-6:
        return None
    near = np.column_stack([(points - centre) / size, np.ones(len(points))])
    zero = np.zeros_like(near)
    rows = np.concatenate(
        [np.hstack([near, zero, -rays[:, :1] * near]), np.hstack([zero, near, -rays[:, 1:] * near])]
    )
    for _ in range(5):  # downweight rows of false sightings
        values, vectors = np.linalg.eigh(rows.T @ rows)
        matrix = vectors[:, 0].reshape(3, 4)
        size_of = np.abs(rows @ vectors[:, 0])
        weight = 1.0 / (1.0 + np.square(size_of / max(3.0 * float(np.median(size_of)), 1e-12)))
        rows = rows * np.sqrt(weight)[:, None]
    if values[1] < 1e-12 * values[-1]:
        return None
    turn = matrix[:, :3]
    place = matrix[:, 3]
    sign = np.sign(np.median(near @ matrix[2])) or 1.0
    turn = sign * turn
    place = sign * place
    scale = np.cbrt(max(np.linalg.det(turn), 1e-12))
    rotation = nearest_rotation(turn)
    return make_transform(rotation, size * place / scale - rotation @ centre)


def _align_by_hand_eye(rig: Rig, data: Sequence[Sighted], k: int) -> Rig:
    """Place camera and board by hand-eye calibration from the board's poses."""
    poses, links = board_poses(rig, data, k)
    if len(poses) < 3:
        return rig
    found = hand_eye(poses, links)
    sight = rig.sights[k]
    carrier = replace(rig.carriers[sight.carrier], anchor=found[1])
    carriers = tuple(carrier if n == sight.carrier else one for n, one in enumerate(rig.carriers))
    return _anchor_camera(replace(rig, carriers=carriers), sight.camera, found[0])


def _is_placed(carrier: Carrier) -> bool:
    """Whether a board's pose is known beforehand."""
    return carrier.turns and float(carrier.doubt[3:].max()) < _KNOWN


def _place_by_known_board(rig: Rig, data: Sequence[Sighted], k: int) -> Rig:
    """Place a camera by a board that is known, or that another camera has located."""
    poses, links = board_poses(rig, data, k)
    sight = rig.sights[k]
    if not poses:
        return rig
    board = rig.carriers[sight.carrier].anchor
    found = [seen @ invert_transform(link @ board) for seen, link in zip(poses, links, strict=True)]
    turn = nearest_rotation(np.sum([one[:3, :3] for one in found], axis=0))
    return _anchor_camera(
        rig, sight.camera, make_transform(turn, np.median([one[:3, 3] for one in found], axis=0))
    )


def board_poses(rig: Rig, data: Sequence[Sighted], k: int) -> tuple[list[Array], list[Array]]:
    """The board's pose (4,4) in the camera, and its link's
    in the camera's link, for each frame that determines it.
    """
    sight = rig.sights[k]
    one = data[k]
    camera = rig.cameras[sight.camera]
    arm = sight.chain.at(one.q)
    poses = [
        planar_board_pose(sight.points, normalised_directions(image, camera.lens))
        for image in one.image
    ]
    rows = [n for n, pose in enumerate(poses) if pose is not None]
    return [pose for pose in poses if pose is not None], [
        make_transform(arm.rotation[n], arm.place[n]) for n in rows
    ]


def planar_board_pose(points: Array, rays: Array) -> Array | None:
    """The pose (4,4) of a planar board with corners (C,3)
    m at directions (C,2); None where too few are seen.
    """
    seen = np.isfinite(rays).all(axis=-1)
    if seen.sum() < _CORNERS:
        return None
    corners = points[seen]
    rays = rays[seen]
    centre = corners.mean(axis=0)
    axes = np.linalg.svd(corners - centre)[2]
    if np.linalg.det(axes) < 0:
        axes[2] *= -1.0
    flat = (corners - centre) @ axes.T
    near = np.column_stack([flat[:, :2], np.ones(len(flat))])
    zero = np.zeros_like(near)
    rows = np.concatenate(
        [np.hstack([near, zero, -rays[:, :1] * near]), np.hstack([zero, near, -rays[:, 1:] * near])]
    )
    columns = np.linalg.svd(rows)[2][-1].reshape(3, 3)
    columns /= np.linalg.norm(columns[:, :2], axis=0).mean() * (np.sign(columns[2, 2]) or 1.0)
    rotation = nearest_rotation(
        np.column_stack([columns[:, 0], columns[:, 1], np.cross(columns[:, 0], columns[:, 1])])
    )
    return make_transform(rotation @ axes, columns[:, 2] - rotation @ axes @ centre)


def hand_eye(boards: Sequence[Array], links: Sequence[Array]) -> tuple[Array, Array]:
    """X (link in camera) and Z (board in its link) with
    board pose = X · link pose · Z for all (4,4) pairs, m.
    """
    order = range(len(boards))
    # relative rotation vectors of both sides differ by X's rotation alone
    gaps = [(i, j) for gap in (1, 2, 5) for i in order if (j := i + gap) < len(boards)]
    seen = np.array(
        [vector_from_rotation(boards[i][:3, :3] @ boards[j][:3, :3].T) for i, j in gaps]
    )
    moved = np.array([vector_from_rotation(links[i][:3, :3] @ links[j][:3, :3].T) for i, j in gaps])
    turn = nearest_rotation(seen.T @ moved)
    turns = [(turn @ a[:3, :3]).T @ p[:3, :3] for a, p in zip(links, boards, strict=True)]
    board = nearest_rotation(np.sum(turns, axis=0))
    rows = np.concatenate([np.hstack([turn @ a[:3, :3], np.eye(3)]) for a in links])
    right = np.concatenate([p[:3, 3] - turn @ a[:3, 3] for a, p in zip(links, boards, strict=True)])
    places = np.linalg.lstsq(rows, right, rcond=None)[0]
    return make_transform(turn, places[3:]), make_transform(board, places[:3])


def _anchor_camera(rig: Rig, index: int, pose: Array) -> Rig:
    def moved(camera: RigCamera) -> RigCamera:
        return replace(camera, anchor=pose)

    return replace(
        rig, cameras=tuple(moved(c) if n == index else c for n, c in enumerate(rig.cameras))
    )
