"""What `fit` learns of the recorded arm and says of it, and what `info` and `plot` say of the body it leaves."""

import json
import re
import shutil

import numpy as np
import pytest

JOINTS = ("elbow_joint", "shoulder_lift_joint", "shoulder_pan_joint")


def _learned(capsys, run_cli, out, *typed):
    """The result of a fit that succeeds, its scores by name, and the body as `info` tells it."""
    capsys.readouterr()
    assert run_cli("fit", *typed, "-o", out, "--json") == 0
    result = json.loads(capsys.readouterr().out)["results"][0]
    return result, {name: one["value"] for name, one in result["scores"].items()}, result["body"]


def _printed(capsys, run_cli, *typed):
    capsys.readouterr()
    assert run_cli(*typed) == 0
    return capsys.readouterr()


def test_fit_prints_what_it_learned_and_what_it_did_not(tmp_path, capsys, run_cli, arm):
    typed = ("fit", arm / "explore.mcap", "-o", tmp_path / "body.npz", "--all", "-v")
    printed = _printed(capsys, run_cli, *typed)
    assert printed.out.startswith("learned over 3 joints: elbow_joint, ")
    rows = re.findall(r"^(\w+/\S+) +\S+ +([0-9.e-]+)$", printed.out, re.MULTILINE)
    scores = {name: float(value) for name, value in rows}
    for joint in JOINTS:
        assert 0.5 < scores[f"range/{joint}"] < 1.5
        assert scores[f"influence/effector/{joint}"] > 10.0
        assert 1.0 < scores[f"length_scale/effector/{joint}"] < 3.0
    assert scores["used_share/effector"] == 1.0 and scores["rmse/held_out/effector"] < 0.6
    assert 0.7 < scores["nis/held_out/effector"] < 1.5
    for joint in ("wrist_1_joint", "wrist_2_joint", "wrist_3_joint"):
        assert f"{joint}: moved 0.000 rad, left out: vision does not observe it" in printed.err
    shown = _printed(capsys, run_cli, "info", tmp_path / "body.npz").out
    assert printed.out.endswith(shown) and "touch: a1 = 1, b1 = 0.003472 /px²" in shown
    assert re.search(r"inputs: explore\.mcap [0-9a-f]{64}\n", shown)


def test_noise_is_printed_with_standard_errors_that_hold(tmp_path, capsys, run_cli, arm):
    """The arm's encoders have 0.003 rad (its README)."""
    shown = _printed(
        capsys, run_cli, "fit", arm / "explore.mcap", "-o", tmp_path / "body.npz", "--all"
    ).out
    found = re.findall(r"  noise encoders (\w+): (\S+) ± (\S+) rad\n", shown)
    assert tuple(joint for joint, _, _ in found) == JOINTS
    assert all(abs(float(std) - 0.003) < 4.0 * float(off) < 3e-4 for _, std, off in found)
    assert len(re.findall(r"  noise effector [uv]: \S+ ± \S+ px\n", shown)) == 2
    assert len(re.findall(r"  process \w+: \S+ ± \S+ rad²/s³\n", shown)) == 3


def test_logs_of_three_containers_are_learned_from_together(tmp_path, capsys, run_cli, arm):
    logs = [arm / name for name in ("explore.mcap", "reach.bag", "reach_rosbag2")]
    result, scores, body = _learned(capsys, run_cli, tmp_path / "all.npz", *logs)
    assert [name for name, _ in body["provenance"]["inputs"]] == [log.name for log in logs]
    assert body["joints"] == list(JOINTS) and body["senses"]["effector"]["samples"] == 320 + 2 * 120
    assert {key.split(":")[0] for key in result["health"]} == {log.name for log in logs}
    assert scores["used_share/effector"] == 1.0


def test_folder_of_logs_is_learned_from_together_and_what_teaches_nothing_is_named(
    tmp_path, capsys, run_cli, arm
):
    folder = tmp_path / "set"
    folder.mkdir()
    for name in ("reach.bag", "reach.mcap"):
        shutil.copy(arm / name, folder / name)
    pictures = folder / "pictures.mcap"
    typed = ("-o", pictures, "--topics", "/camera/color/image_raw/compressed")
    assert run_cli("convert", arm / "reach.mcap", *typed) == 0
    result, _, body = _learned(capsys, run_cli, tmp_path / "set.npz", folder)
    assert [name for name, _ in body["provenance"]["inputs"]] == ["reach.bag", "reach.mcap"]
    left_out = [
        one["text"] for one in result["findings"] if one["text"].endswith("; it is left out")
    ]
    assert [text.partition(": ")[0] for text in left_out] == [str(pictures)]
    assert run_cli("fit", folder, "--episodes", "0:1", "-o", tmp_path / "none.npz") == 65
    assert f"{pictures}: no joint readings" in capsys.readouterr().err
    assert run_cli("fit", arm / "reach.mcap", "--episodes", "0:1", "-o", tmp_path / "none.npz") == 2
    assert "for a dataset" in capsys.readouterr().err and not (tmp_path / "none.npz").exists()


def test_paper_preset_has_the_papers_constants(tmp_path, capsys, run_cli, arm):
    typed = (arm / "explore.mcap", "--preset", "paper")
    _, scores, body = _learned(capsys, run_cli, tmp_path / "paper.npz", *typed)
    assert body["senses"]["effector"]["samples"] == 46
    assert body["senses"]["effector"]["length_scales"] == [
        dict.fromkeys(JOINTS, pytest.approx(np.exp(0.1)))
    ]
    assert (
        scores["std/noise/effector/u"]
        == scores["std/noise/effector/v"]
        == pytest.approx(np.exp(0.02))
    )
    assert scores["used_share/effector"] == 46 / 320


def test_joints_are_those_named_in_that_order_and_frames_every_nth(tmp_path, capsys, run_cli, arm):
    typed = (arm / "explore.mcap", "--joints", ",".join(reversed(JOINTS)), "--every", 4)
    _, _, body = _learned(capsys, run_cli, tmp_path / "body.npz", *typed)
    assert body["joints"] == list(reversed(JOINTS))
    assert body["senses"]["effector"]["samples"] == 80


@pytest.mark.soak
def test_fit_update_equals_learning_from_all_logs(tmp_path, capsys, run_cli, arm, arm_body):
    """In the mean; how sure each is differs, as a body keeps less of a log than the log itself."""
    from bodylog.body.storage import load_body

    both, added = tmp_path / "both.npz", tmp_path / "added.npz"
    _learned(capsys, run_cli, both, arm / "explore.mcap", arm / "reach.bag")
    _, _, body = _learned(capsys, run_cli, added, arm / "reach.bag", "--update", arm_body)
    assert body["joints"] == list(JOINTS) and len(body["provenance"]["update_sha256"]) == 64
    truth = np.load(arm / "reach.mcap.truth.npz")
    x = np.column_stack(
        [np.interp(truth["tf"], truth["t"], column) for column in truth["x"].T[::-1]]
    )  # elbow first
    alone, together, later = (
        load_body(path).senses["effector"].predict(x)[0] for path in (arm_body, both, added)
    )
    assert all(
        np.sqrt(np.mean((mean - truth["ee"]) ** 2)) < 0.6 for mean in (alone, together, later)
    )
    assert np.sqrt(np.mean((together - later) ** 2)) < 0.1


def test_touch_logs_teach_the_constants_and_where_each_cell_is_seen(
    tmp_path, capsys, run_cli, arm, arm_body
):
    _, _, body = _learned(
        capsys, run_cli, tmp_path / "body.npz", arm / "touch.mcap", "--update", arm_body
    )
    assert body["touch"]["b1"] < 0.002
    truth = np.load(arm / "touch.mcap.truth.npz")
    shown = _printed(capsys, run_cli, "info", tmp_path / "body.npz").out
    for onset, offset, cell in truth["touches"]:
        during = (truth["tf"] >= onset) & (truth["tf"] <= offset)
        place = (truth["hand"] - truth["ee"])[during].mean(axis=0)
        assert body["cells"][str(int(cell))][:2] == pytest.approx(place, abs=1.5)
        assert f"  cell {int(cell)}: seen " in shown


def test_plot_shows_the_body_over_two_joints(tmp_path, run_cli, arm_body):
    assert run_cli("plot", arm_body, "-o", tmp_path / "body.svg") == 0
    drawn = (tmp_path / "body.svg").read_text()
    for title in ("effector u: mean", "effector u: standard deviation", "effector v: mean"):
        assert f"<!-- {title} -->" in drawn
    assert "<!-- elbow_joint, rad -->" in drawn and "<!-- shoulder_lift_joint, rad -->" in drawn
    assert drawn.count("<use ") >= 4 * 320


def _header(**changed):
    def change(arrays):
        arrays["header"] = np.array(json.dumps(json.loads(str(arrays["header"])) | changed))

    return change


def _poisoned(arrays):
    arrays["effector/weights"][0, 0] = np.nan


def _cut(arrays):
    arrays["effector/weights"] = arrays["effector/weights"][:, :5]


DAMAGED = {
    "version": (_header(version=9), "field version: found 9, possible: 1"),
    "not finite": (_poisoned, "field effector/weights: found nan, possible: numbers from "),
    "shape": (_cut, "field effector/weights: found shape (2, 5), possible: (2, "),
    "a joint more": (_header(joints=[*JOINTS, "wrist_1_joint"]), "field noise.encoder: "),
}


@pytest.mark.parametrize("damage", DAMAGED)
def test_damaged_body_is_refused_by_every_command(tmp_path, capsys, run_cli, arm, arm_body, damage):
    change, expected = DAMAGED[damage]
    body = tmp_path / "body.npz"
    with np.load(arm_body) as found:
        arrays = {name: found[name] for name in found}
    change(arrays)
    np.savez(body, **arrays)
    log, out = arm / "reach.mcap", tmp_path / "out"
    for typed in (
        ("info", body),
        ("plot", body, "-o", f"{out}.png"),
        ("estimate", log, "--body", body, "-o", f"{out}.mcap"),
        ("compare", log, "--body", body),
        ("fit", log, "--update", body, "-o", f"{out}.npz"),
    ):
        capsys.readouterr()
        assert run_cli(*typed) == 65
        assert capsys.readouterr().err.startswith(f"bodylog: {body}: {expected}")
    assert list(tmp_path.iterdir()) == [body]


def test_another_robots_body_is_not_learned_on_from(tmp_path, capsys, run_cli, robot, arm_body):
    body = tmp_path / "body.npz"
    with np.load(arm_body) as found:
        arrays = {name: found[name] for name in found}
    _header(joints=["knee_joint", *JOINTS[1:]])(arrays)
    np.savez(body, **arrays)
    capsys.readouterr()
    assert run_cli("fit", robot / "reach.mcap", "--update", body, "-o", tmp_path / "out.npz") == 65
    assert "joint 'knee_joint' of the body to update is missing; it has " in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [body]


def test_missing_body_is_an_error(tmp_path, capsys, run_cli):
    capsys.readouterr()
    assert run_cli("info", tmp_path / "none.npz") == 65
    assert "there is no such body model; type: bodylog fit LOG" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["body", "body.txt"])
def test_body_of_any_name_is_printed_and_plotted(tmp_path, capsys, run_cli, arm_body, name):
    shutil.copy(arm_body, tmp_path / name)
    assert run_cli("info", tmp_path / name) == 0
    assert "body model of" in capsys.readouterr().out
    assert run_cli("plot", tmp_path / name, "-o", tmp_path / "x.png") == 0
