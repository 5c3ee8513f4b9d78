"""Whether a camera stands where it stood in other
episodes, by the part of its picture that does not move.
"""

import base64
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..types import Array
from .siblings import Outlier, Step, find_outliers, find_step

QUALITY = 92
"""JPEG quality of a view: blocks below that shift corners by less than a tenth of a pixel."""
MOST_CORNERS = 400
LEAST_AGREEING = 25
"""Fewest corners that agree on one move of the picture."""
AGREEING_SHARE = 0.4
"""Share of the corners found again that agree: an arm's pictures and moved things do not."""
AGREEMENT_PX = 0.7
RETURN_PX = 0.5
"""Distance by which a corner tracked there and back may miss its place."""
RESOLUTION_PX = 0.3
"""Least spread between episodes that is believed, px of a view: lights, codecs, a swaying stand."""
_LOCAL_PX = 9.0
"""Scale over which a view's brightness and contrast are made equal."""
_REFERENCES = 3
"""Episodes that are tried as the one that others are compared with."""

Evidence = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Views:
    """A camera's views beside that of one episode.

    moves (N,4) px of the stored image, NaN where the picture's resting part does not agree: to the
    right, downwards, by a turn and by a change of scale at half a width from the centre · moved_px
    (N,): length of the move from where most episodes have it · px: size of a view's pixel in pixels
    of the image.
    """

    moves: Array
    moved_px: Array
    px: float


def picture_at_rest(pictures: Sequence[Array]) -> Array | None:
    """The median (H,W) uint8 of a film's pictures: things that move leave it; None without any."""
    if not pictures:
        return None
    return np.asarray(np.median(np.stack(pictures), axis=0)).astype(np.uint8)


def encode_view(picture: Array | None) -> str | None:
    """A picture (H,W) as JPEG in base64."""
    import cv2

    if picture is None:
        return None
    done = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1]
    return base64.b64encode(done.tobytes()).decode()


def compare_views(names: Sequence[str], evidence: Mapping[str, Evidence]) -> dict[str, Views]:
    """The views of each camera that stands still in most episodes, by its name."""
    cameras = sorted({camera for name in names for camera in evidence[name]["cameras"]})
    found = {}
    for camera in cameras:
        known = [evidence[name]["cameras"].get(camera, {}) for name in names]
        views = _compare_camera(known)
        if views is not None:
            found[camera] = views
    return found


def find_moved(views: Views, looks: int) -> tuple[list[Outlier], Step | None]:
    """Episodes whose view stands out, with the length of their move in px, and a lasting move.

    A lasting move is taken away before single episodes are compared with the others.
    """
    moves = views.moves.copy()
    resolution = RESOLUTION_PX * views.px
    steps = [find_step(column, resolution, looks) for column in moves.T]
    lasting = max(
        (step for step in steps if step is not None),
        key=lambda step: step.z / step.bound,
        default=None,
    )
    if lasting is not None:
        first = lasting.first
        change = np.nanmedian(moves[first:], axis=0) - np.nanmedian(moves[:first], axis=0)
        moves[first:] -= change
        lasting = Step(first, float(np.linalg.norm(change)), lasting.z, lasting.bound)
    strongest: dict[int, Outlier] = {}
    for column in moves.T:
        for one in find_outliers(column, np.zeros(len(column)), resolution, looks):
            if one.number not in strongest or one.z > strongest[one.number].z:
                strongest[one.number] = one
    length = np.linalg.norm(moves - np.nanmedian(moves, axis=0), axis=1)
    return [
        Outlier(one.number, float(length[one.number]), 0.0, one.spread, one.z, one.bound)
        for one in strongest.values()
    ], lasting


def _compare_camera(known: Sequence[Mapping[str, Any]]) -> Views | None:
    """The views of one camera; None where fewer than half agree with the best of some
    references."""
    pictures = [_decode_view(one.get("view")) for one in known]
    sizes = [None if one.get("size") is None else tuple(one["size"]) for one in known]
    usable = [k for k, picture in enumerate(pictures) if picture is not None]
    if len(usable) < 2:
        return None
    spread = np.linspace(0, len(usable) - 1, min(_REFERENCES, len(usable))).round().astype(int)
    best: Array | None = None
    for reference in dict.fromkeys(usable[k] for k in spread.tolist()):
        moves = np.full((len(known), 4), np.nan)
        for k in usable:
            if sizes[k] == sizes[reference]:
                moves[k] = _measure_move(pictures[reference], pictures[k])
        if best is None or np.isfinite(moves[:, 0]).sum() > np.isfinite(best[:, 0]).sum():
            best = moves
        if np.isfinite(best[:, 0]).sum() == len(usable):
            break
    assert best is not None
    if 2 * np.isfinite(best[:, 0]).sum() < len(usable) + 1:
        return None
    first = usable[0]
    size = sizes[first]
    picture = pictures[first]
    px = size[0] / picture.shape[1] if size is not None and picture is not None else 1.0
    best *= px
    moved = np.linalg.norm(best - np.nanmedian(best, axis=0), axis=1)
    return Views(best, moved, px)


def _decode_view(text: Any) -> Array | None:
    """A view with its brightness and contrast made equal everywhere, (H,W) uint8."""
    import cv2

    if not isinstance(text, str):
        return None
    try:
        data = base64.b64decode(text, validate=True)
    except ValueError:
        return None
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE) if data else None
    if image is None:
        return None
    grey = np.asarray(image, np.float32)
    level = cv2.GaussianBlur(grey, (0, 0), _LOCAL_PX)
    contrast = np.sqrt(cv2.GaussianBlur((grey - level) ** 2, (0, 0), _LOCAL_PX))
    return np.clip(128.0 + 40.0 * (grey - level) / (contrast + 4.0), 0, 255).astype(np.uint8)


def _measure_move(one: Array | None, other: Array | None) -> Array:
    """The move (4,) px of the resting part from one picture to another; NaN where corners do not
    agree."""
    import cv2

    unknown = np.full(4, np.nan)
    if one is None or other is None or one.shape != other.shape:
        return unknown
    corners = cv2.goodFeaturesToTrack(one, MOST_CORNERS, 0.01, 4.0)
    if corners is None or len(corners) < LEAST_AGREEING:
        return unknown
    begin = np.asarray(corners)
    guess = np.zeros_like(begin)
    window = (13, 13)
    there, seen, _ = map(
        np.asarray, cv2.calcOpticalFlowPyrLK(one, other, begin, guess.copy(), winSize=window)
    )
    back, returned, _ = map(
        np.asarray, cv2.calcOpticalFlowPyrLK(other, one, there, guess, winSize=window)
    )
    miss = np.linalg.norm((back - begin).reshape(-1, 2), axis=1)
    again = (seen.ravel() == 1) & (returned.ravel() == 1) & (miss < RETURN_PX)
    start = begin.reshape(-1, 2)[again]
    end = there.reshape(-1, 2)[again]
    if len(start) < LEAST_AGREEING:
        return unknown
    matrix, agree = cv2.estimateAffinePartial2D(
        start, end, method=cv2.RANSAC, ransacReprojThreshold=AGREEMENT_PX
    )
    if matrix is None or np.sum(agree) < max(LEAST_AGREEING, AGREEING_SHARE * len(start)):
        return unknown
    height, width = one.shape
    centre = np.array([0.5 * width, 0.5 * height])
    shift = matrix @ np.append(centre, 1.0) - centre
    turn = matrix[1, 0]
    scale = matrix[0, 0] - 1.0
    return np.array([*shift, 0.5 * width * turn, 0.5 * width * scale])


def moved_sentences(camera: str, step: Step | None, names: Sequence[str]) -> Iterator[str]:
    """What a lasting move says of the dataset."""
    if step is not None:
        where = f"from {names[step.first]} on"
        size = f"{step.size:.1f} px"
        yield f"{camera}: the camera moved by {size} {where}, by the scene that does not move"
