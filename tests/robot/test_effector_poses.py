"""Kinematic results of still poses: a Franka's board, whose third joint stood still, by the printed calibration."""

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from bodylog import pipeline, views
from bodylog.annotating import read_back
from bodylog.config import load_settings
from bodylog.kinematics import urdf
from bodylog.kinematics.chain import chain_between
from bodylog.robot import calibration
from bodylog.settings import Settings

DATA = Path(__file__).parents[3] / "shared" / "real" / "franka"
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason="the Franka's images (../shared/real/franka) are not at hand")


@pytest.fixture(scope="module")
def estimated(tmp_path_factory):
    """The folder of a body learned from twelve images, and of their estimate."""
    folder = tmp_path_factory.mktemp("franka")
    settings = load_settings(DATA / "robot.toml")
    known = replace(settings, kinematics=replace(settings.kinematics, urdf=str(DATA / "panda.urdf")))
    pipeline.fit([DATA / "A" / "poses.csv"], folder / "body.npz", known)
    pipeline.estimate(DATA / "A" / "poses.csv", folder / "body.npz", folder / "run.mcap", settings)
    return folder


def test_all_corners_are_predicted_as_opencv_projects_them_by_the_printed_calibration(estimated):
    found = calibration.load_calibration(estimated / "body.npz")
    zeros = {one.joint: one.value for one in found.zeros if one.identifiable}
    assert zeros["panda_joint3"] != 0.0
    chain = chain_between(urdf.load_urdf(DATA / "panda.urdf"), found.cameras[0].link, found.markers[0].link)
    _, features = pipeline.observe(DATA / "A" / "poses.csv", load_settings(DATA / "robot.toml"))
    q = features.joints.values[:, [features.joints.names.index(name) for name in chain.joints]]
    q[:, chain.joints.index("panda_joint3")] = np.median(q[:, chain.joints.index("panda_joint3")])
    arm = chain.at(q + np.array([zeros.get(name, 0.0) for name in chain.joints]))
    lens = found.lenses[0]
    matrix = np.array([[lens.focal[0], 0, lens.centre[0]], [0, lens.focal[1], lens.centre[1]], [0, 0, 1.0]])
    names, points = features.boards["board"]
    placed = points @ found.markers[0].pose[:3, :3].T + found.markers[0].pose[:3, 3]
    drawn = read_back.read_estimate(estimated / "run.mcap")
    assert set(drawn.kinematic) == set(names) & set(features.tracks) and len(drawn.kinematic) > 20
    for row in range(len(q)):
        linked = placed @ arm.rotation[row].T + arm.place[row]
        inside = (linked - found.cameras[0].pose[:3, 3]) @ found.cameras[0].pose[:3, :3]
        distortion = np.array([*lens.distortion, 0.0, 0.0])
        image = cv2.projectPoints(inside, np.zeros(3), np.zeros(3), matrix, distortion)[0][:, 0]
        for name, place in zip(names, image, strict=True):
            if name in drawn.kinematic:
                np.testing.assert_allclose(drawn.kinematic[name].values[row], place, atol=0.01)


def test_page_shows_every_pose_with_arrows_and_no_lines_between(estimated):
    result = views.write_report(estimated / "run.mcap", estimated / "report.html", Settings())
    page = (estimated / "report.html").read_text()
    data = json.loads(re.search(r'id="data">(.*?)</script>', page, re.DOTALL)[1])
    kinds = {trace["kind"] for group in data for panel in group["panels"] for trace in panel["traces"]}
    assert kinds == {"dots", "whiskers"} and data[0]["unit"] == "" and data[0]["span"] == [0.5, 12.5]
    assert "1970" not in page and "12 still poses" in page
    assert page.count("data:image/jpeg") == 12 and page.count("pose 12 · 21 points") == 2  # alt and caption
    assert page.count("<svg") == 1 and "board: 1.5" in page  # one sheet, not one for each corner
    cards = dict(result.headline)
    assert re.fullmatch(r"[\d.]+ px, [\d.]+ mm \(board\)", cards["error of the calibration alone"])
    zeros = "panda_joint3 -0.61° ± 0.18°, panda_joint5 +0.68° ± 0.11°, panda_joint6 -0.42° ± 0.18°"
    assert cards["zeros off by more than 2σ"] == zeros
    # a pixel is about a board's distance over the focal length: .35 m and 626 px
    px, mm = (float(part.split()[0]) for part in cards["error of the calibration alone"].split(", "))
    assert 0.4 < mm / px < 0.9
