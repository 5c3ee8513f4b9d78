import numpy as np
import pytest

from bodylog.body.data.angle_smoother import WhiteMotion
from bodylog.body.gp.fit import samples_without_noise, train_gp
from bodylog.body.noise_estimates import learn_noise, pool_noise
from bodylog.body_model import Noise


def test_pixel_variance_is_the_stated_one_plus_the_fits() -> None:
    draw = np.random.default_rng(0)
    x = draw.uniform(-1, 1, (200, 1))
    y = np.column_stack([50 * x[:, 0], 20 * x[:, 0]]) + draw.normal(0, 0.5, (200, 2))
    gp = train_gp(samples_without_noise(x, y), ("u", "v"), "px")
    motion = WhiteMotion(2, 0.3, 1e-4, 0.0, (0.05, 1e-6))
    noise = learn_noise([motion, motion], {"effector": gp}, {"effector": np.full((200, 2), 0.01)})
    assert noise.encoder == (1e-4, 1e-4) and noise.process == (0.3, 0.3)
    assert noise.senses["effector"] == pytest.approx(gp.noise + 0.01)
    assert noise.std_error["effector"] == pytest.approx((gp.noise + 0.01) * 0.1)
    assert noise.std_error["process"] == (0.05, 0.05) and noise.std_error["encoder"] == (1e-6, 1e-6)


def test_variances_of_perfect_sensors_stay_positive_and_finite() -> None:
    draw = np.random.default_rng(0)
    x = draw.uniform(-1, 1, (30, 1))
    gp = train_gp(samples_without_noise(x, np.hstack([x, x])), ("u", "v"), "px")
    still = WhiteMotion(2, 0.0, 0.0, 0.0, (float("inf"), 0.0))
    noise = learn_noise([still], {"effector": gp}, {"effector": np.zeros((30, 2))})
    values = [*noise.encoder, *noise.process, *noise.senses["effector"], *noise.std_error["process"]]
    assert all(0 < v < np.inf for v in values)


def test_variances_of_two_logs_are_weighed_by_their_readings() -> None:
    explored = Noise((1e-4,), {"effector": (0.01, 0.02)}, (0.3,), _errors((1e-6,), (0.02,), (0.001, 0.001)))
    still = Noise((2e-4,), {"effector": (0.04, 0.04)}, (1e-9,), _errors((2e-6,), (1e9,), (0.004, 0.004)))
    both = pool_noise(still, explored)
    # both have equally many encoder readings, so the arm was still for half of the time
    assert both.process == pytest.approx((0.15,)) and both.std_error["process"] == pytest.approx((0.01,))
    assert both.encoder == pytest.approx((1.5e-4,)) and both.std_error["encoder"][0] < 1.5e-6
    assert both.senses["effector"] == pytest.approx(((0.01 + 0.04) / 2, (400 * 0.02 + 100 * 0.04) / 500))


def test_variances_of_one_log_alone_are_kept() -> None:
    new, old = Noise((1e-4,), {}, (0.3,), {}), Noise((2e-4,), {"effector": (0.1, 0.1)}, (0.1,), {})
    both = pool_noise(new, old)
    assert (both.encoder, both.process, both.senses) == ((1e-4,), (0.3,), {"effector": (0.1, 0.1)})


def _errors(encoder: tuple[float, ...], process: tuple[float, ...], effector: tuple[float, ...]) -> dict:
    return {"encoder": encoder, "process": process, "effector": effector}
