"""Bodies on axes that were found without a URDF: what they predict, how sure they are, when not."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bodylog import body
from bodylog.body import storage
from bodylog.body.data.pairs import correlate_angle_errors
from bodylog.body.gp.axis_gp import AxisGP
from bodylog.body.gp.model import GP
from bodylog.body.kinematic import found_axes
from bodylog.body.kinematic.scores import evidence_of_gp_alone
from bodylog.body.learning import learn_from_features
from bodylog.errors import ModelError
from bodylog.settings import FitSettings, Settings
from bodylog.types import Series
from tests.body.conftest import project
from tests.seeds import seeds

HOME = np.array([0.0, 0.3, 0.6])
FAR = np.random.default_rng(4).uniform(-0.9, 0.9, (400, 3)) + HOME
"""Angles (400,3) rad of postures, most of them beyond those of an exploration."""


def _with_axes(features, settings=None, known=None):
    settings = settings or Settings()
    plain = learn_from_features([features], settings, {}, known)
    return plain, body.with_kinematics([features], settings, plain, None, known)


def _errors(model, q=FAR):
    mean, _, variance = model.predict(q)
    away = mean - project(q)
    return float(np.sqrt(np.square(away).mean())), float((np.square(away) / variance).mean())


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.soak
def test_postures_never_seen_are_predicted_as_well_as_stated(explored, seed):
    plain, found = _with_axes(explored(seed, 0.003).features)
    models = [one.model.senses["effector"] for one in (plain, found)]
    assert type(models[0]) is GP and type(models[1]) is AxisGP
    (alone, _), (error, squares) = (_errors(one) for one in models)
    assert error < 0.5 * alone and error < 3.0
    assert squares < 3.0
    before, scores = ({s.name: s.value for s in one.scores} for one in (plain, found))
    assert scores["rmse/held_out/effector"] < before["rmse/held_out/effector"]
    assert scores["std/model/effector"] < before["std/model/effector"]
    noise = models[1].noise + plain.used["effector"].floor.mean(axis=0)
    assert found.model.noise.senses["effector"] == pytest.approx(tuple(noise))
    assert 0.7 < scores["nis/held_out/effector"] < 1.4
    assert any("in order pan, lift, elbow" in one.text for one in found.findings)


@pytest.mark.soak
def test_error_bars_hold_over_explorations(explored):
    squares = [
        _errors(_with_axes(explored(seed, 0.003).features)[1].model.senses["effector"])[1]
        for seed in range(20, 28)
    ]
    assert 0.4 < np.mean(squares) < 1.8


def test_one_posture_is_predicted_as_many(explored):
    model = _with_axes(explored(0, 0.003).features)[1].model.senses["effector"]
    q = FAR[:40]
    for one, many in zip(zip(*(model.predict_one(x) for x in q), strict=True), model.predict(q), strict=True):
        assert np.allclose(one, many, rtol=1e-8, atol=1e-8)
    above, below = (model.means(q + way)[0] for way in (1e-5, -1e-5))
    assert np.allclose(model.means(q)[1].sum(axis=2), (above - below) / 2e-5, rtol=1e-4, atol=1e-2)
    variance = ((model.predict(q)[2] - model.drift) / model.share).mean(axis=1)
    assert np.allclose(np.diagonal(model.covariance(q)[0]), variance, rtol=1e-6)


def _place(q):
    """The arm's end (N,3) mm, as a tracker measures it."""
    reach = 0.42 * np.cos(q[:, 1]) + 0.39 * np.cos(q[:, 1] + q[:, 2])
    height = 0.42 * np.sin(q[:, 1]) + 0.39 * np.sin(q[:, 1] + q[:, 2])
    return 1e3 * np.column_stack([reach * np.cos(q[:, 0]), reach * np.sin(q[:, 0]), height])


@pytest.mark.parametrize("seed", seeds(1, 3))
def test_points_in_space_tell_axes_too(explored, seed):
    run = explored(seed, 0.001)
    seen = _place(run.angles) + np.random.default_rng(seed).normal(0.0, 0.1, (len(run.angles), 3))
    t = run.features.tracks["effector"].t
    track = Series(t, seen, ("x", "y", "z"), "mm", (t * 1e9).astype(np.int64))
    plain, found = _with_axes(replace(run.features, tracks={"effector": track}))
    errors = []
    for one in (plain, found):
        mean, _, variance = one.model.senses["effector"].predict(FAR)
        away = np.square(mean - _place(FAR))
        errors.append(float(np.sqrt(away.mean())))
    assert errors[1] < 0.1 * errors[0]
    assert (away / variance).mean() < 2.0


def test_joints_that_move_together_tell_no_axes(explored):
    run = explored(0, 0.003)
    readings = run.features.joints
    rigid = readings.values.copy()
    rigid[:, 2] = 0.5 * rigid[:, 1] + 0.4
    pixels = project(np.column_stack([run.angles[:, :2], 0.5 * run.angles[:, 1] + 0.4]))
    noisy = pixels + np.random.default_rng(0).normal(0.0, 0.3, pixels.shape)
    track = replace(run.features.tracks["effector"], values=noisy)
    features = replace(run.features, joints=replace(readings, values=rigid), tracks={"effector": track})
    found = _with_axes(features)[1]
    assert type(found.model.senses["effector"]) is GP


@pytest.mark.soak
def test_a_marker_that_no_arm_carries_keeps_its_process(explored):
    run = explored(0, 0.003)
    pan, lift, elbow = run.angles.T
    odd = 100.0 + 40.0 * np.column_stack([np.abs(pan) + lift**2 * elbow, np.tanh(4 * lift) - pan * elbow**2])
    odd += np.random.default_rng(0).normal(0.0, 0.3, odd.shape)
    features = replace(run.features, tracks={"effector": replace(run.features.tracks["effector"], values=odd)})
    plain, found = _with_axes(features)
    assert found is plain


def test_tracks_after_two_without_axes_are_not_tried(explored, monkeypatch):
    run = explored(0, 0.003, 20.0)
    track = run.features.tracks["effector"]
    tracks = {name: track for name in ("a", "b", "c", "side/a")}
    tried = []

    def give_up(data, seed, known):
        tried.append(known)
        return SimpleNamespace(order=range(3))

    monkeypatch.setattr(found_axes, "find_axes", give_up)
    monkeypatch.setattr(found_axes, "_learn_on_chain", lambda *_: SimpleNamespace(gain=-np.inf))
    plain, found = _with_axes(replace(run.features, tracks=tracks))
    assert found is plain and tried == [None] * 3


def test_axes_of_many_joints_are_not_looked_for(explored, monkeypatch):
    monkeypatch.setattr(found_axes, "MOST_JOINTS", 2)
    plain, found = _with_axes(explored(0, 0.003, 20.0).features)
    assert found is plain


def test_evidence_of_two_equal_kernels_is_that_of_one(explored):
    run = explored(0, 0.003, 20.0)
    plain = learn_from_features([run.features], Settings(), {})
    gp, part = plain.model.senses["effector"], plain.used["effector"]
    each = replace(
        gp, scales=np.repeat(gp.scales, 2, axis=0), amplitude=np.repeat(gp.amplitude, 2), factor=np.repeat(gp.factor, 2, axis=0)
    )
    known = correlate_angle_errors(part, [])
    even = replace(part, variance=np.zeros(part.variance.shape), floor=np.full(part.floor.shape, 0.1))
    models = [replace(one, noise=np.full(2, 0.01)) for one in (gp, each)]
    shared, apart = (evidence_of_gp_alone(one, even, known) for one in models)
    assert shared == pytest.approx(apart, rel=1e-9)


def test_the_papers_preset_has_no_axes(explored):
    settings = Settings(fit=FitSettings(preset="paper"))
    plain, found = _with_axes(explored(0, 0.003).features, settings)
    assert found is plain


def test_it_is_saved_and_read_with_the_same_bytes(explored, tmp_path):
    model = _with_axes(explored(1, 0.003).features)[1].model
    for name in ("one", "two"):
        storage.save(model if name == "one" else storage.load_body(tmp_path / "one.npz"), tmp_path / f"{name}.npz")
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()
    again = storage.load_body(tmp_path / "two.npz").senses["effector"]
    assert all(np.array_equal(a, b) for a, b in zip(again.predict(FAR), model.senses["effector"].predict(FAR), strict=True))


@pytest.mark.parametrize(("field", "value"), [("frames", 2.0), ("order", 0.0), ("lens", np.nan)])
def test_a_broken_file_is_refused_by_field(explored, tmp_path, field, value):
    model = _with_axes(explored(1, 0.003, 20.0).features)[1].model
    sense = model.senses["effector"]
    chain = replace(sense.chain, **{field: np.full(getattr(sense.chain, field).shape, value)})
    broken = replace(model, senses={**model.senses, "effector": replace(sense, chain=chain)})
    storage.save(broken, tmp_path / "body.npz")
    with pytest.raises(ModelError, match=f"effector/{field}"):
        storage.load_body(tmp_path / "body.npz")


def test_an_update_learns_on_with_earlier_samples(explored):
    first, second = explored(2, 0.003, 20.0), explored(3, 0.003, 20.0)
    once = _with_axes(first.features)[1].model
    twice = _with_axes(second.features, known=once)[1].model
    assert type(twice.senses["effector"]) is AxisGP
    assert len(twice.senses["effector"].samples) > len(once.senses["effector"].samples)
    errors = [_errors(one.senses["effector"])[0] for one in (once, twice)]
    assert errors[1] < 1.1 * errors[0]
