"""The estimate of a log with the checks around it, where joints bend as if their zeros had changed."""

import numpy as np
import pytest

from bodylog import pipeline
from bodylog.body import storage
from bodylog.evaluation.scores import truth_at_times
from bodylog.findings import log_estimate
from bodylog.findings.log_estimate import LogWithBody
from bodylog.settings import Settings
from bodylog.types import HARDWARE_ERRORS

LOAD = "payload=1"
LOGS = 10


DRAWN = {"noise": 1e-3, "size": (320, 240)}


def fit_body(folder, **options):
    """The body learned from 40 s of babbling."""
    exploration = folder / "explore.mcap"
    pipeline.record("babble", exploration, seed=1, duration=40.0, **{**DRAWN, **options})
    pipeline.fit([exploration], folder / "body.npz")
    return storage.load_body(folder / "body.npz")


def estimate_run(scenario, run, body, **options):
    """The estimate of a run that is recorded first."""
    pipeline.record(scenario, run, **{**DRAWN, **options})
    read, features = pipeline.observe(run, Settings())
    return log_estimate.estimate_log(LogWithBody(run, read, features, body, Settings(), Settings()))


@pytest.mark.soak
def test_a_load_is_named_as_a_payload_by_a_body_with_a_urdf(tmp_path):
    body = fit_body(tmp_path)
    named = 0
    for seed in range(11, 11 + LOGS):
        run = tmp_path / f"run{seed}.mcap"
        found = estimate_run("babble", run, body, seed=seed, duration=12.0, hardware=LOAD)
        assert not found.faults
        load = found.settings.get(HARDWARE_ERRORS, {}).get("load")
        named += load is not None and load["weight"]
    assert named >= 0.8 * LOGS


@pytest.mark.soak
@pytest.mark.parametrize("since", [0.0, 8.0])
def test_a_payload_is_named_where_joints_rest_that_moved_in_the_exploration(tmp_path, since):
    body = fit_body(tmp_path, full=True)
    hardware = f"{LOAD}@{since}s" if since else LOAD
    for seed in range(11, 14):
        run = tmp_path / f"run{seed}.mcap"
        found = estimate_run("reach", run, body, seed=seed, duration=16.0, hardware=hardware)
        assert not found.faults
        load = found.settings[HARDWARE_ERRORS]["load"]
        assert load["weight"]
        assert load["moments"] == ([None] if not since else [pytest.approx(since, abs=0.3)])


@pytest.mark.soak
@pytest.mark.parametrize("hardware", ["play=0.25", "correlated=0.002@2s"])
def test_an_arm_of_six_joints_that_wears_out_has_true_error_bars_and_no_fault(tmp_path, hardware):
    """Play and errors that came after the exploration: 56 to 65 % were within 2 standard deviations."""
    body = fit_body(tmp_path, full=True, noise=3e-3)
    for seed in (4, 5):
        run = tmp_path / f"run{seed}.mcap"
        drawn = {"seed": seed, "duration": 16.0, "full": True, "noise": 3e-3}
        found = estimate_run("babble", run, body, hardware=hardware, **drawn)
        assert not found.faults
        read, _ = pipeline.observe(run, Settings())
        names = list(found.joints.names)
        error = found.joints.values - truth_at_times(read.signals.truth, names, found.joints.t)
        stated = np.sqrt(np.einsum("nii->ni", found.cov))
        assert np.mean(np.abs(error) <= 2.0 * stated) > 0.8
