"""Build the wheel, install it into an empty environment, and use it from / as a stranger would."""

import re
import resource
import shutil
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).parents[1]
RECIPES = ("Write a log", "Cut by time", "Rewrite a frame_id", "Compare two logs")
IMPORT_S = 0.15


def main() -> None:
    """Fails with the output of the first command that fails."""
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        wheel = _build(work)
        python = _empty_environment(work / "venv")
        install = ("-m", "pip", "install", "--quiet", "--disable-pip-version-check")
        _run(python, *install, str(wheel))
        _import(python)
        _read(python, work)
        _run(python, *install, f"{wheel}[sim]")
        _use(python.with_name("bodylog"), work)
    print("wheel: built, installed into an empty environment and used from /")


def _build(work: Path) -> Path:
    # setuptools keeps what it copied before: modules that were deleted since would be in the wheel
    for left in (ROOT / "build").glob("lib*"):
        shutil.rmtree(left)
    _run(Path(sys.executable), "-m", "build", "--wheel", "--outdir", str(work), str(ROOT))
    return next(work.glob("*-py3-none-any.whl"))


def _empty_environment(folder: Path) -> Path:
    venv.create(folder, with_pip=True)
    return folder / "bin" / "python"


def _import(python: Path) -> None:
    """`import bodylog.logs` brings neither OpenCV nor SciPy, and takes next to no time."""
    check = "import sys, bodylog.logs; sys.exit(', '.join({'cv2', 'scipy'} & sys.modules.keys()) or 0)"
    took = []
    for _ in range(5):
        before = _cpu_seconds()
        _run(python, "-c", check)
        took.append(_cpu_seconds() - before)
    if min(took) > IMPORT_S:
        raise SystemExit(f"import bodylog.logs took {min(took):.3f} CPU s; the limit is {IMPORT_S}")
    print(f"wheel: import bodylog.logs in {min(took):.3f} CPU s")


def _cpu_seconds() -> float:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return children.ru_utime + children.ru_stime


def _read(python: Path, work: Path) -> None:
    """Recipes of docs/logs.md that need no extra, one after another in one folder."""
    page = (ROOT / "docs" / "logs.md").read_text()
    for number, title in enumerate(RECIPES):
        script = work / f"recipe{number}.py"
        (code,) = re.findall(rf"### {title}\n\n```python\n(.*?)```", page, re.DOTALL)
        script.write_text(code)
        _run(python, str(script), folder=work)
        if not number:
            shutil.copy(work / "new.mcap", work / "run.mcap")


def _use(run_cli: Path, work: Path) -> None:
    explore, reach, body, out = (str(work / name) for name in ("explore.mcap", "reach.mcap", "body.npz", "out.mcap"))
    _run(run_cli, "--help")
    _run(run_cli, "record", "babble", "-o", explore, "--duration", "8", "--size", "160x120")
    _run(run_cli, "record", "reach", "-o", reach, "--duration", "3", "--size", "160x120")
    _run(run_cli, "fit", explore, "-o", body)
    _run(run_cli, "estimate", reach, "--body", body, "-o", out)
    _run(run_cli, "evaluate", out, "--fail-if", "rmse/joint>0.05")


def _run(program: Path, *arguments: str, folder: Path = Path("/")) -> None:
    done = subprocess.run([str(program), *arguments], cwd=folder, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{program.name} {' '.join(arguments)}: exit {done.returncode}\n{done.stdout}{done.stderr}")


if __name__ == "__main__":
    main()
