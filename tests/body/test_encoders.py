import numpy as np
import pytest

from bodylog.body.senses.encoder_function import Polynomial


@pytest.mark.parametrize("seed", range(3))
def test_slope_is_that_of_the_reading(seed: int) -> None:
    draw = np.random.default_rng(seed)
    encoders = Polynomial(("a", "b", "c"), draw.normal(size=(3, 4)))
    x, h = draw.uniform(-1, 1, (20, 3)), 1e-6
    value, slope, spread = encoders.predict(x)
    for m in range(3):
        step = h * np.eye(3)[m]
        apart = (encoders.predict(x + step)[0] - encoders.predict(x - step)[0]) / (2 * h)
        assert np.allclose(slope[:, :, m], apart, atol=1e-8)
    assert value.shape == spread.shape == (20, 3) and not spread.any()


def test_squares_and_straight_lines() -> None:
    encoders = Polynomial(("a", "b"), np.array([[0.0, 0.0, 1.0], [0.5, 2.0, 0.0]]))
    assert np.allclose(encoders.predict(np.array([[-3.0, 4.0]]))[0], [[9.0, 8.5]])
