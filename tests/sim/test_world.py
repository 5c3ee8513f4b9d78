import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from math import pi

import numpy as np
import pytest

from bodylog.errors import UsageError
from bodylog.sim.arms import ARMS
from bodylog.sim.camera import FAR, ellipse_centre, look_at
from bodylog.sim.world import EFFECTOR_RADIUS, matrix_from_quaternion, open_world

pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'bodylog[sim]'")

# Public Denavit-Hartenberg rows (a, d, alpha) of each arm, m and rad.
TABLES = {
    "ur5": [
        (0.0, 0.089159, pi / 2),
        (-0.425, 0.0, 0.0),
        (-0.39225, 0.0, 0.0),
        (0.0, 0.10915, pi / 2),
        (0.0, 0.09465, -pi / 2),
        (0.0, 0.0823, 0.0),
    ],
    "seven": [
        (0.0, 0.34, -pi / 2),
        (0.0, 0.0, pi / 2),
        (0.0, 0.4, pi / 2),
        (0.0, 0.0, -pi / 2),
        (0.0, 0.4, -pi / 2),
        (0.0, 0.0, pi / 2),
        (0.0, 0.126, 0.0),
    ],
}


def hartenberg(rows, q):
    total = np.eye(4)
    for (a, d, alpha), theta in zip(rows, q, strict=True):
        c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        total = total @ [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
    return total


@pytest.mark.parametrize("name", ARMS)
def test_urdf_agrees_with_the_denavit_hartenberg_formula(name):
    rng = np.random.default_rng(3)
    with open_world(ARMS[name]) as world:
        tool = world.links.index("tool0")
        for q in rng.uniform(-3, 3, (20, len(ARMS[name].joints))):
            places, turns = world.pose(q)
            expected = hartenberg(TABLES[name], q)
            np.testing.assert_allclose(places[tool], expected[:3, 3], atol=1e-6)
            np.testing.assert_allclose(matrix_from_quaternion(turns[tool]), expected[:3, :3], atol=1e-6)


@pytest.mark.parametrize("name", ARMS)
def test_home_and_swing_stay_within_the_limits(name):
    arm = ARMS[name]
    root = ElementTree.parse(arm.urdf).getroot()
    joints = [joint for joint in root.findall("joint") if joint.get("type") == "revolute"]
    limits = {joint.get("name"): joint.find("limit") for joint in joints}
    assert tuple(limits) == arm.joints
    for joint, home, swing in zip(arm.joints, arm.home, arm.swing, strict=True):
        # A spline overshoots its points by up to a third of the swing.
        assert float(limits[joint].get("lower")) < home - 1.34 * swing
        assert home + 1.34 * swing < float(limits[joint].get("upper"))


@pytest.mark.parametrize("size", [(320, 240), (640, 480), (200, 333)])
def test_pinhole_is_the_renderers(size):
    arm, rng, errors = ARMS["ur5"], np.random.default_rng(0), []
    with open_world(arm) as world:
        effector = world.links.index("effector")
        world.bullet.changeVisualShape(world.body, effector, rgbaColor=[0, 1, 0, 1], physicsClientId=world.client)
        target = world.pose(np.array(arm.home))[0][effector]
        for _ in range(20):
            place = target + np.array([0.2, -1.1, -0.3]) + rng.normal(0, 0.02, 3)
            camera = look_at(place, target + rng.normal(0, 0.1, 3), size)
            colour, depth = world._render(camera)
            rows, columns = np.nonzero((colour[..., 1] > 1.5 * colour[..., 0]) & (depth < FAR))
            centre = ellipse_centre(camera, target[None], EFFECTOR_RADIUS)[0]
            errors.append([columns.mean() - centre[0], rows.mean() - centre[1]])
            ahead = float(camera.rotation[2] @ (target - place))
            assert depth[rows, columns].min() == pytest.approx(ahead - EFFECTOR_RADIUS, abs=0.005)
    np.testing.assert_allclose(np.mean(errors, axis=0), 0.0, atol=0.12)


@pytest.mark.parametrize("size", [(640, 480), (64, 48)])
def test_rows_alone_are_those_of_the_whole_picture(size):
    arm = ARMS["ur5"]
    with open_world(arm) as world:
        places, _ = world.pose(np.array(arm.home))
        target = places[world.links.index("effector")]
        camera = look_at(target + arm.camera, target, size)
        wall = np.zeros((size[1], size[0], 3), np.uint8)
        whole, depth = world.picture(camera, wall)
        first, end = size[1] // 2 - 4, size[1] // 2 + 12
        rows = slice(first - 2, end + 2)
        part, near = world.picture(camera.take_rows(rows.start, rows.stop), wall[rows])
    assert (depth[first:end] < FAR).any()
    np.testing.assert_array_equal(part[2:-2], whole[first:end])
    np.testing.assert_allclose(near[2:-2], depth[first:end], atol=1e-4)


def test_wide_pictures_show_the_same_arm():
    arm = ARMS["ur5"]
    with open_world(arm) as world:
        target = world.pose(np.array(arm.home))[0][world.links.index("effector")]
        camera = look_at(target + arm.camera, target, (640, 480))
        wall = np.zeros((480, 640, 3), np.uint8)
        picture, depth = world.picture(camera, wall)
        colour, fine = world._render(camera)
        assert picture.shape == (480, 640, 3) and depth.shape == (480, 640)
        assert np.mean((depth < FAR) == (fine < FAR)) > 0.98
        both = (depth < FAR) & (fine < FAR)
        assert np.median(np.abs(picture[both].astype(int) - colour[both][:, :3])) <= 4
        small = replace(camera, width=320, height=240, focal=camera.focal / 2)
        assert small.centre == (159.5, 119.5)


@pytest.mark.parametrize("version, words", [((3, 11, 7), r"'$"), ((3, 13, 0), r"' \(it is compiled here: .*\)$")])
def test_open_world_without_pybullet_names_the_package(monkeypatch, version, words):
    monkeypatch.setitem(sys.modules, "pybullet", None)
    monkeypatch.setattr(sys, "version_info", version)
    with pytest.raises(UsageError, match=r"type: pip install 'bodylog\[sim\]" + words), open_world(ARMS["ur5"]):
        pass


def test_loading_writes_nothing_on_the_terminal():
    code = """
from bodylog.sim.arms import ARMS
from bodylog.sim.world import open_world
with open_world(ARMS["ur5"]):
    pass
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert (done.stdout, done.stderr) == (b"", b"")


def test_sim_imports_no_heavy_package():
    code = "import sys, bodylog.sim; print({'cv2', 'pybullet', 'rosbags', 'scipy', 'mcap'} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout == b"set()\n"
