import re
from dataclasses import replace

import numpy as np
import pytest

from bodylog.body.senses.touch import learn_touch
from bodylog.types import Features, Series, Synchrony, Touch


class _Still:
    outputs = ("u", "v")

    def predict(self, x):
        return *self.means(x), np.zeros((len(x), 2))

    def means(self, x):
        return np.tile([100.0, 80.0], (len(x), 1)), np.zeros((len(x), 2, x.shape[1]))


def _features(
    seed: int, count: int, late: float, apart: float, offsets: tuple[tuple[float, float], ...] = ((0.0, 0.0),)
) -> Features:
    """Touches 2 s apart of cells 1, 2, … in turn, each seen at its cell's offset from the effector."""
    draw = np.random.default_rng(seed)
    t = np.arange(0.0, 2.0 * count + 2, 0.01)
    onset = 1.0 + 2.0 * np.arange(count)
    cell = np.arange(count) % len(offsets)
    place = np.array([100.0, 80.0]) + np.array(offsets)[cell] + draw.normal(0, apart, (count, 2))
    hand = np.repeat(place, 200, axis=0)
    hand = np.vstack([hand, np.full((len(t) - len(hand), 2), np.nan)])
    series = Series(t, hand, ("u", "v"), "px", np.arange(len(t)))
    joints = Series(t, np.zeros((len(t), 1)), ("pan",), "rad", np.arange(len(t)))
    touches = tuple(Touch(float(o), float(o) + 0.5, (c,), 1.0, c, 0) for o, c in zip(onset, cell + 1, strict=True))
    synchrony = tuple(Synchrony(k, k, float(d), 1.0) for k, d in enumerate(draw.normal(0, late, count)))
    return Features(joints, {"hand": series}, touches, (), synchrony, {})


@pytest.mark.parametrize("seed", range(4))
def test_touch_spread_of_many_touches_is_their_own(seed: int) -> None:
    constants, _, findings = learn_touch([_features(seed, 300, 0.03, 6.0)], ("pan",), _Still())
    assert constants.a1 == 1.0
    assert np.sqrt(1 / (2 * constants.b1)) == pytest.approx(6.0, rel=0.15)
    printed = float(re.search(r"300 delays, spread ([\d.]+) s", findings[0].text)[1])
    assert printed == pytest.approx(0.03, rel=0.15)


def test_touch_learned_without_strokes_is_the_same() -> None:
    features = _features(0, 40, 0.03, 6.0)
    kept = replace(features, synchrony=tuple(replace(pair, stroke=None) for pair in features.synchrony))
    assert learn_touch([kept], ("pan",), _Still()) == learn_touch([features], ("pan",), _Still())


def test_touch_spread_of_few_touches_is_near_the_prior() -> None:
    constants, _, _ = learn_touch([_features(0, 3, 1e-4, 1e-3)], ("pan",), _Still())
    assert 8.0 < np.sqrt(1 / (2 * constants.b1)) < 12.0


def test_touch_spread_without_touches_is_the_prior() -> None:
    features = replace(_features(0, 1, 0.0, 0.0), touches=None, synchrony=())
    constants, _, findings = learn_touch([features], ("pan",), _Still())
    assert findings == () and np.sqrt(1 / (2 * constants.b1)) == pytest.approx(12.0)


@pytest.mark.parametrize("seed", range(4))
def test_touch_places_each_cell_beside_the_effector(seed: int) -> None:
    offsets = ((0.0, -15.0), (2.0, -40.0), (-8.0, 10.0))
    _, cells, findings = learn_touch([_features(seed, 90, 0.0, 3.0, offsets)], ("pan",), _Still())
    assert set(cells) == {1, 2, 3} and "place of 3 cells" in findings[0].text
    for cell, offset in enumerate(offsets, 1):
        u, v, spread = cells[cell]
        # thirty touches: the mean's error is 3/√30 px, and the weight of one touch pulls it to the common position
        assert np.hypot(u - offset[0], v - offset[1]) < 3.0
        assert 2.0 < spread < 5.5


def test_touch_spread_grows_with_strokes_along_the_limb() -> None:
    features = _features(0, 40, 0.0, 0.0)
    along = np.where(features.hand.t[:, None] % 2.0 > 0.99, 1.0, 0.0) * ((features.hand.t % 1.0) * 60.0)[:, None]
    hand = replace(features.hand, values=features.hand.values + along * [0.0, 1.0])
    seen = replace(features, tracks={"hand": hand})
    constants, cells, _ = learn_touch([seen], ("pan",), _Still())
    # from 0 to 30 px in one coordinate: mean square 300 px² there, 150 over both; the prior is five touches of 144 px²
    assert 1 / (2 * constants.b1) == pytest.approx(150.0, rel=0.1)
    assert cells[1][:2] == pytest.approx((0.0, 15.0), abs=0.5) and cells[1][2] == pytest.approx(np.sqrt(37.5), rel=0.1)


def test_late_or_distant_strokes_are_not_used() -> None:
    features = _features(0, 30, 0.0, 5.0)
    late = tuple(replace(s, delay=0.6) for s in features.synchrony)
    constants, cells, _ = learn_touch([replace(features, synchrony=late)], ("pan",), _Still())
    assert cells == {} and 1 / (2 * constants.b1) == pytest.approx(144.0)
    stray = features.hand.values + np.where(features.hand.t < 2.0, 150.0, 0.0)[:, None]
    seen = replace(features, tracks={"hand": replace(features.hand, values=stray)})
    constants, cells, _ = learn_touch([seen], ("pan",), _Still())
    assert np.sqrt(1 / (2 * constants.b1)) < 8.0 and np.hypot(*cells[1][:2]) < 3.0


def test_pairs_half_a_second_apart_are_no_pairs() -> None:
    features = _features(0, 50, 0.02, 5.0)
    far = tuple(replace(s, delay=0.6) for s in features.synchrony)
    _, cells, findings = learn_touch([replace(features, synchrony=far)], ("pan",), _Still())
    assert cells == {} and findings == ()
