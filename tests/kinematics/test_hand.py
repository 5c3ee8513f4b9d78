"""An arm that holds the camera: joints that stood still, and a weight at the camera."""

import numpy as np
import pytest

from bodylog.findings import log_estimate
from bodylog.settings import Settings
from bodylog.types import FaultKind
from tests.body import camera_arms
from tests.seeds import first_of, seeds
from tests.validation import pushed_cameras

STEP = 1e-6


@pytest.fixture(scope="module")
def known():
    return camera_arms.explored()


def test_images_show_what_a_joint_that_stood_still_gives_way(known):
    model = known.senses["effector"]
    assert model.base.camera and model.still_joints == ("wrist",)
    q = camera_arms.run(5)[0].joints.values[::97]
    shown, rises = model.show_still_joints(q[:, : camera_arms.WRIST])
    one = camera_arms.rig()
    chain = camera_arms.chain_to_tool()

    def see(wrist):
        angles = q.copy()
        angles[:, camera_arms.WRIST] = wrist
        image = one.see(one.sights[0], one.prior[0], angles).image[:, 0]
        return image, chain.at(angles).place[:, 2]

    middle = camera_arms.CENTRE[camera_arms.WRIST]
    (above, high), (below, low) = see(middle + STEP), see(middle - STEP)
    # the learned camera is some mm and mrad from the true one
    np.testing.assert_allclose(shown[..., 0], (above - below) / (2 * STEP), atol=15.0)
    np.testing.assert_allclose(rises[:, 0, 0], (high - low) / (2 * STEP), atol=0.01)
    assert np.abs(shown).max() > 300.0 and np.abs(rises).max() > 0.05


def test_the_noise_of_a_joint_that_stood_still_is_no_error_of_images(known):
    """It would be one of half a pixel, beside 0.3 px, and move the calibration by 13 standard deviations."""
    without = camera_arms.explored(wrist_noise=False).senses["effector"]
    model = known.senses["effector"]
    std = np.sqrt(np.square(without.root).sum(axis=1))
    np.testing.assert_array_less(np.abs(model.printed - without.printed), 0.5 * std + 1e-9)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.soak
def test_a_weight_at_the_camera_is_a_payload_and_no_moved_camera(known, seed):
    for payload in (0.0, 0.01):
        features, truth = camera_arms.run(60 + seed, payload=payload)
        found, _ = log_estimate.infer_with_changes(features, known, Settings())
        named = {name for fault in found.faults for name in fault.names}
        assert ("payload" in named) == bool(named) and not any(np.isfinite(one.size) for one in found.faults)
        has_load = any(one.text.startswith("payload:") for one in found.findings)
        assert (has_load or bool(named)) == (payload > 0.0)
        off, nees = _judge(found, truth)
        assert nees < 2.0 and (named or off < 2e-3)


@pytest.mark.parametrize("degrees", first_of(1, [0.3, 1.0]))
@pytest.mark.parametrize("seed", seeds(1, 4))
def test_a_camera_that_was_pushed_on_the_hand_is_no_payload(known, seed, degrees):
    push = pushed_cameras.push(np.random.default_rng(seed), degrees, 0.01 * degrees)
    features, truth = camera_arms.run(60 + seed, push=push)
    found, _ = log_estimate.infer_with_changes(features, known, Settings())
    assert [(fault.name, fault.kind) for fault in found.faults] == [("camera", FaultKind.MOVED)]
    off, nees = _judge(found, truth)
    assert off < 0.6e-3 and nees < 1.5


@pytest.mark.soak
def test_an_offset_that_a_payload_explains_as_well_has_no_size(known):
    """By small motions alone nothing tells whether the lift slipped, or bends as others do."""
    features, truth = camera_arms.run(60, payload=0.01, swing_rad=0.35)
    found, _ = log_estimate.infer_with_changes(features, known, Settings())
    (fault,) = found.faults
    assert set(fault.names) == {"lift", "payload"} and np.isnan(fault.size)
    off, nees = _judge(found, truth)
    assert off > 3e-3 and nees < 2.0


def _judge(found, truth):
    """RMS error, rad, and NEES of joints that moved."""
    off = found.joints.values - truth.values[:, : camera_arms.WRIST]
    nees = float((off**2 / np.einsum("nii->ni", found.cov)).mean())
    return float(np.sqrt(np.square(off).mean())), nees
