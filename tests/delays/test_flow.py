"""Delays by the motion of the whole picture: recovered where joints and images belong together, refused elsewhere."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bodylog.delays.flow import (
    date_by_camera_clock,
    group_joints,
    measure_flow_delays,
    name_moving_arm,
    smooth_joints,
)
from bodylog.delays.flow_delay import estimate_flow_delay
from bodylog.perception.surface.flow import GridFlow
from bodylog.perception.surface.repeats import FrameRepeats
from bodylog.recording import recording
from bodylog.settings import Settings, TopicSettings
from bodylog.types import Array, Series
from tests.seeds import seeds

G1 = Path(__file__).parents[3] / "shared/real/g1"
SO101 = Path(__file__).parents[3] / "shared/real/so101"
NAMES = ("left_pan", "left_lift", "right_pan", "right_lift", "right_elbow")
GROUPS = list(group_joints(NAMES).values())


def angles(seed: int, t: Array) -> Array:
    """Five joints (N,5) rad: smooth curves whose speeds change all the time."""
    rng = np.random.default_rng(seed)
    rates = rng.uniform(0.1, 0.9, (6, len(NAMES)))
    phases = rng.uniform(0.0, 2.0 * np.pi, (6, len(NAMES)))
    return np.asarray(0.25 * np.sin(2.0 * np.pi * rates * t[:, None, None] + phases).sum(axis=1))


def recorded(seed: int, noise: float) -> Series:
    """Joints at 100 Hz for 16 s."""
    t = np.arange(0.0, 16.0, 0.01)
    values = angles(seed, t) + np.random.default_rng(seed + 100).normal(0.0, noise, (len(t), len(NAMES)))
    return Series(t, values, NAMES, "rad", np.zeros(len(t), np.int64))


def filmed(seed: int, delay: float) -> tuple[Array, Array]:
    """Stamps (N,2), late by `delay` s, and the flow that the right arm causes, with noise and glitches."""
    true = np.arange(1.0, 15.0, 1.0 / 15.0)
    return np.column_stack([true[:-1], true[1:]]) + delay, make_flow(seed, true)


def make_flow(seed: int, true: Array) -> Array:
    """The flow (N-1,6,8,2) between pictures taken at `true` (N,) s."""
    rng = np.random.default_rng(seed + 200)
    begin, end = angles(seed, true[:-1])[:, 2:], angles(seed, true[1:])[:, 2:]
    constant, varying = rng.normal(0.0, 30.0, (96, 3)), rng.normal(0.0, 20.0, (96, 3, 3))
    slope = constant + np.einsum("nk,cjk->ncj", begin, varying)
    flow = np.einsum("ncj,nj->nc", slope, end - begin) + rng.normal(0.0, 0.3, (len(begin), 96))
    flow[rng.choice(len(begin), 6, replace=False)] += rng.normal(0.0, 20.0, (6, 96))
    return np.asarray(flow.reshape(-1, 6, 8, 2))


@pytest.mark.parametrize(("seed", "delay"), [(0, 0.083), (1, -0.05), (2, 0.0)])
def test_delay_is_recovered_with_its_error_bar(seed: int, delay: float) -> None:
    joints = smooth_joints(recorded(seed, 0.002), 0.015)
    times, flow = filmed(seed, delay)
    found = estimate_flow_delay(joints, times, flow, GROUPS, 0.0)
    assert found is not None and found.certain
    assert found.joints == (2, 3, 4)
    assert abs(found.delay.seconds - delay) < min(3.0 * found.delay.std_error + 0.0005, 0.006)


@pytest.mark.parametrize("seed", seeds(1, 4))
def test_a_recorder_that_stores_a_slow_camera_twice_leaves_the_delay(seed: int) -> None:
    """Stamps k/30 of a camera at 15.1 Hz lie up to 33 ms behind it; its clock leaves the delay that the true
    times of its pictures have."""
    rng = np.random.default_rng(seed)
    taken = np.arange(1.0 + rng.uniform(0.0, 0.06), 15.0, 1.0 / 15.1)
    ticks = np.arange(31, 449) / 30.0
    latest = np.searchsorted(taken, ticks, side="right") - 1
    ticks, latest = ticks[latest >= 0], latest[latest >= 0]
    repeated = np.diff(latest, prepend=-1) == 0
    new = ticks[~repeated]
    flow = make_flow(seed, taken)[: len(new) - 1]
    nothing = np.zeros(len(ticks))
    repeats = FrameRepeats(ticks, repeated, np.ones(len(ticks), bool), nothing, nothing)
    times = np.column_stack([new[:-1], new[1:]])
    seen = GridFlow(times, flow, nothing, nothing, nothing, nothing, (), repeats, (320, 240))
    dated = date_by_camera_clock(seen)
    joints = smooth_joints(recorded(seed, 0.002), 0.015)
    shown = taken[latest[~repeated]]
    late = float(np.mean(new - shown))
    true = replace(seen, times=np.column_stack([shown[:-1], shown[1:]]) + late)
    by_stamps, by_clock, by_truth = (
        estimate_flow_delay(joints, one.times, one.flow, GROUPS, 0.0) for one in (seen, dated, true)
    )
    assert by_stamps is not None and by_clock is not None and by_truth is not None
    assert abs(by_clock.delay.seconds - by_truth.delay.seconds) < 0.0005
    assert by_clock.nats > by_stamps.nats + 20.0


def test_images_of_another_motion_are_refused() -> None:
    joints = smooth_joints(recorded(0, 0.002), 0.015)
    for seed in (5, 6):
        times, flow = filmed(seed, 0.05)
        found = estimate_flow_delay(joints, times, flow, GROUPS, 0.0)
        assert found is None or not found.certain


def test_a_rolling_shutter_that_may_be_there_widens_the_error_bar() -> None:
    joints = smooth_joints(recorded(0, 0.002), 0.015)
    times, flow = filmed(0, 0.05)
    flow = flow * np.linspace(0.0, 1.0, 6)[None, :, None, None]  # the arm fills the lower rows
    sharp, rolling = (estimate_flow_delay(joints, times, flow, GROUPS, row_s) for row_s in (0.0, 0.06))
    assert sharp is not None and rolling is not None
    assert rolling.delay.std_error > sharp.delay.std_error + 0.005


def test_joints_are_grouped_by_the_side_in_their_names() -> None:
    names = ("kLeftElbow", "kRightElbow", "left_arm", "waist", "R_wrist")
    assert group_joints(names) == {"left": (0, 2), "right": (1, 4), "": (3,)}
    assert group_joints(("0", "1")) == {"": (0, 1)}


def test_joints_are_grouped_by_what_precedes_the_same_names() -> None:
    two = ("arm1/a", "arm2/a", "arm1/b", "arm2/b", "arm1/c", "arm2/c")
    assert group_joints(two) == {"arm1": (0, 2, 4), "arm2": (1, 3, 5)}
    for one in (two[:5], ("hip_x", "hip_y", "hip_z", "wrist_x", "wrist_y", "wrist_z"), ("j1.pos", "j2.pos"), ("1", "2")):
        assert group_joints(one) == {"": tuple(range(len(one)))}


@pytest.mark.skipif(not SO101.is_dir(), reason="the recorded arms are not in ../shared/real/so101")
def test_the_arm_that_carries_each_camera_is_named() -> None:
    """The mean change of a camera's images correlates by 0.5 and 0.6 with the speed of the arm named here,
    by 0.2 and 0.3 with the other's."""
    topics = TopicSettings(camera=("/cam0/image", "/cam1/image"))
    read = recording.read_recording(Path(f"{SO101}#1"), replace(Settings(), topics=topics))
    assert read.signals.joints is not None
    found = [one.found for one in measure_flow_delays(read)]
    assert [one and name_moving_arm(read.signals.joints.names, one) for one in found] == ["arm2", "arm1"]


@pytest.mark.skipif(not G1.is_dir(), reason="the recorded humanoid is not in ../shared/real/g1")
def test_the_delay_of_a_recorded_humanoid_is_found_without_marker_or_urdf() -> None:
    read = recording.read_recording(Path(f"{G1}#1"), Settings())
    (camera,) = measure_flow_delays(read)
    assert camera.found is not None and camera.found.certain
    # an adjustment with the URDF gives 85.2 ms
    assert abs(camera.found.delay.seconds - 0.0852) < min(0.02, 2.0 * camera.found.delay.std_error + 0.005)
    assert {read.signals.joints.names[k][:6] for k in camera.found.joints} == {"kRight"}  # type: ignore[union-attr]
