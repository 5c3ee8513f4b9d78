"""A reproduction that is killed goes on where it was, and ends as if it had not been."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

from bodylog.experiments import reproduce, run

RUN = """
import sys
from pathlib import Path
from bodylog.experiments import Reproduction, reproduce
out = Path(sys.argv[1])
reproduce(Reproduction(out, ("E2",), seeds=1, jobs=1, exploration=8.0, reading={"speed": "4"}))
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
    assert reproduce(wish) == claims
    assert all(path.stat().st_mtime_ns == before for path, before in kept.items()), "recorded again"
    for name in ("index.html", "claims.json"):
        assert (tmp_path / name).read_bytes() == (whole.out / name).read_bytes()
