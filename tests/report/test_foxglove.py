import json
from dataclasses import replace

from bodylog.report.viewers.foxglove import build_layout, write_foxglove_layout

from .records import estimate


def _panels(tree):
    if isinstance(tree, str):
        return {tree}
    return _panels(tree["first"]) | _panels(tree["second"])


def test_layout_shows_exactly_the_configured_panels():
    made = build_layout("/cam", estimate(), {"side": "/side/image"})
    side = made["configById"]["Image!side"]["imageMode"]
    assert side["imageTopic"] == "/side/image" and list(side["annotations"]) == ["/bodylog/annotations/side"]
    assert _panels(made["layout"]) == set(made["configById"])


def test_lines_are_named_for_joints_and_senses(tmp_path, robot, run_cli):
    assert run_cli("estimate", robot / "reach.mcap", "--body", robot / "body.npz", "-o", tmp_path / "out.mcap") == 0
    assert run_cli("layout", tmp_path / "out.mcap", "-o", tmp_path / "layout.json") == 0
    panels = json.loads((tmp_path / "layout.json").read_text())["configById"]
    belief = {path["label"]: path["value"] for path in panels["Plot!belief"]["paths"]}
    assert belief["elbow_joint"].startswith("/bodylog/joint_states.position[")
    assert {path["label"] for path in panels["Plot!errors"]["paths"]} >= {"effector u, σ", "encoders elbow_joint, σ"}
    assert panels["Image!camera"]["imageMode"]["imageTopic"] == "/camera/image/compressed"


def test_same_bytes_twice(tmp_path):
    for name in ("a", "b"):
        write_foxglove_layout(tmp_path / name, None, estimate(), {})
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_layout_quotes_topics_with_special_characters():
    found = estimate()
    (sense, errors), *_ = found.errors.items()
    made = build_layout("/cam", replace(found, errors={'front-camera/"a\\': errors, sense: errors}), {})
    values = [line["value"] for line in made["configById"]["Plot!errors"]["paths"]]
    assert values[0] == '"/bodylog/prediction_error/front-camera/\\"a\\\\".data[0]'
    assert values[-1].startswith(f"/bodylog/prediction_error/{sense}.data[")
