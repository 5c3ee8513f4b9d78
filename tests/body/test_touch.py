from dataclasses import replace

import numpy as np
import pytest

from bodylog.body.touch import learned
from bodylog.types import Features, Series, Synchrony, Touch


class _Still:
    outputs = ("u", "v")

    def predict(self, x):
        return np.tile([100.0, 80.0], (len(x), 1)), np.zeros((len(x), 2, x.shape[1])), np.zeros((len(x), 2))


def _features(seed: int, count: int, late: float, apart: float) -> Features:
    draw = np.random.default_rng(seed)
    t = np.arange(0.0, 2.0 * count + 2, 0.01)
    onset = 1.0 + 2.0 * np.arange(count)
    place = np.array([100.0, 80.0]) + draw.normal(0, apart, (count, 2))
    hand = np.repeat(place, 200, axis=0)
    hand = np.vstack([hand, np.full((len(t) - len(hand), 2), np.nan)])
    series = Series(t, hand, ("u", "v"), "px", np.arange(len(t)))
    joints = Series(t, np.zeros((len(t), 1)), ("pan",), "rad", np.arange(len(t)))
    touches = tuple(Touch(float(o), float(o) + 0.5, (1,), 1.0, 1, 0) for o in onset)
    synchrony = tuple(Synchrony(k, k, float(d), 1.0) for k, d in enumerate(draw.normal(0, late, count)))
    return Features(joints, {"hand": series}, touches, (), synchrony, {})


@pytest.mark.parametrize("seed", range(4))
def test_many_touches_give_back_their_own_spread(seed: int) -> None:
    constants, said = learned([_features(seed, 300, 0.03, 6.0)], ("pan",), _Still())
    assert constants.a1 == constants.a2 == 1.0
    assert np.sqrt(1 / (2 * constants.b2)) == pytest.approx(0.03, rel=0.15)
    assert np.sqrt(1 / (2 * constants.b1)) == pytest.approx(6.0, rel=0.15)
    assert "300 delays" in said[0].text


def test_few_touches_move_the_assumption_only_a_little() -> None:
    constants, _ = learned([_features(0, 3, 1e-4, 1e-3)], ("pan",), _Still())
    assert 0.03 < np.sqrt(1 / (2 * constants.b2)) < 0.05
    assert 8.0 < np.sqrt(1 / (2 * constants.b1)) < 12.0


def test_without_touches_the_illusion_fades_beyond_a_tenth_of_a_second() -> None:
    features = replace(_features(0, 1, 0.0, 0.0), touches=None, synchrony=())
    constants, said = learned([features], ("pan",), _Still())
    assert said == () and np.exp(-constants.b2 * 0.1**2) < 0.2 < np.exp(-constants.b2 * 0.05**2)


def test_pairs_half_a_second_apart_are_no_pairs() -> None:
    features = _features(0, 50, 0.02, 5.0)
    far = tuple(replace(s, delay=0.6) for s in features.synchrony)
    constants, _ = learned([replace(features, synchrony=far)], ("pan",), _Still())
    assert np.sqrt(1 / (2 * constants.b2)) == pytest.approx(0.05)
