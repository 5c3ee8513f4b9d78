"""Points in space along a motion: late ones are learned without a wrong zero, and other logs are judged by them."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog import Estimator, body, pipeline
from bodylog.body.kinematic.placements import calibration_of_body
from bodylog.delays.camera_delay import learn_with_delays
from bodylog.delays.tracker_delay import measure_tracker_delays, measure_turning_delays
from bodylog.errors import UsageError
from bodylog.kinematics.rotations import make_transform, rotation_from_vector
from bodylog.settings import Settings
from bodylog.types import Features, Series
from tests.body.kinematic_arms import given
from tests.body.tracked_arms import measure_points, points_series
from tests.kinematics.robots import JOINTS

LATE_S = 0.04
NOISE_M = 3e-4
END_S = 24.0
SEEN_FROM = make_transform(rotation_from_vector(np.array([0.3, -0.5, 2.0])), np.array([-2.0, 1.0, 0.4]))
TOOL = np.array([0.03, -0.02, 0.08])


def path_of_arm(seed: int | np.random.Generator):
    """The angles (N,M) rad at times (N,) s of slow waves."""
    draw = np.random.default_rng(seed)
    speed, phase = draw.uniform(0.3, 1.3, (3, 4)), draw.uniform(0.0, 6.0, (3, 4))

    def angles(t):
        waves = sum(np.sin(speed[k] * t[:, None] + phase[k]) for k in range(3))
        return np.array([0.0, -0.6, 0.9, 0.2]) + 0.25 * waves

    return angles


def moving_arm(seed: int, offset=(0.0, 0.0, 0.0, 0.0), shift_m: float = 0.0) -> Features:
    """An arm in slow waves; its readings lack an offset (M,) rad, and the tracker moves by shift_m half-way."""
    draw = np.random.default_rng(seed)
    angles = path_of_arm(draw)
    t = np.arange(0.0, END_S, 0.02)
    joints = Series(t, angles(t) - offset + draw.normal(0.0, 2e-4, (len(t), 4)), JOINTS, "rad", (t * 1e9).astype(np.int64))
    at = np.arange(0.3, END_S - 0.3, 0.04)
    points = measure_points(angles(at), TOOL, SEEN_FROM) + draw.normal(0.0, NOISE_M, (len(at), 3))
    points[at > END_S / 2] += np.array([shift_m, 0.0, 0.0])
    return Features(joints, {"tracker/ball": points_series(at + LATE_S, points)}, None, (), (), {})


def test_each_log_has_its_own_delay():
    """Two logs of the same arm, one of them on time; a third without points says nothing."""
    late, timely = moving_arm(6), moving_arm(7)
    tracks = {name: replace(one, t=one.t - LATE_S) for name, one in timely.tracks.items()}
    logs = [late, replace(timely, tracks=tracks), replace(timely, tracks={})]
    found = measure_tracker_delays(logs, Settings(), given(), ["tracker"])
    for delays, true in zip(found, (LATE_S, 0.0), strict=False):
        assert abs(delays["tracker"].seconds - true) < 4.0 * delays["tracker"].std_error < 0.001
    assert found[2] == {}
    hidden = points_series(late.tracks["tracker/ball"].t, np.full((len(late.tracks["tracker/ball"].t), 3), np.nan))
    assert measure_tracker_delays([replace(late, tracks={"tracker/ball": hidden})], Settings(), given(), ["tracker"]) == [{}]


@pytest.mark.parametrize("seed", [11, 14])
@pytest.mark.soak
def test_without_a_urdf_a_delay_is_found_within_its_error_bar(seed, monkeypatch):
    """A process of the points' slopes found 12 ± 2 ms with the first seed."""
    for late in (LATE_S, 0.0):
        monkeypatch.setattr(f"{__name__}.LATE_S", late)
        found = measure_turning_delays([moving_arm(seed)], Settings(), ["tracker"])[0]["tracker"]
        assert abs(found.seconds - late) < 3.0 * found.std_error < 0.03


def test_without_motion_or_points_no_delay_is_measured():
    log = moving_arm(11)
    assert log.joints is not None
    still = replace(log, joints=replace(log.joints, values=0.0 * log.joints.values))
    tracks = {name: points_series(one.t[:20], one.values[:20] / 1e3) for name, one in log.tracks.items()}
    few = replace(log, tracks=tracks)
    assert measure_turning_delays([still, few], Settings(), ["tracker"]) == [{}, {}]


@pytest.mark.parametrize("seed", [2, 3])
@pytest.mark.soak
def test_without_a_urdf_error_bars_hold_beyond_the_explored_path(seed, monkeypatch):
    """Another log goes where the process errs by millimetres for seconds: no error of encoders, and no noise of one axis."""
    monkeypatch.setattr(f"{__name__}.LATE_S", 0.0)
    model = body.learn_body([moving_arm(seed)], Settings(), {}, None, "explained").model
    np.testing.assert_allclose(np.sqrt(model.noise.senses["tracker/ball"]), 1e3 * NOISE_M, rtol=0.15)
    log = moving_arm(seed + 100)
    found = pipeline.infer(log, model, Settings())
    exact = path_of_arm(seed + 100)(found.joints.t)
    off = found.joints.values - exact
    nees = np.einsum("ni,ni->n", off, np.linalg.solve(found.cov, off[..., None])[..., 0]).mean() / len(JOINTS)
    raw = log.joints.values - path_of_arm(seed + 100)(log.joints.t)
    assert 0.5 < nees < 2.0 and np.square(off).mean() < np.square(raw).mean()
    assert not found.faults and not any("errors last" in one.text for one in found.findings)


@pytest.fixture(scope="module")
def learned():
    return learn_with_delays([moving_arm(1)], Settings(), {}, None, given())


def test_late_points_are_learned_on_time(learned):
    assert learned.model.provenance["delay"]["tracker"] == pytest.approx(LATE_S, abs=0.002)
    zeros = {one.joint: one for one in calibration_of_body(learned.model).zeros}
    for joint in ("lift", "elbow"):
        assert abs(zeros[joint].value) < 3.0 * zeros[joint].std and zeros[joint].std < np.radians(0.2)


def test_other_logs_are_judged_by_points(learned):
    sound = pipeline.infer(moving_arm(2), learned.model, Settings())
    assert not sound.faults and sound.settings["delay"]["tracker"] == pytest.approx(LATE_S, abs=0.002)
    turned = pipeline.infer(moving_arm(3, (0.0, np.radians(1.0), 0.0, 0.0)), learned.model, Settings())
    (fault,) = turned.faults
    assert (fault.name, fault.sense) == ("lift", "encoders") and abs(fault.size) == pytest.approx(np.radians(1.0), rel=0.05)
    moved = pipeline.infer(moving_arm(4, shift_m=0.005), learned.model, Settings())
    (fault,) = moved.faults
    assert (fault.name, fault.kind, fault.unit) == ("tracker", "displaced", "mm")
    assert fault.size == pytest.approx(5.0, abs=4.0 * fault.std) and fault.since == pytest.approx(END_S / 2, abs=0.2)


def test_points_alone_tell_the_posture_that_they_determine(learned):
    """Without one encoder its joint is known by the points, with error bars that hold."""
    log = moving_arm(5)
    blind = log.joints.values.copy()
    blind[25:, 1] = np.nan  # silent after half a second
    found = pipeline.infer(replace(log, joints=replace(log.joints, values=blind)), learned.model, Settings())
    m = found.joints.names.index("lift")
    rows = (found.joints.t > 1.0) & (found.joints.t < END_S - 1.0)
    truth = np.interp(found.joints.t, log.joints.t, log.joints.values[:, 1])
    off = (found.joints.values[:, m] - truth)[rows]
    assert np.sqrt(np.mean(off**2)) < 0.003
    assert np.mean(off**2 / found.cov[rows, m, m]) < 3.0


def test_live_filter_takes_points_in_metres(learned):
    log = moving_arm(8)
    track = log.tracks["tracker/ball"]
    live = Estimator(learned.model)
    belief = None
    for k in range(100):
        live.step(float(log.joints.t[k]), log.joints.values[k])
    for k in range(len(track.t)):
        if track.t[k] < log.joints.t[99]:
            belief = live.step(float(track.t[k]), **{"tracker/ball": tuple(track.values[k] / 1e3)})
    assert belief is not None and "tracker/ball" in belief.errors
    truth = [np.interp(belief.t, log.joints.t, column) for column in log.joints.values.T]
    np.testing.assert_allclose(belief.x, truth, atol=0.003)
    with pytest.raises(UsageError, match=r"\(x, y, z\) or \(x, y, z, std_x, std_y, std_z\) in m"):
        live.step(3.0, **{"tracker/ball": (1.0, 2.0)})
