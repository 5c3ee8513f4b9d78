"""Points given once: the patch around each is tracked,
always compared with the first, and found again.
"""

from collections.abc import Mapping

import numpy as np

from ...errors import EvidenceError, InputError
from ...sources import PointSource
from ...types import Array, Frames
from ..colours.coarse_search import convert_to_gray
from ..tracking.contract import HIDDEN, UNDECODABLE, Tracked
from . import patch
from .patch import Laid, Patch

_HALF = 1 / 50
"""Half a patch's side, in the image's width."""
_FOLLOWED = 0.8
_FOUND = 0.9
"""Least correlation of patch and image, where the patch is expected, and anywhere."""
_CANDIDATE = 0.6
_APART = 0.05
"""Least correlation of a candidate, and least lead
over the second best: else the two are ambiguous.
"""
_MARGIN = 12.0
_FARTHEST = 96.0
"""px searched around the expected place, in addition to twice the last motion; at most."""
_LATE = 1.0
"""s between `at` and the nearest frame, at most."""
_ANGLES = 12
RIVAL = "two candidates"


def track_points(
    frames: Frames, points: Mapping[str, PointSource], where: str = "image"
) -> list[Tracked]:
    """Track each point through all frames, which are read
    twice; EvidenceError where one cannot be tracked.
    """
    firsts = {
        name: _patch_about_point(frames, point, f"{where}: features.{name}")
        for name, point in points.items()
    }
    trackers = [PointTracker(name, *first) for name, first in firsts.items()]
    for frame in frames() if trackers else ():
        try:
            image = convert_to_gray(frame.decode(1))
        except InputError:
            image = None
        for tracker in trackers:
            tracker.add(image)
    return [tracker.tracked() for tracker in trackers]


class PointTracker:
    """Tracks one patch."""

    def __init__(self, name: str, first: Patch, uv: Array) -> None:
        """`uv` (2,) px is where the patch was cut out."""
        self._name = name
        self._patch = first
        self._shown: Laid = Laid(patch.map_at_place(uv), 1.0, np.eye(2))
        self._step: Array | None = None
        self._rows: list[Array] = []
        self._reasons: list[str] = []
        self._lost = 0

    def add(self, image: Array | None) -> None:
        """The next frame (H,W) uint8; None: undecodable."""
        laid, why = (None, UNDECODABLE) if image is None else self._seen(image)
        self._reasons.append(why)
        if laid is None:
            self._rows.append(np.full(4, np.nan))
            self._step = None
            return
        self._lost = 0
        self._step = laid.uv - self._shown.uv if self._step is not None else np.zeros(2)
        self._shown = laid
        self._rows.append(np.concatenate([laid.uv, np.sqrt(np.diag(laid.cov))]))

    def tracked(self) -> Tracked:
        """The point in all frames."""
        values = np.array(self._rows).reshape(-1, 1, 4)
        return Tracked((self._name,), values, np.array(self._reasons, dtype=object))

    def _seen(self, image: Array) -> tuple[Laid | None, str]:
        if self._step is not None and (laid := self._nearby(image, self._step)):
            return laid, ""
        return self._anywhere(image)

    def _nearby(self, image: Array, step: Array) -> Laid | None:
        """The patch about where it is expected."""
        reach = min(_MARGIN + 2 * float(np.linalg.norm(step)), _FARTHEST) + self._patch.half
        middle = self._shown.uv + step
        low = np.clip(np.floor(middle - reach), 0, None).astype(int)
        high = np.ceil(middle + reach).astype(int) + 1
        part = image[low[1] : high[1], low[0] : high[0]]
        places, _ = _best_matches(part, patch.draw_patch(self._patch, self._shown.map))
        return (
            self._fitted(image, places[0] + low, self._shown.map, _FOLLOWED)
            if len(places)
            else None
        )

    def _anywhere(self, image: Array) -> tuple[Laid | None, str]:
        """The patch in the whole image, searched at half size, as last seen and as first seen."""
        import cv2

        if min(image.shape) < 4 * self._patch.half:
            return None, HIDDEN
        small = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        for map_ in (self._shown.map, self._turned()):
            shown = cv2.resize(
                patch.draw_patch(self._patch, map_),
                None,
                fx=0.5,
                fy=0.5,
                interpolation=cv2.INTER_AREA,
            )
            places, correlation = _best_matches(small, np.asarray(shown))
            if len(places) and correlation[0] >= _CANDIDATE:
                fits = [self._fitted(image, 2 * place + 0.5, map_, _FOUND) for place in places]
                good = sorted((fit for fit in fits if fit), key=lambda fit: -fit.correlation)
                if (
                    len(good) > 1
                    and good[0].correlation - good[1].correlation < _APART
                    and np.linalg.norm(good[0].uv - good[1].uv) > 2
                ):
                    return None, RIVAL
                if good:
                    return good[0], ""
        return None, HIDDEN

    def _turned(self) -> Array:
        """The first patch turned, by a further angle in each frame searched."""
        angle = 2 * np.pi * self._lost / _ANGLES
        self._lost += 1
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        return np.column_stack([turn, self._shown.uv])

    def _fitted(self, image: Array, place: Array, map_: Array, least: float) -> Laid | None:
        laid = patch.align_patch(image, self._patch, np.column_stack([map_[:, :2], place]))
        near = laid is not None and np.linalg.norm(laid.uv - place) <= self._patch.half / 2
        return laid if laid is not None and near and laid.correlation >= least else None


def _best_matches(image: Array, shown: Array) -> tuple[Array, Array]:
    """The two best places (≤2,2) px of a patch, a patch apart, and their correlations (≤2,)."""
    import cv2

    height, width = shown.shape
    if image.shape[0] < height or image.shape[1] < width:
        return np.empty((0, 2)), np.empty(0)
    correlation = np.array(
        cv2.matchTemplate(np.ascontiguousarray(image), shown, cv2.TM_CCOEFF_NORMED)
    )
    places = []
    values = []
    for _ in range(2):
        v, u = np.unravel_index(np.argmax(correlation), correlation.shape)
        places.append((u + (width - 1) / 2, v + (height - 1) / 2))
        values.append(float(correlation[v, u]))
        correlation[
            max(0, v - height // 2) : v + height // 2 + 1,
            max(0, u - width // 2) : u + width // 2 + 1,
        ] = -1
    return np.array(places), np.array(values)


def _patch_about_point(frames: Frames, point: PointSource, key: str) -> tuple[Patch, Array]:
    """The patch about a point in the frame nearest its time."""
    frame = min(frames(), key=lambda frame: abs(frame.t - point.at), default=None)
    if frame is None or abs(frame.t - point.at) > _LATE:
        nearest = "the log has no image" if frame is None else f"the nearest is at {frame.t:.3f} s"
        raise EvidenceError(f"{key}.at is {point.at:g} s, but no image was taken then: {nearest}")
    image = convert_to_gray(frame.decode(1))
    uv = np.array(point.point)
    height, width = image.shape
    half = max(6, round(_HALF * width))
    found = patch.cut_patch(image, uv, half)
    if found is None:
        possible = f"{half} to {width - 1 - half}, {half} to {height - 1 - half} px"
        raise EvidenceError(f"{key}.point is {list(point.point)}; possible: {possible}")
    if found.edge < 1:
        raise EvidenceError(
            f"{key}.point is {list(point.point)}: too plain to follow; take a corner or a pattern"
        )
    return found, uv
