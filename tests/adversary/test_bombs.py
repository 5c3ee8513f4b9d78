"""Small files that ask for much: every one is read or refused in one line, within 1 GB and 60 s, and leaks nothing."""

import json

import pytest

from . import worker
from .bombs import BOMBS, SECRET
from .cases import _wrong

LONG = {"hdf5 giant chunk", "hdf5 endless stream", "csv commas", "csv full", "yaml values"}
"""Those that take longest, each of a kind of which another is tried always."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.soak) if name in LONG else name for name in BOMBS]
)
def test_commands_defuse_bombs(name, tmp_path):
    bomb = BOMBS[name]
    words = json.loads(worker.run([], lambda: json.dumps(bomb.write(tmp_path)))[-1].err)
    run = worker.run([words])[0]
    assert not list(_wrong(run)) and run.code == bomb.code, run
    assert bomb.says in run.out + run.err
    assert not any(SECRET in path.read_bytes() for path in tmp_path.glob("out.*")), "another file's bytes leaked"
