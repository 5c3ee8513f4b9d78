"""Run commands on thousands of hostile inputs: python -m tests.adversary --files 5000 --sets 3000 --seed 1."""

import argparse
import json
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from .cases import Base, Problem, file_case, prepare, set_case, settings_case
from .worker import Run, plain


@dataclass
class Tally:
    """Statistics of the cases so far."""

    cases: Counter[str] = field(default_factory=Counter)
    codes: Counter[str] = field(default_factory=Counter)
    times: dict[str, float] = field(default_factory=dict)
    slowest: Run | None = None
    largest: Run | None = None
    problems: list[Problem] = field(default_factory=list)
    start: float = field(default_factory=time.monotonic)

    def add(self, what: str, runs: list[Run], wrong: list[Problem]) -> None:
        """Count one case of kind `what` (files, settings or sets)."""
        self.cases[what] += 1
        self.problems += wrong
        for one in runs:
            name = one.command[0]
            self.codes[f"{name} {one.code}"] += 1
            self.times[name] = self.times.get(name, 0.0) + one.seconds
            self.slowest = max(self.slowest or one, one, key=lambda run: run.seconds)
            self.largest = max(self.largest or one, one, key=lambda run: run.memory)

    def figures(self) -> dict[str, object]:
        """The statistics for JSON."""
        slowest, largest = self.slowest, self.largest
        return {
            **self.cases,
            "problems": len(self.problems),
            "commands": sum(self.codes.values()),
            "codes": dict(sorted(self.codes.items())),
            "seconds by command": {name: round(self.times[name], 1) for name in sorted(self.times)},
            "worst seconds": slowest and [round(slowest.seconds, 2), *slowest.command[:2]],
            "worst MB": largest and [largest.memory >> 20, *largest.command[:2]],
            "seconds": round(time.monotonic() - self.start, 1),
        }


def meet(
    base: Base, place: Path, files: range, settings: range, progress: Path | None = None, sets: range = range(0)
) -> tuple[list[Problem], dict[str, object]]:
    """Run every case of these seeds; returns violations and statistics, which `progress` gets after each case."""
    tally = Tally()
    for what, case, seeds in (
        ("files", file_case, files),
        ("settings", settings_case, settings),
        ("sets", set_case, sets),
    ):
        for seed in seeds:
            kind, runs, wrong = case(base, place, seed)
            tally.add(what, runs, wrong)
            if progress is not None:
                _write(progress, kind, seed, tally, wrong)
    return tally.problems, tally.figures()


def _write(progress: Path, kind: str, seed: int, tally: Tally, wrong: list[Problem]) -> None:
    """Write intermediate results, so that an interrupted run leaves them."""
    (progress / "figures.json").write_text(json.dumps({"last seed": seed, **tally.figures()}, indent=1))
    for problem in wrong:
        print(f"{kind} {seed}: {' '.join(problem.run.command)}: {problem.what}", flush=True)
        print(problem.run.err[-1200:], flush=True)
    if wrong:
        found = [{"seed": p.seed, "kind": p.kind, "what": p.what} | plain(p.run) for p in tally.problems]
        (progress / "problems.json").write_text(json.dumps(found, indent=1))


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--files", type=int, default=100)
    parser.add_argument("--settings", type=int, default=20)
    parser.add_argument("--sets", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    typed = parser.parse_args()
    base = prepare(typed.out / "base")
    first = typed.seed * 1_000_000
    files, settings, sets = (range(first, first + count) for count in (typed.files, typed.settings, typed.sets))
    problems, figures = meet(base, typed.out, files, settings, typed.out, sets)
    print(json.dumps(figures, indent=1))
    print(f"{len(problems)} problems")


if __name__ == "__main__":
    main()
