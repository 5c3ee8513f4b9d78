"""The estimate of a log with the checks around it, where joints bend as if their zeros had changed."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bodylog import pipeline
from bodylog.body import storage
from bodylog.body.kinematic import model
from bodylog.body.kinematic.change import Change, FoundChanges
from bodylog.estimation import estimate_from_features
from bodylog.evaluation.scores import truth_at_times
from bodylog.findings import log_estimate
from bodylog.findings.log_estimate import LogWithBody
from bodylog.settings import EstimationSettings, Settings
from bodylog.types import HARDWARE_ERRORS, LASTING_ERROR, Fault, FaultKind
from tests.estimation.conftest import draw

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


@pytest.fixture
def judged(monkeypatch):
    """`infer_with_changes` where `infer` gives these estimates by the body as learned and as moved, and changes are these."""
    world = draw(0, duration=4.0)
    plain = estimate_from_features(world.features, world.body, EstimationSettings())
    moved = replace(world.body, provenance={"camera": "moved"})

    by_offsets = []

    def judge(found, again, changes):
        by_errors = []
        by_offsets.clear()

        def find(_, body, errors, offsets=()):
            by_errors.append(errors)
            by_offsets.append(list(offsets))
            return changes

        monkeypatch.setattr(model, "can_show_changes", lambda body: True)
        monkeypatch.setattr(log_estimate, "infer", lambda _, body, settings: again if body is moved else found)
        monkeypatch.setattr(log_estimate, "_find_changes", find)
        estimate, body = log_estimate.infer_with_changes(world.features, world.body, Settings())
        return estimate, body is moved, by_errors

    return SimpleNamespace(judge=judge, plain=plain, body=world.body, moved=moved, by_offsets=by_offsets)


def displaced(since):
    return Fault("vision", "camera", FaultKind.DISPLACED, since, 5.0, "px", 0.2)


def camera_moved(body, doubt=0.0):
    value = np.full(6, 0.01)
    one = Change("camera", "camera", value, 0.1 * value, 100.0, shift=(0.01, 0.001), turn=(0.01, 0.001))
    return FoundChanges((one,), body, doubt * np.eye(len(body.joints)))


def test_a_moved_camera_that_explains_a_later_fault_replaces_it(judged):
    found = replace(judged.plain, faults=(displaced(2.0),))
    estimate, is_moved, _ = judged.judge(found, judged.plain, camera_moved(judged.moved, 1e-6))
    assert is_moved and [fault.kind for fault in estimate.faults] == [FaultKind.MOVED]
    assert np.allclose(estimate.cov, judged.plain.cov + 1e-6 * np.eye(3), rtol=1e-12, atol=0.0)


def test_a_later_fault_that_a_moved_camera_does_not_explain_is_all(judged):
    """It begins before it is found: what images show until then is no change."""
    found = replace(judged.plain, faults=(displaced(2.0),))
    estimate, is_moved, tried = judged.judge(found, found, camera_moved(judged.moved))
    assert estimate is found and not is_moved and len(tried) == 1


def test_changes_are_sought_beside_errors_that_only_widen_the_error_bars(judged):
    """Only those of the log's own evidence: the body holds the exploration's."""
    none = FoundChanges((), judged.body, np.zeros((3, 3)))
    for nats in (50.0, 0.0):
        widened = {"std": 2e-3, "seconds": 2.0, "nats": nats}
        found = replace(judged.plain, settings={**judged.plain.settings, LASTING_ERROR: widened})
        _, _, tried = judged.judge(found, found, none)
        assert tried[-1] == ({"lasting": widened} if nats else {})


@pytest.mark.parametrize(("load", "since", "offsets"), [(False, 0.0, ["lift"]), (True, 0.0, []), (False, 2.0, [])])
def test_offsets_from_the_start_are_compared_with_loads_where_an_estimate_has_none(judged, load, since, offsets):
    off = Fault("encoders", "lift", FaultKind.DRIFTING, since, 0.01, "rad", 1e-3)
    errors = {HARDWARE_ERRORS: {"load": {"rad": {"lift": 0.01}}}} if load else {}
    found = replace(judged.plain, faults=(off,), settings={**judged.plain.settings, **errors})
    judged.judge(found, found, FoundChanges((), judged.body, np.zeros((3, 3))))
    assert judged.by_offsets[-1] == offsets


@pytest.mark.parametrize(
    ("before", "after", "less"),
    [
        ((2, 0.0, 0.0), (1, 0.01, 1.0), True),
        ((1, 0.0, 1.0), (1, 0.0, 0.0), False),
        ((0, 0.01, 0.0), (0, 0.001, 0.0), True),
        ((0, 0.01, 0.0), (1, 0.0, 0.0), False),
        ((0, 0.0, 1.0), (0, 0.0, 0.4), True),
        ((0, 0.0, 1.0), (0, 0.0, 0.6), False),
        ((0, 0.0, 1.0), (0, 0.01, 0.4), False),
    ],
)
def test_an_estimate_by_a_moved_camera_must_need_less(monkeypatch, before, after, less):
    """Faults count first, then a load, then half of the variance of errors that last."""
    needs = {"before": log_estimate._Needs(*before), "after": log_estimate._Needs(*after)}
    monkeypatch.setattr(log_estimate, "_measure_needs", needs.get)
    assert log_estimate._needs_less("after", "before") == less


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
