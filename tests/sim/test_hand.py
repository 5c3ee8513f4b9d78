import numpy as np
import pytest

from bodylog.sim import hand, skin
from bodylog.sim.plan import TRAVEL, Contact
from bodylog.sim.world import HAND_RADIUS

CONTACT = Contact(onset=2.0, length=0.9, delay=0.6, start=0.085, stop=0.02)


def test_picture_is_late_by_the_delay():
    t = np.arange(0.0037, 5.0, 0.01)
    np.testing.assert_allclose(
        hand.hand_path([CONTACT], 3, t + 0.6, seen=True), hand.hand_path([CONTACT], 3, t, seen=False), atol=1e-12
    )


def test_hand_is_away_except_around_the_contact():
    t = np.arange(0.0037, 5.0, 0.01)
    near = ~np.isnan(hand.hand_path([CONTACT], 3, t, seen=False)[:, 0])
    np.testing.assert_array_equal(near, (t > 2.0 - TRAVEL) & (t < 2.9 + TRAVEL))


def test_contact_begins_and_ends_with_a_turn():
    t = np.arange(1.3, 3.6, 0.01)
    speed = np.linalg.norm(np.gradient(hand.hand_path([CONTACT], 0, t, seen=False)[:, 1:], 0.01, axis=0), axis=1)
    contact = (t > 2.05) & (t < 2.85)
    travel = (t < 1.95) | (t > 2.95)
    assert speed[contact].max() < 0.5 * speed[travel].min()


def test_hand_never_enters_the_limb():
    t = np.arange(1.3, 3.6, 0.005)
    place = hand.hand_path([CONTACT], 5, t, seen=False)
    assert np.hypot(place[:, 0], place[:, 1]).min() > skin.RADIUS + HAND_RADIUS - 1e-6


@pytest.mark.parametrize("column", range(skin.COLUMNS))
def test_facing_column_is_the_one_that_looks_at_the_camera(column):
    centre = skin.cell_places()[column * skin.RINGS + 6]
    assert hand.column_facing_camera(centre * [1, 1, 0] * 30) == column
