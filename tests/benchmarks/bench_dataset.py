"""`doctor DATASET` over a hundred episodes of 13 s of AV1 at 640x480: wall time, CPU and memory, and two processes against
one. `python -m tests.benchmarks dataset` notes the goals; its episodes are copies of four drawn ones, so that drawing
takes a minute.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

from tests.benchmarks.goals import at_least, at_most
from tests.dataset import arm_dataset
from tests.logs.datasets import drawn

EPISODES = 100
DRAWN = 4
FEW = 12
"""Episodes over which one process is compared with two, in turn."""
SECONDS = 13.0
FPS = 30
SIZE = (640, 480)
MOST_WALL_S = 240.0
MOST_CPU_S = 4.0
MOST_MB = 1000.0
LEAST_SPEEDUP = 1.8


def main() -> None:
    """The goals of a dataset's examination."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "set"
        # in a process of its own: what it holds would count as memory of those that this one starts
        subprocess.run([sys.executable, "-m", "tests.benchmarks.bench_dataset", str(folder)], check=True)
        wall_s, cpu_s, mb = examine(folder, "2")
        at_most(f"doctor DATASET, {EPISODES} episodes of 13 s, 2 processes", wall_s, MOST_WALL_S, "s")
        at_most("CPU of an episode, decoding included", cpu_s / EPISODES, MOST_CPU_S, "s")
        at_most("peak memory of the larger process", mb, MOST_MB, "MB")
        # the shorter of two runs each, in turn: another process on the machine only makes them longer
        pairs = [[examine(folder, jobs, "--episodes", f"0:{FEW}")[0] for jobs in "12"] for _ in range(2)]
        one_s, two_s = np.min(pairs, axis=0)
        at_least("speed of two processes over one", one_s / two_s, LEAST_SPEEDUP)


def write_dataset(folder: Path) -> None:
    """A hundred episodes, each a link to one of a few drawn ones."""
    os.environ.setdefault("SVT_LOG", "1")
    arm_dataset.SECONDS = SECONDS
    arm_dataset.FPS = FPS
    drawn.FPS = FPS
    episodes = [arm_dataset.episode(number) for number in range(DRAWN)]
    arm_dataset.write(folder, [episodes[number % DRAWN] for number in range(EPISODES)], write_film=False)
    films = folder / f"videos/chunk-000/{drawn.CAMERA}"
    for number, one in enumerate(episodes):
        enlarged = np.array([cv2.resize(image, SIZE, interpolation=cv2.INTER_CUBIC) for image in one.images])
        drawn.film(films / f"episode_{number:06d}.mp4", enlarged, "libsvtav1", crf="30", preset="10")
    for number in range(DRAWN, EPISODES):
        os.link(films / f"episode_{number % DRAWN:06d}.mp4", films / f"episode_{number:06d}.mp4")


def examine(folder: Path, jobs: str, *more: str) -> tuple[float, float, float]:
    """Wall time (s), CPU of all processes (s), and peak memory of the largest (MB) of a run."""
    command = [sys.executable, "-m", "bodylog", "doctor", str(folder), "--jobs", jobs, "-q", *more]
    begin = time.perf_counter()
    process = subprocess.Popen(command)
    _, status, used = os.wait4(process.pid, 0)
    wall_s = time.perf_counter() - begin
    assert status == 0, command
    return wall_s, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0


if __name__ == "__main__":
    write_dataset(Path(sys.argv[1])) if sys.argv[1:] else main()
