"""The whole chain, raw log to annotated log, beside a script of the usual libraries and beside its limits.

`python -m tests.benchmarks.bench_chain [jpeg] [raw] [raw-zstd] [command] [--keep FOLDER]`; without names: jpeg, raw,
command. FOLDER keeps the logs for the next run.
"""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import simplejpeg
from mcap.writer import CompressionType

from bodylog import pipeline
from bodylog.body import storage as models
from bodylog.io.atomic_files import hash_files, sync_to_disk
from bodylog.settings import Settings
from bodylog.types import Array
from tests.benchmarks import chain_log, chain_peer
from tests.benchmarks.bench_annotate import _and_remove, _synced_copy
from tests.benchmarks.goals import at_least, at_most
from tests.benchmarks.timing import side_by_side

SECONDS = 60.0
THREADS = 2
BOUNDS = {"jpeg": 6.0, "raw": 7.0, "raw-zstd": 7.0}
REPEATS = {"jpeg": 5, "raw": 3, "raw-zstd": 1, "command": 5}


def main() -> None:
    """Print times, ratios and the bounds they are held to."""
    typed = sys.argv[1:] if sys.argv[0].endswith("bench_chain.py") else []
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        if "--keep" in typed:
            work = Path(typed.pop(typed.index("--keep") + 1))
            typed.remove("--keep")
            work.mkdir(exist_ok=True)
        if not (work / "body.npz").exists():
            chain_log.learn(work / "body.npz")
        for name in typed or ["jpeg", "raw", "command"]:
            command(work) if name == "command" else whole(work, name)


def whole(work: Path, kind: str) -> None:
    """A minute of robot with a camera of that kind."""
    log, body, out = work / f"{kind}.mcap", work / "body.npz", work / "out.mcap"
    if not log.exists():
        chain_log.record(log, kind, SECONDS)
    packed = CompressionType.NONE if kind == "raw" else CompressionType.ZSTD
    synced: list[float] = []
    cases: dict[str, Callable[[], object]] = {
        "bodylog estimate": lambda: pipeline.estimate(log, body, out, Settings()),
        "bodylog estimate, a fresh process": lambda: _command(log, body, out),
        "mcap, mcap_ros2, OpenCV, numpy; synced": lambda: _peer(log, body, out, packed, synced),
        "limit: copying the log, synced": lambda: _synced_copy(log, out),
    }
    cases = {name: partial(_and_remove, case, out) for name, case in cases.items()}
    cases["limit: digesting the log"] = partial(hash_files, log)
    if kind == "jpeg":
        jpegs = chain_log.jpegs(log)
        cases[f"limit: decoding the JPEGs alone, {THREADS} threads"] = partial(_decode, jpegs, _opencv)
        cases["limit: the same by simplejpeg, as we decode"] = partial(_decode, jpegs, _simplejpeg)
    title = f"{SECONDS:.0f} s, {kind}, {log.stat().st_size / 1e6:.0f} MB, all of it synced"
    took = side_by_side(title, cases, REPEATS[kind])
    ours, fresh, durable, copy, digest, *decode = took.values()
    peer = durable - statistics.median(synced[1:])
    print(f"  the peer without its sync {peer:.2f} s, of which the bound speaks; {SECONDS / ours:.0f} x real time")
    text = f"mcap, mcap_ros2, OpenCV and numpy, not synced, {peer:.2f} s; ours {ours:.2f} s"
    at_least(f"a minute of {kind}, log to annotated log, times a script", peer / ours, BOUNDS[kind], "", text)
    print(f"  it takes {peer / fresh:.1f} x a fresh process's;")
    print(f"  synced as ours is, {durable / ours:.1f} x our time, {durable / fresh:.1f} x a fresh process's")
    reach = f"{peer / max(copy, digest):.1f} x is what a copy and a digest side by side would reach"
    print(f"  ours is {ours / copy:.1f} x a synced copy, {ours / digest:.1f} x a digest; {reach}")
    for by, alone in zip(("OpenCV (bound 2)", "simplejpeg, as we decode"), decode, strict=False):
        print(f"  {ours / alone:.2f} x decoding alone by {by}; {fresh / alone:.2f} x by a fresh process")
    if decode:
        text = f"OpenCV on {THREADS} threads, {decode[0]:.2f} s"
        at_most("a minute of jpeg, log to annotated log, times decoding its pictures", ours / decode[0], 2, "", text)


def _peer(log: Path, body: Path, out: Path, packed: CompressionType, synced: list[float]) -> None:
    """The script, and how long (s) its file takes to the disk."""
    chain_peer.run(log, models.load_body(body), out, packed)
    started = time.perf_counter()
    sync_to_disk(out)
    synced.append(time.perf_counter() - started)


def command(work: Path) -> None:
    """The command on ten minutes whose tracks are in the log, against the estimation alone."""
    log, body, out = work / "tracks.mcap", work / "body.npz", work / "out.mcap"
    if not log.exists():
        chain_log.record_features(log, 600.0, 100.0)
    learned, settings = models.load_body(body), Settings()
    _, features = pipeline.observe(log, settings)
    cases: dict[str, Callable[[], object]] = {
        "the loop": partial(pipeline.infer, features, learned, settings),
        "bodylog estimate": lambda: pipeline.estimate(log, body, out, settings),
        "bodylog estimate, a fresh process": lambda: _command(log, body, out),
        "python -c pass": lambda: subprocess.run([sys.executable, "-c", "pass"], check=True),
    }
    loop, inside, fresh, _ = side_by_side("10 minutes at 100 Hz, tracks in the log", cases, REPEATS["command"]).values()
    print(f"  beside the loop {inside - loop:.2f} s, as a command {fresh - loop:.2f} s")
    what = "`bodylog estimate` of 10 minutes, tracks in the log, beyond the estimation"
    at_most(what, fresh - loop, 0.6, "s", f"the loop alone, {loop:.2f} s")


def _command(log: Path, body: Path, out: Path) -> None:
    """With the package's bytecode at hand, as it is where it was installed."""
    typed = ["estimate", str(log), "--body", str(body), "-o", str(out)]
    shell = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    shell["PYTHONPYCACHEPREFIX"] = str(body.parent / "bytecode")
    subprocess.run([sys.executable, "-m", "bodylog_cli", *typed], check=True, capture_output=True, env=shell)


def _decode(jpegs: list[Array], decode: Callable[[Array], Array]) -> None:
    with ThreadPoolExecutor(THREADS) as pool:
        for _ in pool.map(lambda jpeg: decode(jpeg).shape, jpegs):
            pass


def _opencv(jpeg: Array) -> Array:
    return np.asarray(cv2.imdecode(jpeg, cv2.IMREAD_COLOR))


def _simplejpeg(jpeg: Array) -> Array:
    return np.asarray(simplejpeg.decode_jpeg(jpeg, "BGR"))


if __name__ == "__main__":
    main()
