"""The estimate of a log with the checks around it, where joints bend as if their zeros had changed."""

import pytest

from bodylog import pipeline
from bodylog.body import storage
from bodylog.findings import log_estimate
from bodylog.findings.log_estimate import LogWithBody
from bodylog.settings import Settings
from bodylog.types import HARDWARE_ERRORS

LOAD = "payload=1"
LOGS = 10


@pytest.mark.soak
def test_a_load_is_named_as_a_payload_by_a_body_with_a_urdf(tmp_path):
    exploration = tmp_path / "explore.mcap"
    drawn = {"noise": 1e-3, "size": (320, 240)}
    pipeline.record("babble", exploration, seed=1, duration=40.0, **drawn)
    pipeline.fit([exploration], tmp_path / "body.npz")
    body = storage.load_body(tmp_path / "body.npz")
    named = 0
    for seed in range(11, 11 + LOGS):
        run = tmp_path / f"run{seed}.mcap"
        pipeline.record("babble", run, seed=seed, duration=12.0, hardware=LOAD, **drawn)
        read, features = pipeline.observe(run, Settings())
        log = LogWithBody(run, read, features, body, Settings(), Settings())
        found = log_estimate.estimate_log(log)
        assert not found.faults
        load = found.settings.get(HARDWARE_ERRORS, {}).get("load")
        named += load is not None and load["weight"]
    assert named >= 0.8 * LOGS


@pytest.mark.soak
@pytest.mark.parametrize("since", [0.0, 8.0])
def test_a_payload_is_named_where_joints_rest_that_moved_in_the_exploration(tmp_path, since):
    exploration = tmp_path / "explore.mcap"
    drawn = {"noise": 1e-3, "size": (320, 240)}
    pipeline.record("babble", exploration, seed=1, duration=40.0, full=True, **drawn)
    pipeline.fit([exploration], tmp_path / "body.npz")
    body = storage.load_body(tmp_path / "body.npz")
    hardware = f"{LOAD}@{since}s" if since else LOAD
    for seed in range(11, 14):
        run = tmp_path / f"run{seed}.mcap"
        pipeline.record("reach", run, seed=seed, duration=16.0, hardware=hardware, **drawn)
        read, features = pipeline.observe(run, Settings())
        log = LogWithBody(run, read, features, body, Settings(), Settings())
        found = log_estimate.estimate_log(log)
        assert not found.faults
        load = found.settings[HARDWARE_ERRORS]["load"]
        assert load["weight"]
        assert load["moments"] == ([None] if not since else [pytest.approx(since, abs=0.3)])
