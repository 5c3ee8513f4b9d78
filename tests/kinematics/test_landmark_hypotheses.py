"""What changed since earlier logs: one joint's offset, a moved camera, or nothing."""

import numpy as np
import pytest

from bodylog.kinematics.landmark_errors import unknowns_covariance
from bodylog.kinematics.landmark_fit import search_delay, staged_fit
from bodylog.kinematics.landmark_hypotheses import (
    CAMERA,
    SOUND,
    ChangeHypothesis,
    information_of_log,
    join_changes,
    weigh_hypotheses,
    widen_zero_belief,
)
from bodylog.kinematics.landmarks import LandmarkBelief
from bodylog.types import Array
from tests.kinematics.landmark_arm import JOINTS, model, motion, seen, truth

NATS = 8.0


def changes(offset: Array, moved: Array, seed: int) -> dict[str, ChangeHypothesis]:
    """The hypotheses of a log whose readings are off by `offset` (4,) rad, for a belief of 0.3° and 5 mm."""
    built = model([motion(seed)])
    phi = truth(built, delay=0.03)
    std = built.prior[1].copy()
    std[:6], std[6], std[built.rig.of_joints] = 0.005, 0.003, 0.005
    std[7:12] *= 0.2
    belief = LandmarkBelief(phi.copy(), np.diag(std**2))
    there = phi.copy()
    there[built.rig.of_joints] -= offset
    there[:6] += moved
    part, _ = seen(built, there, seed + 1)
    free = widen_zero_belief(built, belief)
    start, _ = search_delay(free, belief.mean.copy(), part.thinned(4))
    found = staged_fit(free, start, part.thinned(2))
    assert found is not None
    log_information = information_of_log(free, found.phi, unknowns_covariance(found))
    return {one.name: one for one in weigh_hypotheses(built, belief, log_information)}


@pytest.mark.parametrize("joint", [0, 1, 2])
def test_offset_of_one_joint_is_found_and_alone(joint):
    off = np.radians(5.0) * (np.arange(4) == joint)
    found = changes(off, np.zeros(6), 200 + 7 * joint)
    best = max(found.values(), key=lambda one: one.nats)
    assert best.name == JOINTS[joint]
    assert best.nats - found[SOUND].nats > NATS
    assert abs(-best.value - np.radians(5.0)) < 2.5 * best.std
    assert best.std < np.radians(1.0)


def test_sound_log_is_accused_of_nothing():
    found = changes(np.zeros(4), np.zeros(6), 300)
    assert max(one.nats for one in found.values()) - found[SOUND].nats < NATS / 2


def test_moved_camera_is_no_joint():
    found = changes(np.zeros(4), np.array([0.08, 0.0, 0.0, 0.0, 0.05, 0.03]), 310)
    assert max(found.values(), key=lambda one: one.nats).name == CAMERA


def test_evidence_is_that_of_the_gaussian():
    built = model([motion(400)])
    count = len(built.prior[0])
    rng = np.random.default_rng(1)
    belief = LandmarkBelief(np.zeros(count), np.diag(rng.uniform(0.01, 0.02, count) ** 2))
    design = rng.standard_normal((40, count)) * 50.0
    phi = belief.mean.copy()
    index = built.rig.of_joints.start + 2
    phi[index] = 0.08
    z = design @ phi + rng.standard_normal(40)
    free = widen_zero_belief(built, belief)
    precision = design.T @ design + free.prior_precision
    mean = np.linalg.solve(precision, design.T @ z)
    log_information = information_of_log(free, mean, np.linalg.inv(precision))
    found = {one.name: one for one in weigh_hypotheses(built, belief, log_information)}

    def ln_evidence(covariance: Array) -> float:
        spread = design @ covariance @ design.T + np.eye(40)
        return float(-0.5 * np.linalg.slogdet(spread)[1] - 0.5 * z @ np.linalg.solve(spread, z))

    plain = ln_evidence(belief.covariance)
    wide = belief.covariance.copy()
    wide[index, index] += 0.1**2
    assert found[JOINTS[2]].nats - found[SOUND].nats == pytest.approx(ln_evidence(wide) - plain, abs=1e-3)
    gain = wide @ design.T @ np.linalg.inv(design @ wide @ design.T + np.eye(40))
    expected = 0.1**2 / wide[index, index] * (gain @ z)[index]
    assert found[JOINTS[2]].value == pytest.approx(expected, rel=1e-4)
    alone = join_changes([list(found.values())], 3, 4.0)
    for one, joined in zip(found.values(), alone, strict=True):
        assert joined.name == one.name
        assert joined.nats == pytest.approx(one.nats - found[SOUND].nats, abs=1e-3)
        assert (joined.value, joined.std) == pytest.approx((one.value, one.std), rel=1e-6)


def changes_by_measurements(measured: Array, own: Array, prior: float) -> list[list[ChangeHypothesis]]:
    """Of logs the hypotheses of one joint, whose offset each measures with std `own`."""
    std = (own**-2.0 + prior**-2.0) ** -0.5
    value = std**2 / own**2 * measured
    nats = np.log(std / prior) + 0.5 * (value / std) ** 2
    each = zip(nats, value, std, strict=True)
    return [[ChangeHypothesis(SOUND, 0.0), ChangeHypothesis("elbow", *one, prior), ChangeHypothesis(CAMERA, 1.0)] for one in each]


def test_logs_together_have_the_evidence_of_one_offset_and_of_the_body_s_error():
    prior, learned_from, own = 0.1, 3, np.full(4, 0.012)
    measured = np.array([0.024, 0.031, 0.02, 0.028])
    sound, joint, camera = join_changes(changes_by_measurements(measured, own, prior), learned_from, 4.0)
    shared = own[0] ** 2 / (learned_from + 1.0)
    covariance = np.eye(4) * (own**2 - shared) + shared
    wide = covariance + prior**2

    def ln_density(spread: Array) -> float:
        return float(-0.5 * np.linalg.slogdet(spread)[1] - 0.5 * measured @ np.linalg.solve(spread, measured))

    assert joint.nats == pytest.approx(ln_density(wide) - ln_density(covariance), abs=1e-6)
    assert joint.value == pytest.approx(prior**2 * np.linalg.solve(wide, measured).sum(), rel=1e-6)
    assert joint.std**2 == pytest.approx(prior**2 - prior**4 * np.linalg.inv(wide).sum(), rel=1e-6)
    assert (sound.nats, camera.nats) == (0.0, 4.0)
    assert joint.std > own[0] / 2.0  # four logs are no surer than their body


def test_offset_of_one_log_is_none_of_all_logs():
    logs = changes_by_measurements(np.array([0.0, 0.087, 0.001]), np.full(3, 0.004), 0.1)
    _, joint, _ = join_changes(logs, 6, 4.0)
    assert joint.value == 0.0 and joint.nats > 100.0  # it differs: so no other joint explains it
    still = [logs[0][:2], *logs[1:]]  # in the first log the camera cannot have moved
    assert [one.name for one in join_changes(still, 6, 4.0)] == [SOUND, "elbow", CAMERA]
    assert join_changes(still, 6, 4.0)[2].nats == 2.0
    assert len(join_changes([one[:2] for one in logs], 6, 4.0)) == 2
    same = changes_by_measurements(np.array([0.085, 0.087, 0.094]), np.full(3, 0.004), 0.1)
    _, joint, _ = join_changes(same, 6, 4.0)
    assert joint.value == pytest.approx(0.0885, abs=0.001) and joint.nats > 100.0
