"""Run every experiment on every seed in its readings,
in parallel; keep results, judge them, write a page.
"""

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ..errors import PartError, UsageError
from ..io.atomic_files import ensure_dir
from ..io.extras import describe_missing
from ..io.temporary import remove_killed
from ..runtime.workers import become_worker, block_interrupts, end_children_on_failure
from . import page, readings, real, rubber_hand
from .claims import Claim
from .drawn import SIZE
from .lab import EXPLORATION_S, Lab, load_or_make
from .readings import Reading
from .records import ExperimentReadings, Trial
from .table import EXPERIMENTS, RUN_ONLY_WHEN_NAMED, UNSEEDED

Task = tuple[str, int]
"""An experiment's name and a seed."""

Progress = Callable[[str, int, int], None]
"""Called with the name of a finished run, the number finished and the total."""


@dataclass(frozen=True)
class Reproduction:
    """A reproduction's options: output, experiments by name, seeds, processes, exploration s.

    reading: judge in this one alone · setting: the
    rubber hand's sweeps · data: real robots' folder.
    """

    out: Path
    names: tuple[str, ...] = ()
    seeds: int = 10
    jobs: int = 2
    exploration: float = EXPLORATION_S
    reading: Reading | None = None
    setting: rubber_hand.Setting = rubber_hand.SETTING
    data: Path | None = None

    def readings_of(self, name: str) -> ExperimentReadings:
        """The readings that an experiment is run in."""
        concerned = EXPERIMENTS[name].concerned
        if self.reading is not None:
            return ExperimentReadings((self.reading,))
        return (
            ExperimentReadings(readings.design_readings(concerned), readings.list_sweeps(concerned))
            if concerned
            else ExperimentReadings(({},))
        )

    def run(self, name: str, seed: int) -> Trial:
        """One seed of an experiment."""
        tried = self.readings_of(name)
        if name == "Rubber-hand":
            return rubber_hand.run_rubber_hand_sweeps(self.lab, seed, tried, self.setting)
        if name == "Real" and self.data is not None:
            return real.run_real_robots(self.lab, seed, tried, self.data)
        return EXPERIMENTS[name].run(self.lab, seed, tried)

    def key(self, name: str) -> str:
        """Digest of a kept trial's inputs."""
        inputs: dict[str, Any] = {
            "readings": [readings.reading_key(reading) for reading in self.readings_of(name).all]
        }
        inputs |= {"setting": repr(self.setting)} if name == "Rubber-hand" else {}
        inputs |= (
            {"data": real.digest_tables(self.data)}
            if name == "Real" and self.data is not None
            else {}
        )
        return self.lab.key(inputs)

    def seeds_of(self, name: str) -> range:
        """The seeds of an experiment; one that draws no number has one."""
        return range(1 if name in UNSEEDED else self.seeds)

    @property
    def lab(self) -> Lab:
        """The folder of its logs and bodies."""
        return Lab(self.out / "work", SIZE, self.exploration)


def run_reproduction(wish: Reproduction, progress: Progress | None = None) -> tuple[Claim, ...]:
    """Run missing trials, write index.html, claims.json,
    data and figures to `out`, return the claims.
    """
    names = choose_experiments(wish.names)
    _check_requirements(names, wish.data)
    tasks = [(name, seed) for name in names for seed in wish.seeds_of(name)]
    ensure_dir(wish.lab.folder)
    for done, (name, seed) in enumerate(_iterate_finished(wish, tasks), 1):
        if progress:
            progress(f"{name} seed {seed}", done, len(tasks))
    trials = {
        name: [load_or_run_trial(wish, name, seed) for seed in wish.seeds_of(name)]
        for name in names
    }
    tried = {name: wish.readings_of(name) for name in names}
    return page.write_reproduction_page(wish.out, trials, tried, wish.seeds, f"{SIZE[0]}×{SIZE[1]}")


def choose_experiments(names: Sequence[str]) -> tuple[str, ...]:
    """The experiments named, in the table's order, or
    all that need no data; UsageError for an unknown one.
    """
    known = {name.lower(): name for name in EXPERIMENTS}
    for name in names:
        if name.lower() not in known:
            possible = ", ".join(EXPERIMENTS)
            raise UsageError(
                f"experiment {name!r}: it must be one of {possible}; type: bodylog reproduce "
                "E1 -o out"
            )
    wanted = {known[name.lower()] for name in names} or set(EXPERIMENTS) - set(RUN_ONLY_WHEN_NAMED)
    return tuple(name for name in EXPERIMENTS if name in wanted)


def _check_requirements(names: Sequence[str], data: Path | None) -> None:
    """UsageError, before any run, where a requirement is not installed or not given."""
    if "Real" in names:
        if data is None:
            raise UsageError(
                "reproduce real: --data is not given; possible: the measurements' folder; "
                "type: --data DIR"
            )
        real.digest_tables(data)
    needed = ["pybullet"] if set(names) - {"Real"} else []
    for module in (*needed, "matplotlib"):
        if find_spec(module) is None:
            raise UsageError(f"reproduce: {describe_missing(module)}")


def load_or_run_trial(wish: Reproduction, name: str, seed: int) -> Trial:
    """One seed of an experiment, from the folder if it is there."""
    found: dict[str, Any] = load_or_make(trial_path(wish, name, seed), lambda: wish.run(name, seed))
    return found


def trial_path(wish: Reproduction, name: str, seed: int) -> Path:
    """The file of a kept trial."""
    return wish.lab.folder / "trials" / f"{name}-{seed}-{wish.key(name)}.json"


def _iterate_finished(wish: Reproduction, tasks: list[Task]) -> Iterator[Task]:
    """Tasks as they finish, those in the folder first."""
    there = [task for task in tasks if trial_path(wish, *task).exists()]
    yield from there
    left = [task for task in tasks if task not in there]
    if wish.jobs > 1 and len(left) > 1:
        yield from _run_in_pool(wish, left)
        return
    for task in left:
        load_or_run_trial(wish, *task)
        yield task


def _run_in_worker(wish: Reproduction, name: str, seed: int) -> Trial:
    """Run a trial in a worker. SystemExit ends the process:
    the pool would take it for a result and send the next.
    """
    try:
        return load_or_run_trial(wish, name, seed)
    except SystemExit as ending:
        os._exit(int(ending.code or 0))


def _run_in_pool(wish: Reproduction, tasks: list[Task]) -> Iterator[Task]:
    """Tasks as worker processes finish them; PartError when a worker is killed."""
    pool = ProcessPoolExecutor(wish.jobs, multiprocessing.get_context("spawn"), become_worker)
    try:
        with end_children_on_failure():
            with block_interrupts():
                futures = {pool.submit(_run_in_worker, wish, *task): task for task in tasks}
            for future in as_completed(futures):
                future.result()
                yield futures[future]
    except BrokenProcessPool as problem:
        raise PartError(
            f"{wish.out}: a worker process was killed, perhaps for want of memory; finished "
            "runs are kept; "
            "type the same command again with --jobs 1"
        ) from problem
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        remove_killed(wish.lab.folder, *{trial_path(wish, *task).parent for task in tasks})
