"""What a user of a real robot reads, on logs of robots that nobody here owns."""

from pathlib import Path

import pytest


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
