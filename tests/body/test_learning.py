from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bodylog import perception
from bodylog.body import Polynomial, learn_body
from bodylog.body.learning import LearnedBody
from bodylog.body.storage import load_body, save
from bodylog.body_model import TouchConstants
from bodylog.errors import EvidenceError, ModelError
from bodylog.estimation import estimate_from_features
from bodylog.recording import recording
from bodylog.settings import BodySettings, EstimationSettings, FitSettings, Settings
from bodylog.types import Features, Series
from tests.body.standard_residuals import standardise_residuals
from tests.seeds import first_of

_ARM = Path(__file__).parents[2].parent / "shared" / "logs" / "arm"


def _scores(learned: LearnedBody) -> dict[str, float]:
    return {score.name: score.value for score in learned.scores}


@pytest.fixture(scope="module")
def learned(explored) -> LearnedBody:
    return learn_body([explored(0, 0.003).features], Settings(), {})


def test_moving_joints_are_learned_to_a_fraction_of_a_pixel(learned: LearnedBody, explored) -> None:
    run = explored(0, 0.003)
    assert learned.model.joints == ("pan", "lift", "elbow")
    error = learned.model.senses["effector"].predict(run.angles)[0] - run.pixels
    assert np.sqrt(np.mean(error**2)) < 0.25
    assert "wrist: moved 0.000 rad, left out" in learned.findings[1].text


def test_noise_is_learned_with_its_error_bars(learned: LearnedBody) -> None:
    noise = learned.model.noise
    assert np.sqrt(noise.encoder) == pytest.approx(0.003, rel=0.05)
    assert np.sqrt(noise.senses["effector"]) == pytest.approx(0.3, rel=0.1)
    assert all(0 < e < v for e, v in zip(noise.std_error["encoder"], noise.encoder, strict=True))
    assert all(0 < e < v for e, v in zip(noise.std_error["process"], noise.process, strict=True))


def test_scores_say_what_was_learned(learned: LearnedBody) -> None:
    scores = _scores(learned)
    assert scores["used_share/effector"] == 1.0
    assert 0.3 < scores["rmse/held_out/effector"] < 1.5
    assert 0.7 < scores["nis/held_out/effector"] < 1.4
    assert {f"length_scale/effector/{j}" for j in learned.model.joints} <= set(scores)
    assert all(scores[f"influence/effector/{j}"] > 5.0 and scores[f"range/{j}"] > 0.5 for j in learned.model.joints)
    assert all(np.isfinite(v) for v in scores.values())


def test_learn_is_deterministic(explored, tmp_path: Path) -> None:
    for name in ("one", "other"):
        save(learn_body([explored(3, 0.003, 15.0).features], Settings(), {"by": "test"}).model, tmp_path / name)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "other").read_bytes()


def test_learn_from_two_logs_is_better_than_one(explored) -> None:
    logs, test = [explored(seed, 0.003, 20.0) for seed in (1, 2)], explored(9, 0.003, 20.0)

    def error(features: Sequence[Features]) -> float:
        gp = learn_body(features, Settings(), {}).model.senses["effector"]
        return float(np.sqrt(np.mean((gp.predict(test.angles)[0] - test.pixels) ** 2)))

    assert error([run.features for run in logs]) < 0.9 * min(error([run.features]) for run in logs)


def test_learn_updates_a_body_from_another_log(explored) -> None:
    first, second, test = (explored(seed, 0.003, 20.0) for seed in (1, 2, 9))
    once = learn_body([first.features], Settings(), {})
    twice = learn_body([second.features], Settings(), {}, once.model)
    both = learn_body([first.features, second.features], Settings(), {})
    assert twice.model.joints == once.model.joints and len(twice.model.senses["effector"].samples) == 398

    def error(found: LearnedBody) -> float:
        value = found.model.senses["effector"].predict(test.angles)[0]
        return float(np.sqrt(np.mean((value - test.pixels) ** 2)))

    assert error(twice) < 0.9 * error(once)
    assert error(twice) == pytest.approx(error(both), rel=0.15)
    other = replace(second.features, joints=replace(second.features.joints, names=("pan", "lift", "e", "wrist")))
    with pytest.raises(ModelError, match="log 1 of 1: joint 'elbow' of the body to update is missing; it has pan"):
        learn_body([other], Settings(), {}, once.model)


def test_learn_models_every_named_track_except_the_hand(explored) -> None:
    features = explored(0, 0.003, 15.0).features
    track = features.tracks["effector"]
    knob = replace(track, values=0.5 * track.values)
    few = replace(track, t=track.t[:5], values=track.values[:5], std=None)
    tracks = {"effector": track, "knob": knob, "hand": track, "rare": few}
    found = learn_body([replace(features, tracks=tracks)], Settings(), {})
    assert set(found.model.senses) == {"effector", "knob"} == set(found.model.noise.senses)
    assert any(f.text.startswith("rare: left out: only 5 sightings with joint readings") for f in found.findings)


def test_thinning_is_reported_and_costs_little(explored) -> None:
    run = explored(0, 0.003)
    thin = learn_body([run.features], Settings(fit=FitSettings(samples=120)), {})
    assert len(thin.model.senses["effector"].samples) == 120
    assert any("120 of 400 sightings kept, which cover" in f.text for f in thin.findings)
    error = thin.model.senses["effector"].predict(run.angles)[0] - run.pixels
    assert np.sqrt(np.mean(error**2)) < 0.5


@pytest.mark.parametrize("seed", range(3))
def test_false_sightings_are_left_out_and_reported(explored, seed: int) -> None:
    run, draw = explored(seed, 0.003), np.random.default_rng(seed)
    track = run.features.tracks["effector"]
    wrong = draw.random(len(track.t)) < 0.04
    values = np.where(wrong[:, None], draw.uniform([0, 0], [320, 240], track.values.shape), track.values)
    found = learn_body([replace(run.features, tracks={"effector": replace(track, values=values)})], Settings(), {})
    error = found.model.senses["effector"].predict(run.angles)[0] - run.pixels
    assert np.sqrt(np.mean(error**2)) < 0.3
    texts = [f.text for f in found.findings if f.severity == "warning"]
    assert len(texts) == 1 and abs(int(texts[0].split()[1]) - wrong.sum()) <= 2


def test_sound_sightings_are_all_kept(learned: LearnedBody) -> None:
    assert not any(f.severity == "warning" for f in learned.findings)


def test_paper_preset_has_its_constants_and_its_error(explored) -> None:
    run = explored(0, 0.003)
    found = learn_body([run.features], Settings(fit=FitSettings(preset="paper")), {})
    gp = found.model.senses["effector"]
    assert np.allclose(gp.scales, np.exp(0.1)) and np.allclose(gp.noise, np.exp(0.04)) and len(gp.centres) == 46
    error = gp.predict(run.angles)[0] - run.pixels
    assert 5.0 < np.sqrt(np.mean(error**2)) < 40.0


def test_learn_keeps_a_named_still_joint_with_a_warning(explored) -> None:
    settings = Settings(body=BodySettings(joints=("pan", "lift", "elbow", "wrist")))
    found = learn_body([explored(0, 0.003, 20.0).features], settings, {})
    assert found.model.joints == settings.body.joints
    assert any(f.severity == "warning" and f.text.startswith("wrist: moved 0.0") for f in found.faint)
    gp = found.model.senses["effector"]
    here = gp.samples.mean(axis=0)
    near, far = gp.predict(np.array([here, here + np.eye(4)[3]]))[2]
    assert (far > 100 * near).all()


def test_learn_refuses_logs_without_samples(explored) -> None:
    features = explored(0, 0.003, 10.0).features
    with pytest.raises(EvidenceError, match="no track to learn from, though 3 joints moved"):
        learn_body([replace(features, tracks={})], Settings(), {})
    still = replace(features.joints, values=0 * features.joints.values)
    with pytest.raises(EvidenceError, match="no joint moved; the log has pan, lift, elbow, wrist"):
        learn_body([replace(features, joints=still)], Settings(), {})


def _with_readings(features: Features, column: int, value: float, rows: slice = slice(None)) -> Features:
    values = features.joints.values.copy()
    values[rows, column] = value
    return replace(features, joints=replace(features.joints, values=values))


def _warnings(found: LearnedBody) -> list[str]:
    return [f.text for f in found.findings if f.severity == "warning"]


def test_learn_names_a_joint_without_finite_readings(explored) -> None:
    features = _with_readings(explored(0, 0.003, 10.0).features, 2, np.nan)
    found = learn_body([features], Settings(), {})
    assert found.model.joints == ("pan", "lift")
    texts = "elbow: only 0 of 1000 readings in log 1 are numbers, 4 are needed"
    assert any(text.startswith(f"{texts}; left out") for text in _warnings(found))
    with pytest.raises(EvidenceError, match=rf"{texts}, but \[body\] joints names it"):
        learn_body([features], Settings(body=BodySettings(joints=("pan", "elbow"))), {})
    values = np.full_like(features.joints.values, np.nan)
    with pytest.raises(EvidenceError, match=r"no joint moved; the log has none \(pan: only 0 of 1000"):
        learn_body([replace(features, joints=replace(features.joints, values=values))], Settings(), {})


def test_impossible_readings_are_left_out_by_name(explored) -> None:
    whole = explored(0, 0.003, 10.0).features
    found = learn_body([_with_readings(whole, 1, 1e300, slice(100, 103))], Settings(), {})
    assert "lift: 3 of 1000 readings in log 1 left out: no joint reaches 1e+300 rad" in _warnings(found)
    without = learn_body([_with_readings(whole, 1, np.nan, slice(100, 103))], Settings(), {})
    assert found.model.joints == ("pan", "lift", "elbow")
    assert np.allclose(found.model.noise.encoder, without.model.noise.encoder, rtol=1e-6)


def test_logs_of_two_robots_are_refused(explored) -> None:
    features = explored(0, 0.003, 10.0).features
    other = replace(features, joints=replace(features.joints, names=("a", "b", "c", "d")))
    with pytest.raises(EvidenceError, match="share no joint: log 1 has pan, lift, elbow, wrist; log 2 has a, b, c, d"):
        learn_body([features, other], Settings(), {})


def test_learn_names_an_unselected_joint_that_moved(explored) -> None:
    found = learn_body([explored(0, 0.003, 10.0).features], Settings(body=BodySettings(joints=("pan", "lift"))), {})
    moved = [text for text in _warnings(found) if "not among the joints learned" in text]
    assert len(moved) == 1 and moved[0].startswith("elbow: moved ")


@pytest.mark.parametrize("encoder", first_of(1, [0.02, 0.0005]))
@pytest.mark.parametrize("seeds", [4, pytest.param(20, marks=pytest.mark.soak)])
def test_learned_body_has_true_error_bars(explored, encoder: float, seeds: int) -> None:
    runs = [standardise_residuals(explored, encoder, seed) for seed in range(seeds)]
    # the bound is for 20 runs together; 4 of them scatter more
    slack = 1.0 if seeds == 20 else 1.5
    for name in runs[0]:
        variance = np.array([np.mean(run[name]) for run in runs])
        covered = np.array([np.mean(run[name] < 4) for run in runs])
        for what, each in (("variance", variance), ("within 2 sigma", covered)):
            spread = f"{each.std(ddof=1):.3f} ({each.min():.3f} to {each.max():.3f})"
            print(f"{encoder} rad, {name}: {what} {each.mean():.3f}, over seeds {spread}")
        assert abs(variance.mean() - 1.0) < 0.2 * slack, name
        assert 0.95 - 0.03 * slack < covered.mean() < 0.95 + 0.03 * slack, name


@pytest.mark.skipif(not _ARM.is_dir(), reason="the recorded arm (../shared/logs/arm) is not at hand")
def test_recorded_arm_is_predicted_along_paths_it_never_took() -> None:
    read = recording.read_recording(_ARM / "explore.mcap", Settings())
    model = learn_body([perception.observe_recording(read, Settings())], Settings(), {}).model
    order = [("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint").index(name) for name in model.joints]
    for log, allowed in (("reach.mcap", 0.3), ("drift.mcap", 0.3), ("reach.bag", 0.3), ("touch.mcap", 0.3)):
        with np.load(_ARM / f"{log}.truth.npz") as truth:
            angles = np.column_stack([np.interp(truth["tf"], truth["t"], truth["x"][:, k]) for k in order])
            seen = truth["seen"] > 0
            error = model.senses["effector"].predict(angles)[0][seen] - truth["ee"][seen]
        assert np.sqrt(np.mean(error**2)) < allowed, log


def test_learn_keeps_the_image_width_if_all_logs_agree(explored) -> None:
    features = explored(0, 0.003, 15.0).features
    wide, other = (replace(features, picture_size=(width, 240)) for width in (320, 640))
    known = learn_body([wide], Settings(), {"by": "test"}).model.provenance
    assert {**known, "held": None} == {"image_width": 320, "by": "test", "held": None}
    assert "image_width" not in learn_body([wide, other], Settings(), {}).model.provenance
    assert "image_width" not in learn_body([features], Settings(), {}).model.provenance


def test_encoders_that_read_squares_are_estimated_with_the_model_given(explored, tmp_path: Path) -> None:
    run = explored(0, 0.003, 20.0)
    model = learn_body([run.features], Settings(), {}).model
    read = Polynomial(model.joints, np.tile([0.0, 0.0, 1.0], (3, 1)))
    save(replace(model, senses={**model.senses, "encoders": read}), tmp_path / "body.npz")
    t, at = np.arange(0, 15, 0.02), np.array([0.6, 0.5, 0.7])
    noise = np.random.default_rng(0).normal(0, 0.01, (len(t), 3))
    squared = Series(t, at**2 + noise, model.joints, "rad", (t * 1e9).astype(np.int64))
    features = replace(run.features, joints=squared, tracks={})
    asked = EstimationSettings(method="predictive-coding", senses=("encoders",), start=(0.4, 0.7, 0.9))
    found = estimate_from_features(features, load_body(tmp_path / "body.npz"), asked)
    assert np.abs(found.joints.values[-20:].mean(axis=0) - at).max() < 0.02


def test_update_keeps_given_senses_and_touch(explored) -> None:
    features = explored(0, 0.003, 15.0).features
    once = learn_body([features], Settings(), {}).model
    read = Polynomial(once.joints, np.tile([0.0, 1.0], (3, 1)))
    felt = TouchConstants(1.0, 0.001)
    known = replace(once, senses={**once.senses, "encoders": read}, touch=felt, cells={7: (0.0, -30.0, 9.0)})
    again = learn_body([features], Settings(), {}, known).model
    assert again.senses["encoders"] is read and set(again.senses) == {"effector", "encoders"}
    assert (again.touch, again.cells) == (felt, known.cells)


def test_learn_uses_what_precedes_silent_encoders(explored) -> None:
    run = explored(0, 0.003)
    readings = run.features.joints
    values = readings.values.copy()
    values[(readings.t > 12.0) & (readings.t < 26.0)] = np.nan
    learned = learn_body([replace(run.features, joints=replace(readings, values=values))], Settings(), {})
    error = learned.model.senses["effector"].predict(run.angles)[0] - run.pixels
    assert np.median(np.abs(error)) < 0.3
    assert 0.5 < _scores(learned)["used_share/effector"] < 0.75
