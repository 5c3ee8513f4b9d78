"""A camera that moved during a log: found with its time and size, corrected, and never found where none moved."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.estimation import estimate_from_features
from bodylog.estimation.faults.moved_camera import detect_moved_camera
from bodylog.estimation.faults.screening import screen_measurements
from bodylog.estimation.faults.threshold import EVIDENCE_THRESHOLD_NATS
from bodylog.estimation.measurements.arm_errors import ArmErrors
from bodylog.estimation.measurements.gather import gather_measurements
from bodylog.settings import EstimationSettings
from bodylog.sim.hardware import Hardware
from tests.estimation.conftest import JOINTS
from tests.estimation.mechanisms import Fault, Mechanism, replayed
from tests.estimation.moved_cameras import MOVED, cameras, moved
from tests.estimation.resting import MOTIONS, Drawn, drawn, judged
from tests.seeds import first_of, seeds


def stepped(features, joint, size, since):
    joints = features.joints
    values = joints.values + size * np.outer(joints.t >= since, np.arange(3) == joint)
    return replace(features, joints=replace(joints, values=values))


@pytest.mark.parametrize("px", [5.0, 30.0])
@pytest.mark.parametrize("moves", ["reach", "sines"])
@pytest.mark.parametrize("count", [3, pytest.param(20, marks=pytest.mark.soak)])
def test_moved_camera_is_found_with_time_and_size(moves, px, count):
    worlds = [drawn(100 + seed, Drawn(moves, noise=0.01)) for seed in range(count)]
    named = [
        cameras(moved(world.features, px, seed), world.body) for seed, world in enumerate(worlds)
    ]
    found = [fault for faults in named for fault in faults]
    assert max(map(len, named)) == 1 and len(found) >= 0.95 * count
    assert {(fault.name, fault.kind, fault.unit) for fault in found} == {
        ("camera", "displaced", "px")
    }
    assert (
        max(abs(fault.since - MOVED) for fault in found) < 0.4
        and max(fault.std for fault in found) < 0.375
    )
    off = np.array([(fault.size - px) / fault.std for fault in found])
    assert np.sqrt(np.mean(off**2)) < 1.75 and np.abs(off).max() < 5.0


@pytest.mark.parametrize("row", [0, -1])
@pytest.mark.parametrize("seed", range(8, 11))
def test_a_false_image_at_either_end_is_no_moved_camera(world, seed, row):
    drawn = world(seed, duration=8.0, encoder_hz=100.0, camera_hz=60.0)
    track = drawn.features.tracks["effector"]
    kept = np.random.default_rng(seed).random(len(track.t)) < 0.12  # at uneven times
    kept[[0, -1]] = True
    values = track.values.copy()
    values[row] += (-6.0, -120.0)
    parts = {name: getattr(track, name)[kept] for name in ("t", "source_ns", "std")}
    uneven = replace(track, values=values[kept], **parts)
    assert not cameras(replace(drawn.features, tracks={"effector": uneven}), drawn.body)


@pytest.mark.parametrize("method", ["filter", "smoother"])
@pytest.mark.parametrize("px", [4.0, 20.0])
def test_moved_camera_does_not_degrade_the_estimate(method, px):
    world = drawn(101, Drawn("reach", noise=0.01))
    found, sound = (
        estimate_from_features(features, world.body, EstimationSettings(method=method))
        for features in (moved(world.features, px, 1.0), world.features)
    )
    assert [fault.kind for fault in found.faults] == ["displaced"] and not sound.faults
    (rmse, nees), (best, _) = (
        judged(world, found.joints, found.cov),
        judged(world, sound.joints, sound.cov),
    )
    assert rmse < 1.15 * best and nees < 1.3
    # the track's prediction is where this camera shows it
    off = found.predicted["effector"].values - sound.predicted["effector"].values
    assert np.abs(np.hypot(*off[-30:].T) - px).max() < 1.0


@pytest.mark.parametrize("moves", MOTIONS)
@pytest.mark.parametrize("seed", seeds(2, 20))
def test_moved_camera_is_absent_in_logs_without_one(moves, seed):
    world = drawn(300 + seed, Drawn(moves, noise=(0.01, 0.002, 0.0005)[seed % 3]))
    t = world.features.joints.t
    off = np.outer(np.clip(0.02 * (t - 5.0), 0.0, None), np.arange(3) == seed % 3)
    joints = replace(world.features.joints, values=world.features.joints.values + off)
    drifting, step = (
        replace(world.features, joints=joints),
        stepped(world.features, seed % 3, 0.03, 7.0),
    )
    for features in (world.features, step, drifting):
        assert not cameras(features, world.body)


@pytest.mark.parametrize("moves", ["reach", "sines"])
@pytest.mark.parametrize("count", [3, pytest.param(20, marks=pytest.mark.soak)])
def test_a_camera_that_moves_beside_an_encoder_that_drifts_is_found(moves, count):
    off = []
    for seed in range(count):
        world = drawn(900 + seed, Drawn(moves, noise=0.002))
        t = world.features.joints.t
        drift = np.outer(np.clip(0.02 * (t - 7.0), 0.0, None), np.arange(3) == seed % 3)
        joints = replace(world.features.joints, values=world.features.joints.values + drift)
        found = cameras(moved(replace(world.features, joints=joints), 8.0, seed), world.body)
        off += [(fault.size - 8.0) / fault.std for fault in found[:1] if len(found) == 1]
    assert len(off) >= 0.9 * count
    assert np.median(np.abs(off)) < 1.5


@pytest.mark.parametrize(("seed", "joint"), [(101, "elbow"), (103, "pan"), (109, "pan")])
def test_drifting_encoder_is_not_three_moves_of_the_camera(world, seed, joint):
    sound = world(seed, duration=16.0, encoder_std=0.01, camera_hz=20.0)
    joints = sound.features.joints
    off = np.outer(np.clip(0.02 * (joints.t - 8.0), 0.0, None), np.array(joints.names) == joint)
    assert not cameras(
        replace(sound.features, joints=replace(joints, values=joints.values + off)), sound.body
    )


@pytest.mark.parametrize("seed", seeds(2, 10))
def test_encoders_that_are_wrong_at_first_move_no_camera(seed):
    world = drawn(500 + seed, Drawn("rest", noise=0.02))
    joints = world.features.joints
    off = np.random.default_rng(seed).choice([-0.15, 0.15], 3)
    values = joints.values + np.outer(joints.t < 0.5, off)
    assert not cameras(replace(world.features, joints=replace(joints, values=values)), world.body)


@pytest.mark.parametrize("joint", range(3))
@pytest.mark.parametrize("seed", seeds(2, 10))
def test_an_encoder_that_is_off_while_the_arm_stands_still_moves_no_camera(world, seed, joint):
    """Both displace all images by the same; one angle explains both coordinates, and no two do by chance."""
    drawn = world(seed, duration=10.0, encoder_std=0.003, pixel_std=0.1, speed=0.0)
    off = stepped(drawn.features, joint, 0.13, -1.0)
    assert not cameras(off, drawn.body)
    found = estimate_from_features(off, drawn.body, EstimationSettings())
    (fault,) = found.faults
    assert fault.name == off.joints.names[joint] and abs(fault.size - 0.13) < 0.003


@pytest.mark.parametrize("rate", [0.05, 0.2])
def test_an_encoder_that_drifts_far_leaves_one_finite_hypothesis(rate):
    world = drawn(300, Drawn("sines", noise=0.002))
    joints = world.features.joints
    off = np.outer(np.clip(rate * (joints.t - 5.0), 0.0, None), np.arange(3) == 0)
    features = replace(world.features, joints=replace(joints, values=joints.values + off))
    verdict = screen_measurements(features, world.body, EstimationSettings())
    (moved,) = [one for one in verdict.hypotheses if one.name == "camera moved"]
    assert np.isfinite(moved.nats) and moved.nats < 0.0 and not moved.chosen


def test_moved_camera_is_named_among_two():
    world = drawn(102, Drawn("reach", noise=0.01))
    names = ("effector", "side/effector")
    track = world.features.tracks["effector"]
    shaken = np.random.default_rng(0).normal(0.0, 0.4, track.values.shape)
    tracks = dict(zip(names, (track, replace(track, values=track.values + shaken)), strict=True))
    body = replace(world.body, senses=dict.fromkeys(names, world.body.senses["effector"]))
    (fault,) = cameras(
        moved(replace(world.features, tracks=tracks), 10.0, 2.0, names=names[1:]), body
    )
    assert (fault.name, fault.kind) == ("side", "displaced")


def test_moved_camera_is_found_for_two_moves():
    world = drawn(103, Drawn("sines", noise=0.01, duration=24.0))
    faults = cameras(moved(moved(world.features, 12.0, 0.3), 9.0, 2.0, since=16.0), world.body)
    assert sorted(round(fault.since) for fault in faults) == [8, 16]


def test_evidence_for_a_moved_camera_is_reported():
    world = drawn(104, Drawn("reach", noise=0.01))
    found = detect_moved_camera(
        replace(
            screen_measurements(world.features, world.body, EstimationSettings()), hypotheses=()
        ),
        world.body,
    )
    (hypothesis,) = found.hypotheses
    assert hypothesis.name == "camera moved" and hypothesis.nats < 0.0 and not hypothesis.chosen
    hypotheses = estimate_from_features(world.features, world.body, EstimationSettings()).settings[
        "hypotheses"
    ]
    cameras = [one for one in hypotheses if one["about"] == "camera"]
    assert [(one["name"], one["chosen"], one["threshold"]) for one in cameras] == [
        ("camera late", False, EVIDENCE_THRESHOLD_NATS), ("camera moved", False, EVIDENCE_THRESHOLD_NATS),
    ]  # fmt: skip


@pytest.mark.parametrize("seed", [7721, 7722, 7724])
def test_a_moved_camera_is_found_once_beside_the_play_and_the_outliers_of_the_arm(world, seed):
    arm = Mechanism(5e-4, Hardware(play=8e-3, correlated=1e-3, outliers=1e-3))
    features = replayed(seed, arm, Fault(), reaches=seed % 2 == 1)
    errors = ArmErrors(
        play={name: (8e-3, 5e-4) for name in JOINTS},
        lasting={name: (1e-3, 1.0) for name in JOINTS},
    )
    sound = world(0, duration=1.0).body
    body = replace(sound, provenance={**sound.provenance, **errors.as_provenance()})

    def find_moves(seen):
        evidence = gather_measurements(seen, body, EstimationSettings())
        return detect_moved_camera(evidence, body).faults

    track = features.tracks["effector"]
    off = track.values + np.array([4.0, 0.0]) * (track.t >= 8.0)[:, None]
    (fault,) = find_moves(replace(features, tracks={"effector": replace(track, values=off)}))
    assert abs(fault.since - 8.0) < 0.2 and abs(fault.size - 4.0) < 0.8
    assert not find_moves(features)


@pytest.mark.parametrize("seed", [7721, 7722])
def test_play_that_came_after_the_exploration_is_no_moved_camera_and_hides_none(world, seed):
    arm = Mechanism(1e-3, Hardware(play=17.5e-3))
    features = replayed(seed, arm, Fault(), reaches=seed % 2 == 1)
    body = world(0, duration=1.0).body
    track = features.tracks["effector"]
    off = track.values + np.array([5.0, 0.0]) * (track.t >= 8.0)[:, None]
    seen = replace(features, tracks={"effector": replace(track, values=off)})
    (fault,) = cameras(seen, body)
    assert abs(fault.since - 8.0) < 0.2 and abs(fault.size - 5.0) < 0.8
    evidence = screen_measurements(features, body, EstimationSettings())
    assert not evidence.faults
    assert np.abs(evidence.worn - 0.5 * 17.5e-3).max() < 1e-3


@pytest.mark.parametrize(
    "errors", [Hardware(), Hardware(correlated=2e-3, correlation_s=2.0), Hardware(stick=4e-3)]
)
def test_no_play_is_measured_where_joints_have_none(world, errors):
    features = replayed(7721, Mechanism(1e-3, errors), Fault(), reaches=True)
    body = world(0, duration=1.0).body
    assert not screen_measurements(features, body, EstimationSettings()).worn.any()


@pytest.mark.parametrize("seed", [4, 9])
def test_noise_that_moves_a_motor_within_its_play_is_no_play(seed):
    sound = drawn(100 + seed, Drawn("reach", noise=0.01))
    seen = moved(sound.features, 5.0, seed)
    assert not screen_measurements(seen, sound.body, EstimationSettings()).worn.any()


@pytest.mark.parametrize("seed", first_of(1, [7801, 7803, 7805]))
def test_an_encoder_that_drifts_beside_a_move_is_no_play(world, seed):
    features = replayed(seed, Mechanism(1e-3, Hardware()), Fault(), reaches=True)
    joints, track = features.joints, features.tracks["effector"]
    drift = np.outer(np.clip(0.02 * (joints.t - 8.0), 0.0, None), [1.0, 0.0, 0.0])
    off = track.values + np.array([5.0, 0.0]) * (track.t >= 5.0)[:, None]
    seen = replace(
        features,
        joints=replace(joints, values=joints.values + drift),
        tracks={"effector": replace(track, values=off)},
    )
    evidence = screen_measurements(seen, world(0, duration=1.0).body, EstimationSettings())
    (fault,) = evidence.faults
    assert abs(fault.since - 5.0) < 0.2 and abs(fault.size - 5.0) < 0.8
    assert not evidence.worn.any()
