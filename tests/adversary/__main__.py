"""Meet hostile files and settings by the thousand: python -m tests.adversary --files 5000 --settings 1000 --seed 1."""

import argparse
import json
import time
from collections import Counter
from pathlib import Path

from .cases import Base, Problem, file_case, prepare, settings_case
from .worker import Run, plain


def meet(
    base: Base, place: Path, files: range, settings: range, verbose: bool = False
) -> tuple[list[Problem], dict[str, object]]:
    """Every case of these seeds: what did not hold, and figures."""
    problems: list[Problem] = []
    codes: Counter[str] = Counter()
    times: Counter[str] = Counter()  # type: ignore[type-arg]
    slowest: Run | None = None
    largest: Run | None = None
    begun = time.monotonic()
    for case, seeds in ((file_case, files), (settings_case, settings)):
        for seed in seeds:
            kind, runs, wrong = case(base, place, seed)
            problems += wrong
            for one in runs:
                times[one.command[0]] += one.seconds
            for one in runs:
                codes[f"{one.command[0]} {one.code}"] += 1
                slowest = one if slowest is None or one.seconds > slowest.seconds else slowest
                largest = one if largest is None or one.memory > largest.memory else largest
            for problem in wrong if verbose else ():
                print(
                    f"{kind} {seed}: {' '.join(problem.run.command)}: {problem.what}\n{problem.run.err[-1200:]}",
                    flush=True,
                )
    assert slowest and largest
    figures = {
        "files": len(files),
        "settings": len(settings),
        "commands": sum(codes.values()),
        "codes": dict(sorted(codes.items())),
        "seconds by command": {name: round(seconds, 1) for name, seconds in times.most_common()},
        "worst seconds": [round(slowest.seconds, 2), *slowest.command[:2]],
        "worst MB": [largest.memory >> 20, *largest.command[:2]],
        "seconds": round(time.monotonic() - begun, 1),
    }
    return problems, figures


def main() -> None:
    """As typed."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--files", type=int, default=100)
    parser.add_argument("--settings", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    typed = parser.parse_args()
    base = prepare(typed.out / "base")
    first = typed.seed * 1_000_000
    problems, figures = meet(
        base, typed.out, range(first, first + typed.files), range(first, first + typed.settings), True
    )
    (typed.out / "problems.json").write_text(
        json.dumps([{"seed": p.seed, "kind": p.kind, "what": p.what} | plain(p.run) for p in problems], indent=1)
    )
    print(json.dumps(figures, indent=1))
    print(f"{len(problems)} problems")


if __name__ == "__main__":
    main()
