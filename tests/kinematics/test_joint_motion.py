"""Joint angles as curves: what smoothing leaves of the encoders' noise."""

import numpy as np
import pytest

from bodylog.body.data import angle_smoother
from bodylog.kinematics.joint_motion import curve_error


@pytest.mark.parametrize("rate_hz", [50.0, 100.0])
def test_error_of_a_curve_is_the_smoother_s_own(rate_hz):
    t = np.arange(0.0, 12.0, 1.0 / rate_hz)
    rng = np.random.default_rng(3)
    noise = 0.02
    readings = 0.3 * np.sin(1.1 * t) + 0.1 * np.sin(2.3 * t) + noise * rng.standard_normal(len(t))
    signal = angle_smoother.build_reading_chain(t, readings)
    motion = angle_smoother.fit_white_motion([signal], 3, with_errors=False)
    error = curve_error(*np.array([[motion.encoder], [motion.process], [1.0 / rate_hz]]))
    middle = np.arange(5.0, 7.0, 0.02)
    variance = angle_smoother.smooth_angles(signal, motion, middle)[1]
    assert error.std[0] ** 2 == pytest.approx(variance.mean(), rel=0.02)
    later, earlier, value = angle_smoother.covariance_between_times(signal, motion, middle)
    expected = error.std[0] ** 2 * error.correlation(0, middle[later] - middle[earlier])
    np.testing.assert_allclose(value, expected, atol=0.02 * variance.mean())
