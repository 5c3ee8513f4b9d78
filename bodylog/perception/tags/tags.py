"""Tags tracked from frame to frame: at the expected place, around it, then in the whole image."""

from collections.abc import Mapping

import numpy as np

from ...sources import TagSource, track_names
from ...types import Array
from ..tracking.contract import HIDDEN, UNDECODABLE, Tracked, Tracker
from . import search
from .codes import load_codes

_ABOUT = 1.5
"""Search radius around a tag's expected place, in its longest sides."""
_FORGOTTEN = 3
"""Frames after which an unseen tag has no expected place."""


def tag_trackers(features: Mapping[str, TagSource]) -> list[Tracker]:
    """One per dictionary."""
    dictionaries = sorted({source.dictionary for source in features.values()})
    return [
        TagTracker({n: s for n, s in features.items() if s.dictionary == one})
        for one in dictionaries
    ]


class TagTracker:
    """Tracks the tags of one dictionary."""

    def __init__(self, features: Mapping[str, TagSource]) -> None:
        """Load no library before the first frame."""
        self._features = features
        self._wanted = np.unique([source.tag for source in features.values()])
        self._dictionary = next(iter(features.values())).dictionary
        self._last: dict[int, tuple[int, Array, Array]] = {}
        self._frames: list[search.Tags | None] = []

    def add(self, gray: Array | None) -> None:
        """The next frame (H,W) uint8; None: undecodable."""
        if gray is None:
            self._frames.append(None)
            return
        found = self._found(gray)
        for number, quad in zip(found.number.tolist(), found.quads, strict=True):
            before = self._last.get(number)
            step = (
                quad - before[1]
                if before and before[0] == len(self._frames) - 1
                else np.zeros((4, 2))
            )
            self._last[number] = len(self._frames), quad, step
        self._frames.append(found)

    def tracked(self) -> Tracked:
        """Centres, or corners, of all tags."""
        names = [
            name
            for feature, source in self._features.items()
            for name in track_names(feature, source)
        ]
        values = np.full((len(self._frames), len(names), 4), np.nan)
        reasons = np.array(
            [UNDECODABLE if found is None else HIDDEN for found in self._frames], dtype=object
        )
        at = {name: k for k, name in enumerate(names)}
        for row, found in enumerate(self._frames):
            if found is None:
                continue
            for feature, source in self._features.items():
                if (points := _points_of_tag(found, source)) is not None:
                    columns = [at[name] for name in track_names(feature, source)]
                    values[row, columns] = points
                    reasons[row] = ""
        return Tracked(tuple(names), values, reasons)

    def _found(self, gray: Array) -> search.Tags:
        known = load_codes(self._dictionary)
        found = search.no_tags()
        for expected in (self._followed, self._nearby):
            left = self._left(found)
            if left.size:
                found = search.join_tags(found, expected(gray, left))
        left = self._left(found)
        return (
            search.join_tags(found, search.search_whole_image(gray, known, left))
            if left.size
            else found
        )

    def _left(self, found: search.Tags) -> Array:
        return np.setdiff1d(self._wanted, found.number)

    def _followed(self, gray: Array, left: Array) -> search.Tags:
        """Tags whose edges are at their expected places."""
        quads = [quad for number in left.tolist() if (quad := self._expected(number)) is not None]
        return search.verify_quads(
            gray, np.array(quads).reshape(-1, 4, 2), load_codes(self._dictionary), left
        )

    def _nearby(self, gray: Array, left: Array) -> search.Tags:
        """Tags around their expected places."""
        found = search.no_tags()
        for number in left.tolist():
            if (quad := self._expected(number)) is not None:
                side = float(np.linalg.norm(quad - np.roll(quad, 1, axis=0), axis=1).max())
                one = np.array([number])
                about = search.search_window(
                    gray, quad.mean(axis=0), _ABOUT * side, load_codes(self._dictionary), one
                )
                found = search.join_tags(found, about)
        return found

    def _expected(self, number: int) -> Array | None:
        """Corners (4,2) px in the next frame, by their last
        motion; None where the tag was not seen lately.
        """
        if number not in self._last:
            return None
        seen, quad, step = self._last[number]
        ago = len(self._frames) - seen
        return quad + ago * step if ago <= _FORGOTTEN else None


def _points_of_tag(found: search.Tags, source: TagSource) -> Array | None:
    """u, v, std_u, std_v of a source's tracks: (K,4) px; None where its tag was not found."""
    rows = np.flatnonzero(found.number == source.tag)
    if not rows.size:
        return None
    row = rows[0]
    points = found.quads[row] if source.corners else found.centres[row][None]
    cov = found.corner_cov[row] if source.corners else found.centre_cov[row][None]
    return np.hstack([points, np.sqrt(np.diagonal(cov, axis1=1, axis2=2))])
