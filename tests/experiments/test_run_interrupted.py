"""A reproduction that is killed goes on where it was, and ends as if it had not been."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace

import pytest

from bodylog.errors import PartError
from bodylog.experiments import Reproduction, run, run_reproduction

RUN = """
import sys
from pathlib import Path
from bodylog.experiments import Reproduction, run_reproduction
out = Path(sys.argv[1])
run_reproduction(Reproduction(out, ("E2",), seeds=1, jobs=1, exploration=8.0, reading={"speed": "4"}))
"""


def killed(out):
    """Start the reproduction `small` in a process of its own, and end it without warning once one log is there."""
    started = subprocess.Popen(
        [sys.executable, "-c", RUN, str(out)], env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        start_new_session=True, stderr=subprocess.PIPE,
    )  # fmt: skip
    try:
        while not list(out.glob("work/[a-z]*.mcap")):
            assert started.poll() is None, started.communicate()[1]
            time.sleep(0.01)
    finally:
        os.killpg(started.pid, signal.SIGKILL)
        started.communicate()


def test_killed_and_started_again_it_ends_with_the_same_bytes(small, tmp_path):
    whole, claims, _ = small
    wish = replace(whole, out=tmp_path)
    killed(tmp_path)
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.glob("work/[a-z]*.mcap")}
    assert kept and not run.trial_path(wish, "E2", 0).exists()
    assert run_reproduction(wish) == claims
    assert all(path.stat().st_mtime_ns == before for path, before in kept.items()), "recorded again"
    for name in ("index.html", "claims.json"):
        assert (tmp_path / name).read_bytes() == (whole.out / name).read_bytes()


@dataclass(frozen=True)
class KilledAtSeedOne(Reproduction):
    """Seed 1 kills its worker, as the kernel does where memory ends."""

    def run(self, name, seed):
        if seed == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        return {"figures": {}, "panels": []}


def test_killed_worker_prints_one_line_and_keeps_finished_runs(tmp_path):
    wish, finished = KilledAtSeedOne(tmp_path, jobs=1), []
    with pytest.raises(PartError, match=r"^[^\n]*a worker process was killed[^\n]*; type the same command") as problem:
        finished.extend(run._run_in_pool(wish, [("E2", 0), ("E2", 1)]))
    assert problem.value.exit_code == 3
    assert run.trial_path(wish, "E2", 0).exists() and not run.trial_path(wish, "E2", 1).exists()
