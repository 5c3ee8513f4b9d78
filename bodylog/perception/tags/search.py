"""Tags of one dictionary in an image: quads are found, refined to their edges and read."""

from typing import NamedTuple

import numpy as np

from ...types import Array
from . import codes, edges, quads
from .codes import Codes
from .edges import Refined

_SHORTEST = 8.0
"""px: sides of the smallest tag searched for."""
_HALF = 7.0
"""px: the same in the image at half size."""
_BORDER = 0.65
"""Share of the border's cells that must be dark: OpenCV's 1 - maxErroneousBitsInBorderRate."""
_SIMILAR = 0.6
"""Least correlation of bits and pattern, -1..1; of two
patterns 3 of 16 bits apart the wrong one reaches 0.63.
"""
_LIKELY = 0.5
"""The same before a quad is refined to its edges."""


class Tags(NamedTuple):
    """M tags: numbers (M,) · corners (M,4,2) px, as printed
    from top left clockwise · centres (M,2) px · score (M,).

    corner_cov (M,4,2,2) and centre_cov (M,2,2) px²; the
    score is the correlation with the pattern, -1..1.
    """

    number: Array
    quads: Array
    centres: Array
    corner_cov: Array
    centre_cov: Array
    score: Array

    def chosen(self, rows: Array) -> "Tags":
        """The tags of these rows."""
        return Tags(*(column[rows] for column in self))


def search_whole_image(gray: Array, known: Codes, only: Array | None = None) -> Tags:
    """Tags anywhere in the image (H,W) uint8: at half
    size first, then at full size those not found yet.
    """
    found = verify_quads(gray, _at_half_size(gray), known, only)
    if only is not None and np.isin(only, found.number).all():
        return found
    return _distinct_tags(
        join_tags(found, verify_quads(gray, quads.find_quads(gray, _SHORTEST), known, only))
    )


def find_candidate_quads(gray: Array) -> Array:
    """Quads (M,4,2) px that may be tags, clockwise, found at half and at full size."""
    return np.concatenate([_at_half_size(gray), quads.find_quads(gray, _SHORTEST)])


def _at_half_size(gray: Array) -> Array:
    import cv2

    if min(gray.shape) < 2:
        return np.empty((0, 4, 2))
    small = cv2.resize(gray, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return 2 * quads.find_quads(small, _HALF) + 0.5


def search_window(gray: Array, middle: Array, reach: float, known: Codes, only: Array) -> Tags:
    """Tags within `reach` px of a place (2,)."""
    height, width = gray.shape
    first = np.clip(np.floor(middle - reach), 0, (width, height)).astype(int)
    last = np.clip(np.ceil(middle + reach), 0, (width, height)).astype(int)
    part = gray[first[1] : last[1], first[0] : last[0]]
    return verify_quads(gray, quads.find_quads(part, _SHORTEST) + first, known, only)


def verify_quads(gray: Array, found: Array, known: Codes, only: Array | None = None) -> Tags:
    """The tags among quads (M,4,2) px, clockwise from
    any corner, that lie within some px of their edges.
    """
    found = _likely_quads(gray, found, known, only)
    return (
        recognise_tags(gray, refine_candidates(gray, found, known.side), known, only)
        if len(found)
        else no_tags()
    )


def refine_candidates(gray: Array, found: Array, side: int) -> Refined:
    """Refine quads (M,4,2) px of tags of side² bits to
    their edges; those without four edges are left out.
    """
    shortest = np.linalg.norm(found - np.roll(found, -1, axis=1), axis=2).min(axis=1)
    moved = edges.refine_quads(gray, found, shortest / (side + 2))
    sound = moved.sides.all(axis=1) & np.isfinite(moved.quads).all(axis=(1, 2))
    sound &= np.linalg.norm(moved.quads - found, axis=2).max(axis=1) < 2 * shortest
    return Refined(*(column[sound] for column in moved))


def recognise_tags(gray: Array, found: Refined, known: Codes, only: Array | None = None) -> Tags:
    """The tags among refined quads, each number once."""
    bits, border = quads.sample_cells(gray, found.quads, known.side)
    rows = np.flatnonzero(np.isfinite(bits).all(axis=1))
    if not rows.size:
        return no_tags()
    seen = codes.decode_cells(bits[rows], known, only)
    middle = (bits[rows].max(axis=1) + bits[rows].min(axis=1)) / 2
    dark = (border[rows] < middle[:, None]).mean(axis=1)
    good = (seen.wrong <= known.correctable) & (dark >= _BORDER) & (seen.score >= _SIMILAR)
    rows = rows[good]
    tag = seen.tag[good]
    turn = seen.turn[good]
    score = seen.score[good]
    order = (np.arange(4) - turn[:, None]) % 4
    corners = np.take_along_axis(found.quads[rows], order[..., None], 1)
    cov = np.take_along_axis(found.corner_cov[rows], order[..., None, None], 1)
    return _distinct_tags(
        Tags(tag, corners, quads.centres_of_quads(corners), cov, found.centre_cov[rows], score)
    )


def _likely_quads(gray: Array, found: Array, known: Codes, only: Array | None) -> Array:
    """Quads (M,4,2) px whose cells resemble a tag before refinement, which costs ten times more."""
    if not len(found):
        return found
    bits, border = quads.sample_cells(gray, found, known.side, fine=False)
    rows = np.flatnonzero(np.isfinite(bits).all(axis=1) & (border.mean(axis=1) < bits.max(axis=1)))
    return found[rows[codes.decode_cells(bits[rows], known, only).score >= _LIKELY]]


def no_tags() -> Tags:
    """No tags."""
    empty = np.empty
    return Tags(
        np.empty(0, int),
        empty((0, 4, 2)),
        empty((0, 2)),
        empty((0, 4, 2, 2)),
        empty((0, 2, 2)),
        empty(0),
    )


def join_tags(first: Tags, second: Tags) -> Tags:
    """The tags of both."""
    return Tags(*(np.concatenate(both) for both in zip(first, second, strict=True)))


def _distinct_tags(found: Tags) -> Tags:
    """Each number once: the one most similar to its pattern."""
    best: dict[int, int] = {}
    for row in np.argsort(-found.score, kind="stable").tolist():
        best.setdefault(int(found.number[row]), row)
    return found.chosen(np.array(sorted(best.values()), int))
