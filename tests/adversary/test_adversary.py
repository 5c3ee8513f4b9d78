"""Commands read hostile containers and settings, or refuse them in one line; no half-written files remain."""

import json

import pytest

from . import cases, worker
from .__main__ import meet
from .grammar import Draw


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    """Sound files, the sources of all cases."""
    return cases.prepare(tmp_path_factory.mktemp("adversary") / "base")


def _texts(problems):
    return "\n".join(
        f"{p.kind} {p.seed}: {' '.join(p.run.command)}: {p.what}\n{p.run.err[-800:]}" for p in problems[:5]
    )


def test_commands_read_or_refuse_hostile_input_in_one_line(base, tmp_path):
    problems, figures = meet(base, tmp_path, range(12), range(4), sets=range(12))
    assert not problems, _texts(problems)
    assert figures["commands"] > 50


@pytest.mark.parametrize(
    "seed",
    [
        43000074,  # half a century without readings: rounding lost a variance
        61000064,  # names that are not UTF-8, kept in the output
        61000157,  # OpenCV's output for a readable image
        62001059,  # and for an unreadable one
        61000427,  # topics named with two slashes
        62000789,  # a signalling NaN of the skin
        62002319,  # a touch of no cell
        82000125,  # a signalling NaN, written as a float32
        94002125,  # a body whose tracks depend on no joint
        92000784,  # stamps that are lists in some messages
        92000236,  # a variance that rounding takes below 0
        203000613,  # a model whose variance is 0 where its slope's is not
        203001702,  # weights of 1e19: delays from a singular covariance
        302000356,  # angles of 1e8 rad: a kernel of rounding errors
        412000000001533,  # an image whose encoding is half a surrogate pair
        511000000000281,  # a number of 400 digits in JSON
        512000000000378,  # no digits, and then 400
        71000041,  # a count of messages of 401 digits
    ],
)
def test_commands_survive_known_bad_seeds(base, tmp_path, seed):
    assert not (problems := cases.file_case(base, tmp_path, seed)[2]), _texts(problems)


@pytest.mark.parametrize(
    "seed",
    [
        7000023,  # Arrow's error for a damaged table
        21001760,  # a kinematic body whose scales of 1e19 leave no covariance
    ],
)
def test_commands_survive_known_bad_datasets_and_bodies(base, tmp_path, seed):
    assert not (problems := cases.set_case(base, tmp_path, seed)[2]), _texts(problems)


def test_meet_writes_progress_before_it_is_stopped(base, tmp_path):
    meet(base, tmp_path, range(2), range(0), tmp_path)
    left = json.loads((tmp_path / "figures.json").read_text())
    assert left["files"] == 2 and left["last seed"] == 1 and left["worst MB"][0] > 0


@pytest.mark.soak
def test_commands_survive_3000_hostile_datasets_tables_robots_bodies_and_servers(base, tmp_path):
    problems, figures = meet(base, tmp_path, range(0), range(0), sets=range(1000, 4000))
    print(figures)
    assert not problems, _texts(problems)


@pytest.mark.soak
def test_commands_survive_20000_hostile_inputs(base, tmp_path):
    problems, figures = meet(base, tmp_path, range(1000, 20_000), range(1000, 2000))
    print(figures)
    assert not problems, _texts(problems)


def _outcome(**how):
    defaults = {
        "command": ("info", "x", "--json"),
        "code": 0,
        "out": "{}",
        "err": "",
        "seconds": 1.0,
        "memory": 1 << 28,
    }
    return worker.Run(**(defaults | how))


@pytest.mark.parametrize(
    ("how", "what"),
    [
        ({"code": 1, "err": "Traceback (most recent call last):\n"}, "exit code 1"),
        ({"code": 65, "err": "bodylog: a\nbodylog: b\n"}, "not refused in one line"),
        ({"code": 65, "err": "bodylog: there is not enough memory\n"}, "not enough memory"),
        ({"err": "x.py:3: RuntimeWarning: overflow\n"}, "a library speaks"),
        ({"out": '{"t": NaN}'}, "its JSON: NaN in it"),
        ({"seconds": 61.0}, "61.0 s"),
        ({"memory": 2 << 30}, "2048 MB"),
        ({"code": None}, "it did not end, or was killed"),
        ({"command": ("fit", "x", "-o", "/nowhere/b.npz")}, "success without an output"),
    ],
)
def test_wrong_reports_each_violation(how, what):
    assert what in list(cases._wrong(_outcome(**how)))


def test_wrong_reports_nothing_for_a_sound_run():
    assert not list(cases._wrong(_outcome()))


def test_same_reports_a_changed_message(tmp_path, monkeypatch):
    cases.WRITERS["log.mcap"](Draw(3, 0.0), tmp_path / "log.mcap")
    assert cases._same(tmp_path / "log.mcap", []) is None
    read = cases._by_mcap
    monkeypatch.setattr(cases, "_by_mcap", lambda file: read(file) + read(file))
    assert "messages" in cases._same(tmp_path / "log.mcap", [])


def test_left_reports_lost_and_left_over_files():
    before, run = {"a": (1, 1), "b": (2, 2)}, _outcome(code=65)
    assert list(cases._left(before, before, [run])) == []
    assert list(cases._left(before, {"a": (1, 1)}, [run])) == ["an input changed or is gone"]
    assert list(cases._left(before, before | {".c.part": (0, 0)}, [run])) == ["left over: .c.part"]
