"""Frames that err alike: how many count as one, the same one by one as all at once, and error bars that hold."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from bodylog.estimation import estimate_from_features
from bodylog.estimation.noise import correlated_noise as alike
from bodylog.settings import EstimationSettings
from bodylog.types import Series
from tests.estimation.conftest import Arm

PROCESS = np.array([0.02, 0.03, 0.04])


@dataclass(frozen=True)
class Local(Arm):
    """An arm whose model errs alike within some angle only."""

    blur: float = 0.002
    reach: float = 0.1


class Turned(Arm):
    """The same arm, its pan and lift taken for each other."""

    def place(self, x):
        return super().place(x[..., [1, 0, 2]])


def passed(world, seed, speed):
    """Times (F,), places (F,2), angles (F,3), Jacobians, pixel and model variances of a pass before the camera."""
    drawn = world(seed, duration=6.0, speed=speed, camera_hz=30.0)
    track, model = drawn.features.tracks["effector"], drawn.body.senses["effector"]
    points = np.column_stack([np.interp(track.t, drawn.truth.t, column) for column in drawn.truth.values.T])
    pixel = np.random.default_rng(seed).uniform(0.001, 0.004, (len(track.t), 2))
    return track.t, track.values, points, model.predict(points)[1], pixel, np.full_like(pixel, 0.002)


def test_counts_are_the_recursion():
    kept = np.random.default_rng(0).uniform(0.0, 1.0, 300)
    expected = [1.0]
    for share in kept:
        expected.append(1.0 + share * expected[-1])
    np.testing.assert_allclose(alike.count_effective_frames(kept), expected, rtol=1e-12)


@pytest.mark.parametrize("speed", [0.0, 0.02, 0.5])
@pytest.mark.parametrize("near", [0.0, alike.PIXEL_CORRELATION_PX])
@pytest.mark.parametrize("whole", [False, True])
def test_frame_variances_one_by_one_equal_the_batch(world, speed, near, whole):
    like, seen = alike.ErrorCorrelation(PROCESS, alike.read_correlation_length(Local()), near, whole), passed(world, 1, speed)
    together = alike.inflate_variances(like, *seen)
    memory, single, (t, places, points, _, pixel, _) = alike.LastFrame(), [], seen
    for k, now in enumerate(t):
        sight = alike.PendingFrame(Local(), float(now), places[k], pixel[k], like, memory)
        _, _, _, var, memory = sight.predict_inflated(points[k])
        single.append(var)
    np.testing.assert_allclose(together, single, rtol=1e-9)


def test_frame_variances_of_a_moving_arm_are_uncorrelated(world):
    seen = passed(world, 2, 1.5)
    for whole in (False, True):
        found = alike.inflate_variances(alike.ErrorCorrelation(PROCESS, np.array(0.002), alike.PIXEL_CORRELATION_PX, whole), *seen)
        assert np.all(alike.ErrorCorrelation(PROCESS, np.array(0.1), 0.0, whole).correlate_place_steps(np.zeros((3, 2))) == 0.0)
        assert np.median(found / (seen[-2] + seen[-1])) == pytest.approx(1.0, abs=0.01)


def test_error_correlation_of_a_lasting_error_equals_linear_interpolation():
    x = np.linspace(0.0, 1.0, 100_001)
    like = alike.ErrorCorrelation(PROCESS, np.array(0.1), 0.0, True)
    for correlation in (0.0, 0.4, 1.0):
        lasting = (x**2 + (1 - x) ** 2 + 2.0 * correlation * x * (1 - x)).mean()
        assert like.compute_variance_factor(1.0, correlation) == pytest.approx(lasting / (x**2 + (1 - x) ** 2).mean(), rel=1e-4)


def test_lasting_errors_count_less_than_independent_ones_in_a_filter():
    like = alike.ErrorCorrelation(PROCESS, np.array(0.1), 0.0)
    # extrapolated from two frames alone
    assert 1.0 - 5.0 / 8.0 < like.compute_variance_factor(1.0, 1.0) < 1.0


@pytest.mark.parametrize(("whole", "steady"), [(False, np.sqrt(2.0)), (True, np.sqrt(0.125))])
def test_frame_variances_of_constant_frames_keep_the_common_error(whole, steady):
    dt, error, jac, many = 1e-3, 0.002, np.eye(3)[:2], 10_000
    like = alike.ErrorCorrelation(np.full(3, 0.02), np.array(0.1), 0.0, whole)
    t, still, models = dt * np.arange(many), np.zeros((many, 3)), np.full((many, 2), error)
    found = alike.inflate_variances(like, t, still[:, :2], still, np.tile(jac, (many, 1, 1)), 0.0 * models, models)
    assert steady * (found[-1] * dt) ** 0.75 * 0.02**0.25 == pytest.approx(np.full(2, error), rel=0.01)


def test_independent_errors_do_not_extend_the_correlation(world):
    t, places, points, jac, pixel, model = passed(world, 3, 0.02)
    like = alike.ErrorCorrelation(PROCESS, np.array(0.1), 0.0, True)
    once, ten = (alike.inflate_variances(like, t, places, points, jac, noise, model) - noise for noise in (pixel, 10.0 * pixel))
    np.testing.assert_allclose(once, ten, rtol=1e-9)
    far = alike.ErrorCorrelation(PROCESS, np.array(0.1), alike.PIXEL_CORRELATION_PX, True)
    apart = places + 100.0 * np.arange(len(t))[:, None]
    np.testing.assert_allclose(alike.inflate_variances(far, t, apart, points, jac, pixel, model) - pixel, once, rtol=1e-9)


@pytest.mark.parametrize("method", ["filter", "smoother"])
def test_belief_of_a_resting_arm_keeps_the_model_variance(world, method):
    inside = []
    for seed in range(15):
        drawn = world(seed, duration=6.0, speed=0.0, encoder_std=0.01, pixel_std=0.02, camera_hz=20.0)
        off = np.random.default_rng([seed, 1]).normal(0.0, 0.1, 2)
        track = drawn.features.tracks["effector"]
        track = Series(track.t, track.values + off, track.names, track.unit, track.source_ns, track.std)
        model = replace(drawn.body.senses["effector"], blur=0.01)
        body = replace(drawn.body, senses={"effector": model})
        found = estimate_from_features(replace(drawn.features, tracks={"effector": track}), body, EstimationSettings(method=method))
        late = found.joints.t > 3.0
        jac = model.predict(drawn.truth.values[:1])[1][0]
        apart = (found.joints.values - drawn.truth.values)[late] @ jac.T
        cov = np.einsum("dj,njk,ek->nde", jac, found.cov[late], jac)
        inside.append(np.einsum("nd,nd->n", apart, np.linalg.solve(cov, apart[..., None])[..., 0]).mean() / 2)
    # fifteen draws of a two-dimensional offset: a standard error of 0.26
    assert 0.6 < np.mean(inside) < 1.45


def test_repeated_counts_the_models_common_error_once():
    assert alike.compute_shared_model_factors([90], [0.8], 2) == (1.0,)
    for share in (0.3, 1.0):
        times = alike.compute_shared_model_factors([90, 90, 50, 90], [share, share, 0.0, share], 2)
        assert times[2] == 1.0
        assert times[0] / 3.0 == pytest.approx(share + (1.0 - share) / 3.0)
        assert alike.compute_shared_model_factors([90, 90], [share, share], 3)[1] == pytest.approx(1.0 + share / 3.0)
    assert alike.compute_shared_model_factors([90, 0], [1.0, 1.0], 2)[0] == 1.0


def test_directions_of_duplicate_models_equal_those_of_one():
    x = np.array([-0.9, -0.9, 1.0])
    assert [alike.count_directions(models, x) for models in ([Arm()], [Arm(), Arm()], [Arm(), Turned()])] == [2, 2, 3]


@pytest.mark.parametrize("common", [0.0, 1.0])
def test_smoother_variance_with_two_cameras_keeps_the_common_error(world, common):
    drawn = world(3, pixel_std=0.01)
    model = replace(drawn.body.senses["effector"], blur=0.2)
    object.__setattr__(model, "spread", np.full((5, 2), 1e5 if common else 1e-4))
    variances = []
    for names in (("effector",), ("effector", "side/effector")):
        features = replace(drawn.features, tracks=dict.fromkeys(names, drawn.features.tracks["effector"]))
        noise = replace(drawn.body.noise, senses=dict.fromkeys(names, (1e-4, 1e-4)))
        body = replace(drawn.body, senses=dict.fromkeys(names, model), noise=noise)
        found = estimate_from_features(features, body, EstimationSettings(method="smoother", precision="model"))
        variances.append(np.einsum("nii->ni", found.cov).mean(axis=0))
    ratio = variances[1] / variances[0]
    assert np.allclose(ratio, 1.0, atol=0.01) if common else np.all(ratio < 0.95)
