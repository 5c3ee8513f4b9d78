"""What many tests need once: a small simulated robot, its body, and the recorded arm where it is at hand."""

from collections.abc import Callable
from pathlib import Path

import bodylog_cli
import hypothesis
import pytest

# The same examples every time: a red run can be repeated, a green one means the same everywhere.
hypothesis.settings.register_profile("same", derandomize=True, deadline=None)
hypothesis.settings.load_profile("same")

SHARED = Path(__file__).parents[2] / "shared" / "logs"


@pytest.fixture(scope="session")
def run_cli() -> Callable[..., int]:
    """Run a command and return its exit code; a test that records skips where PyBullet is absent."""
    return _run


def _run(*arguments: object) -> int:
    if arguments[:1] == ("record",):
        pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'bodylog[sim]'")
    return bodylog_cli.run_command([str(argument) for argument in arguments])


@pytest.fixture(scope="session")
def robot(tmp_path_factory, run_cli) -> Path:
    """A folder with explore.mcap, reach.mcap and body.npz of one small simulated robot."""
    folder = tmp_path_factory.mktemp("robot")
    record = ("--size", "160x120")
    assert run_cli("record", "babble", "-o", folder / "explore.mcap", "--duration", 10, "--seed", 1, *record) == 0
    assert run_cli("record", "reach", "-o", folder / "reach.mcap", "--duration", 4, "--seed", 2, *record) == 0
    assert run_cli("fit", folder / "explore.mcap", "-o", folder / "body.npz") == 0
    return folder


@pytest.fixture(scope="session")
def arm() -> Path:
    """The independently drawn arm's logs."""
    if not (SHARED / "arm").is_dir():
        pytest.skip("the recorded arm (../shared/logs/arm) is not at hand")
    return SHARED / "arm"


@pytest.fixture(scope="session")
def worlds() -> Path:
    """Logs of an arm in a furnished scene, rendered elsewhere, with truth beside them."""
    if not (SHARED / "worlds").is_dir():
        pytest.skip("the rendered worlds (../shared/logs/worlds) are not at hand")
    return SHARED / "worlds"


@pytest.fixture(scope="session")
def real() -> Path:
    """Measurements of real robots, made by others."""
    folder = SHARED.parent / "real"
    if not folder.is_dir():
        pytest.skip("the real robots (../shared/real) are not at hand")
    return folder


@pytest.fixture(scope="session")
def arm_body(tmp_path_factory, arm, run_cli) -> Path:
    """The body learned from the arm's exploration."""
    body = tmp_path_factory.mktemp("arm") / "body.npz"
    assert run_cli("fit", arm / "explore.mcap", "-o", body) == 0
    return body
