"""Learn touch: the constants of g_t, and the positions
of skin cells relative to the effector (paper, tactile).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...body_model import TouchConstants
from ...types import Array, Features, Finding
from ..gp.model import GP

_APART_PX = 12.0
_NEAR_S = 0.5
_ASSUMED = 5
_STRAY = 16.0

Cells = Mapping[int, tuple[float, float, float]]


@dataclass(frozen=True, eq=False)
class Felt:
    """A touch with a synchronous stroke: its strongest cell
    · hand minus predicted effector (K,2) px during it.
    """

    cell: int
    apart: Array

    @property
    def square(self) -> float:
        """Mean square distance per coordinate, px²."""
        return float(np.square(self.apart).mean())


def learn_touch(
    features: Sequence[Features], joints: tuple[str, ...], effector: GP | None
) -> tuple[TouchConstants, Cells, tuple[Finding, ...]]:
    """Constants and cells' positions from touches paired
    with strokes, and a remark with their numbers.

    Both forms share the constants: a1 = 1, so that g_t is 1 at its peak, and b1 = 1/(2 variance) of
    the distance, whose prior is 12 px with the weight of five touches. f_t has one constant, B2 of
    perception/touch/matching: the delays of one log show how it was recorded, not which delays
    still count as synchronous.
    """
    delays = np.array([s.delay for f in features for s in f.synchrony if np.isfinite(s.delay)])
    delays = delays[np.abs(delays) < _NEAR_S]
    felt = (
        []
        if effector is None
        else [one for f in features for one in _touches_with_strokes(f, joints, effector)]
    )
    late = float(1.4826 * np.median(np.abs(delays))) if len(delays) else 0.0
    sound = _drop_stray_touches(felt)
    px = _pool_spread(
        _APART_PX, len(sound), float(np.sqrt(np.mean([f.square for f in sound]))) if sound else 0.0
    )
    constants = TouchConstants(1.0, 1.0 / (2.0 * px**2))
    found = locate_cells(sound)
    return constants, found, _touch_findings(len(delays), len(sound), late, px, len(found))


def locate_cells(felt: Sequence[Felt]) -> Cells:
    """Each touched cell's position relative to the
    effector (u, v) px and its spread per coordinate, px.

    The mean over all touches counts as one more touch
    of every cell, which regularises cells touched once.
    """
    if not felt:
        return {}
    centres = np.array([f.apart.mean(axis=0) for f in felt])
    common = centres.mean(axis=0)
    about = float(np.mean([np.square(f.apart - common).mean() for f in felt]))
    return {
        cell: _place_of_cell([f for f in felt if f.cell == cell], common, about)
        for cell in sorted({f.cell for f in felt})
    }


def _place_of_cell(felt: Sequence[Felt], common: Array, about: float) -> tuple[float, float, float]:
    place = (common + sum(f.apart.mean(axis=0) for f in felt)) / (1 + len(felt))
    square = (about + sum(np.square(f.apart - place).mean() for f in felt)) / (1 + len(felt))
    return float(place[0]), float(place[1]), float(np.sqrt(square))


def _touches_with_strokes(features: Features, joints: tuple[str, ...], effector: GP) -> list[Felt]:
    """Touches with a stroke in time, while hand and angles are known."""
    hand = features.hand
    angles_read = features.joints
    if (
        hand is None
        or angles_read is None
        or not features.touches
        or not set(joints) <= set(angles_read.names)
    ):
        return []
    rows = np.flatnonzero(np.isfinite(hand.values).all(axis=1))
    t = hand.t[rows]
    columns = (angles_read.values[:, angles_read.names.index(name)] for name in joints)
    angles = np.column_stack([np.interp(t, angles_read.t, column) for column in columns])
    inside = (t >= angles_read.t[0]) & (t <= angles_read.t[-1]) & np.isfinite(angles).all(axis=1)
    t = t[inside]
    apart = (hand.values[rows] - effector.means(angles)[0])[inside]
    timely = {s.touch for s in features.synchrony if abs(s.delay) < _NEAR_S}
    touches = [features.touches[index] for index in sorted(timely)]
    found = [
        Felt(touch.strongest, apart[(t >= touch.onset) & (t <= touch.offset)]) for touch in touches
    ]
    return [one for one in found if len(one.apart)]


def _drop_stray_touches(felt: Sequence[Felt]) -> list[Felt]:
    """Drop stray touches, seen four times farther off than the median."""
    usual = float(np.median([f.square for f in felt])) if felt else 0.0
    return [f for f in felt if f.square <= _STRAY * usual]


def _pool_spread(assumed: float, count: int, found: float) -> float:
    """Spread about zero per coordinate: the prior and `count` touches pooled."""
    return float(np.sqrt((_ASSUMED * assumed**2 + count * found**2) / (_ASSUMED + count)))


def _touch_findings(
    delays: int, touches: int, late: float, px: float, places: int
) -> tuple[Finding, ...]:
    if max(delays, touches) == 0:
        return ()
    seen = f"{touches} touches seen, spread {px:.1f} px; place of {places} cells"
    return (Finding("info", f"touch: {delays} delays, spread {late:.3f} s; {seen}"),)
