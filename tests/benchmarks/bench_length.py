"""Time as logs grow: every command that reads a log, on 900 s and on 3,600 s of the same arm.

`python -m tests.benchmarks.bench_length [SECONDS] [command ...] [--keep FOLDER]`: the shorter log's
length, and which commands; FOLDER keeps the logs for the next run.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from tests.benchmarks import long_log
from tests.benchmarks.goals import at_most
from tests.benchmarks.timing import cpu_seconds

SECONDS, LONGER = 900, 4
_LIMIT = 4.4
"""Times the shorter log's: a tenth above what grows as the log does."""
_LEARNED_S = 60


def main() -> None:
    """Print CPU seconds of a fresh process on each log, and their ratio with its bound."""
    typed = sys.argv[1:] if sys.argv[0].endswith("bench_length.py") else []
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        if "--keep" in typed:
            work = Path(typed.pop(typed.index("--keep") + 1))
            typed.remove("--keep")
            work.mkdir(exist_ok=True)
        short = int(typed.pop(0)) if typed and typed[0].isdecimal() else SECONDS
        for name in typed or commands(work, short):
            compare_lengths(work, name, short, LONGER * short)


def compare_lengths(work: Path, name: str, short: int, long: int) -> None:
    """One command on the logs of two lengths (s)."""
    first = _measured(work, name, short)
    second = _measured(work, name, long)
    text = f"CPU {first:.1f} s and {second:.1f} s"
    print(f"\n{name}: {text}", flush=True)
    what = f"`bodylog {name}` on {long:,} s, times on {short:,} s"
    at_most(what, second / first, _LIMIT, "", text)


def commands(work: Path, seconds: int) -> dict[str, list[str]]:
    """What is typed for each command on the log of that length (s)."""
    log, body = f"{work}/{seconds}.mcap", f"{work}/body.npz"
    out, estimate = f"{work}/out_{seconds}", f"{work}/estimate_{seconds}.mcap"
    return {
        "info": [log],
        "doctor": [log],
        "features": [log],
        "extract": [log, "-o", f"{out}.mcap"],
        "ingest": [log, "-o", f"{out}.mcap"],
        "convert": [log, "-o", f"{out}.mcap"],
        "plot": [log, "-o", f"{out}.png"],
        "fit": [log, "-o", f"{out}.npz"],
        "estimate": [log, "--body", body, "-o", estimate],
        "evaluate": [estimate],
        "report": [estimate, "-o", f"{out}.html"],
        "layout": [estimate, "-o", f"{out}.json"],
        "view": [estimate, "-o", f"{out}.rrd"],
        "compare": [log, "--body", body],
    }


def _measured(work: Path, name: str, seconds: int) -> float:
    """CPU seconds of one command in a fresh process; what it reads is made first."""
    typed = commands(work, seconds)[name]
    _made(Path(typed[0]), work, seconds)
    if "--body" in typed:
        _made(work / "body.npz", work, _LEARNED_S)
    started = cpu_seconds()
    _run(name, typed)
    return cpu_seconds() - started


def _made(path: Path, work: Path, seconds: int) -> None:
    """Make a log, an estimate or the body where it is missing."""
    if path.exists():
        return
    log = work / f"{seconds}.mcap"
    if path == log:
        long_log.record(log, seconds)
        return
    _made(log, work, seconds)
    if path.suffix == ".npz":
        _run("fit", [str(log), "-o", str(path)])
        return
    _made(work / "body.npz", work, _LEARNED_S)
    _run("estimate", commands(work, seconds)["estimate"])


def _run(name: str, typed: list[str]) -> None:
    command = [sys.executable, "-m", "bodylog_cli", name, *typed]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode not in (0, 3):
        raise SystemExit(f"bodylog {name} {' '.join(typed)}: exit {done.returncode}\n{done.stderr}")


if __name__ == "__main__":
    main()
