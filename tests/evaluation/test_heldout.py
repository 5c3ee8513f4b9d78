"""Withheld pictures: which are taken, and that the better foretold ones score higher, by the textbook's density."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bodylog.evaluation.heldout import EVERY, held_out, withhold
from bodylog.types import BodyModel, Estimate, Features, Noise, Series, TouchConstants


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
                     TouchConstants(1.0, 0.1, 1.0, 0.1), {})  # fmt: skip
    return Features(None, {"effector": track}, None, (), (), {}), body


def believed(t, x, cov, predicted=None, predicted_cov=None):
    joints = series(t, x, ("a", "b"), "rad")
    return Estimate("laplace", joints, joints, cov, {}, np.zeros(len(t)), {}, predicted or {}, predicted_cov or {}, {})


def test_each_fifth_frame_is_withheld_and_only_those_that_show_something_are_asked_for(scene):
    features, _ = scene
    fewer, withheld = withhold(features)
    hidden = np.isnan(fewer.tracks["effector"].values).any(axis=1)
    assert np.flatnonzero(hidden).tolist() == list(range(EVERY - 1, 40, EVERY))
    assert withheld["effector"].t.tolist() == features.tracks["effector"].t[[4, 14, 19, 24, 29, 34, 39]].tolist()
    assert np.isfinite(withheld["effector"].values).all()


def test_the_score_is_the_mean_density_of_what_was_foretold(scene):
    features, body = scene
    _, withheld = withhold(features)
    track, seen = features.tracks["effector"], withheld["effector"]
    cov = np.array([[2.0, 0.3], [0.3, 1.0]])
    found = believed(track.t, np.zeros((40, 2)), np.zeros((40, 2, 2)),
                     {"effector": replace(track, values=np.full((40, 2), 0.1))},
                     {"effector": np.repeat(cov[None], 40, axis=0)})  # fmt: skip
    (score,) = held_out(found, withheld, body)
    assert score.value == pytest.approx(multivariate_normal([0.1, 0.1], cov).logpdf(seen.values).mean(), rel=1e-12)


def test_a_belief_that_did_not_see_is_asked_through_the_body(scene):
    features, body = scene
    _, withheld = withhold(features)
    track, seen = features.tracks["effector"], withheld["effector"]
    spread = np.diag([0.5, 0.1])
    (score,) = held_out(believed(track.t, np.full((40, 2), 0.2), np.repeat(spread[None], 40, axis=0)), withheld, body)
    expected = multivariate_normal([0.4, 0.4], 4.0 * spread + 0.5 * np.eye(2)).logpdf(seen.values).mean()
    assert score.value == pytest.approx(expected, rel=1e-12)


def test_nothing_withheld_gives_no_score(scene):
    _, body = scene
    assert held_out(believed(np.arange(3.0), np.zeros((3, 2)), np.zeros((3, 2, 2))), {}, body) == ()


def test_a_track_that_would_show_nothing_any_more_is_left(scene):
    features, _ = scene
    track = features.tracks["effector"]
    once = np.where(np.arange(40)[:, None] == EVERY - 1, track.values, np.nan)
    fewer, withheld = withhold(replace(features, tracks={"effector": replace(track, values=once)}))
    assert np.isfinite(fewer.tracks["effector"].values[EVERY - 1]).all()
    assert not len(withheld["effector"].t)
