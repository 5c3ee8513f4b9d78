"""Scatter of calibrations over disjoint sets of poses, beside their σ: `python -m tests.benchmarks.disjoint_sets DIR`.

A ratio is the variance over the sets to the mean of the stated variances; 1 if σ is what sets differ by, below 1 where
it holds an error too that all sets share. DIR has the robots' folders as docs/real.md lists them.
"""

import sys
from pathlib import Path

import numpy as np

from bodylog.body.kinematic.placements import Calibration
from bodylog.kinematics.rotations import vector_from_rotation
from bodylog.types import Array
from tests.benchmarks.calibration import ROBOTS, learn_calibration

SETS = {"nao": 5, "panda": 3}
RANDOM_SPLITS = 6


def split_rows(rows: Array, sets: int, seed: int | None) -> list[Array]:
    """Disjoint sets of rows: in time, or at random."""
    order = np.arange(len(rows)) if seed is None else np.random.default_rng(seed).permutation(len(rows))
    return [np.sort(rows[part]) for part in np.array_split(order, sets)]


def variance_ratio(values: Array, stds: Array) -> float:
    """Mean ratio of K quantities' variance over the sets to the stated one: values, stds (S,K)."""
    return float(np.mean(values.var(axis=0, ddof=1) / np.square(stds).mean(axis=0)))


def ratios(found: list[Calibration]) -> tuple[float, float, float, float]:
    """Of zeros that most sets identify, the camera's place, its turn and its focal length."""
    by_joint = {zero.joint: [one for other in found for one in other.zeros if one.joint == zero.joint] for zero in found[0].zeros}
    zeros = [ones for ones in by_joint.values() if np.mean([one.identifiable for one in ones]) > 0.5]
    cameras = [one.cameras[0] for one in found]
    first = cameras[0].pose[:3, :3].T
    return (
        variance_ratio(
            np.array([[one.value for one in ones] for ones in zeros]).T, np.array([[one.std for one in ones] for ones in zeros]).T
        ),
        variance_ratio(np.array([one.pose[:3, 3] for one in cameras]), np.array([one.place_std for one in cameras])),
        variance_ratio(
            np.array([vector_from_rotation(one.pose[:3, :3] @ first) for one in cameras]),
            np.array([one.turn_std for one in cameras]),
        ),
        variance_ratio(
            np.array([one.lenses[0].focal[:1] for one in found]), np.array([one.lenses[0].focal_std[:1] for one in found])
        ),
    )


def main(folder: Path) -> None:
    """Print a row for each robot and split, and each robot's means."""
    print("| robot | split | zeros | camera's place | camera's turn | focal length |")
    print("|---|---|---|---|---|---|")
    for robot, sets in SETS.items():
        split = ROBOTS[robot](folder)
        every = []
        for seed in (None, *range(RANDOM_SPLITS)):
            every.append(ratios([learn_calibration(split, rows) for rows in split_rows(split.rows, sets, seed)]))
            name = "in time" if seed is None else f"random {seed}"
            print(f"| {robot} | {name} | {' | '.join(f'{one:.2f}' for one in every[-1])} |", flush=True)
        print(f"| {robot} | mean | {' | '.join(f'{one:.2f}' for one in np.mean(every, axis=0))} |", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
