"""Healthy logs without any fault found: drawn with many settings, recorded, and joints of real robots."""

from pathlib import Path

import numpy as np
import pytest

from bodylog.body_model import BodyModel, Noise, TouchConstants
from bodylog.estimation import estimate_from_features
from bodylog.recording import recording
from bodylog.settings import EstimationSettings, Settings
from bodylog.types import Features, Series
from tests.estimation.resting import MOTIONS, READ, Drawn, drawn

SHARED = Path(__file__).parents[3] / "shared"


def accused(joints: Series) -> list[str]:
    """Faults found in joints alone."""
    m = len(joints.names)
    body = BodyModel(joints.names, {}, Noise((1e-4,) * m, {}, (0.3,) * m), TouchConstants(1.0, 0.005), {})
    found = estimate_from_features(Features(joints, {}, None, (), (), {}), body, EstimationSettings())
    return [f"{fault.name} {fault.kind} {fault.since:.2f} s" for fault in found.faults]


@pytest.mark.soak
@pytest.mark.parametrize("moves", MOTIONS)
@pytest.mark.parametrize("how", READ, ids=str)
def test_faults_are_absent_for_drawn_encoders(moves, how):
    for seed in (100, 101, 102, 103):
        world = drawn(seed, Drawn(moves, **how))
        for senses in (None, ("encoders",)):
            assert not estimate_from_features(world.features, world.body, EstimationSettings(senses=senses)).faults


LOGS = (
    "ipab-slmc__kuka_honeypot_demo/data/test.bag",
    "vbarcena2020__abitobot/rosbag",
    *(f"worlds/{name}" for name in ("ball_explore", "ball_offset", "tag_explore", "tag_noise")),
    *(f"arm/{name}" for name in ("drift.mcap", "explore.mcap", "reach.mcap", "touch.mcap", "touch_async.mcap")),
    *(f"arm/{name}" for name in ("reach.bag", "reach_rosbag2")),
)


@pytest.mark.parametrize("name", LOGS)
def test_faults_are_absent_in_readings_of_real_logs(name):
    path = SHARED / "logs" / name
    if not path.exists():
        pytest.skip(f"{path} is not at hand")
    joints = recording.read_recording(path, Settings()).signals.joints
    assert joints is not None and not accused(joints)


@pytest.mark.parametrize("episode", [0, 1])
@pytest.mark.parametrize("column", ["observation.state", "action"])
def test_faults_are_absent_for_servos_of_real_arms(episode, column):
    path = SHARED / "real" / "so101" / "data" / "chunk-000" / f"episode_{episode:06}.parquet"
    if not path.exists():
        pytest.skip(f"{path} is not at hand")
    table = pytest.importorskip("pyarrow.parquet").read_table(path, columns=["timestamp", column])
    t, ticks = (np.array(table[name].to_pylist(), float) for name in ("timestamp", column))
    names = tuple(f"servo_{number}" for number in range(ticks.shape[1]))
    joints = Series(t, ticks * 2.0 * np.pi / 4096.0, names, "rad", (t * 1e9).astype(np.int64))
    assert np.mean(np.diff(ticks, axis=0) == 0.0) > 0.6
    assert not accused(joints)
