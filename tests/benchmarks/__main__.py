"""Run every benchmark, or those named, each in a process of its own: python -m tests.benchmarks [columns annotate ...].

A run of all of them writes docs/performance.md. Exit code 4 if a bound is broken.
"""

import importlib
import os
import subprocess
import sys
import tempfile
from pathlib import Path

for _variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

from tests.benchmarks import goals  # noqa: E402

PAGE = Path(__file__).parents[2] / "docs" / "performance.md"
_BROKEN = 4
_ONE = "--into"
"""Run one benchmark here, and write its goals into a file."""


def main() -> int:
    """Each bench_*.py has a main() that prints its figures and notes its goals."""
    if sys.argv[1:2] == [_ONE]:
        _run(sys.argv[3], Path(sys.argv[2]))
        return 0
    names = sys.argv[1:] or sorted(path.stem[6:] for path in Path(__file__).parent.glob("bench_*.py"))
    groups = {name: _measured(name) for name in names}
    found = [goal for some in groups.values() for goal in some]
    print(f"\n{goals.table(found)}\n\n{goals.machine()}")
    if not sys.argv[1:]:
        PAGE.write_text(goals.page(groups))
        print(f"written: {PAGE}")
    return 0 if all(goal.holds for goal in found) else _BROKEN


def _measured(name: str) -> list[goals.Goal]:
    """The goals of one benchmark; one that ends badly is a broken goal itself, after those it had noted."""
    print(f"\n=== {name}", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        into = Path(folder) / "goals.json"
        done = subprocess.run([sys.executable, "-m", "tests.benchmarks", _ONE, str(into), name])
        found = goals.load(into)
    if done.returncode:
        text = f"exit code {done.returncode}"
        found.append(goals.Goal(f"{name} runs to its end", float("nan"), 0.0, False, "", text))
    return found


def _run(name: str, into: Path) -> None:
    sys.argv = [f"bench_{name}"]
    try:
        importlib.import_module(f"tests.benchmarks.bench_{name}").main()
    finally:
        goals.save(into)


if __name__ == "__main__":
    sys.exit(main())
