"""Tracks in view over time.

White acceleration fits no motion at all time scales, and the images
determine the time scale: where fewer tracks than usual are in view,
the process variance is the one that these tracks alone would give.
"""

from collections.abc import Sequence

import numpy as np

from ...types import Array
from ..measurements.long_arrays import find_finite_rows as seen_rows
from ..measurements.long_arrays import median_step
from ..measurements.records import Sighting

GAP_STEPS = 10
"""Usual steps after which there is a gap: an unseen track
is out of view, a filter of encoder readings restarts.
"""

View = tuple[str, ...]


def select_visual_sightings(sightings: Sequence[Sighting]) -> list[Sighting]:
    """Sightings of tracks seen at least once, without touch."""
    return [s for s in sightings if s.name != "touch" and seen_rows(s.values).any()]


def list_track_sets(sightings: Sequence[Sighting], t: Array) -> tuple[list[View], Array]:
    """The distinct sets of tracks in view at the times t (E,) s, and the index (E,) of the set."""
    tracks = select_visual_sightings(sightings)
    code = np.zeros(len(t), int)
    for bit, track in enumerate(tracks):
        code |= _is_in_view(track, t).astype(int) << bit
    if (code == code[0]).all():
        found = code[:1]
        which = np.zeros(len(t), int)
    else:
        found, which = np.unique(code, return_inverse=True)
    return [tuple(s.name for bit, s in enumerate(tracks) if one >> bit & 1) for one in found], which


def _is_in_view(track: Sighting, t: Array) -> Array:
    """Whether a track is in view at times t (E,), with sightings shortly before and after."""
    seen = track.t[seen_rows(track.values)]
    around = np.concatenate([[min(t[0], seen[0])], seen, [max(t[-1], seen[-1])]])
    quick = (
        np.diff(around) <= GAP_STEPS * median_step(track.t)
        if len(track.t) > 1
        else np.zeros(2, bool)
    )
    return np.ones(len(t), bool) if quick.all() else quick[np.searchsorted(seen, t)]
