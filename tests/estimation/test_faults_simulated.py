"""Encoder faults over ten seeds of every simulated scenario: faulty encoders are found in time, sound ones never."""

from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

from bodylog.estimation import estimate_from_features
from bodylog.experiments.beliefs import believe_by_default
from bodylog.experiments.lab import OTHER_LOG_SEED, Lab
from bodylog.settings import EstimationSettings

SEEDS = range(10)
SOUND = (
    ("babble", {"duration": 30.0}),
    ("horizontal", {"duration": 12.0, "noise": 0.02}),
    ("reach", {}),
    ("touch", {}),
    ("touch", {"variant": "late"}),
    ("rubber-hand", {"duration": 20.0, "variant": "synchronous", "place": "left"}),
    ("rubber-hand", {"duration": 20.0, "variant": "asynchronous", "place": "left"}),
    ("biased-start", {"duration": 16.0, "variant": "settling"}),
)
LYING = (("drift", "drifting", "shoulder_pan_joint", 9.6), ("frozen", "frozen", "elbow_joint", 8.0))
"""Scenario, kind of fault, joint, and the time (s) at which it exceeds 0.03 rad or begins."""
pytestmark = pytest.mark.soak


@pytest.fixture(scope="module")
def lab(request):
    """A lab that keeps its logs from run to run while their inputs are unchanged."""
    pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'bodylog[sim]'")
    package = Path(__file__).parents[2] / "bodylog"
    sources = sorted(
        path for stage in ("sim", "perception", "body") for path in (package / stage).rglob("*.py")
    )
    digest = sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()[:12]
    return Lab(Path(request.config.cache.mkdir(f"soak-{digest}")))


def believed(lab, scenario, seed, options):
    elsewhere = OTHER_LOG_SEED * (scenario in ("touch", "horizontal"))
    run, body = lab.observed(scenario, seed + elsewhere, **options), lab.body("default", seed)
    return run, estimate_from_features(run.features, body, EstimationSettings())


@pytest.mark.parametrize(("scenario", "options"), SOUND)
def test_faults_are_absent_for_sound_encoders(lab, scenario, options):
    accused = {
        seed: found.faults
        for seed in SEEDS
        if (found := believed(lab, scenario, seed, options)[1]).faults
    }
    print(f"{scenario:14s} {options.get('variant', ''):14s} {len(accused)} of {len(SEEDS)} accused")
    assert not accused


@pytest.mark.parametrize(("scenario", "kind", "joint", "exceeds"), LYING)
def test_faulty_encoder_is_named_within_two_seconds_and_replaced(
    lab, scenario, kind, joint, exceeds
):
    for seed in SEEDS:
        run, found = believed(lab, scenario, seed, {})
        (fault,) = found.faults
        error = found.joints.values - run.true(found.joints.names, found.joints.t)
        late = np.sqrt(np.mean(error[found.joints.t > found.joints.t[-1] - 8.0] ** 2, axis=0))
        print(
            f"{scenario:8s} {seed} since {fault.since:.2f} s, {fault.size:.3f} rad; last 8 s",
            late.round(4),
        )
        assert (fault.kind, fault.name) == (kind, joint)
        assert fault.since < exceeds + 2.0
        assert late.max() < 0.015


@pytest.mark.parametrize("joint", ["pan", "lift", "elbow"])
def test_frozen_encoder_adds_less_than_three_milliradians_everywhere(world, joint):
    for seed in SEEDS:
        drawn = world(seed, duration=16.0, encoder_std=0.001, pixel_std=0.5, camera_hz=30.0)
        joints = drawn.features.joints
        values, column = joints.values.copy(), joints.names.index(joint)
        values[joints.t >= 8.0, column] = values[np.searchsorted(joints.t, 8.0), column]
        features = replace(drawn.features, joints=replace(joints, values=values))
        found = estimate_from_features(features, drawn.body, EstimationSettings())
        assert [(fault.name, fault.kind) for fault in found.faults] == [(joint, "frozen")]
        assert np.sqrt(np.mean((found.joints.values - drawn.truth.values) ** 2)) < 3e-3


@pytest.mark.parametrize("size", [0.05, 0.1, -0.2])
def test_encoder_step_of_several_deviations_is_always_named(world, size):
    for seed in SEEDS:
        drawn = world(seed, duration=16.0, encoder_std=0.01, pixel_std=0.5, camera_hz=20.0)
        joints = drawn.features.joints
        values = joints.values + size * np.outer(joints.t >= 8.0, np.array(joints.names) == "pan")
        found = estimate_from_features(
            replace(drawn.features, joints=replace(joints, values=values)),
            drawn.body,
            EstimationSettings(),
        )
        (fault,) = found.faults
        assert fault.name == "pan" and 7.9 < fault.since < 10.0
        assert fault.size == pytest.approx(size, abs=0.04)


def test_rubber_hand_moves_the_estimate_only_when_synchronous(lab):
    """Drift of the estimated effector toward the hand, px: synchronous at least twenty times asynchronous."""
    for seed in SEEDS:
        body, drift = lab.body("default", seed), {}
        for variant in ("synchronous", "asynchronous"):
            run = lab.observed("rubber-hand", seed, duration=20.0, variant=variant, place="left")
            with_it, without = (
                believe_by_default(run, body),
                believe_by_default(run, body, ("encoders",)),
            )
            apart = [
                body.senses["effector"].predict(belief.x)[0][:, 0] for belief in (with_it, without)
            ]
            drift[variant] = float(np.abs(apart[0] - apart[1])[with_it.t > 5.0].max())
        print(seed, drift)
        assert drift["synchronous"] > 20.0 * drift["asynchronous"]
