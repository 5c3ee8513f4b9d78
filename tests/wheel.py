"""Build the wheel, install it into an empty environment, and use it from / as a stranger would."""

import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).parents[1]


def main() -> None:
    """Fails with the output of the first command that fails."""
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        wheel = _build(work)
        python = _empty_environment(work / "venv")
        _run(python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", f"{wheel}[sim]")
        _use(python.with_name("bodylog"), work)
    print("wheel: built, installed into an empty environment and used from /")


def _build(work: Path) -> Path:
    _run(Path(sys.executable), "-m", "build", "--wheel", "--outdir", str(work), str(ROOT))
    return next(work.glob("*.whl"))


def _empty_environment(folder: Path) -> Path:
    venv.create(folder, with_pip=True)
    return folder / "bin" / "python"


def _use(bodylog: Path, work: Path) -> None:
    explore, reach, body, out = (str(work / name) for name in ("explore.mcap", "reach.mcap", "body.npz", "out.mcap"))
    _run(bodylog, "--help")
    _run(bodylog, "record", "babble", "-o", explore, "--duration", "8", "--size", "160x120")
    _run(bodylog, "record", "reach", "-o", reach, "--duration", "3", "--size", "160x120")
    _run(bodylog, "fit", explore, "-o", body)
    _run(bodylog, "estimate", reach, "--body", body, "-o", out)
    _run(bodylog, "evaluate", out, "--fail-if", "joint_rmse>0.05")


def _run(program: Path, *arguments: str) -> None:
    done = subprocess.run([str(program), *arguments], cwd="/", capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{program.name} {' '.join(arguments)}: exit {done.returncode}\n{done.stdout}{done.stderr}")


if __name__ == "__main__":
    main()
