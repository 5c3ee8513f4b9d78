"""Postures that `--next` proposes, beside random ones: `python -m tests.benchmarks.next_postures DIR FIRST LAST [ROBOT …]`.

In each draw a body learns from some random poses, and again with more: those proposed among the rest, or random sets of
as many. Its error is the RMS distance, px, of withheld poses. DIR has the robots' folders as docs/real.md lists them.
"""

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from shutil import copy
from tempfile import TemporaryDirectory

import numpy as np

from bodylog import pipeline
from bodylog.robot.next_postures import propose_next_postures
from bodylog.types import Array
from tests.benchmarks.calibration import ROBOTS, Split

FIRST_POSES = {"nao": 15, "panda": 8}
MORE_POSES = {"nao": 6, "panda": 4}
WITHHELD = {"nao": "left_test.csv"}
"""Tables of poses to predict; every other robot's are the rows that its split leaves."""
SETS = 5
"""Random sets in each draw."""


@dataclass(frozen=True, eq=False)
class Draw:
    """Errors, px: by the first poses alone, with those proposed, and with each random set (SETS,)."""

    before: float
    proposed: float
    random: Array


class Bench:
    """One robot's split, learned from rows of its table in a folder."""

    def __init__(self, split: Split, folder: Path, withheld: str | None) -> None:
        self.split = split
        self.folder = folder
        self.head, *self.lines = split.table.read_text().splitlines()
        for picture in split.table.parent.glob("*.[pj][np]g"):
            copy(picture, folder)
        rest = np.setdiff1d(np.arange(len(self.lines)), split.rows)
        self.test = self.write_rows("test.csv", rest) if withheld is None else split.table.parent / withheld

    def write_rows(self, name: str, rows: Array) -> Path:
        """Some rows as a table."""
        (self.folder / name).write_text("\n".join([self.head, *(self.lines[k] for k in rows)]) + "\n")
        return self.folder / name

    def error_px(self, rows: Array) -> float:
        """RMS error, px, over the withheld poses of a body that learned from some rows."""
        out = self.folder / "body.npz"
        result = pipeline.fit([self.write_rows("learn.csv", np.sort(rows))], out, self.split.settings, test=[self.test])
        found = [score.value for score in result.scores if score.name.startswith("rmse/test/")]
        return float(np.sqrt(np.mean(np.square(found))))

    def draw(self, seed: int, first: int, more: int) -> Draw:
        """One draw."""
        draw = np.random.default_rng(seed)
        rows = draw.permutation(self.split.rows)
        known, rest = rows[:first], np.sort(rows[first:])
        before = self.error_px(known)
        among = self.write_rows("among.csv", rest)
        found = propose_next_postures(self.folder / "body.npz", more, None, among)
        columns = [self.head.split(",").index(name) for name in found.joints]
        table = np.array([[float(self.lines[k].split(",")[c]) for c in columns] for k in rest])
        proposed = [rest[np.abs(table - one).sum(axis=1).argmin()] for one in found.postures]
        random = [self.error_px(np.concatenate([known, draw.choice(rest, more, replace=False)])) for _ in range(SETS)]
        return Draw(before, self.error_px(np.concatenate([known, proposed])), np.array(random))


def summarise_draws(draws: list[Draw]) -> Mapping[str, float]:
    """Shares of single random sets and of medians of a draw's sets that are worse, and the ratio to the medians."""
    medians = np.array([np.median(one.random) for one in draws])
    proposed = np.array([one.proposed for one in draws])
    return {
        "better than single sets": float(np.mean([one.proposed < one.random for one in draws])),
        "better than the median of sets": float(np.mean(proposed < medians)),
        "error over the median's": float(np.exp(np.log(proposed / medians).mean())),
        "error of all random sets over the median's": float(
            np.exp(np.mean([np.log(one.random / np.median(one.random)).mean() for one in draws]))
        ),
    }


def main(folder: Path, first: int, last: int, robots: list[str]) -> None:
    """Print a row for each draw, and each robot's shares."""
    for robot in robots or list(FIRST_POSES):
        with TemporaryDirectory() as scratch:
            bench = Bench(ROBOTS[robot](folder), Path(scratch), WITHHELD.get(robot))
            draws = []
            for seed in range(first, last):
                draws.append(bench.draw(seed, FIRST_POSES[robot], MORE_POSES[robot]))
                one = draws[-1]
                print(robot, seed, f"{one.before:.2f} {one.proposed:.2f}", np.round(one.random, 2), flush=True)
        print(robot, {name: round(value, 3) for name, value in summarise_draws(draws).items()}, flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), sys.argv[4:])
