"""The paper's descent: where it converges, when it is stable, and its two forms of touch."""

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest

from bodylog.body_model import TouchConstants
from bodylog.errors import UsageError
from bodylog.estimation import estimate_from_features
from bodylog.estimation.methods import predictive_coding
from bodylog.estimation.methods.algorithm1 import PaperTouch
from bodylog.evaluation.scores import score_angles
from bodylog.settings import EstimationSettings
from tests.estimation.conftest import Arm
from tests.seeds import seeds

DESCENT = EstimationSettings(method="predictive-coding")


@dataclass(frozen=True)
class Crooked(Arm):
    """The arm seen from `turn` rad aside, wrong by `blur` px², as it says: smoothly over the angles, and by a seed."""

    turn: float = 0.0
    seed: int = 0

    def place(self, x):
        rng = np.random.default_rng(self.seed)
        waves, phases = rng.normal(0, 3.0, (2, 3, 8)), rng.uniform(0, 2 * np.pi, (2, 8))
        off = [np.sin(x @ wave + phase).sum(axis=-1) for wave, phase in zip(waves, phases, strict=True)]
        return super().place(x + np.array([self.turn, 0.0, 0.0])) + np.sqrt(self.blur / 4) * np.stack(off, axis=-1)


def still(drawn):
    """The world's features with the arm held where it began, without noise."""
    joints, track = drawn.features.joints, drawn.features.tracks["effector"]
    x = drawn.truth.values[0]
    held = np.repeat(x[None, [2, 0, 1]], len(joints.t), axis=0)
    seen = np.repeat(drawn.body.senses["effector"].predict(x[None])[0], len(track.t), axis=0)
    tracks = {"effector": replace(track, values=seen)}
    return replace(drawn.features, joints=replace(joints, values=held), tracks=tracks), x


@pytest.mark.parametrize("settings", [replace(DESCENT, preset="paper"), replace(DESCENT, precision="model")])
def test_descent_corrects_a_wrong_start_of_a_still_arm(world, settings):
    features, x = still(world(0, duration=30.0))
    found = estimate_from_features(features, world(0).body, replace(settings, start=tuple(x + 0.1)))
    assert np.abs(found.joints.values[0] - x).max() > 0.01
    np.testing.assert_allclose(found.joints.values[-1], x, atol=2e-3)


def test_calibrated_descent_beats_the_encoders_and_the_papers_preset(world):
    ratios = []
    for seed in range(3):
        drawn = world(seed)
        rmse = {}
        for preset in ("default", "paper"):
            found = estimate_from_features(drawn.features, drawn.body, replace(DESCENT, preset=preset))
            rmse[preset] = {s.name: s.value for s in score_angles(found, drawn.truth, drawn.features.joints)}
        assert rmse["default"]["rmse/joint"] < rmse["default"]["rmse/encoders"] < rmse["paper"]["rmse/joint"]
        ratios.append(rmse["default"]["rmse/joint"])
    assert np.mean(ratios) < 0.016


def test_explicit_steps_are_stable_just_below_the_named_step_and_not_above(world, linear_model):
    drawn = world(0, duration=20.0, model=linear_model)
    features, x = still(drawn)
    settings = replace(DESCENT, preset="paper", start=tuple(x + 0.01))
    plan, *_ = predictive_coding.build_grid_problem(features, drawn.body, replace(settings, rate=100.0))
    senses = tuple(replace(s, s=np.tile(s.predict(x[None])[0], (len(s.s), 1))) for s in plan.senses)
    stable = predictive_coding.find_largest_stable_step(replace(plan, senses=senses))
    for factor, holds in ((0.95, True), (1.05, False)):
        found = predictive_coding.integrate_belief(replace(plan, senses=senses, dt=factor * stable), True)[0]
        assert bool(np.isfinite(found).all() and np.abs(found[-1] - x).max() < 0.01) is holds


def test_descent_refuses_long_steps_and_names_the_longest(world):
    drawn = world(0, duration=10.0)
    with pytest.raises(UsageError, match=r"largest stable Δt is \S+ s; type --rate \S+ or --step implicit"):
        estimate_from_features(drawn.features, drawn.body, replace(DESCENT, step="explicit"))
    short = world(0, duration=1.0)
    found = estimate_from_features(short.features, short.body, replace(DESCENT, step="explicit"))
    assert "largest stable Δt" in found.findings[0].text


@pytest.mark.parametrize("seed", seeds(1, 2))
@pytest.mark.parametrize(
    ("over", "rate"),
    [
        ({}, 20.0),
        ({}, 500.0),
        ({"precision": "model"}, 20.0),
        ({"senses": ("encoders",)}, 20.0),
        ({"precision": "fixed"}, 1.0),
        ({"preset": "paper"}, 1.0),
    ],
)
def test_suggested_rate_is_stable_without_a_warning(world, seed, over, rate):
    drawn = world(seed, duration=0.5)
    settings = replace(DESCENT, step="explicit", **over)

    def planned(rate):
        return predictive_coding.build_grid_problem(drawn.features, drawn.body, replace(settings, rate=rate))[0]

    (warned,) = predictive_coding.warn_of_unstable_step(planned(rate))
    typed = planned(float(re.search(r"type --rate (\S+) or --step implicit$", warned.text)[1]))
    assert not predictive_coding.warn_of_unstable_step(typed)
    first = tuple(replace(sense, s=sense.s[:1000], sigma=sense.sigma[:1000]) for sense in typed.senses)
    found = predictive_coding.integrate_belief(replace(typed, t=typed.t[:1000], senses=first), True)[0]
    assert np.abs(found - drawn.truth.values[0]).max() < 0.5


def test_literal_touch_gradient_is_the_derivative(world):
    drawn = world(0, duration=1.0)
    model, x = drawn.body.senses["effector"], drawn.truth.values[0]
    hand = model.predict(x[None])[0] + 5.0
    touch = PaperTouch(model, TouchConstants(0.9, 0.004), np.array([True]), hand, np.array([0.8]))
    e, slope = touch.measure_touch_error(0, x)
    for joint in range(3):
        step = 1e-6 * np.eye(3)[joint]
        numeric = (touch.measure_touch_error(0, x - step)[0] - touch.measure_touch_error(0, x + step)[0]) / 2e-6
        assert slope[joint] == pytest.approx(numeric, rel=1e-5)
    assert 0 < e < 0.72


def test_descent_matches_a_nonlinear_encoder_in_its_units(world):
    """s_p = x²: the belief settles where x² is right, and cannot know the sign."""

    class Square:
        outputs = ("pan", "lift", "elbow")

        def predict(self, x):
            return x**2, 2.0 * np.stack([np.diag(row) for row in x]), np.zeros_like(x)

    drawn = world(0, duration=30.0)
    joints, x = drawn.features.joints, np.array([-0.955, -0.869, 0.753])
    values = np.repeat((x[None] ** 2)[:, [2, 0, 1]], len(joints.t), axis=0)
    features = replace(drawn.features, joints=replace(joints, values=values), tracks={})
    body = replace(drawn.body, senses={"encoders": Square()})
    found = estimate_from_features(features, body, replace(DESCENT, preset="paper", start=(-0.8, 0.7, 0.6)))
    np.testing.assert_allclose(found.joints.values[-1] ** 2, x**2, atol=0.01)
    assert found.joints.values[-1, 1] == pytest.approx(0.869, abs=0.01)


@pytest.mark.parametrize("seed", range(2))
def test_descent_on_encoders_alone_is_the_papers_kalman_filter_in_kind(world, seed):
    drawn = world(seed)
    descent = estimate_from_features(drawn.features, drawn.body, replace(DESCENT, preset="paper", senses=("encoders",)))
    kalman = estimate_from_features(drawn.features, drawn.body, EstimationSettings(method="kalman"))
    rmse = [{s.name: s.value for s in score_angles(found, drawn.truth, None)}["rmse/joint"] for found in (descent, kalman)]
    assert 0.5 < rmse[0] / rmse[1] < 2.0


@pytest.mark.parametrize("seed", seeds(2, 3))
@pytest.mark.parametrize("turns", [(0.0,), (0.0, 0.6)])
def test_error_bars_know_the_models_error(world, seed, turns):
    """Pictures sharper than the model, of one camera and of two: less than half of the error is claimed without it."""
    drawn, rng = world(seed, camera_hz=20.0), np.random.default_rng(seed)
    seen, truth = drawn.features.tracks["effector"], drawn.truth
    x = np.stack([np.interp(seen.t, truth.t, column) for column in truth.values.T], axis=1)
    tracks, senses = {}, {}
    for k, turn in enumerate(turns):
        values = Crooked(turn=turn).place(x) + rng.normal(0, 0.05, (len(x), 2))
        name = ("effector", "side/effector")[k]
        tracks[name] = replace(seen, values=values, std=np.full(values.shape, 0.05))
        senses[name] = Crooked(0.1**2, turn=turn, seed=seed + 10 * k)
    body = replace(drawn.body, senses=senses)
    found = estimate_from_features(replace(drawn.features, tracks=tracks), body, DESCENT)
    score = {s.name: s.value for s in score_angles(found, truth, drawn.features.joints)}
    assert 0.7 < score["nees/joint"] < 2.0
    assert score["rmse/joint"] < (0.012, 0.003)[len(turns) - 1]


def test_joints_without_an_encoder_give_a_warning_about_error_bars(world):
    drawn = world(0, duration=4.0)
    texts = {
        senses: [
            f.text
            for f in estimate_from_features(drawn.features, drawn.body, settings).findings
            if f.severity == "warning" and f.text.startswith("predictive-coding: ")
        ]
        for senses, settings in (
            ("all", DESCENT),
            ("pan", replace(DESCENT, senses=("pan", "vision"))),
            ("paper", replace(DESCENT, senses=("pan", "vision"), preset="paper")),
        )
    }
    (text,) = texts["pan"]
    assert "knows no motion of lift, elbow without encoders" in text
    assert text.endswith("type --method filter") and texts["all"] == texts["paper"] == []


@pytest.mark.parametrize("method", ["filter", "smoother", "ekf"])
def test_methods_the_paper_has_not_refuse_its_preset(world, method):
    drawn = world(0, duration=2.0)
    with pytest.raises(UsageError, match=f"'paper' is not for {method}; type --method kalman or --method p"):
        estimate_from_features(drawn.features, drawn.body, EstimationSettings(method=method, preset="paper"))


@pytest.mark.parametrize("speed", [0.1, 0.5, 1.5])
def test_warning_is_absent_for_a_moving_arm(world, speed):
    for seed in range(2):
        drawn = world(seed, duration=10.0, speed=speed, encoder_std=0.01)
        assert not [f for f in estimate_from_features(drawn.features, drawn.body, DESCENT).findings if f.severity == "warning"]


def test_warning_is_given_for_a_faulty_encoder(world):
    for seed in range(2):
        drawn = world(seed, duration=14.0, encoder_std=0.005, camera_hz=30.0)
        joints = drawn.features.joints
        values = joints.values + 0.3 * np.outer(joints.t > 6.0, np.array(joints.names) == "pan")
        found = estimate_from_features(replace(drawn.features, joints=replace(joints, values=values)), drawn.body, DESCENT)
        assert any("standard deviations from what was expected" in finding.text for finding in found.findings)


@pytest.mark.parametrize(
    ("settings", "texts"),
    [
        (EstimationSettings(method="kalman", bias="on"), ["bias: 'on' is ignored by kalman; leave it out, or"]),
        (EstimationSettings(method="kalman", precision="model"), ["precision: 'model' is ignored by kalman; leave it out"]),
        (replace(DESCENT, bias="on"), ["bias: 'on' is ignored by predictive-coding; leave it out"]),
        (replace(DESCENT, precision="model"), []),
        (replace(DESCENT, precision="model", preset="paper"), ["precision: 'model' is ignored by predictive"]),
        (EstimationSettings(method="kalman", precision="fixed", bias="off"), []),
    ],
)
def test_ignored_settings_give_a_warning(world, settings, texts):
    drawn = world(0, duration=4.0)
    found = [f.text for f in estimate_from_features(drawn.features, drawn.body, settings).findings if "ignored by" in f.text]
    assert len(found) == len(texts) and all(text.startswith(part) for text, part in zip(found, texts, strict=True))
