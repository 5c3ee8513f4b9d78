"""Faulty encoders: named with kind, time and size, and replaced by vision."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from bodylog.estimation import estimate_from_features
from bodylog.estimation.faults.jumping import find_jumps, unwrap_turns
from bodylog.estimation.faults.repeats import find_final_silence, find_frozen_readings
from bodylog.estimation.faults.screening import screen_measurements
from bodylog.estimation.faults.threshold import EVIDENCE_THRESHOLD_NATS
from bodylog.findings import misfit
from bodylog.findings.faults import fault_warnings
from bodylog.findings.verdict import verdict_of_estimate
from bodylog.settings import EstimationSettings
from tests.estimation.conftest import Linear
from tests.estimation.resting import Drawn, drawn, judged
from tests.seeds import first_of, seeds


def spoil(drawn, change, joint="pan"):
    joints = drawn.features.joints
    values = joints.values.copy()
    change(joints.t, values[:, joints.names.index(joint)])
    return replace(drawn.features, joints=replace(joints, values=values))


def freeze(t, y):
    y[t >= 8.0] = y[np.searchsorted(t, 8.0)]


def die(t, y):
    y[t >= 9.0] = np.nan


def jump(t, y):
    y[t >= 7.0] -= 0.2


def homed_late(t, y):
    y[t < 4.0] += 0.15


def fall_to_zero(t, y):
    y[t >= 8.0] = 0.0


def step(t, y):
    y[t >= 8.0] += 0.1


def drift(t, y):
    y += np.clip((t - 6.0) * 0.02, 0.0, None)


def return_to_zero(t, y):
    y[(t >= 7.0) & (t < 7.3)] = 0.0


HYPOTHESES = {
    "frozen": "encoder frozen", "dead": "encoder dead", "jumping": "encoder jumped", "glitch": "encoder jumped",
    "drifting": "encoder drift",
}  # fmt: skip
"""Kinds of fault and the hypotheses that they are."""


@pytest.mark.parametrize(
    ("change", "kind", "since", "late", "size"),
    [
        (freeze, "frozen", 8.0, 0.1, 0.0),
        (die, "dead", 9.0, 0.1, 0.0),
        (fall_to_zero, "dead", 8.0, 0.01, 0.0),
        (jump, "jumping", 7.0, 0.01, -0.2),
        (return_to_zero, "glitch", 7.0, 0.01, 1.10),
        (drift, "drifting", 6.5, 2.0, 0.14),
    ],
)
def test_faulty_encoder_is_named_and_replaced(world, change, kind, since, late, size):
    drawn = world(4, duration=13.0, encoder_std=0.005, pixel_std=0.5, camera_hz=30.0)
    found = estimate_from_features(spoil(drawn, change), drawn.body, EstimationSettings())
    assert [(f.name, f.kind) for f in found.faults] == [("pan", kind)]
    assert since - 0.5 * late - 0.03 <= found.faults[0].since <= since + late
    assert found.faults[0].size == pytest.approx(size, abs=0.02)
    error = np.sqrt(np.mean((found.joints.values - drawn.truth.values)[:, 0] ** 2))
    assert error < 0.006
    assert chosen(found) == [(HYPOTHESES[kind], "pan")]


@pytest.mark.parametrize("method", ["filter", "smoother"])
@pytest.mark.parametrize("seed", [1, 2])
def test_zeros_before_an_encoders_first_reading_are_removed(world, method, seed):
    drawn = world(seed, duration=8.0, encoder_std=0.002)
    joints, settings, errors = drawn.features.joints, EstimationSettings(method=method), []
    for late in ([], [2], [0, 1, 2]):
        values = joints.values.copy()
        values[np.ix_(joints.t < joints.t[0] + 0.3, late)] = 0.0
        found = estimate_from_features(
            replace(drawn.features, joints=replace(joints, values=values)), drawn.body, settings
        )
        assert sorted(f.name for f in found.faults) == sorted(joints.names[k] for k in late)
        assert all(f.kind == "glitch" and f.since < 0.05 for f in found.faults)
        each = (found.joints.values - drawn.truth.values) ** 2
        errors.append(np.sqrt([each[found.joints.t > 1.0].mean(), each.mean()]))
    assert all(later < 1.1 * errors[0][0] for later, _ in errors)
    # until the first reading there are only images: zeros as the initial mean err by .06 to .12
    assert all(whole < 0.02 for _, whole in errors), errors


@pytest.mark.parametrize("method", ["filter", "smoother"])
@pytest.mark.parametrize(("silent", "count"), first_of(2, [(0, 4), (60, 2), (0, 1), (0, 2), (60, 10)]))
def test_false_readings_where_encoders_begin_or_resume_are_removed(world, method, silent, count):
    """As many before a gap of so many readings as show a level, or at the start of the log: a driver that starts again."""
    errors = []
    for false in (0, count):
        each = []
        for seed in (1, 2):
            drawn = world(seed, duration=8.0, encoder_std=0.003)
            joints = drawn.features.joints
            values = joints.values.copy()
            first = 300 if silent else 0
            values[first : first + silent] = np.nan
            first += silent
            values[first : first + false, 1] += 0.5
            features = replace(drawn.features, joints=replace(joints, values=values))
            found = estimate_from_features(features, drawn.body, EstimationSettings(method=method))
            assert [(one.name, str(one.kind)) for one in found.faults] == [(joints.names[1], "glitch")] * bool(false)
            each.append(judged(drawn, found.joints, found.cov)[0])
        errors.append(np.mean(each))
    # a filter has a few readings less
    assert errors[1] < 1.5 * errors[0], errors


def chosen(found):
    """Hypotheses of encoders that are chosen; each one wins the threshold."""
    won = [
        one
        for one in found.settings["hypotheses"]
        if one["chosen"] and one["name"].startswith("encoder")
    ]
    assert all(one["nats"] > one["threshold"] == EVIDENCE_THRESHOLD_NATS for one in won)
    return [(one["name"], one["about"]) for one in won]


@pytest.mark.parametrize("seed", range(2))
def test_every_hypothesis_stands_in_the_settings_of_a_sound_log(world, seed):
    drawn = world(seed, duration=10.0, encoder_std=0.01, camera_hz=20.0)
    found = estimate_from_features(drawn.features, drawn.body, EstimationSettings())
    listed = [(one["name"], one["about"]) for one in found.settings["hypotheses"]]
    kinds = ("encoder frozen", "encoder dead", "encoder jumped", "encoder offset")
    cameras = [("camera late", "camera"), ("camera moved", "camera"), ("white jerk", "joints")]
    joints = [(kind, joint) for kind in kinds for joint in ("pan", "lift", "elbow")]
    assert sorted(listed) == sorted([*cameras, *joints])
    assert not chosen(found) and all(
        np.isfinite(one["nats"]) for one in found.settings["hypotheses"]
    )


def test_encoder_step_is_weighed_against_a_wandering_offset(world):
    drawn = world(1, duration=14.0, encoder_std=0.01, camera_hz=20.0)
    found = estimate_from_features(spoil(drawn, step), drawn.body, EstimationSettings())
    nats = {
        one["name"]: one["nats"] for one in found.settings["hypotheses"] if one["about"] == "pan"
    }
    assert (
        chosen(found) == [("encoder step", "pan")]
        and nats["encoder step"] > nats["encoder offset"] > EVIDENCE_THRESHOLD_NATS
    )


@pytest.mark.parametrize("method", ["kalman", "predictive-coding"])
@pytest.mark.parametrize(
    ("change", "kind"), [(freeze, "frozen"), (die, "dead"), (jump, "jumping"), (None, None)]
)
def test_methods_without_repair_name_faults_by_readings_alone(world, method, change, kind):
    drawn = world(4, duration=13.0, encoder_std=0.005, pixel_std=0.5, camera_hz=30.0)
    features = drawn.features if change is None else spoil(drawn, change)
    found = estimate_from_features(features, drawn.body, EstimationSettings(method=method))
    assert [(f.name, f.kind) for f in found.faults] == ([("pan", kind)] if kind else [])


def test_sharp_images_do_not_hide_a_drift(world):
    drawn = world(1, duration=14.0, encoder_std=0.01, pixel_std=0.05, camera_hz=20.0)
    (fault,) = estimate_from_features(spoil(drawn, drift), drawn.body, EstimationSettings()).faults
    assert (fault.name, fault.kind) == ("pan", "drifting")
    assert abs(fault.since - 6.0) < 0.5


@pytest.mark.parametrize("seed", [2, 3])
def test_encoder_step_is_not_attributed_to_blurred_images(world, seed):
    drawn = world(seed, duration=16.0, encoder_std=0.02, pixel_std=0.5, camera_hz=20.0)
    found = estimate_from_features(spoil(drawn, step), drawn.body, EstimationSettings())
    assert [fault.name for fault in found.faults] == ["pan"]
    assert found.faults[0].size == pytest.approx(0.1, abs=0.02)
    assert np.sqrt(np.mean((found.joints.values - drawn.truth.values)[:, 0] ** 2)) < 0.015


@pytest.mark.parametrize("seed", range(3))
def test_sound_encoders_have_no_fault(world, seed):
    drawn = world(seed, duration=12.0, hidden=(6.0, 8.0), blunder=0.02)
    assert not estimate_from_features(drawn.features, drawn.body, EstimationSettings()).faults


def test_frozen_encoder_adds_less_than_three_milliradians(world):
    for joint in ("pan", "lift", "elbow"):
        drawn = world(0, duration=16.0, encoder_std=0.001, pixel_std=0.5, camera_hz=30.0)
        found = estimate_from_features(
            spoil(drawn, freeze, joint), drawn.body, EstimationSettings()
        )
        assert [(fault.name, fault.kind) for fault in found.faults] == [(joint, "frozen")]
        assert np.sqrt(np.mean((found.joints.values - drawn.truth.values) ** 2)) < 3e-3


def frozen(t, y):
    """Stretches of repeats that are a fault by the readings alone."""
    return [
        one[1:3]
        for one in find_frozen_readings(t, y, lambda begin, end: 0.0)
        if one.nats > EVIDENCE_THRESHOLD_NATS
    ]


def test_frozen_ignores_an_ideal_encoder_at_rest():
    t = np.arange(0.0, 10.0, 0.02)
    smooth = np.where(t < 5.0, np.sin(t), np.sin(5.0))
    assert frozen(t, smooth) == []
    noisy = np.sin(t) + np.random.default_rng(0).normal(0, 1e-3, len(t))
    noisy[200:260] = noisy[200]
    assert frozen(t, noisy) == [(201, 260)]


def test_jumps_ignores_a_single_spike():
    y = np.random.default_rng(1).normal(0, 0.01, 400)
    t = np.arange(400) / 50.0
    y[200] += 1.0
    assert find_jumps(t, y) == []
    y[250:] += 0.5
    ((at, size, _),) = find_jumps(t, y)
    assert at == 250 and size == pytest.approx(0.5, abs=0.05)


def test_jumps_ignores_a_new_angle_after_a_gap():
    t = np.arange(0.0, 20.0, 0.02)
    y = np.sin(t) + np.random.default_rng(2).normal(0, 0.01, len(t))
    read = (t < 6.0) | (t > 9.0)
    assert find_jumps(t[read], y[read]) == []
    assert find_jumps(t, np.where(read, y, np.nan)) == []


def test_jumps_ignores_the_steps_of_a_coarse_encoder():
    t = np.arange(0.0, 20.0, 0.02)
    y = np.round(0.2 * np.sin(t / 2) / 0.01) * 0.01
    assert np.mean(np.diff(y) == 0.0) > 0.5
    assert find_jumps(t, y) == []
    y[600:] += 0.3
    ((at, size, _),) = find_jumps(t, y)
    assert at == 600 and size == pytest.approx(0.3, abs=0.02)


def test_offsets_on_request_are_reported_for_every_joint(world):
    drawn = world(0, duration=6.0)
    found = estimate_from_features(drawn.features, drawn.body, EstimationSettings(bias="on"))
    assert found.bias is not None and found.bias.names == drawn.body.joints
    assert np.abs(found.bias.values).max() < 0.05
    assert (
        estimate_from_features(drawn.features, drawn.body, EstimationSettings(bias="off")).bias
        is None
    )


def test_frozen_ignores_an_encoder_that_dithers_before_resting():
    rng, t = np.random.default_rng(3), np.arange(0.0, 20.0, 0.02)
    angle = 0.3 * np.sin(np.minimum(t, 8.0)) + rng.normal(0, 1e-3, len(t))
    y = np.round(angle / 1.5e-3) * 1.5e-3
    y[t > 9.0] = y[-1]
    assert frozen(t, y) == []


def test_jumps_ignores_a_fast_joint():
    t = np.arange(0.0, 10.0, 0.055)
    servo = np.where(t < 5.0, 0.3, 0.35) + 0.2 * (t > 7.0)
    assert find_jumps(t, np.round(servo / 1.5e-3) * 1.5e-3) == []
    slow = np.repeat(np.sin(np.arange(0.0, 20.0, 0.05)), 25)  # read at 500 Hz, sampled at 20 Hz
    assert find_jumps(np.arange(len(slow)) * 2e-3, slow) == []


def test_whole_turns_are_unwrapped_and_are_no_jumps(world):
    y = np.linspace(0.0, 20.0, 500)
    wrapped = (y + np.pi) % (2.0 * np.pi) - np.pi
    np.testing.assert_allclose(unwrap_turns(wrapped), y, atol=1e-9)
    sound = world(0, duration=8.0)
    features = spoil(sound, lambda t, v: np.copyto(v, np.where(t > 4.0, v - 2.0 * np.pi, v)))
    assert not estimate_from_features(features, sound.body, EstimationSettings()).faults


def test_silent_ignores_an_encoder_with_rare_readings():
    t = np.arange(0.0, 10.0, 0.02)
    seldom = np.where(np.arange(len(t)) % 40 == 0, 0.1, np.nan)
    seldom[t > 8.9] = np.nan
    assert find_final_silence(t, seldom).nats < EVIDENCE_THRESHOLD_NATS
    dead = find_final_silence(t, np.where(t < 6.0, 0.1, np.nan))
    assert t[dead.begin] == pytest.approx(5.98) and dead.nats > EVIDENCE_THRESHOLD_NATS


@pytest.mark.parametrize("moves", ["sines", "reach"])
@pytest.mark.parametrize("joint", first_of(1, [0, 1, 2]))
@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("first", seeds(1, 2))
def test_images_separate_a_frozen_encoder_from_a_coarse_one_at_rest(moves, joint, noise, first):
    for seed in range(3 * first, 3 * first + 3):
        assert_frozen_encoder_is_separated(drawn(seed, Drawn(moves, 1.5e-3, noise)), joint)


def assert_frozen_encoder_is_separated(sound, joint):
    name = sound.features.joints.names[joint]
    found = estimate_from_features(spoil(sound, freeze, name), sound.body, EstimationSettings())
    assert [(f.name, f.kind) for f in found.faults] == [(name, "frozen")]
    error, nees = judged(sound, found.joints, found.cov)
    assert error < 0.02  # 0.06 to 0.14 rad without the fault's detection
    assert nees < 2.0


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_images_show_a_frozen_encoder_whose_joint_moves_past_a_fold_of_the_image(noise):
    """By 0.7 rad: steps from no motion lead elsewhere, and the encoder is believed."""
    assert_frozen_encoder_is_separated(drawn(31, Drawn("reach", 1.5e-3, noise)), 1)


@pytest.mark.parametrize("gaps", [0, 2])
@pytest.mark.parametrize("joint", first_of(1, [0, 1, 2]))
@pytest.mark.parametrize("method", ["filter", "smoother"])
def test_joints_that_rested_move_while_their_encoders_are_silent(method, joint, gaps):
    """The first reach of pan and elbow is in a gap of all encoders, or begins where its encoder freezes."""
    sound = drawn(41, Drawn("reach", 1.5e-3, 1e-3, gaps=gaps))
    name = sound.features.joints.names[joint]
    features = spoil(sound, lambda t, y: np.copyto(y, y[np.searchsorted(t, 4.0)], where=t >= 4.0), name)
    found = estimate_from_features(features, sound.body, EstimationSettings(method=method))
    assert [(f.name, f.kind) for f in found.faults] == [(name, "frozen")]
    error, nees = judged(sound, found.joints, found.cov)
    assert error < 0.01  # up to 0.035 rad by the joint's own process variance
    assert nees < 2.0  # and 1350


@pytest.mark.parametrize("joint", ["pan", "lift", "elbow"])
def test_constant_offset_is_found_over_the_whole_log(world, joint):
    drawn = world(0, duration=16.0, encoder_std=0.01)
    (fault,) = estimate_from_features(
        spoil(drawn, lambda _, y: np.add(y, 0.0873, out=y), joint), drawn.body, EstimationSettings()
    ).faults
    assert fault.name == joint and fault.size == pytest.approx(0.0873, abs=0.004)


@pytest.mark.parametrize(("joint", "named"), [("lift", {"lift", "elbow"}), ("pan", {"pan"})])
@pytest.mark.parametrize("seed", [0, 1])
def test_ambiguous_joints_are_both_named_without_a_size(world, joint, named, seed):
    similar = Linear(
        np.array([[300.0, 120.0, 120.0], [15.0, 250.0, 250.0]]), np.array([160.0, 120.0])
    )
    drawn = world(seed, duration=16.0, encoder_std=0.01, model=similar)
    (fault,) = estimate_from_features(
        spoil(drawn, lambda _, y: np.add(y, 0.0873, out=y), joint), drawn.body, EstimationSettings()
    ).faults
    assert set(fault.name.split(" or ")) == named and np.isnan(fault.size) == (len(named) > 1)


@pytest.mark.parametrize("method", ["filter", "smoother"])
@pytest.mark.parametrize(
    ("senses", "noise", "size"),
    first_of(
        2,
        [
            (None, 0.02, 0.8),
            (("encoders",), 0.005, -0.2),
            (("encoders",), 0.02, 0.8),
            (None, 0.001, 0.06),
        ],
    ),
)
def test_a_repaired_jump_adds_its_own_uncertainty(world, method, senses, noise, size):
    spread, shares = [], []
    for seed in range(3):
        drawn = world(seed, duration=12.0, encoder_std=noise, camera_hz=12.0)
        features = spoil(drawn, lambda t, y: np.add(y, size, out=y, where=t >= 6.0))
        found = estimate_from_features(
            features, drawn.body, EstimationSettings(senses=senses, method=method)
        )
        (fault,) = found.faults
        assert (fault.name, fault.kind) == ("pan", "jumping")
        shares.append(abs(fault.size - size) / fault.std)
        late = found.joints.t > 6.2
        error = (found.joints.values - drawn.truth.values)[late, 0]
        spread.append(np.mean(error**2 / found.cov[late, 0, 0]))
    assert max(shares) < 3.0 and 0.5 < np.mean(spread) < 2.0


@pytest.mark.parametrize("method", ["filter", "smoother"])
@pytest.mark.parametrize("late", [["elbow"], ["pan", "lift", "elbow"]])
@pytest.mark.parametrize("seed", seeds(1, 3))
def test_encoders_that_are_homed_late_are_wrong_before_they_jump(world, method, late, seed):
    """Readings after each jump were taken for the wrong ones: 135 mrad, and a camera that moved."""
    drawn = world(seed, duration=12.0, encoder_std=0.002, camera_hz=20.0)
    features = drawn.features
    for k, name in enumerate(late):
        homed = partial(lambda size, t, y: np.add(y, size, out=y, where=t < 4.0), 0.15 * (-1) ** k)
        features = spoil(replace(drawn, features=features), homed, name)
    found = estimate_from_features(features, drawn.body, EstimationSettings(method=method))
    assert sorted(fault.name for fault in found.faults) == sorted(late)
    for fault in found.faults:
        assert (fault.kind, fault.since) == ("jumping", pytest.approx(0.0, abs=0.03))
        assert fault.until == pytest.approx(4.0, abs=0.03)
        assert abs(fault.size - 0.15 * (-1) ** late.index(fault.name)) < 4.0 * fault.std
    error = found.joints.values - drawn.truth.values
    assert np.sqrt(np.mean(error**2)) < 0.003
    assert 0.2 < np.mean(error**2 / np.einsum("nii->ni", found.cov)) < 1.6
    settings = EstimationSettings()
    assert misfit.from_many_faults(found, features, drawn.body, settings, "auto") is None
    assert misfit.find_misfit(features, drawn.body, settings) is None


@pytest.mark.parametrize("seed", seeds(1, 2))
def test_the_stretch_between_two_jumps_may_be_the_true_one(world, seed):
    def homed_twice(t, y):
        y[t < 3.0] += 0.2
        y[t >= 9.0] -= 0.1

    drawn = world(seed, duration=12.0, encoder_std=0.002, camera_hz=20.0)
    found = estimate_from_features(spoil(drawn, homed_twice), drawn.body, EstimationSettings())
    first, second = sorted(found.faults, key=lambda fault: fault.since)
    assert (first.size, first.until) == (pytest.approx(0.2, abs=0.01), pytest.approx(3.0, abs=0.03))
    assert (second.size, second.until) == (pytest.approx(-0.1, abs=0.01), None)
    assert second.since == pytest.approx(9.0, abs=0.03)
    assert np.sqrt(np.mean((found.joints.values - drawn.truth.values) ** 2)) < 0.003


@pytest.mark.parametrize("method", ["filter", "smoother"])
@pytest.mark.parametrize("returns_in_gap", [False, True])
@pytest.mark.parametrize("seed", seeds(1, 3))
def test_a_jump_that_hides_in_a_gap_is_found_by_the_jump_that_undoes_it(world, method, returns_in_gap, seed):
    """Readings behind the visible jump were all taken for wrong ones: 85 to 230 mrad."""

    def start_again(t, y):
        y[(t >= 6.0) & (t < 7.0)] = np.nan
        y[(t >= 5.0) & (t < 7.0) if returns_in_gap else (t >= 7.0) & (t < 8.0)] += 0.5

    drawn = world(seed, duration=12.0, encoder_std=0.003, camera_hz=20.0)
    found = estimate_from_features(spoil(drawn, start_again), drawn.body, EstimationSettings(method=method))
    first, second = sorted(found.faults, key=lambda fault: fault.since)
    begin, end = (5.0, 7.0) if returns_in_gap else (7.0, 8.0)
    assert [one.name for one in (first, second)] == ["pan", "pan"]
    assert (first.since, second.since) == (pytest.approx(begin, abs=0.03), pytest.approx(end, abs=0.03))
    assert (first.size, second.size) == (pytest.approx(0.5, abs=0.02), pytest.approx(-0.5, abs=0.02))
    assert np.sqrt(np.mean((found.joints.values - drawn.truth.values) ** 2)) < 0.004


@pytest.mark.parametrize(("resumed", "images", "faults"), [(11.75, 2, 1), (11.0, 8, 2)])
def test_two_images_show_no_jump_in_a_gap(world, resumed, images, faults):
    """Such as two of something else, at the end of a log; here they are where a jump would put them."""

    def pause(t, y):
        y[t >= 7.0] -= 0.2
        y[(t >= resumed - 0.1) & (t < resumed)] = np.nan

    drawn = world(1, duration=12.0, encoder_std=0.002, camera_hz=8.0)
    track = drawn.features.tracks["effector"]
    late = track.t >= resumed
    angles = np.column_stack([np.interp(track.t[late], drawn.truth.t, one) for one in drawn.truth.values.T])
    angles[:, drawn.truth.names.index("pan")] -= 0.2
    values = track.values.copy()
    values[late] = drawn.body.senses["effector"].predict(angles)[0]
    assert np.count_nonzero(late) == images
    features = replace(drawn.features, tracks={"effector": replace(track, values=values)})
    spoilt = spoil(replace(drawn, features=features), pause)
    found = screen_measurements(spoilt, drawn.body, EstimationSettings())
    assert found.faults[0].since == pytest.approx(7.0, abs=0.03) and len(found.faults) == faults


@pytest.mark.parametrize("seed", seeds(1, 2))
def test_images_of_something_else_do_not_choose_the_true_stretch(world, seed):
    drawn = world(seed, duration=12.0, encoder_std=0.002, camera_hz=20.0)
    track = drawn.features.tracks["effector"]
    rng = np.random.default_rng(seed)
    strange = rng.random((len(track.t), 1)) < 0.3
    values = np.where(strange, rng.uniform(0.0, 640.0, track.values.shape), track.values)
    features = replace(drawn.features, tracks={"effector": replace(track, values=values)})
    for change, until in ((jump, None), (homed_late, 4.0)):
        found = screen_measurements(
            spoil(replace(drawn, features=features), change), drawn.body, EstimationSettings()
        )
        (fault,) = found.faults
        assert (fault.kind, fault.until) == ("jumping", until and pytest.approx(until, abs=0.03))


@pytest.mark.parametrize("seed", seeds(1, 3))
def test_a_fault_that_ends_has_an_end(world, seed):
    def freeze_for_a_while(t, y):
        y[(t >= 8.0) & (t < 11.0)] = y[np.searchsorted(t, 8.0)]

    drawn = world(seed, duration=16.0, encoder_std=0.005, camera_hz=20.0)
    found = estimate_from_features(
        spoil(drawn, freeze_for_a_while), drawn.body, EstimationSettings()
    )
    (fault,) = found.faults
    assert (fault.kind, fault.since) == ("frozen", pytest.approx(8.0, abs=0.05))
    assert fault.until == pytest.approx(11.0, abs=0.03)
    assert "pan: encoder is frozen 8.0 to 11.0 s" in verdict_of_estimate(found, ())
    (warning,) = fault_warnings([fault])
    assert warning.text.startswith("encoders pan: frozen 8.020 to 11.000 s")


@pytest.mark.parametrize(("offset", "jumped"), first_of(1, [("pan", "elbow"), ("elbow", "pan")]))
@pytest.mark.parametrize("seed", seeds(1, 2))
def test_two_faults_on_two_joints_are_named_by_kind_and_size(world, offset, jumped, seed):
    drawn = world(seed, duration=16.0, encoder_std=0.005, camera_hz=20.0)
    joints = drawn.features.joints
    values = joints.values.copy()
    values[:, joints.names.index(offset)] += 0.03
    values[joints.t >= 8.0, joints.names.index(jumped)] += 0.06
    features = replace(drawn.features, joints=replace(joints, values=values))
    faults = {
        fault.name: fault
        for fault in estimate_from_features(features, drawn.body, EstimationSettings()).faults
    }
    assert faults.keys() == {offset, jumped}
    assert (faults[offset].kind, faults[jumped].kind) == ("drifting", "jumping")
    assert faults[offset].since < 1.0 and faults[jumped].since == pytest.approx(8.0, abs=0.05)
    for name, size in ((offset, 0.03), (jumped, 0.06)):
        assert faults[name].size == pytest.approx(size, abs=0.002)
