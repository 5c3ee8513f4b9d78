"""What a user of a real robot reads, on logs of robots that nobody here owns."""

import json
from pathlib import Path

import pytest

PANDA_TAG = 'effector = {tag = 30, dictionary = "4x4_100"}'
"""A tag of the board in the Panda's images; to guess one takes longer than all else."""


@pytest.fixture(scope="module")
def franka(tmp_path_factory, real, run_cli) -> tuple[Path, str, str]:
    """The body of a real Franka with a board, and what `fit` printed."""
    import contextlib
    import io

    body, out, err = tmp_path_factory.mktemp("franka") / "body.npz", io.StringIO(), io.StringIO()
    poses, config, urdf = (real / "franka" / name for name in ("A/poses.csv", "robot.toml", "panda.urdf"))
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        assert run_cli("fit", poses, "--config", config, "--urdf", urdf, "-o", body) == 0
    return body, out.getvalue(), err.getvalue()


def test_no_joint_of_a_board_that_all_joints_move_is_called_hardly_observed(franka) -> None:
    _, out, err = franka
    assert "hardly observes" not in out + err


def test_a_body_that_knows_nothing_is_refused(real, tmp_path, run_cli, capsys) -> None:
    body = tmp_path / "body.npz"
    assert run_cli("fit", real / "panda" / "real_new" / "poses.csv", "-o", body) == 65
    text = capsys.readouterr().err
    assert "one image shows no joint's error below 11°" in text
    assert "record more poses, or give the robot's URDF with --urdf" in text
    assert not body.exists()


@pytest.mark.soak
def test_fit_explains_why_a_given_urdf_did_not_help(real, tmp_path, run_cli, capsys) -> None:
    panda, other = real / "panda", tmp_path / "other.urdf"
    other.write_text((panda / "panda.urdf").read_text().replace("0 -0.316 0", "0 -3.16 0"))
    config = tmp_path / "robot.toml"
    config.write_text("[features]\n" + PANDA_TAG)
    typed = ("fit", panda / "real_new" / "poses.csv", "--config", config, "-o", tmp_path / "body.npz")
    assert run_cli(*typed, "--urdf", other) == 65
    (text,) = capsys.readouterr().err.splitlines()[-1:]
    assert "one image shows no joint's error below" in text and "or give the robot's URDF" not in text
    assert "; the URDF is not used: " in text and "--no-urdf" not in text
    assert run_cli(*typed, "--no-urdf") == 65
    assert "record more poses, or leave out --no-urdf" in capsys.readouterr().err

@pytest.mark.parametrize("episode", [0, 1])
@pytest.mark.soak
def test_encoders_that_count_do_not_jump_where_they_step(real, tmp_path, run_cli, capsys, episode) -> None:
    log, angles = f"{real / 'so101'}#{episode}", tmp_path / "robot.toml"
    assert run_cli("estimate", log, "-o", tmp_path / "out.mcap") == 0
    seen = capsys.readouterr()
    assert "jumps" not in seen.out and "two nodes" not in seen.err
    known = float(seen.out.partition("error bar ± ")[2].partition(" rad")[0])
    angles.write_text('[body]\nunit = "4096 counts"\n')
    assert run_cli("estimate", log, "--config", angles, "-o", tmp_path / "out.mcap") == 0
    rad = float(capsys.readouterr().out.partition("error bar ± ")[2].partition(" rad")[0])
    assert rad == pytest.approx(known, rel=0.01)


def test_a_log_without_skin_has_no_hand_and_only_what_is_named_is_looked_for(
    real, franka, tmp_path, run_cli, capsys
) -> None:
    poses, config = real / "franka" / "A" / "poses.csv", real / "franka" / "robot.toml"
    arguments = ("estimate", poses, "--config", config, "--body", franka[0], "-o", tmp_path / "out.mcap")
    capsys.readouterr()
    assert run_cli(*arguments, "--json") == 0
    (result,) = json.loads(capsys.readouterr().out)["results"]
    assert not {"hand", "effector"} & result["health"].keys()
    assert not any(one["text"].startswith(("hand:", "effector:")) for one in result["findings"])
    assert run_cli("report", tmp_path / "out.mcap", "-o", tmp_path / "report.html") == 0
    page = (tmp_path / "report.html").read_text()
    assert "red square: hand" not in page and ">hand<" not in page


def test_fit_reports_a_joint_that_was_not_learned(franka) -> None:
    assert "not over panda_joint3" in franka[1] and "error bars are" in franka[1] and "°" in franka[1]
