import numpy as np
import pytest

from bodylog.body.senses import encoder_calibration
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


def test_error_of_a_curve_is_not_rounding_far_from_zero() -> None:
    draw = np.random.default_rng(5)
    x = np.sort(draw.uniform(-1.0, 1.0, 2_000))
    y = 1e4 + x + draw.normal(0.0, 1e-5, len(x))  # an encoder that has counted turns
    _, error, _ = encoder_calibration._fit_polynomial(x, y, np.arange(len(x)) % 10)
    assert error == pytest.approx(1e-10, rel=0.1)


def test_a_joint_that_moves_in_one_part_of_the_log_has_a_curve() -> None:
    x = np.zeros(2_000)
    x[:200] = np.linspace(-1.0, 1.0, 200)
    curve, error, _ = encoder_calibration._fit_polynomial(x, x, np.repeat(np.arange(10), 200))
    assert np.isfinite(curve).all()
    assert np.isfinite(error)
