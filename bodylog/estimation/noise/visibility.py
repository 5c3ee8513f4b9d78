"""Which tracks are in view when.

White acceleration fits no motion at all time scales, and pictures set how long these are: where fewer are in view than
usual, the arm moves with the process variance it would have if they were all there is.
"""

from collections.abc import Sequence

import numpy as np

from ...types import Array
from ..measurements.records import Sighting

LONG = 10
"""Usual steps after which a track that was not seen is out of view."""

View = tuple[str, ...]


def visual(sightings: Sequence[Sighting]) -> list[Sighting]:
    """Those that can be in view: what was seen at least once, but touch, which is felt now and then."""
    return [s for s in sightings if s.name != "touch" and np.isfinite(s.values).all(axis=1).any()]


def views(sightings: Sequence[Sighting], t: Array) -> tuple[list[View], Array]:
    """The tracks in view at the times t (E,) s, each set of them once, and which set it is (E,)."""
    tracks, code = visual(sightings), np.zeros(len(t), int)
    for bit, track in enumerate(tracks):
        code |= _in_view(track, t).astype(int) << bit
    if (code == code[0]).all():
        found, which = code[:1], np.zeros(len(t), int)
    else:
        found, which = np.unique(code, return_inverse=True)
    return [tuple(s.name for bit, s in enumerate(tracks) if one >> bit & 1) for one in found], which


def _in_view(track: Sighting, t: Array) -> Array:
    """Whether a track is in view at times t (E,), seen before and after in quick succession."""
    seen = track.t[np.isfinite(track.values).all(axis=1)]
    around = np.concatenate([[min(t[0], seen[0])], seen, [max(t[-1], seen[-1])]])
    quick = np.diff(around) <= LONG * float(np.median(np.diff(track.t))) if len(track.t) > 1 else np.zeros(2, bool)
    return np.ones(len(t), bool) if quick.all() else quick[np.searchsorted(seen, t)]
