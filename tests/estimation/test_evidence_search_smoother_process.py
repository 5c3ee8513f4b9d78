"""A smoother's process variances: of least error, whatever moves the arm, and error bars that hold there."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import trapezoid

from bodylog.estimation import estimate_from_features
from bodylog.estimation.noise import evidence_search
from bodylog.settings import EstimationSettings
from tests.estimation import conftest
from tests.estimation.free_motion import white


def errors(drawn):
    """Root mean square error (rad) and squared error over stated variance of a smoother."""
    found = estimate_from_features(
        drawn.features, drawn.body, EstimationSettings(method="smoother")
    )
    apart = np.square(found.joints.values - drawn.truth.values)
    return np.sqrt(apart.mean()), (apart / np.einsum("nii->ni", found.cov)).mean()


@pytest.mark.parametrize("beyond", [0.0, 1.0, 2.0])
@pytest.mark.parametrize("order", [2, 3])
def test_the_move_at_the_least_error_follows_from_the_spectrum(order, beyond):
    u, power = np.exp(np.linspace(-10.0, 8.0, 100_001)), 2.0 * order + beyond

    def whole(y):
        return float(trapezoid(y * u, np.log(u)))

    passed, spectrum = 1.0 / (1.0 + u ** (2 * order)), u**-power
    noise, moved = whole(passed**2), np.square(passed * (1.0 - passed))
    strength = (evidence_search.compute_least_move(power, order) - 1.0) * whole(moved) / whole(moved * spectrum)
    motion = strength * whole((1.0 - passed) ** 2 * spectrum)
    assert noise == pytest.approx((1.0 - 0.5 / order) * whole(passed), rel=2e-3)
    assert motion == pytest.approx(noise / (power - 1.0), rel=2e-3)
    # how the sum changes with ln q
    assert noise / (2.0 * order) == pytest.approx(
        2.0 * strength * whole(passed * (1.0 - passed) ** 2 * spectrum), rel=2e-3
    )


@pytest.mark.parametrize(("moved", "gain"), [("sines", 0.95), ("white", 1.04)])
def test_smoother_process_beats_maximum_evidence_with_true_error_bars(
    world, monkeypatch, white_acceleration, moved, gain
):  # fmt: skip
    if moved == "white":
        monkeypatch.setattr(conftest, "motion", white)
    drawn = [world(seed, duration=30.0) for seed in range(4)]
    found = np.array([errors(one) for one in drawn])
    monkeypatch.setattr(
        evidence_search, "find_least_error_process", lambda part, solved: (part.precision.process, 1.0)
    )
    likeliest = np.array([errors(one) for one in drawn])
    assert np.mean(found[:, 0] / likeliest[:, 0]) < gain
    assert 0.8 < np.mean(found[:, 1]) < 1.2


def test_given_variances_are_used_unchanged(world, white_acceleration):
    drawn = world(0, duration=5.0)
    given = estimate_from_features(
        drawn.features, drawn.body, EstimationSettings(method="smoother", precision="model")
    )
    np.testing.assert_array_equal(given.settings["process"], [0.3] * 3)
    assert given.settings["stated"] == [1.0] * 3
    learned = estimate_from_features(
        drawn.features, drawn.body, EstimationSettings(method="smoother")
    )
    assert 0.75 <= min(learned.settings["stated"]) <= max(learned.settings["stated"]) < 0.9


@pytest.mark.parametrize(("count", "gap"), [(8, 5.0), (40, 1.0)])
def test_poses_that_are_seconds_apart_are_smoothed(world, count, gap):
    drawn = world(0, duration=2.0)
    t = gap * np.arange(count)
    poses = np.random.default_rng(0).uniform(-1.0, 1.0, (count, 3))
    joints = replace(drawn.features.joints, t=t, values=poses, source_ns=(1e9 * t).astype(np.int64))
    found = estimate_from_features(
        replace(drawn.features, joints=joints, tracks={}),
        drawn.body,
        EstimationSettings(method="smoother"),
    )
    assert np.isfinite(found.cov).all() and found.joints.values.shape == (count, 3)


def test_tuning_a_smoother_takes_little_memory_beyond_the_smoother(world, white_acceleration):
    drawn, peak = world(0, duration=60.0, encoder_hz=100.0), {}
    for precision in ("model", "auto"):
        tracemalloc.start()
        estimate_from_features(
            drawn.features, drawn.body, EstimationSettings(method="smoother", precision=precision)
        )
        peak[precision] = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    # 1.9 times; with all candidates side by side 3.9 times
    assert peak["auto"] < 2.5 * peak["model"]
