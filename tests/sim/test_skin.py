import numpy as np
import pytest

from bodylog.sim import hand, skin
from bodylog.sim.plan import Contact
from bodylog.sim.world import HAND_RADIUS

CONTACT = Contact(onset=2.0, length=0.9, delay=0.6, start=0.085, stop=0.02)
BASE = skin.rest_readings(np.random.default_rng(0))


def signal(t):
    return skin.proximity_readings(hand.hand_path([CONTACT], 3, t, seen=False), HAND_RADIUS, BASE)


def test_skin_has_117_cells_on_the_limb():
    places = skin.cell_places()
    assert places.shape == (117, 3)
    np.testing.assert_allclose(np.hypot(places[:, 0], places[:, 1]), skin.RADIUS)
    assert len(np.unique(places.round(6), axis=0)) == 117


def test_touch_lasts_as_long_as_the_contact():
    t = np.arange(1.0, 4.0, 1e-3)
    onset, offset = skin.threshold_crossings(t, signal(t))
    assert onset == pytest.approx(2.0, abs=0.004)
    assert offset == pytest.approx(2.9, abs=0.004)


def test_crossings_interpolate():
    t = np.array([0.0, 1.0, 2.0, 3.0, 4.0])
    values = np.array([[0.1], [0.6], [0.8], [0.9], [0.5]])
    onset, offset = skin.threshold_crossings(t, values)
    assert onset == pytest.approx(1.5)
    assert offset == pytest.approx(3.5)


def test_patch_of_neighbours_rises_smoothly():
    t = np.arange(1.8, 3.1, 0.01)
    values = signal(t)
    touched = np.flatnonzero(values.max(0) > 0.7)
    np.testing.assert_array_equal(touched, np.arange(touched[0], touched[-1] + 1))
    assert len(touched) >= 3 and set(touched // skin.RINGS) == {3}
    assert np.abs(np.diff(values.max(1))).max() < 0.4
    assert values.min() >= BASE.min() and values.max() < 1


def test_untouched_skin_reads_its_rest_and_noise():
    away = np.full((500, 3), np.nan)
    np.testing.assert_array_equal(skin.proximity_readings(away, HAND_RADIUS, BASE), np.tile(BASE, (500, 1)))
    data = skin.add_skin_noise(np.tile(BASE, (500, 1)), np.random.default_rng(1))
    assert data.dtype == np.float32 and data.min() > 0 and data.max() < 0.2
