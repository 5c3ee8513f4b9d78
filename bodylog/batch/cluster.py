"""Run the jobs of a batch on a Dask distributed
scheduler, for example one started by dask-jobqueue.
"""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from ..errors import UsageError
from ..io.extras import require_module
from ..runtime import malloc
from . import work
from .jobs import Job, Row

if TYPE_CHECKING:
    from distributed import Client

TRIES = 3


def run_on_cluster(jobs: Sequence[Job], scheduler: str, workers: int) -> Iterator[Row]:
    """Rows as they finish; a job whose worker is lost is given to another. `scheduler`:
    tcp://host:port, or local.
    """
    client = _open_client(scheduler, workers)
    try:
        yield from _gather_rows(client, jobs)
    finally:
        client.close()


def _open_client(scheduler: str, workers: int) -> "Client":
    # must be set before distributed is imported: forked
    # workers start several times faster than spawned ones
    require_module("dask").config.set(
        {"distributed.worker.multiprocessing-method": "forkserver", "logging.distributed": "error"}
    )
    distributed = require_module("distributed")
    if scheduler == "local":
        return distributed.Client(
            distributed.LocalCluster(
                n_workers=workers, threads_per_worker=1, dashboard_address="127.0.0.1:0"
            )
        )
    try:
        return distributed.Client(scheduler, timeout="5s")
    except (OSError, ValueError, TimeoutError) as err:
        raise UsageError(
            f"--scheduler {scheduler}: no scheduler answers; type: tcp://HOST:PORT or local"
        ) from err


def run_job_on_worker(job: Job) -> Row:
    """Run one job on a worker. The allocator keeps freed
    memory, which Dask otherwise has workers return at once.
    """
    import cv2

    malloc.tune_malloc()
    cv2.setNumThreads(1)
    return work.run_job(job)


def _gather_rows(client: "Client", jobs: Sequence[Job]) -> Iterator[Row]:
    from distributed import as_completed

    # pure=False: a job writes files, so an equal call is not redundant
    futures = {
        client.submit(run_job_on_worker, job, pure=False, retries=TRIES): job for job in jobs
    }
    for future in as_completed(list(futures)):
        if future.status == "finished":
            yield future.result()
        else:
            yield work.write_died_row(
                futures[future], f"lost with its workers: {future.exception()!r}"
            )
