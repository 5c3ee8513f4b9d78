"""Camera delays: measured or given, reported, and corrected so that the estimate is as good as without."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.errors import ModelError, UsageError
from bodylog.estimation import METHODS, estimate_from_features
from bodylog.evaluation.heldout import score_withheld_frames, withhold_frames
from bodylog.evaluation.scores import against_truth
from bodylog.settings import EstimationSettings
from tests.estimation import mechanisms
from tests.estimation.spoilt_logs import delayed
from tests.seeds import first_of


def nees(found, drawn):
    return score(found, drawn, "nees/joint")


def score(found, drawn, name):
    return next(s.value for s in against_truth(found, drawn.truth, list(drawn.truth.names)) if s.name == name)


def delay_texts(found, severity="warning"):
    return [f.text for f in found.findings if f.severity == severity and "image timestamps" in f.text]


def with_side(drawn):
    """A second camera that sees what the first does, mirrored."""
    track, arm = drawn.features.tracks["effector"], drawn.body.senses["effector"]

    class Mirrored:
        outputs = ("u", "v")

        def predict(self, x):
            mean, jac, var = arm.predict(x)
            return mean[:, ::-1], jac[:, ::-1], var

    rng = np.random.default_rng(7)
    seen = track.values[:, ::-1] + rng.normal(0.0, 0.1, track.values.shape)
    features = replace(drawn.features, tracks={"effector": track, "side/effector": replace(track, values=seen)})
    body = replace(drawn.body, senses={**drawn.body.senses, "side/effector": Mirrored()})
    return replace(drawn, features=features, body=body)


@pytest.mark.parametrize("method", METHODS)
def test_delay_correction_leaves_sound_logs_unchanged(world, method):
    drawn, settings = world(0, duration=8.0), EstimationSettings(method=method)
    auto, off = (estimate_from_features(drawn.features, drawn.body, settings, delay) for delay in ("auto", "off"))
    assert not delay_texts(auto) and "delay" not in auto.settings
    for one in ("joints", "rate"):
        assert np.array_equal(getattr(auto, one).values, getattr(off, one).values)
    assert np.array_equal(auto.cov, off.cov) and np.array_equal(auto.free_energy, off.free_energy)


@pytest.mark.parametrize(
    ("method", "seconds"),
    [
        ("filter", -0.1),
        ("smoother", 0.05),
        pytest.param("filter", 0.05, marks=pytest.mark.soak),
        pytest.param("ekf", 0.2, marks=pytest.mark.soak),
    ],
)
def test_delay_is_reported_and_corrected(world, method, seconds):
    settings, truly, found_to_be = EstimationSettings(method=method), [], []
    for seed in range(2):
        drawn = world(seed, camera_hz=20.0)
        features = delayed(drawn.features, seconds)
        found = estimate_from_features(features, drawn.body, settings)
        (text,) = delay_texts(found)
        assert text.startswith("camera: image timestamps ") and "--delay off" in text
        assert (" lag the encoders" in text) == (seconds > 0)
        assert abs(found.settings["delay"]["camera"] - seconds) < 4.0 * found.settings["delay_std"]["camera"]
        track = features.tracks["effector"]
        assert np.array_equal(found.predicted["effector"].t, track.t)
        assert np.array_equal(found.errors["effector"].t, track.t)
        truly.append(nees(estimate_from_features(drawn.features, drawn.body, settings), drawn))
        found_to_be.append(nees(found, drawn))
        # with a long delay the images' noise is learned so large that error bars are true, but errors are larger
        left = estimate_from_features(features, drawn.body, replace(settings, bias="off"), "off")
        assert score(left, drawn, "rmse/joint") > 1.3 * score(found, drawn, "rmse/joint")
    assert np.mean(found_to_be) == pytest.approx(np.mean(truly), abs=0.2)


@pytest.mark.parametrize("seed", [pytest.param(0, marks=pytest.mark.soak), 1])
@pytest.mark.soak
def test_a_delay_that_is_not_believed_is_reported_with_its_error_and_why(world, seed):
    drawn = world(seed, camera_hz=20.0)
    track = drawn.features.tracks["effector"]
    late = track.t > np.median(track.t)
    stepped = replace(track, t=track.t + 0.1 * late)
    features = replace(drawn.features, tracks={"effector": stepped})
    found = estimate_from_features(features, drawn.body, EstimationSettings())
    measured = found.settings["delay_measured"]["camera"]
    (text,) = (f.text for f in found.findings if "not applied, because" in f.text)
    assert f"{abs(measured['seconds']):.4f} ± {measured['std_error']:.4f} s, not applied" in text
    assert "delay" not in found.settings and measured["doubt"] in text


@pytest.mark.soak
def test_a_late_camera_of_a_real_arm_is_never_dropped_in_silence():
    body = mechanisms.learned(1000, mechanisms.REALISTIC)
    for seed in range(2):
        sound = mechanisms.replayed(seed, mechanisms.REALISTIC, mechanisms.Fault())
        found = estimate_from_features(delayed(sound, 0.04), body, EstimationSettings())
        measured = found.settings["delay_measured"]["camera"]
        assert measured["std_error"] > 0.0
        assert any(f"{measured['seconds']:.4f} ±" in f.text for f in found.findings)


def test_delay_is_measured_for_each_camera(world):
    drawn = with_side(world(1, camera_hz=20.0))
    for own in ({"": 0.05, "side": -0.03}, {"": 0.0, "side": 0.04}, {"": 0.06, "side": 0.06}):
        found = estimate_from_features(delayed(drawn.features, own), drawn.body, EstimationSettings())
        by_name = {name or "camera": seconds for name, seconds in own.items() if seconds}
        assert found.settings["delay"] == pytest.approx(by_name, abs=0.01)
        assert sorted(text.partition(":")[0] for text in delay_texts(found)) == sorted(by_name)


def test_given_delays_are_used_and_contradicted_where_the_log_knows_better(world):
    drawn = world(2, camera_hz=20.0, duration=10.0)
    features = delayed(drawn.features, 0.05)
    right = estimate_from_features(features, drawn.body, EstimationSettings(), {"camera": 0.05})
    sound = estimate_from_features(drawn.features, drawn.body, EstimationSettings())
    assert not delay_texts(right) and right.settings["delay"] == {"camera": 0.05}
    np.testing.assert_allclose(right.joints.values, sound.joints.values, atol=1e-9)
    np.testing.assert_allclose(right.cov, sound.cov, atol=1e-12)
    off = "not corrected"
    for given, named in (({"camera": 0.0}, off), ({"camera": 0.12}, "--delay camera=0.12"), ("off", off)):
        wrong = estimate_from_features(features, drawn.body, EstimationSettings(bias="off"), given)
        (text,) = delay_texts(wrong)
        assert named in text and float(text.rpartition("type --delay camera=")[2]) == pytest.approx(0.05, abs=0.01)
    (text,) = delay_texts(estimate_from_features(drawn.features, drawn.body, EstimationSettings(bias="off"), {"camera": 0.05}))
    assert text.endswith("type --delay camera=0")  # independent of the delay that the log happens to show
    with pytest.raises(UsageError, match=r"delay: 'left' found, possible: joints, camera; type --delay camera=0\.05"):
        estimate_from_features(features, drawn.body, EstimationSettings(), {"left": 0.05})


def test_given_joint_delays_are_corrected(world):
    drawn = world(3, camera_hz=20.0, duration=10.0)
    joints = drawn.features.joints
    behind = replace(drawn.features, joints=replace(joints, t=joints.t + 0.05))
    found = estimate_from_features(behind, drawn.body, EstimationSettings(), {"joints": 0.05})
    assert not delay_texts(found)
    np.testing.assert_allclose(found.joints.t, joints.t, atol=1e-12)
    sound = nees(estimate_from_features(drawn.features, drawn.body, EstimationSettings()), drawn)
    assert nees(found, drawn) == pytest.approx(sound, rel=1e-3)


def test_body_delay_applies_to_logs_consistent_with_it(world):
    drawn, still = world(4, camera_hz=20.0), world(4, speed=0.0, duration=6.0)
    body = replace(drawn.body, provenance={"delay": {"camera": 0.05}})
    for one in (drawn, still):
        found = estimate_from_features(delayed(one.features, 0.05), body, EstimationSettings())
        assert not delay_texts(found) and found.settings["delay"] == {"camera": 0.05}
        late = "camera: image timestamps lag the encoders by 0.0500 s"
        first, *rest = delay_texts(found, "info")
        assert first == f"{late}, as in the exploration log, corrected"
        assert all("0.0500 s corrected" in text and "not significant" in text for text in rest)
    mended = estimate_from_features(drawn.features, body, EstimationSettings())
    assert not delay_texts(mended) and "delay" not in mended.settings
    other = estimate_from_features(delayed(drawn.features, -0.1), body, EstimationSettings())
    assert other.settings["delay"]["camera"] == pytest.approx(-0.1, abs=0.01) and delay_texts(other)
    for wrong in ("late", {"camera": "late"}, {"camera": np.inf}, {"camera": True, "side": 1e9}):
        with pytest.raises(ModelError, match=r"provenance\.delay: found"):
            estimate_from_features(drawn.features, replace(body, provenance={"delay": wrong}), EstimationSettings())


def test_error_bars_include_the_delays_uncertainty(world):
    drawn = world(5, camera_hz=20.0)
    features = delayed(drawn.features, 0.06)
    found = estimate_from_features(features, drawn.body, EstimationSettings(method="smoother"))
    given = estimate_from_features(features, drawn.body, EstimationSettings(method="smoother"), found.settings["delay"])
    more = np.einsum("ni,nj->nij", found.rate.values, found.rate.values) * found.settings["delay_std"]["camera"] ** 2
    np.testing.assert_allclose(found.cov, given.cov + more, atol=1e-15)
    assert (np.einsum("nii->n", more) > 0.0).mean() > 0.99


def test_held_out_images_are_predicted_at_their_corrected_time(world):
    drawn = world(6, camera_hz=20.0)
    for senses in (None, ("encoders",)):
        settings, density = EstimationSettings(senses=senses), []
        for features in (drawn.features, delayed(drawn.features, 0.1)):
            fewer, withheld = withhold_frames(features)
            (score,) = score_withheld_frames(estimate_from_features(fewer, drawn.body, settings), withheld, drawn.body)
            density.append(score.value)
        assert density[1] == pytest.approx(density[0], abs=0.1)


@pytest.mark.parametrize("seed", first_of(1, [6200, 6103, 6107]))
@pytest.mark.parametrize("late", first_of(1, [0.04, 0.0]))
def test_a_drift_that_begins_in_the_log_is_no_delay_and_hides_none(seed, late):
    """Before the drift is known, the first two show delays of 23.1 ± 2.8 and 21.6 ± 4.4 ms."""
    drifts = mechanisms.Fault(1, drift=0.01)
    features = delayed(mechanisms.replayed(seed, mechanisms.SOUND, drifts), late)
    body = mechanisms.learned(7699, mechanisms.SOUND)
    found = estimate_from_features(features, body, EstimationSettings())
    assert [fault.name for fault in found.faults] == ["lift"]
    seconds, std = (found.settings.get(name, {}).get("camera") for name in ("delay", "delay_std"))
    assert (seconds is None) if late == 0.0 else abs(seconds - late) < 3.5 * std
    errors, nees = mechanisms.errors_and_nees(found, mechanisms.links_of(seed, mechanisms.SOUND, drifts))
    assert nees < 2.0 and np.sqrt(np.mean(errors**2)) < 2.5e-3
