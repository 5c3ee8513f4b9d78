"""Measured camera delays have true error bars, despite other faults in the log; sound logs have no delay."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.estimation.faults.threshold import EVIDENCE_THRESHOLD_NATS
from bodylog.estimation.timing.correction import (
    CorrectedFeatures,
    correct_camera_delays,
    is_evident,
    is_significant,
    measure_camera_delays,
    reconsider_delays,
)
from bodylog.estimation.timing.delay_profile import climb_profile
from tests.estimation.spoilt_logs import delayed
from tests.seeds import first_of


def spoilt(drawn, how):
    """Add another fault to the log."""
    joints = drawn.features.joints
    values = joints.values.copy()
    if how == "drift":
        values[:, 1] += np.clip((joints.t - 8.0) * 0.03, 0.0, None)
    elif how == "frozen":
        values[joints.t > 14.0, 1] = values[np.searchsorted(joints.t, 14.0), 1]
    elif how == "gap":
        values[(joints.t > 6.0) & (joints.t < 11.0)] = np.nan
    elif how == "outliers":
        values[::37] += 0.5
    elif how == "backwards":
        t = joints.t.copy()
        t[300:320] -= 3.0
        return replace(drawn.features, joints=replace(joints, t=t))
    return replace(drawn.features, joints=replace(joints, values=values))


@pytest.mark.parametrize("camera_hz, encoder_hz", first_of(2, [(12.0, 50.0), (30.0, 10.0), (30.0, 100.0), (5.0, 200.0)]))
def test_measured_delay_has_true_error_bars(world, camera_hz, encoder_hz):
    off = []
    for seed in range(40):
        drawn = world(seed, camera_hz=camera_hz, encoder_hz=encoder_hz)
        seconds = (-0.1, -0.05, -0.02, -0.005, 0.0, 0.005, 0.02, 0.05, 0.1, 0.3)[seed % 10]
        found = measure_camera_delays(delayed(drawn.features, seconds), drawn.body)["camera"]
        off.append((found.seconds - seconds) / found.std_error)
        assert found.nats > EVIDENCE_THRESHOLD_NATS if abs(seconds) >= 0.05 else seconds or found.nats < EVIDENCE_THRESHOLD_NATS
    assert np.abs(off).max() < 4.0 and 0.7 < np.sqrt(np.mean(np.square(off))) < 1.4


@pytest.mark.soak
def test_delay_error_holds_the_correlation_of_interpolated_images(world):
    off = []
    for seed in range(300):
        drawn = world(seed, camera_hz=30.0, encoder_std=0.001)
        found = measure_camera_delays(drawn.features, drawn.body)["camera"]
        off.append(found.seconds / found.std_error)
    assert 0.88 < np.sqrt(np.mean(np.square(off))) < 1.12


@pytest.mark.parametrize("how", ["drift", "frozen", "gap", "outliers", "backwards"])
@pytest.mark.parametrize("seconds", [0.0, 0.08])
def test_measured_delay_is_independent_of_other_faults(world, how, seconds):
    for seed in range(4):
        found = measure_camera_delays(delayed(spoilt(world(seed, camera_hz=30.0), how), seconds), world(seed).body)["camera"]
        assert abs(found.seconds - seconds) < 4.0 * found.std_error + 1e-3
        assert (found.nats > EVIDENCE_THRESHOLD_NATS) == (seconds > 0.0)


def test_blunders_and_pictures_repeated_or_out_of_view_are_no_delay(world):
    count = 0
    for seed in range(4):
        drawn = world(seed, blunder=0.08, hidden=(5.0, 8.0), camera_hz=20.0, duration=25.0)
        track = drawn.features.tracks["effector"]
        values = np.repeat(track.values[::2], 2, axis=0)[: len(track.t)]
        for seen in (track, replace(track, values=np.where(track.t[:, None] > 20.0, values, track.values))):
            features = replace(drawn.features, tracks={"effector": seen})
            for seconds in (0.0, 0.08):
                for found in measure_camera_delays(delayed(features, seconds), drawn.body).values():
                    count += 1
                    assert abs(found.seconds - seconds) < 4.0 * found.std_error
                    assert (found.nats > EVIDENCE_THRESHOLD_NATS) == (seconds > 0.0)
    assert count >= 12


@pytest.mark.parametrize("speed", [0.0, 0.01])
def test_measured_delay_is_absent_for_a_nearly_still_arm(world, speed):
    for seed in range(6):
        assert measure_camera_delays(delayed(world(seed, speed=speed, camera_hz=30.0).features, 0.05), world(seed).body) == {}


def test_measured_delay_is_absent_for_short_logs(world):
    drawn = world(0)
    joints, track = drawn.features.joints, drawn.features.tracks["effector"]
    none = [
        replace(drawn.features, joints=None),
        replace(drawn.features, joints=replace(joints, names=("a", "b", "c"))),
        replace(drawn.features, joints=replace(joints, values=np.full_like(joints.values, np.nan))),
        replace(drawn.features, tracks={"effector": replace(track, values=np.full_like(track.values, np.nan))}),
        replace(drawn.features, tracks={"other": track}),
        world(0, duration=0.8).features,
        world(0, camera_hz=1.0).features,
    ]
    assert all(measure_camera_delays(features, drawn.body) == {} for features in none)


def test_joints_read_in_turn_are_not_one_instant(world):
    drawn = world(2, camera_hz=30.0, encoder_hz=100.0)
    joints = drawn.features.joints
    values = np.where(np.arange(3) == np.arange(len(joints.t))[:, None] % 3, joints.values, np.nan)
    alone = delayed(replace(drawn.features, joints=replace(joints, values=values)), 0.05)
    assert measure_camera_delays(alone, drawn.body) == {}


def test_measured_delay_uses_all_of_a_long_log(world):
    drawn = world(1, duration=100.0, camera_hz=10.0, encoder_hz=30.0)
    track = drawn.features.tracks["effector"]
    asked = measure_camera_delays(delayed(drawn.features, 0.05), drawn.body)["camera"]
    assert abs(asked.seconds - 0.05) < 4.0 * asked.std_error
    still = (track.t > 15.0) & (track.t < 85.0)
    unseen = replace(track, values=np.where(still[:, None], np.nan, track.values))
    found = measure_camera_delays(delayed(replace(drawn.features, tracks={"effector": unseen}), 0.05), drawn.body)["camera"]
    assert abs(found.seconds - 0.05) < 4.0 * found.std_error and found.nats > EVIDENCE_THRESHOLD_NATS


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("by", [-0.3, 0.3])
def test_measured_delay_ignores_a_clock_step(world, seed, by):
    drawn = world(seed, camera_hz=30.0, speed=1.0)
    joints = drawn.features.joints
    stepped = replace(drawn.features, joints=replace(joints, t=np.where(joints.t > 10.0, joints.t + by, joints.t)))
    found = measure_camera_delays(stepped, drawn.body).get("camera")
    assert found is None or "halves of the log show" in found.doubt or "half of the log" in found.doubt
    assert found is None or not is_significant(found)


@pytest.mark.parametrize(("jump", "found"), [(5e-4, True), (5e-3, False)])
def test_a_profile_whose_slope_jumps_within_its_error_has_a_top_there(jump, found):
    def step_at(late):
        return 0.1 - late + (jump if late < 0.1 else -jump), 2e-3, None

    top = climb_profile(step_at)
    assert top is not None and top[0].seconds == pytest.approx(0.1) if found else top is None


@pytest.mark.parametrize("by", [-0.1, 0.05, 0.1])
@pytest.mark.parametrize("seed", range(4))
def test_a_delay_of_half_of_a_log_is_in_doubt(world, seed, by):
    drawn = world(seed, camera_hz=20.0)
    track = drawn.features.tracks["effector"]
    stepped = replace(track, t=track.t + by * (track.t > np.median(track.t)))
    features = replace(drawn.features, tracks={"effector": stepped})
    found = measure_camera_delays(features, drawn.body)["camera"]
    assert "halves of the log show" in found.doubt and found.changes and not is_significant(found)
    # as unsure as the halves are apart, so that it and none are within its error
    assert found.std_error > 0.4 * abs(by) and is_evident(found)
    left = {"camera": {"seconds": 0.04, "std": 1e-3, "nats": 800.0}}
    timely = correct_camera_delays(features, drawn.body, "auto")
    assert not timely.delays and timely.unsure["camera"] > 0.5 * abs(by)
    assert reconsider_delays(timely, features, drawn.body, "auto", left) is None
    (warned,) = correct_camera_delays(features, drawn.body, "off").findings
    why = "error bars are too small for that; the halves of the log show"
    assert f"(not corrected): {why}" in warned.text


@pytest.mark.parametrize("by", [0.0, 0.01])
def test_a_delay_that_changes_by_less_than_it_takes_away_is_believed(world, by):
    """Halves of 90 and 100 ms: without any both would be worse."""
    drawn = world(1, camera_hz=20.0, encoder_std=0.001)
    track = drawn.features.tracks["effector"]
    stepped = replace(track, t=track.t + 0.09 + by * (track.t > np.median(track.t)))
    features = replace(drawn.features, tracks={"effector": stepped})
    found = measure_camera_delays(features, drawn.body)["camera"]
    assert is_significant(found) and abs(found.seconds - 0.095) < 0.01
    assert (found.std_error > 0.4 * by) and (by > 0.0) == (found.std_error > 2e-3)


@pytest.mark.parametrize(
    ("applied", "left", "nats", "kept"),
    [
        (5e-3, -4.5e-3, 6.0, None),  # play explains it, though nothing evident is left
        (40e-3, 1e-3, 1.0, 40e-3),
        (40e-3, -20e-3, 50.0, 20e-3),
    ],
)
def test_a_delay_stays_only_where_it_is_evident_beside_what_explains_the_log(world, applied, left, nats, kept):
    drawn = world(0, duration=4.0)
    timely = CorrectedFeatures(drawn.features, {"camera": applied}, {"camera": 1e-3}, {}, {})
    one = {"camera": {"seconds": left, "std": 1e-3, "nats": nats}}
    again = reconsider_delays(timely, drawn.features, drawn.body, "auto", one)
    if kept == applied:
        assert again is None
    else:
        assert again is not None
        assert again.delays == ({} if kept is None else {"camera": pytest.approx(kept)})
