"""Withheld images: which ones, and that better predictions score higher, by the textbook's density."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bodylog.body_model import BodyModel, Noise, TouchConstants
from bodylog.estimation import METHODS, estimate_from_features
from bodylog.evaluation.heldout import WITHHELD_INTERVAL, score_withheld_frames, withhold_frames
from bodylog.settings import EstimationSettings
from bodylog.types import Estimate, Features, Series
from tests.estimation.conftest import Linear, dense, draw


class Twice:
    """u, v: twice the two angles."""

    outputs = ("u", "v")

    def predict(self, x):
        return 2.0 * x, np.repeat(2.0 * np.eye(2)[None], len(x), axis=0), np.full((len(x), 2), 0.25)


def series(t, values, names, unit, std=None):
    return Series(t, values, names, unit, (t * 1e9).astype(np.int64), std)


@pytest.fixture
def scene():
    rng, t = np.random.default_rng(3), np.arange(40) * 0.1
    seen = rng.normal(0, 1, (40, 2))
    seen[9] = np.nan
    track = series(t, seen, ("u", "v"), "px", np.full((40, 2), 0.5))
    body = BodyModel(("a", "b"), {"effector": Twice()}, Noise((1.0,) * 2, {"effector": (0.25, 0.25)}, (1.0,) * 2),
                     TouchConstants(1.0, 0.1), {})  # fmt: skip
    return Features(None, {"effector": track}, None, (), (), {}), body


def believed(t, x, cov, predicted=None, predicted_cov=None):
    joints = series(t, x, ("a", "b"), "rad")
    return Estimate("filter", joints, joints, cov, {}, np.zeros(len(t)), {}, predicted or {}, predicted_cov or {}, {})


def test_withhold_hides_every_fifth_frame_and_returns_its_sightings(scene):
    features, _ = scene
    fewer, withheld = withhold_frames(features)
    hidden = np.isnan(fewer.tracks["effector"].values).any(axis=1)
    assert np.flatnonzero(hidden).tolist() == list(range(WITHHELD_INTERVAL - 1, 40, WITHHELD_INTERVAL))
    assert withheld["effector"].t.tolist() == features.tracks["effector"].t[[4, 14, 19, 24, 29, 34, 39]].tolist()
    assert np.isfinite(withheld["effector"].values).all()


def test_held_out_is_the_mean_predicted_density(scene):
    features, body = scene
    _, withheld = withhold_frames(features)
    track, seen = features.tracks["effector"], withheld["effector"]
    cov = np.array([[2.0, 0.3], [0.3, 1.0]])
    found = believed(track.t, np.zeros((40, 2)), np.zeros((40, 2, 2)),
                     {"effector": replace(track, values=np.full((40, 2), 0.1))},
                     {"effector": np.repeat(cov[None], 40, axis=0)})  # fmt: skip
    (score,) = score_withheld_frames(found, withheld, body)
    assert score.value == pytest.approx(multivariate_normal([0.1, 0.1], cov).logpdf(seen.values).mean(), rel=1e-12)


def test_held_out_predicts_images_with_the_body(scene):
    features, body = scene
    _, withheld = withhold_frames(features)
    track, seen = features.tracks["effector"], withheld["effector"]
    spread = np.diag([0.5, 0.1])
    (score,) = score_withheld_frames(believed(track.t, np.full((40, 2), 0.2), np.repeat(spread[None], 40, axis=0)), withheld, body)
    expected = multivariate_normal([0.4, 0.4], 4.0 * spread + 0.5 * np.eye(2)).logpdf(seen.values).mean()
    assert score.value == pytest.approx(expected, rel=1e-12)


def test_held_out_is_absent_without_withheld_frames(scene):
    _, body = scene
    assert score_withheld_frames(believed(np.arange(3.0), np.zeros((3, 2)), np.zeros((3, 2, 2))), {}, body) == ()


def test_withhold_keeps_a_tracks_only_sighting(scene):
    features, _ = scene
    track = features.tracks["effector"]
    once = np.where(np.arange(40)[:, None] == WITHHELD_INTERVAL - 1, track.values, np.nan)
    fewer, withheld = withhold_frames(replace(features, tracks={"effector": replace(track, values=once)}))
    assert np.isfinite(fewer.tracks["effector"].values[WITHHELD_INTERVAL - 1]).all()
    assert not len(withheld["effector"].t)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("method", "senses", "off"),
    [
        ("filter", ("encoders", "vision"), 1e-9),
        ("ekf", ("encoders", "vision"), 1e-9),
        ("smoother", ("encoders", "vision"), 1e-9),
        ("filter", ("encoders",), 0.1),
        ("smoother", ("encoders",), 0.01),
    ],
)
def test_held_out_of_a_linear_body_equals_the_textbook(seed, method, senses, off):
    """In nats; estimates that did not see are asked between their instants, which is nearly right."""
    plane = Linear(np.array([[300.0, -40.0, 20.0], [15.0, 250.0, 120.0]]), np.array([160.0, 120.0]))
    drawn = draw(seed, duration=8.0, model=plane)
    fewer, withheld = withhold_frames(drawn.features)
    asked = EstimationSettings(method=method, senses=senses, precision="model", bias="off")
    (score,) = score_withheld_frames(estimate_from_features(fewer, drawn.body, asked), withheld, drawn.body)
    track, seen = fewer.tracks["effector"], withheld["effector"]
    readings = track if "vision" in senses else replace(track, values=np.full_like(track.values, np.nan))
    noise = drawn.body.noise
    known = replace(drawn, features=replace(fewer, tracks={"effector": readings}))
    book = dense(known, np.array(noise.process), np.array(noise.encoder), noise.senses["effector"][0])
    mean, cov = (book.smooth, book.smooth_cov) if method == "smoother" else (book.mean, book.cov)
    rows = np.searchsorted(book.t, seen.t)
    spread = plane.a @ cov[rows][:, :3, :3] @ plane.a.T + noise.senses["effector"][0] * np.eye(2)
    places = plane.predict(mean[rows][:, :3])[0]
    expected = [multivariate_normal(*one).logpdf(v) for *one, v in zip(places, spread, seen.values, strict=True)]
    assert score.value == pytest.approx(np.mean(expected), abs=off)


@pytest.mark.parametrize(("method", "foretold"), [("filter", 0.3), ("kalman", 0.0), ("smoother", 0.5)])
def test_held_out_interpolates_for_smoothers_only(scene, method, foretold):
    """Beliefs 0 and 1 rad, 1 s apart, at a rate of 0.6 rad/s; a frame is asked for half-way."""
    _, body = scene
    seen = series(np.array([0.5]), np.zeros((1, 2)), ("u", "v"), "px", np.full((1, 2), 0.5))
    found = believed(np.arange(2.0), np.repeat(np.arange(2.0)[:, None], 2, axis=1), np.zeros((2, 2, 2)))
    rate = replace(found.joints, values=np.full((2, 2), 0.6))
    (score,) = score_withheld_frames(replace(found, can=METHODS[method].can, rate=rate), {"effector": seen}, body)
    assert score.value == pytest.approx(multivariate_normal([2 * foretold] * 2, 0.5 * np.eye(2)).logpdf([0.0, 0.0]))
