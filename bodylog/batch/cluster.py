"""The jobs of a batch on a Dask distributed scheduler, so on whatever dask-jobqueue and its kin can start."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from ..errors import UsageError
from ..runtime import malloc
from . import work
from .jobs import Job, Row

if TYPE_CHECKING:
    from distributed import Client

TRIES = 3


def run(jobs: Sequence[Job], scheduler: str, workers: int) -> Iterator[Row]:
    """Rows as they finish; a job whose worker is lost is given to another. `scheduler`: tcp://host:port, or local."""
    client = _client(scheduler, workers)
    try:
        yield from _gather(client, jobs)
    finally:
        client.close()


def _client(scheduler: str, workers: int) -> "Client":
    try:
        import dask

        # read when distributed is imported: workers forked from a server that has it loaded start several times sooner
        dask.config.set({"distributed.worker.multiprocessing-method": "forkserver", "logging.distributed": "error"})
        from distributed import Client, LocalCluster
    except ImportError as err:
        raise UsageError("--scheduler needs Dask; type: pip install 'bodylog[dask]'") from err
    if scheduler == "local":
        return Client(LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address="127.0.0.1:0"))
    try:
        return Client(scheduler, timeout="5s")
    except (OSError, ValueError, TimeoutError) as err:
        raise UsageError(f"--scheduler {scheduler}: nothing answers there; type: tcp://HOST:PORT or local") from err


def do(job: Job) -> Row:
    """One job on a worker, which Dask tells to give memory back at once: bodylog asks for the same again and again."""
    import cv2

    malloc.tune_malloc()
    cv2.setNumThreads(1)
    return work.run(job)


def _gather(client: "Client", jobs: Sequence[Job]) -> Iterator[Row]:
    from distributed import as_completed

    # pure=False: the work lies in files, so an equal call is still a call to make.
    futures = {client.submit(do, job, pure=False, retries=TRIES): job for job in jobs}
    for future in as_completed(list(futures)):
        if future.status == "finished":
            yield future.result()
        else:
            yield work.died(futures[future], f"lost with its workers: {future.exception()!r}")
