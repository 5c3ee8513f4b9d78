"""A body file whose matrices are no poses, or whose numbers no camera has, is refused by the field's name."""

import io
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from bodylog.body import storage
from bodylog.errors import ModelError
from tests.adversary.cases import ARM, UR5


@pytest.fixture(scope="module")
def kinematic(tmp_path_factory, run_cli):
    """A body learned with a URDF."""
    body = tmp_path_factory.mktemp("kinematic") / "body.npz"
    assert run_cli("fit", ARM / "explore.mcap", "--urdf", UR5, "-o", body) == 0
    return body


def _scaled(array):
    array[..., :3, :3] *= 1.01


def _mirrored(array):
    array[..., :3, 0] *= -1.0


def _far(array):
    array[..., 0, 3] = 1e30


def _sheared(array):
    array[..., 0, 1] += 0.1


def _last_row(array):
    array[..., 3, 0] = 1.0


def _large(array):
    array[...] = 1e30


@pytest.mark.parametrize("field", ["chain", "camera", "marker", "base", "base_tool", "hand"])
@pytest.mark.parametrize("change", [_scaled, _mirrored, _far, _sheared, _last_row])
def test_load_refuses_matrices_that_are_no_poses(kinematic, tmp_path, field, change):
    with pytest.raises(ModelError, match=rf"field effector/{field}: found .*, possible: (a rotation|at most)"):
        storage.load_body(_changed(kinematic, tmp_path / "x.npz", field, change))


@pytest.mark.parametrize("field", ["theta", "lens", "points", "steps", "base_steps", "hand_steps", "still"])
def test_load_refuses_numbers_that_no_camera_has(kinematic, tmp_path, field):
    with pytest.raises(ModelError, match=f"field effector/{field}: found "):
        storage.load_body(_changed(kinematic, tmp_path / "x.npz", field, _large))


def test_load_reads_a_learned_body(kinematic, tmp_path):
    storage.load_body(_changed(kinematic, tmp_path / "x.npz", "chain", lambda array: None))


def test_joints_that_stood_still_come_back(kinematic, tmp_path):
    body = storage.load_body(kinematic)
    sense = body.senses["effector"]
    assert sense.still_joints[0] == "wrist_1_joint"
    storage.save(body, tmp_path / "again.npz")
    again = storage.load_body(tmp_path / "again.npz").senses["effector"]
    assert again.still_joints == sense.still_joints
    x = sense.samples[:3]
    for one, other in zip(again.show_still_joints(x), sense.show_still_joints(x), strict=True):
        np.testing.assert_array_equal(one, other)
        assert np.abs(one).max() > 0.01
    alone = replace(sense, base=replace(sense.base, hand=None, still=np.zeros(0)))
    storage.save(replace(body, senses={**body.senses, "effector": alone}), tmp_path / "alone.npz")
    assert storage.load_body(tmp_path / "alone.npz").senses["effector"].still_joints == ()


def test_zeros_of_resting_joints_come_back_and_need_rigid_steps(kinematic, tmp_path):
    body = storage.load_body(kinematic)
    sense = body.senses["effector"]
    chain = sense.rig.sights[0].chain.fixed.copy()
    chain[1, :3, 3] += 0.01
    rested = replace(body, senses={**body.senses, "effector": replace(sense, resting=chain)})
    storage.save(rested, tmp_path / "rested.npz")
    again = storage.load_body(tmp_path / "rested.npz").senses["effector"]
    np.testing.assert_array_equal(again.resting, chain)
    x = sense.samples[:3]
    assert np.abs(again.kinematics(x) - sense.kinematics(x)).max() > 1.0
    np.testing.assert_array_equal(again.means(x)[0], sense.means(x)[0])
    with pytest.raises(ModelError, match=r"field effector/resting: found .*, possible: a rotation"):
        storage.load_body(_changed(tmp_path / "rested.npz", tmp_path / "x.npz", "resting", _sheared))


def _changed(source, path, field, change):
    """A copy of a body with one array changed."""
    with zipfile.ZipFile(source) as read, zipfile.ZipFile(path, "w") as written:
        for name in read.namelist():
            data = read.read(name)
            if name == f"effector/{field}.npy":
                array = np.load(io.BytesIO(data))
                change(array)
                out = io.BytesIO()
                np.save(out, array)
                data = out.getvalue()
            written.writestr(name, data)
    return path
