"""Run the jobs of a batch on this machine: a pool of
processes, largest logs first, within a memory budget.
"""

import multiprocessing
from collections.abc import Iterator, Mapping, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path

from ..errors import BodylogError
from ..io import remote
from ..io.temporary import remove_killed
from ..logs.formats import files_of
from ..runtime.workers import become_worker, block_interrupts, stop_processes
from . import work
from .jobs import Job, Row

BASE_BYTES = 300 << 20
TRIES = 2


def run_on_this_machine(
    jobs: Sequence[Job], workers: int, memory: int | None, keep_going: bool
) -> Iterator[Row]:
    """Rows as they finish; after a bug no further log is started, unless `keep_going`."""
    sizes = {job.name: log_size_bytes(job.log, job.settings.input.max_wait_s) for job in jobs}
    queue = sorted(jobs, key=lambda job: (-sizes[job.name], job.name))
    if workers == 1:
        yield from _run_in_this_process(queue, keep_going)
        return
    yield from WorkerPool(workers, memory, keep_going).run(queue, sizes)


def _run_in_this_process(queue: Sequence[Job], keep_going: bool) -> Iterator[Row]:
    for job in queue:
        row = work.run_job(job)
        yield row
        if row["exit_code"] == 1 and not keep_going:
            return


def log_size_bytes(log: str, wait_s: float = remote.WAIT_S) -> int:
    """Bytes of a log: file, folder or URL; 0 when it cannot be read."""
    try:
        if remote.is_url(log):
            return remote.remote_size_bytes(log, wait_s)
        parts = files_of(Path(log))
        every = (p for part in parts for p in (part.rglob("*") if part.is_dir() else [part]))
        return sum(p.stat().st_size for p in every if not p.is_dir())
    except (OSError, BodylogError):
        return 0


def expected_memory_bytes(size: int) -> int:
    """Expected memory (bytes) for a log of `size` bytes: signals are held, images are streamed."""
    return BASE_BYTES + size // 2


class WorkerPool:
    """Worker processes, each with its own pipe: a worker that dies loses only its own job."""

    def __init__(self, workers: int, memory: int | None, keep_going: bool) -> None:
        """Start no process yet."""
        self._workers = workers
        self._memory = memory
        self._keep_going = keep_going
        self._context = multiprocessing.get_context("spawn")
        self._idle: list[tuple[BaseProcess, Connection]] = []
        self._busy: dict[Connection, tuple[BaseProcess, Job]] = {}
        self._tries: dict[str, int] = {}
        self._needs: dict[str, int] = {}

    def run(self, queue: Sequence[Job], sizes: Mapping[str, int]) -> Iterator[Row]:
        """Rows as they finish; a job whose worker dies is tried
        once more, then becomes a row. sizes: bytes by name.
        """
        queue = list(queue)
        self._needs = {name: expected_memory_bytes(size) for name, size in sizes.items()}
        try:
            while queue or self._busy:
                self._hand_out(queue)
                for pipe in wait(list(self._busy)):
                    assert isinstance(pipe, Connection)
                    row = self._collect(pipe, queue)
                    if row is not None:
                        yield row
                        if row["exit_code"] == 1 and not self._keep_going:
                            queue.clear()
        finally:
            self._stop()

    def _hand_out(self, queue: list[Job]) -> None:
        while queue and len(self._busy) < self._workers and self._fits(queue[0]):
            job = queue.pop(0)
            process, pipe = self._idle.pop() if self._idle else self._start()
            pipe.send(job)
            self._busy[pipe] = (process, job)

    def _fits(self, job: Job) -> bool:
        """Whether the memory budget allows another job; a job above the budget runs alone."""
        taken = sum(self._needs[busy.name] for _, busy in self._busy.values())
        return (
            not self._busy or self._memory is None or taken + self._needs[job.name] <= self._memory
        )

    def _start(self) -> tuple[BaseProcess, Connection]:
        here, there = self._context.Pipe()
        process = self._context.Process(target=_serve_jobs, args=(there,), daemon=True)
        with block_interrupts():
            process.start()
        there.close()
        return process, here

    def _collect(self, pipe: Connection, queue: list[Job]) -> Row | None:
        process, job = self._busy.pop(pipe)
        try:
            row: Row = pipe.recv()
        except (EOFError, OSError):
            return self._died(process, job, queue)
        self._idle.append((process, pipe))
        return row

    def _died(self, process: BaseProcess, job: Job, queue: list[Job]) -> Row | None:
        process.join()
        self._tries[job.name] = self._tries.get(job.name, 0) + 1
        if self._tries[job.name] < TRIES:
            queue.insert(0, job)
            return None
        return work.write_died_row(
            job, f"the worker process died with {process.exitcode} on {job.log}, {TRIES} times"
        )

    def _stop(self) -> None:
        stop_processes(
            [
                *(process for process, _ in self._idle),
                *(process for process, _ in self._busy.values()),
            ]
        )
        if self._busy:
            remove_killed(*(job.folder for _, job in self._busy.values()))


def _serve_jobs(pipe: Connection) -> None:
    """Run the jobs that arrive through the pipe until it closes or the process gets a signal."""
    import cv2

    become_worker()
    cv2.setNumThreads(1)
    try:
        while True:
            pipe.send(work.run_job(pipe.recv()))
    except (EOFError, BrokenPipeError):
        return
