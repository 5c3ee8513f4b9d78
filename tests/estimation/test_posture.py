"""Postures by the robot's surface as a sense: better than encoders alone, and error bars that hold."""

import numpy as np
import pytest

from bodylog.body_model import BodyModel, Noise, TouchConstants
from bodylog.estimation import estimate_from_features
from bodylog.estimation.measurements.posture import POSTURE_ERROR_S, inflate_lasting_errors
from bodylog.settings import EstimationSettings
from bodylog.types import LASTING_ERROR, Features, PostureReadings, Series

NAMES = ("pan", "lift", "elbow")
ENCODER_STD = 0.02


def body():
    return BodyModel(NAMES, {}, Noise((ENCODER_STD**2,) * 3, {}, (2.0,) * 3), TouchConstants(1.0, 0.005), {})


def motion(t, seed):
    rng = np.random.default_rng(seed)
    rates, phases = rng.uniform(0.6, 2.0, (2, 3)), rng.uniform(0.0, 6.3, (2, 3))
    return 0.3 * np.sin(rates * t[:, None, None] + phases).sum(axis=1)


def drawn_log(seed, names=NAMES):
    """Encoders with white noise; an image's posture errs along two directions by an error that wanders."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 20.0, 0.01)
    images = np.arange(0.3, 19.5, 1.0 / 12.0)
    joints = motion(t, seed) + ENCODER_STD * rng.standard_normal((len(t), 3))
    # pan is known well, lift and elbow by their sum alone
    cov = np.array([[3e-6, 0.0, 0.0], [0.0, 4e-5, -3.6e-5], [0.0, -3.6e-5, 4e-5]])
    root = np.linalg.cholesky(cov)
    kept = np.exp(-1.0 / 12.0 / POSTURE_ERROR_S)
    error = rng.standard_normal((len(images), 3))
    for number in range(1, len(images)):
        error[number] = kept * error[number - 1] + np.sqrt(1.0 - kept**2) * error[number]
    shown = motion(images, seed) + error @ root.T
    order = [NAMES.index(name) for name in names]
    reading = PostureReadings(
        images, shown[:, order], np.tile(cov[np.ix_(order, order)], (len(images), 1, 1)), names,
        np.rint(images * 1e9).astype(np.int64),
    )  # fmt: skip
    series = Series(t, joints, NAMES, "rad", np.rint(t * 1e9).astype(np.int64))
    return Features(series, {}, None, (), (), {}, postures={"surface": reading})


def estimated(features, seed, method="smoother", **settings):
    found = estimate_from_features(features, body(), EstimationSettings(method=method, **settings))
    error = found.joints.values - motion(found.joints.t, seed)
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.cov), error).mean() / 3.0
    return found, np.sqrt(np.square(error).mean()), nees


def test_smoother_is_better_than_by_encoders_alone_and_knows_how_good():
    ratios, all_nees = [], []
    for seed in (11, 12, 13, 14):  # the factor was chosen on others
        features = drawn_log(seed)
        found, rms, nees = estimated(features, seed)
        _, alone, _ = estimated(features, seed, without=("vision",))
        assert found.used["surface"].used == len(features.postures["surface"].t)
        assert not found.faults and LASTING_ERROR not in found.settings
        assert "surface" not in found.predicted
        ratios.append(rms / alone)
        all_nees.append(nees)
    assert np.mean(ratios) < 0.9 and max(ratios) < 1.0
    assert 0.5 < np.mean(all_nees) < 2.0


@pytest.mark.parametrize("method", ["filter", "smoother"])
def test_order_of_joints_does_not_matter(method):
    """Two ways agree: a camera may list the joints otherwise than the body."""
    first = estimated(drawn_log(3), 3, method)[0]
    second = estimated(drawn_log(3, ("elbow", "pan", "lift")), 3, method)[0]
    np.testing.assert_allclose(first.joints.values, second.joints.values, atol=1e-12)


def test_errors_that_last_count_as_the_span_of_motion_asks():
    cov = np.tile(np.diag([1e-4, 1e-6]), (40, 1, 1))
    often = inflate_lasting_errors(np.arange(40) / 24.0, cov, np.array([1.0, 1.0]))
    rarely = inflate_lasting_errors(np.arange(40) / 6.0, cov, np.array([1.0, 1.0]))
    lively = inflate_lasting_errors(np.arange(40) / 24.0, cov, np.array([100.0, 100.0]))
    factor = [np.einsum("nii->ni", one)[5] / np.diag(cov[5]) for one in (often, rarely, lively)]
    assert (factor[0] > factor[1]).all() and (factor[0] > factor[2]).all()
    assert min(map(np.min, factor)) >= 1.0
    assert factor[0][0] > factor[0][1]  # what is known badly lasts longer against the same motion
    # no more than an error that wanders allows in any log: 1 + 2 Σ ρᵏ
    assert max(map(np.max, factor)) <= 2.0 * POSTURE_ERROR_S * 24.0 + 1.0
    np.testing.assert_array_equal(inflate_lasting_errors(np.zeros(1), cov[:1], np.ones(2)), cov[:1])
