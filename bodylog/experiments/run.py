"""Every experiment on every seed, each once: done by processes, kept in a folder, judged, and put on a page."""

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ..errors import UsageError
from ..files import made
from ..sim import how_to_install
from ..temporary import remove_killed
from ..workers import ended, ready, uninterrupted
from . import page
from .lab import EXPLORATION_S, Lab, kept
from .records import Claim, Trial
from .table import EXPERIMENTS, TIMED

Task = tuple[str, int]
"""An experiment's name and a seed."""

Tell = Callable[[str, int, int], None]
"""Called with what is done, how many are done and how many there are."""


@dataclass(frozen=True)
class Reproduction:
    """What to reproduce and where: experiments by name, seeds, processes, picture size px, exploration s."""

    out: Path
    names: tuple[str, ...] = ()
    seeds: int = 10
    jobs: int = 2
    size: tuple[int, int] = (320, 240)
    exploration: float = EXPLORATION_S

    @property
    def lab(self) -> Lab:
        """Where its logs and bodies are kept."""
        return Lab(self.out / "work", self.size, self.exploration)


def reproduce(wish: Reproduction, tell: Tell | None = None) -> tuple[Claim, ...]:
    """Run what is not done yet, write index.html, claims.json and cost.json to `out`, give the claims."""
    names = chosen(wish.names)
    _ready()
    tasks = [(name, seed) for name in names for seed in range(wish.seeds)]
    made(wish.lab.folder)
    for done, (name, seed) in enumerate(_finished(wish, tasks), 1):
        if tell:
            tell(f"{name} seed {seed}", done, len(tasks))
    trials = {name: [trial(wish.lab, name, seed) for seed in range(wish.seeds)] for name in names}
    return page.write(wish.out, trials, wish.seeds, f"{wish.size[0]}×{wish.size[1]}")


def chosen(names: Sequence[str]) -> tuple[str, ...]:
    """The experiments named, in the table's order, or all; UsageError for an unknown one."""
    known = {name.lower(): name for name in EXPERIMENTS}
    for name in names:
        if name.lower() not in known:
            possible = ", ".join(EXPERIMENTS)
            raise UsageError(f"experiment {name!r}: it must be one of {possible}; type: bodylog reproduce E1 -o out")
    wanted = {known[name.lower()] for name in names} or set(EXPERIMENTS)
    return tuple(name for name in EXPERIMENTS if name in wanted)


def _ready() -> None:
    """UsageError, before minutes are spent, where what is needed at the end is not installed."""
    for module, command in (("pybullet", how_to_install()), ("matplotlib", "pip install 'bodylog[report]'")):
        if find_spec(module) is None:
            raise UsageError(f"reproduce: {module} is not installed; type: {command}")


def trial(lab: Lab, name: str, seed: int) -> Trial:
    """One seed of an experiment, from the folder when it is there."""
    found: dict[str, Any] = kept(trial_path(lab, name, seed), lambda: EXPERIMENTS[name].run(lab, seed))
    return found


def trial_path(lab: Lab, name: str, seed: int) -> Path:
    """Where that is kept."""
    return lab.folder / "trials" / f"{name}-{seed}-{lab.key({})}.json"


def _finished(wish: Reproduction, tasks: list[Task]) -> Iterator[Task]:
    """Tasks as they are done, those in the folder first; what is timed runs alone, at the end."""
    lab = wish.lab
    there = [task for task in tasks if trial_path(lab, *task).exists()]
    yield from there
    left = [task for task in tasks if task not in there]
    side_by_side = [task for task in left if task[0] not in TIMED] if wish.jobs > 1 else []
    if len(side_by_side) > 1:
        yield from _pooled(lab, side_by_side, wish.jobs)
        left = [task for task in left if task not in side_by_side]
    for task in left:
        trial(lab, *task)
        yield task


def _worked(lab: Lab, name: str, seed: int) -> Trial:
    """A trial in a worker, which ends when told to: the pool would take that for an answer and ask for the next."""
    try:
        return trial(lab, name, seed)
    except SystemExit as told:
        os._exit(int(told.code or 0))


def _pooled(lab: Lab, tasks: list[Task], jobs: int) -> Iterator[Task]:
    pool = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), ready)
    try:
        with ended():
            with uninterrupted():
                futures = {pool.submit(_worked, lab, *task): task for task in tasks}
            for future in as_completed(futures):
                future.result()
                yield futures[future]
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        remove_killed(lab.folder, *{trial_path(lab, *task).parent for task in tasks})
