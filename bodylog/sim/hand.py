"""The path of the experimenter's hand: it enters
the image, strokes the skin, and leaves another way.

Places are in the frame of the skin's link: z along the limb towards the end effector, the hand
above one column of cells, the one that faces the camera.
"""

from collections.abc import Sequence

import numpy as np

from ..types import Array
from .plan import TRAVEL, Contact
from .skin import COLUMNS, RADIUS, THRESHOLD_GAP
from .world import HAND_RADIUS

_FROM = np.array([-0.25, -0.45])
_TO = np.array([0.15, -0.50])
_HOVER = 0.12
_PRESS = 0.02
_ROUND = np.linspace(-0.03, 0.03, 7)


def column_facing_camera(view: Array) -> int:
    """The column of cells that faces a camera in direction `view` (3,) of the skin's frame."""
    angle = np.arctan2(view[1], view[0]) % (2 * np.pi)
    return int(np.rint(angle / (2 * np.pi) * COLUMNS)) % COLUMNS


def hand_path(contacts: Sequence[Contact], column: int, t: Array, seen: bool) -> Array:
    """The hand's centre (N,3) m at times t (N,) s, as felt
    or, if `seen`, as the image shows it; NaN when away.
    """
    place = np.full((len(t), 3), np.nan)
    for contact in contacts:
        since = t - contact.onset - (contact.delay if seen else 0.0)
        near = (since > -TRAVEL) & (since < contact.length + TRAVEL)
        if near.any():
            place[near] = _stroke_path(contact, column, since[near])
    return place


def _stroke_path(contact: Contact, column: int, since: Array) -> Array:
    """The centre (N,3) m at `since` (N,) s after contact began."""
    times = np.array([-TRAVEL, 0.0, contact.length, contact.length + TRAVEL])
    knots = np.array([_FROM, [0.0, contact.start], [0.0, contact.stop], _TO])
    moments = since[:, None] + _ROUND
    # The mean over a short symmetric window rounds the corners without moving them in time.
    side, along = (np.interp(moments, times, knots[:, axis]).mean(1) for axis in (0, 1))
    height = (
        RADIUS
        + HAND_RADIUS
        + _gap_of_hand_and_skin(since)
        + _gap_of_hand_and_skin(contact.length - since)
    )
    angle = 2 * np.pi * column / COLUMNS
    out = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-np.sin(angle), np.cos(angle)])
    return np.column_stack([height[:, None] * out + side[:, None] * across, along])


def _gap_of_hand_and_skin(since: Array) -> Array:
    """Distance of hand and skin (m): falls through the skin's threshold at 0 s, then to nothing."""
    return np.asarray(
        _HOVER * np.tanh(THRESHOLD_GAP * np.logaddexp(0.0, -since / _PRESS) / np.log(2.0) / _HOVER)
    )
