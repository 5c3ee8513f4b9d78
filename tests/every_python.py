"""Run the tests on every Python that pyproject.toml names, and on the first with all dependencies at their lowest.

python tests/every_python.py [lowest 3.11 3.12 …] [-- pytest's arguments]      each in build/python-NAME, made once
"""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from shutil import which

ROOT = Path(__file__).parents[1]
SOURCE = (ROOT / "pyproject.toml").read_text()
PROJECT = tomllib.loads(SOURCE)["project"]
VERSIONS = [word.split()[-1] for word in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", word)]
EXTRAS = PROJECT["optional-dependencies"]
HIGH = {"test", "all", "view", "docs"}
"""Extras that the lowest environment does without: Rerun asks for NumPy 2, and test tools are not the user's."""

WARNINGS = {"lowest": ("-W", "ignore::DeprecationWarning")}
"""Old Matplotlib calls what its newer parser deprecates; elsewhere every warning fails a test."""


def main(arguments: list[str]) -> int:
    """Exit code 1 when one environment's tests fail."""
    split = arguments.index("--") if "--" in arguments else len(arguments)
    names = arguments[:split] or ["lowest", *VERSIONS]
    ends = {name: _tests(_environment(name), [*WARNINGS.get(name, ()), *arguments[split + 1 :]]) for name in names}
    for name, code in ends.items():
        print(f"{name}: {'passed' if code == 0 else f'pytest ended with {code}'}")
    return int(any(ends.values()))


def _tests(python: Path, options: list[str]) -> int:
    # Tests that run commands by name mean this environment's.
    surroundings = {**os.environ, "PATH": f"{python.parent}:{os.environ['PATH']}", "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.run([str(python), "-m", "pytest", *options], cwd=ROOT, env=surroundings).returncode


def _environment(name: str) -> Path:
    """The Python of the environment of that name, reinstalled when what it was built from has changed."""
    folder = ROOT / "build" / f"python-{name}"
    python, stamp = folder / "bin" / "python", folder / "built_from"
    if not stamp.exists() or stamp.read_text() != SOURCE:
        print(f"{name}: installing into {folder}", flush=True)
        _uv("venv", "--clear", "--python", _interpreter(VERSIONS[0] if name == "lowest" else name), str(folder))
        (_install_lowest if name == "lowest" else _install_newest)(python, folder)
        stamp.write_text(SOURCE)
    return python


def _install_newest(python: Path, folder: Path) -> None:
    extras = ",".join(sorted(set(EXTRAS) - {"all", "sim"}))
    _uv("pip", "install", "--python", str(python), "--editable", f".[{extras}]")
    if _uv("pip", "install", "--python", str(python), *EXTRAS["sim"], must=False):
        print("PyBullet has no wheel for this Python and could not be compiled: its tests will be skipped")


def _install_lowest(python: Path, folder: Path) -> None:
    exact = folder / "lowest.txt"
    exact.write_text("\n".join(lowest()))
    extras = ",".join(sorted(set(EXTRAS) - HIGH | {"test"}))
    lowest_first = ("--resolution", "lowest-direct", "--overrides", str(exact))
    _uv("pip", "install", "--python", str(python), *lowest_first, "--editable", f".[{extras}]")


def lowest() -> list[str]:
    """`name==bound.*` of every dependency, whatever other packages ask for."""
    words = [*PROJECT["dependencies"], *(word for extra in sorted(set(EXTRAS) - HIGH) for word in EXTRAS[extra])]
    return [re.sub(r">=(.*)", r"==\1.*", word) for word in words]


def _interpreter(version: str) -> str:
    """The Python of that version on the path, or of pyenv."""
    kept = sorted(Path.home().glob(f".pyenv/versions/{version}.*/bin/python{version}"))
    found = [str(path) for path in kept] or [path for path in [which(f"python{version}")] if path]
    if not found:
        raise SystemExit(f"python{version} is not installed; install it, or name others: lowest {' '.join(VERSIONS)}")
    return found[-1]


def _uv(*arguments: str, must: bool = True) -> int:
    code = subprocess.run([sys.executable, "-m", "uv", "--quiet", *arguments], cwd=ROOT).returncode
    if code and must:
        raise SystemExit(f"uv {' '.join(arguments)}: exit {code}")
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
