"""The reader that web viewers use, @mcap/core with its ROS 2 decoder, reads every message of an annotated log.

Needs node, and npm once to fetch it: a soak test.
"""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

HERE = Path(__file__).parent
pytestmark = [
    pytest.mark.soak,
    pytest.mark.skipif(not (shutil.which("node") and shutil.which("npm")), reason="needs node and npm on the path"),
]


@pytest.fixture(scope="module")
def packages(tmp_path_factory):
    """A folder with the packages of package.json."""
    folder = tmp_path_factory.mktemp("node")
    shutil.copy(HERE / "package.json", folder)
    command = ["npm", "install", "--ignore-scripts", "--no-audit", "--no-fund", "--no-package-lock"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=180)
    if done.returncode:
        pytest.skip(f"npm could not fetch the packages: {done.stderr.strip().splitlines()[-1:]}")
    return folder


@pytest.fixture(scope="module")
def read(packages):
    def of(path):
        command = ["node", str(HERE / "read.mjs"), str(path)]
        done = subprocess.run(command, cwd=packages, capture_output=True, text=True, timeout=180)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return of


@pytest.fixture(scope="module")
def annotated(run_cli, robot, tmp_path_factory):
    """A log of touches with its estimate, so that every topic we write has messages."""
    folder = tmp_path_factory.mktemp("touched")
    typed = ("--size", "160x120", "--duration", 8, "--seed", 4)
    assert run_cli("record", "touch", "-o", folder / "touch.mcap", *typed) == 0
    assert run_cli("estimate", folder / "touch.mcap", "--body", robot / "body.npz", "-o", folder / "out.mcap") == 0
    return folder / "out.mcap"


def _whole(read, path):
    """The topics that have messages, after every message has been read, by index and as a stream, and decoded."""
    from bodylog.logs.formats import open_log

    with open_log(path) as log:
        expected = {topic.name: topic.messages for topic in log.topics if topic.messages}
    found = read(path)
    assert {name: topic["count"] for name, topic in found["topics"].items()} == expected
    assert found["streamed"] == found["declared"] == sum(expected.values()) and found["done"]
    assert "bodylog" in found["metadata"]
    return set(expected)


def test_mcap_core_decodes_every_message_both_ways(read, annotated):
    assert {"/bodylog/touch", "/bodylog/synchrony", "/bodylog/annotations"} <= _whole(read, annotated)


def test_mcap_core_reads_annotated_bags_and_extracts(read, run_cli, arm, arm_body, tmp_path):
    assert run_cli("estimate", arm / "reach.bag", "--body", arm_body, "-o", tmp_path / "bag.mcap") == 0
    assert run_cli("extract", arm / "touch.mcap", "-o", tmp_path / "features.mcap") == 0
    assert {"/tomm/truth", "/bodylog/joint_states"} <= _whole(read, tmp_path / "bag.mcap")
    assert {"/bodylog/track/effector", "/bodylog/touch"} <= _whole(read, tmp_path / "features.mcap")


def test_mcap_core_decodes_the_written_values(read, annotated):
    from bodylog.annotating import read_back as log

    estimate, topics = log.read_estimate(annotated), read(annotated)["topics"]
    joints = topics["/bodylog/joint_states"]
    assert [int(ns) for ns in joints["times"]] == estimate.joints.source_ns.tolist()
    assert np.array_equal([one["position"] for one in joints["values"]], estimate.joints.values)
    assert all(one["name"] == list(estimate.joints.names) for one in joints["values"])
    covariance = np.array([one["data"] for one in topics["/bodylog/joint_covariance"]["values"]])
    assert np.array_equal(covariance.reshape(estimate.cov.shape), estimate.cov)
    assert np.array_equal([one["data"] for one in topics["/bodylog/free_energy"]["values"]], estimate.free_energy)
    drawn = topics["/bodylog/annotations"]
    assert drawn["type"] == "foxglove_msgs/msg/ImageAnnotations"
    assert max(len(one["circles"]) for one in drawn["values"]) >= 3
    assert max(len(line["points"]) for one in drawn["values"] for line in one["points"]) > 10
