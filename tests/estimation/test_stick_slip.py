"""Joints that stick and slip: readings lead, by a belief of slips that is right where joints do."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bodylog.estimation import estimate_from_features
from bodylog.estimation.faults.jumping import find_evident_slips
from bodylog.estimation.measurements.records import Encoders
from bodylog.estimation.methods import stick_slip
from bodylog.estimation.methods.stick_slip import StickSlip
from bodylog.estimation.timing.correction import measure_camera_delays
from bodylog.evaluation.scores import truth_at_times
from bodylog.settings import EstimationSettings
from bodylog.sim.hardware import Hardware
from bodylog.types import HARDWARE_ERRORS
from tests.estimation import mechanisms, resting
from tests.estimation.mechanisms import Fault, Mechanism
from tests.seeds import first_of

SLIPPING = Mechanism(hardware=Hardware(stick=8.7e-3))
WHITE = 1e-3


def drawn(seed, joints=2, count=1500, size=8e-3, rate=20.0):
    """Times, true angles of joints that slip as the model says, and readings of them."""
    rng = np.random.default_rng(seed)
    t = np.arange(count) / 100.0
    slips = rng.random((count, joints)) < -np.expm1(-rate * 0.01)
    true = np.cumsum(slips * rng.normal(0.0, size, (count, joints)), axis=0)
    return t, true, true + rng.normal(0.0, WHITE, true.shape)


def posed(t, values):
    """A problem of readings alone."""
    encoders = Encoders(t, values, (t * 1e9).astype(np.int64))
    evidence = SimpleNamespace(encoders=encoders, sightings=())
    line = SimpleNamespace(t=t, encoders=np.arange(len(t)), sightings=())
    return SimpleNamespace(evidence=evidence, timeline=line, start=values[0])


def test_the_size_and_the_number_of_slips_are_learned():
    t, _, values = drawn(1)
    encoders = Encoders(t, values, (t * 1e9).astype(np.int64))
    found = stick_slip.learn_slips(encoders, np.full(2, 4e-6))
    np.testing.assert_allclose(np.sqrt(found.white), WHITE, rtol=0.25)
    np.testing.assert_allclose(found.size, 8e-3, rtol=0.5)
    np.testing.assert_allclose(found.rate, 20.0, rtol=0.5)


@pytest.mark.parametrize(
    ("hardware", "sticks"),
    [
        (Hardware(stick=8.7e-3), True),
        (Hardware(correlated=1e-3, correlation_s=0.2), False),
    ],
)
def test_errors_that_last_are_no_slips_though_these_follow_them(hardware, sticks):
    joints = mechanisms.replayed(8306, Mechanism(hardware=hardware), Fault()).joints
    encoders = Encoders(joints.t, joints.values, joints.source_ns)
    slips = stick_slip.learn_slips(encoders, np.full(joints.values.shape[1], 4e-6))
    assert stick_slip.sticks_and_slips(encoders, slips) == sticks


def test_readings_that_repeat_because_they_are_counted_are_no_surer_than_a_count():
    """Between two counts readings repeat as those of a joint that stands still do: NEES of 380 to 930."""
    world = resting.drawn(200, resting.Drawn("reach", step=1.5e-3))
    joints = world.features.joints
    encoders = Encoders(joints.t, joints.values, joints.source_ns)
    slips = stick_slip.learn_slips(encoders, np.full(3, 1e-7))
    assert (slips.white >= 1.5e-3**2 / 12.0 * (1.0 - 1e-9)).all()
    found = estimate_from_features(world.features, world.body, EstimationSettings(method="smoother"))
    assert "slips" not in found.settings.get(HARDWARE_ERRORS, {})
    off = found.joints.values - truth_at_times(world.truth, list(found.joints.names), found.joints.t)
    assert np.mean(off**2 / np.einsum("emm->em", found.cov)) < 1.0


@pytest.mark.parametrize("method", ["filter", "smoother"])
def test_joints_that_stick_and_are_counted_are_known_no_better_than_a_count(method):
    """Where readings of one count were many readings: NEES of 500 to 1,600."""
    world = resting.drawn(700, resting.Drawn("sines", 1.5e-3, 5e-4, 100.0, 20.0, slip=9e-3, pixel=0.3))
    found = estimate_from_features(world.features, world.body, EstimationSettings(method=method))
    assert set(found.settings[HARDWARE_ERRORS]["slips"]) == {"pan", "lift", "elbow"}
    off = found.joints.values - truth_at_times(world.truth, list(found.joints.names), found.joints.t)
    assert np.mean(off**2 / np.einsum("emm->em", found.cov)) < 2.0


def test_a_joint_whose_readings_never_change_has_no_slips():
    t, _, values = drawn(1)
    values[:, 1] = 0.3
    encoders = Encoders(t, values, (t * 1e9).astype(np.int64))
    found = stick_slip.learn_slips(encoders, np.full(2, 4e-6))
    assert found.size[0] > 1e-3 and found.size[1] == 0.0
    assert found.white[1] >= 4e-6 / (t[-1] / 0.15)


def test_beliefs_of_slips_are_as_wrong_as_they_say_and_the_whole_log_knows_more():
    squares = {"filter": [], "smoother": []}
    errors = {"filter": [], "smoother": []}
    slips = StickSlip(np.full(2, WHITE**2), np.full(2, 8e-3), np.full(2, 20.0))
    for seed in range(4):
        t, true, values = drawn(seed)
        problem = posed(t, values)
        order = range(len(t))
        before = stick_slip.follow_slips(problem, slips, (), order)
        after = stick_slip.follow_slips(problem, slips, (), order[::-1])
        whole = stick_slip.join_beliefs(t, before, after, slips)
        for name, found in (("filter", before), ("smoother", whole)):
            off = found.mean - true
            errors[name].append(np.mean(off**2))
            squares[name].append(np.mean(off**2 / np.einsum("emm->em", found.cov)))
    for name in squares:
        assert np.mean(squares[name]) == pytest.approx(1.0, abs=0.2)
    assert np.mean(errors["smoother"]) < 0.8 * np.mean(errors["filter"]) < 0.5 * WHITE**2


@pytest.mark.parametrize("reaches", [False, True])
@pytest.mark.parametrize("method", ["filter", "smoother"])
def test_angles_of_joints_that_slip_are_better_than_their_readings(method, reaches):
    body = mechanisms.learned(1000, mechanisms.SOUND)
    features = mechanisms.replayed(5, SLIPPING, Fault(), reaches=reaches)
    found = estimate_from_features(features, body, EstimationSettings(method=method))
    slips = found.settings[HARDWARE_ERRORS]["slips"]
    assert all(0.5 * 8.7e-3 < size < 2.0 * 8.7e-3 for size in slips.values())
    true = mechanisms.links_of(5, SLIPPING, Fault(), reaches).values
    error = found.joints.values - true
    raw = features.joints.values - true
    assert np.mean(error**2) < np.mean(raw**2)
    assert 0.5 < float((error**2 / np.einsum("nii->ni", found.cov)).mean()) < 2.0
    (warning,) = [one.text for one in found.findings if one.severity == "warning"]
    assert "stick and slip" in warning


@pytest.mark.parametrize(
    ("motion", "slip"),
    first_of(1, [("reach", 0.02), ("slow", 0.02), ("sines", 0.04), ("sines", 0.02), ("reach", 0.04)]),
)
@pytest.mark.parametrize("method", ["filter", "smoother"])
def test_joints_that_slip_by_many_times_their_noise_are_followed(method, motion, slip):
    """A smooth motion lost such arms: errors of 70 to 330 mrad, NEES of up to 50,000, and up to 200 false faults."""
    how = resting.Drawn(motion, noise=1e-3, encoder_hz=100.0, camera_hz=20.0, pixel=0.3, slip=slip)
    world = resting.drawn(720, how)
    found = estimate_from_features(world.features, world.body, EstimationSettings(method=method))
    assert not found.faults and found.settings[HARDWARE_ERRORS]["slips"]
    true = truth_at_times(world.truth, list(found.joints.names), found.joints.t)
    off = found.joints.values - true
    raw = world.features.joints.values - world.truth.values
    assert np.mean(off**2) < 0.5 * np.mean(raw**2)
    assert np.mean(off**2 / np.einsum("emm->em", found.cov)) < 1.5
    assert not any("standard deviations from" in one.text for one in found.findings)
    net = np.abs(found.joints.values[-1] - found.joints.values[0])
    mean_rate = np.abs(np.trapezoid(found.rate.values, found.joints.t, axis=0))
    np.testing.assert_allclose(mean_rate, net, atol=0.5 * net.max() + 0.03)


def test_slips_of_hundreds_of_times_the_noise_are_found():
    """With sizes of up to 30 standard deviations alone, an error of 1.4 rad."""
    how = resting.Drawn("sines", noise=1e-4, encoder_hz=25.0, camera_hz=20.0, pixel=0.3, slip=0.04)
    for seed in (720, 721):
        world = resting.drawn(seed, how)
        found = estimate_from_features(world.features, world.body, EstimationSettings())
        sizes = found.settings[HARDWARE_ERRORS]["slips"]
        assert all(0.02 < size < 0.1 for size in sizes.values())
        off = found.joints.values - truth_at_times(world.truth, list(found.joints.names), found.joints.t)
        assert np.mean(off**2 / np.einsum("emm->em", found.cov)) < 2.0


def spoiled(world, joint, off):
    """The world with a joint's readings off by a function of time."""
    joints = world.features.joints
    values = joints.values.copy()
    values[:, joint] += off(joints.t)
    return replace(world, features=replace(world.features, joints=replace(joints, values=values)))


@pytest.mark.parametrize(
    ("joint", "off"), [(0, lambda t: 0.02 * np.maximum(t - 8.0, 0.0)), (1, lambda t: 0.035 * (t >= 8.0))]
)
@pytest.mark.parametrize("motion", first_of(1, ["reach", "sines"]))
@pytest.mark.parametrize("method", first_of(1, ["smoother", "filter"]))
def test_the_encoder_that_is_off_is_named_where_joints_slip(method, motion, joint, off):
    """All readings used, it had errors of 37 mrad with NEES of 2,900; a smooth motion lost the arm and named others."""
    how = resting.Drawn(motion, noise=1e-3, encoder_hz=100.0, camera_hz=20.0, pixel=0.3, slip=np.deg2rad(1.0))
    world = spoiled(resting.drawn(740, how), joint, off)
    found = estimate_from_features(world.features, world.body, EstimationSettings(method=method))
    assert [fault.name for fault in found.faults] == [found.joints.names[joint]]
    off = found.joints.values - truth_at_times(world.truth, list(found.joints.names), found.joints.t)
    assert np.mean(off**2) < 0.01**2
    assert np.mean(off**2 / np.einsum("emm->em", found.cov)) < 1.5


@pytest.mark.parametrize("method", ["smoother", "filter"])
@pytest.mark.soak
def test_encoders_that_jump_together_where_joints_slip_are_known_to_their_jumps(method):
    """All their readings left out, images alone lost such arms: 300 mrad, NEES of 12 and 34."""
    how = resting.Drawn("sines", noise=1e-3, encoder_hz=100.0, camera_hz=20.0, pixel=0.3, slip=np.deg2rad(1.0))
    errors, spreads = [], []
    for seed in range(740, 744):
        world = resting.drawn(seed, how)
        for joint, size in enumerate((0.3, -0.3, 0.3)):
            world = spoiled(world, joint, lambda t, size=size: size * (t >= 8.0))
        found = estimate_from_features(world.features, world.body, EstimationSettings(method=method))
        assert len(found.faults) == 3 and all(fault.kind == "jumping" for fault in found.faults)
        off = found.joints.values - truth_at_times(world.truth, list(found.joints.names), found.joints.t)
        errors.append(np.sqrt(np.mean(off**2)))
        spreads.append(np.mean(off**2 / np.einsum("emm->em", found.cov)))
    assert max(errors) < 0.04 and 0.4 < np.median(spreads) < 1.6


@pytest.mark.soak
def test_images_that_no_encoder_explains_are_distrusted_and_reported():
    how = resting.Drawn("sines", noise=1e-3, encoder_hz=100.0, camera_hz=20.0, pixel=0.3, slip=0.02)
    for seed in (700, 701):
        world = resting.drawn(seed, how)
        track = world.features.tracks["effector"]
        seen = track.values + np.outer(track.t >= 8.0, [4.0, 3.0])
        tracks = {"effector": replace(track, values=seen)}
        found = estimate_from_features(replace(world.features, tracks=tracks), world.body, EstimationSettings())
        off = found.joints.values - truth_at_times(world.truth, list(found.joints.names), found.joints.t)
        assert np.mean(off**2) < 0.002**2
        told = [one.text for one in found.findings if "the camera moved" in one.text]
        assert told or [fault.name for fault in found.faults] == ["camera"]


@pytest.mark.parametrize("late", [0.0, 0.04])
def test_the_delay_of_a_camera_that_sees_slips_is_measured_by_them(late):
    """A curve through the images of an arm that slips by 4° had it 89 ms late."""
    for seed, motion, slip in ((720, "sines", 0.02), (721, "reach", 0.02), (722, "slow", 0.02), (723, "sines", 0.04)):
        how = resting.Drawn(motion, noise=1e-3, encoder_hz=100.0, camera_hz=20.0, pixel=0.3, slip=slip)
        world = resting.drawn(seed, how)
        tracks = {name: replace(one, t=one.t + late) for name, one in world.features.tracks.items()}
        (found,) = measure_camera_delays(replace(world.features, tracks=tracks), world.body).values()
        assert abs(found.seconds - late) < 3.0 * found.std_error < 0.06


@pytest.mark.parametrize("motion", ["slow", "sines", "reach"])
@pytest.mark.parametrize(("step", "noise"), [(0.0, 1e-3), (0.0, 1e-5), (1.5e-3, 7.5e-5), (1.5e-3, 5e-4)])
def test_smooth_motion_shows_no_slips(motion, step, noise):
    for seed, rate in ((720, 25.0), (721, 100.0), (722, 500.0)):
        joints = resting.drawn(seed, resting.Drawn(motion, step=step, noise=noise, encoder_hz=rate)).features.joints
        assert not any(len(find_evident_slips(joints.t, column)) for column in joints.values.T)


def test_an_encoder_that_jumps_is_separated_from_a_joint_that_slips():
    how = resting.Drawn("reach", noise=1e-3, encoder_hz=100.0, camera_hz=20.0, pixel=0.3)
    for seed in range(720, 724):
        world = resting.drawn(seed, how)
        values = world.features.joints.values.copy()
        for at in (400, 700, 1000):
            values[at:, 1] += 0.05
        joints = replace(world.features.joints, values=values)
        found = estimate_from_features(
            replace(world.features, joints=joints), world.body, EstimationSettings()
        )
        assert {(one.name, one.kind) for one in found.faults} == {("lift", "jumping")}
        assert "slips" not in found.settings.get(HARDWARE_ERRORS, {})


def test_settings_keep_smooth_angles_and_widen_error_bars():
    body = mechanisms.learned(1000, mechanisms.SOUND)
    features = mechanisms.replayed(5, SLIPPING, Fault())
    smooth = estimate_from_features(features, body, EstimationSettings(hardware_errors="widen"))
    assert HARDWARE_ERRORS not in smooth.settings
    assert any("err alike" in one.text for one in smooth.findings)


@pytest.mark.parametrize(("seed", "joint"), [(45, 1), (41, 2)])
@pytest.mark.parametrize("method", ["filter", "smoother"])
def test_a_joint_whose_encoder_died_does_not_stick_at_its_last_reading(method, seed, joint):
    """Its own readings, 20 a second and without noise, look like slips, and images show it elsewhere."""
    sound = resting.drawn(seed, resting.Drawn("reach", 1.5e-3, encoder_hz=20.0))
    values = sound.features.joints.values.copy()
    values[sound.features.joints.t >= 4.0, joint] = np.nan
    features = replace(sound.features, joints=replace(sound.features.joints, values=values))
    found = estimate_from_features(features, sound.body, EstimationSettings(method=method))
    error, nees = resting.judged(sound, found.joints, found.cov)
    assert error < 0.01  # 0.075 and 0.25 rad
    assert nees < 2.0


def test_a_missing_reading_leaves_a_slip_open():
    t, _, values = drawn(3, joints=1)
    values[700:750] = np.nan
    slips = StickSlip(np.full(1, WHITE**2), np.full(1, 8e-3), np.full(1, 20.0))
    found = stick_slip.follow_slips(posed(t, values), slips, (), range(len(t)))
    assert found.cov[749, 0, 0] > 20 * found.cov[699, 0, 0]
    assert np.isnan(found.errors[700:750]).all() and np.isfinite(found.mean).all()
    assert found.cov[760, 0, 0] < 2 * WHITE**2
