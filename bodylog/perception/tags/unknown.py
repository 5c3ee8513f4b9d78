"""Find tags of unknown number and dictionary in a few images."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...sources import TagSource
from ...types import Array
from ..colours.coarse_search import convert_to_gray
from . import search
from .codes import load_codes

COMMON = (
    "apriltag_36h11",
    "mip_36h12",
    "6x6_250",
    "aruco_original",
    "apriltag_25h9",
    "5x5_100",
    "7x7_100",
    "4x4_100",
)
"""Dictionaries searched for: the common ones of printed tags, the most distinct patterns first."""
_CLEAR = 0.8
"""Least correlation of a tag and its pattern, -1..1, of tags that no setting names."""
_SIDE = 6
"""Bits along a side, for the least distance of other
edges: those of the common dictionaries have 4 to 7.
"""
_TWICE = 2
"""Images that must show a tag, where there are more: chance patterns do not repeat."""


class FoundTag(NamedTuple):
    """A tag: its source · number of images that show it
    · its centre in each, (I,2) px, NaN where not seen.
    """

    source: TagSource
    seen: int
    uv: Array


def find_unknown_tags(
    images: Sequence[Array], dictionaries: Sequence[str] = COMMON
) -> list[FoundTag]:
    """The tags in images (H,W,3) BGR, those seen most often
    first; a quad is read as one dictionary's tag alone.
    """
    where: dict[tuple[str, int], Array] = {}
    for row, image in enumerate(images):
        for name, tags in tags_by_dictionary(convert_to_gray(image), dictionaries).items():
            for number, centre in zip(tags.number.tolist(), tags.centres, strict=True):
                where.setdefault((name, number), np.full((len(images), 2), np.nan))[row] = centre
    found = [
        FoundTag(TagSource(n, d), int(np.isfinite(uv[:, 0]).sum()), uv)
        for (d, n), uv in where.items()
    ]
    least = min(_TWICE, len(images))
    return sorted(
        (one for one in found if one.seen >= least), key=lambda one: (-one.seen, one.source.tag)
    )


def tags_by_dictionary(image: Array, dictionaries: Sequence[str]) -> dict[str, search.Tags]:
    """The tags in one image (H,W) uint8, by dictionary."""
    candidates = search.refine_candidates(image, search.find_candidate_quads(image), _SIDE)
    taken = np.empty((0, 2))
    found = {}
    for name in dictionaries:
        tags = search.recognise_tags(image, candidates, load_codes(name))
        far = np.linalg.norm(tags.centres[:, None] - taken, axis=2).min(axis=1, initial=np.inf) > 2
        found[name] = tags.chosen(np.flatnonzero(far & (tags.score >= _CLEAR)))
        taken = np.concatenate([taken, found[name].centres])
    return found
