"""The estimate of a log with the checks around it, where joints bend as if their zeros had changed."""

import numpy as np
import pytest

from bodylog import pipeline
from bodylog.body import storage
from bodylog.findings import log_estimate
from bodylog.findings.log_estimate import LogWithBody
from bodylog.settings import Settings
from bodylog.sim.hardware import Hardware
from bodylog.types import HARDWARE_ERRORS

LOAD = Hardware(payload=float(np.deg2rad(1.0)))
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
