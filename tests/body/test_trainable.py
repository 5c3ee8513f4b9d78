"""Tracks that cannot be learned are refused, or left out, by name and with counts."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog import body
from bodylog.body.gp.inducing import choose_inducing_points
from bodylog.body.gp.marginal_likelihood import Hyper
from bodylog.errors import EvidenceError
from bodylog.settings import Settings
from bodylog.types import Array, Features, Health


def _with(features: Features, places: Array, name: str = "other") -> Features:
    """The features with one more track, seen as often as the effector."""
    track = features.tracks["effector"]
    return replace(features, tracks={**features.tracks, name: replace(track, values=places)})


def _only(features: Features, places: Array) -> Features:
    return replace(features, tracks={"effector": replace(features.tracks["effector"], values=places)})


def _refused(features: Features) -> str:
    with pytest.raises(EvidenceError) as caught:
        body.learn_body([features], Settings(), {})
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.fixture(scope="module")
def run(explored):
    """20 s of an arm: 199 images."""
    return explored(3, 0.002, 20.0).features


def test_learn_refuses_a_still_track_by_name(run):
    still = np.full(run.tracks["effector"].values.shape, [40.0, 30.0])
    text = _refused(_only(run, still))
    assert "effector: stands still at (40.0, 30.0) px in all 199 sightings, seen in 199 of 199 images" in text
    assert "3 joints moved (pan, lift, elbow)" in text and "type bodylog features LOG" in text


@pytest.mark.parametrize("seed", range(2))
def test_learn_refuses_a_track_unrelated_to_the_joints(run, seed):
    draw, track = np.random.default_rng(seed), run.tracks["effector"]
    noise = draw.normal([40.0, 30.0], 0.4, track.values.shape)
    t = track.t[:, None] * draw.uniform(0.3, 1.5, 2)
    walking = [160.0, 120.0] + 50.0 * np.sin(t + draw.uniform(0, 6, 2)) + draw.normal(0, 0.4, track.values.shape)
    for places in (noise, walking):
        assert "it does not move with the joints" in _refused(_only(run, places))


def test_false_sightings_do_not_hide_that_the_arm_is_seen(run):
    draw, places = np.random.default_rng(1), run.tracks["effector"].values.copy()
    places[draw.random(len(places)) < 0.15] = draw.uniform(0, 300, 2)
    assert set(body.learn_body([_only(run, places)], Settings(), {}).model.senses) == {"effector"}


def test_learn_omits_a_still_track_with_a_warning(run):
    still = np.full(run.tracks["effector"].values.shape, [40.0, 30.0])
    noisy = still + np.random.default_rng(2).normal(0, 0.3, still.shape)
    alone = body.learn_body([run], Settings(), {})
    found = body.learn_body([_with(_with(run, still), noisy, "poster")], Settings(), {})
    assert set(found.model.senses) == {"effector"}
    warned = [f.text for f in found.findings if f.severity == "warning"]
    assert any(text.startswith("other: left out: stands still at (40.0, 30.0) px") for text in warned)
    assert any(text.startswith("poster: left out: joints predict") for text in warned)
    x = alone.model.senses["effector"].samples
    np.testing.assert_array_equal(
        alone.model.senses["effector"].predict(x)[0], found.model.senses["effector"].predict(x)[0]
    )


def test_too_few_sightings_for_the_joints_are_refused_with_the_counts(run):
    places = run.tracks["effector"].values.copy()
    places[8:] = np.nan
    lost = replace(_only(run, places), health={"effector": Health(199, 8, {"too small": 180, "out of view": 11})})
    text = _refused(lost)
    assert "effector: only 8 sightings with joint readings, 9 are needed as 3 joints moved" in text
    assert "seen in 8 of 199 images (others: 180 too small, 11 out of view)" in text


def test_findings_name_the_share_that_joints_explain(run):
    found = body.learn_body([run], Settings(), {})
    (explained,) = (s.value for s in found.scores if s.name == "explained/effector")
    assert 0.999 < explained < 1.0
    (text,) = (f.text for f in found.findings if f.text.startswith("joints: 3 learned over"))
    assert "pan" in text and text.endswith("not learned over: wrist")


def test_places_beyond_any_camera_are_left_out(run):
    places = run.tracks["effector"].values.copy()
    places[3] = 1e300
    found = body.learn_body([_only(run, places)], Settings(), {})
    assert any("1 of 199 places in log 1 left out: beyond 1e+06 px" in f.text for f in found.findings)


def test_inducing_gives_one_point_without_amplitude():
    x = np.random.default_rng(0).normal(size=(700, 3))
    assert len(choose_inducing_points([Hyper(np.ones(3), 1e-9, 1.0)], x, 1.0)) == 1


def test_learn_refuses_a_table_of_few_poses(tmp_path, run_cli, capsys):
    draw = np.random.default_rng(0)
    rows = [f"{a},{b},{c},{d}" for a, b, c, d in draw.normal(size=(5, 4)).tolist()]
    (tmp_path / "poses.csv").write_text("\n".join(["pan,lift,tip_u,tip_v", *rows]) + "\n")
    assert run_cli("fit", tmp_path / "poses.csv", "-o", tmp_path / "body.npz") == 65
    text = capsys.readouterr().err
    assert "tip: only 5 sightings with joint readings, 8 are needed" in text and "seen in 5 of 5 images" in text
    assert not (tmp_path / "body.npz").exists()
