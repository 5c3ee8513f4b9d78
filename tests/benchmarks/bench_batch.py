"""Batches: two processes against one, the cost of a row, Dask against the pool, the scheduler's share of tiny logs.

`python -m tests.benchmarks.bench_batch scale` measures what docs/scale.md says, a thousand tiny logs among it.
"""

import contextvars
import io
import shutil
import sys
import tempfile
import time
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import bodylog_cli

from bodylog import pipeline, views
from bodylog.batch import BatchPlan, Group, run_batch
from bodylog.perception.colours.colour_tracker import THREADS
from bodylog.settings import Settings

LOGS = 16
TINY = (10, 100)


def main() -> None:
    """One row per comparison, ratios included."""
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        _robot(work)
        if sys.argv[1:] == ["scale"]:
            _kinds(work / "large")
            _tiny(work, (*TINY, 1000))
        else:
            _processes(work)
            _tiny(work, TINY)


def _robot(work: Path) -> None:
    _body(work, "320x240")
    for name, seconds in (("reach", 60), ("tiny", 4)):
        _quiet("record", "reach", "-o", work / f"{name}.mcap", "--duration", seconds, "--size", "320x240")


def _body(work: Path, size: str) -> None:
    _quiet("record", "babble", "-o", work / "explore.mcap", "--duration", 20, "--size", size)
    _quiet("fit", work / "explore.mcap", "-o", work / "body.npz")


def _quiet(*typed: object) -> None:
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        assert bodylog_cli.run_command([str(part) for part in typed]) == 0


def _copies(work: Path, source: str, count: int) -> Path:
    folder = work / f"{source}{count}"
    folder.mkdir()
    for number in range(count):
        shutil.copy(work / f"{source}.mcap", folder / f"{number:04}.mcap")
    return folder


def _processes(work: Path) -> None:
    logs = _copies(work, "reach", LOGS)
    alone = _estimate(work)
    one, two = _batch(work, logs, workers=1), _batch(work, logs, workers=2)
    started = _batch(work, logs, workers=2, scheduler="local")
    dask = _on_cluster(work, logs)
    size = (work / "reach.mcap").stat().st_size / 1e9
    print(f"\n{LOGS} equal logs of {size * 1e3:.1f} MB")
    print(f"  one estimate and report in a warm process     {alone:8.2f} s")
    print(f"  batch, 1 process: per log                      {one / LOGS:8.2f} s  (+{one / LOGS - alone:.3f} s)")
    print(f"  batch, 2 processes: per log                    {two / LOGS:8.2f} s  (x{one / two:.2f} of one process)")
    print(f"  Dask, 2 workers of a cluster that runs: per log{dask / LOGS:8.2f} s  (x{dask / two:.2f} of the pool)")
    print(f"  Dask, 2 workers started for it: per log       {started / LOGS:8.2f} s  (x{started / two:.2f} of it)")
    print(f"  per GB of log, 1 process                       {one / LOGS / size:8.1f} s")


def _estimate(work: Path, log: str = "reach") -> float:
    _once(work, log)
    started = time.perf_counter()
    _once(work, log)
    return time.perf_counter() - started


def _once(work: Path, log: str) -> None:
    """On one core, as in a batch."""
    contextvars.copy_context().run(_alone, work, log)


def _alone(work: Path, log: str) -> None:
    THREADS.set(1)
    pipeline.estimate(work / f"{log}.mcap", work / "body.npz", work / "alone.mcap", Settings())
    views.write_report(work / "alone.mcap", work / "alone.html", Settings())


def _batch(work: Path, logs: Path, workers: int, scheduler: str | None = None) -> float:
    out = work / "out"
    started = time.perf_counter()
    group = Group("", (str(logs),), Settings(), work / "body.npz")
    rows = run_batch(BatchPlan((group,), out, workers=workers, scheduler=scheduler))
    took = time.perf_counter() - started
    assert all(row["exit_code"] == 0 for row in rows)
    shutil.rmtree(out)
    return took


def _on_cluster(work: Path, logs: Path) -> float:
    """Two workers of a cluster that was there before, as on a cluster they are."""
    from distributed import Client, LocalCluster

    wanted = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
    with LocalCluster(**wanted) as cluster, Client(cluster) as client:
        client.wait_for_workers(2)
        return _batch(work, logs, 2, cluster.scheduler_address)


def _kinds(work: Path) -> None:
    """Seconds per log and per GB by what the camera writes, or with the features alone: one process, a minute each."""
    work.mkdir()
    _body(work, "640x480")
    print("\none process, logs of 60 s at 640x480")
    for kind in ("jpeg", "raw"):
        _quiet("record", "reach", "-o", work / f"{kind}.mcap", "--duration", 60, "--size", "640x480", "--image", kind)
    _quiet("extract", work / "jpeg.mcap", "-o", work / "features.mcap")
    for kind in ("jpeg", "raw", "features"):
        size, logs = (work / f"{kind}.mcap").stat().st_size / 1e9, _copies(work, kind, 4)
        took = _batch(work, logs, 1) / 4
        print(f"  {kind:<8} {size * 1e3:8.1f} MB  {took:6.2f} s per log  {took / size:8.1f} s per GB")


def _tiny(work: Path, counts: tuple[int, ...]) -> None:
    print("\ntiny logs (4 s), s per log")
    print(f"  one estimate and report in a warm process {_estimate(work, 'tiny'):.3f}")
    for count in counts:
        logs = _copies(work, "tiny", count)
        pool, dask = _batch(work, logs, 2), _batch(work, logs, 2, "local")
        print(f"  {count:>5} logs: pool {pool / count:.3f}, Dask {dask / count:.3f} (x{dask / pool:.2f})")


if __name__ == "__main__":
    main()
