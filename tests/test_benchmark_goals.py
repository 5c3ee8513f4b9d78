"""The run of all benchmarks: goes on past what is broken, ends with one table and exit code 4."""

import math
import sys

from tests.benchmarks import __main__ as run
from tests.benchmarks import goals


def test_goal_holds_on_its_side_of_the_limit():
    assert goals.Goal("x", 1.0, 1.0, True).holds and not goals.Goal("x", 1.01, 1.0, True).holds
    assert goals.Goal("x", 3.0, 3.0, False).holds and not goals.Goal("x", 2.99, 3.0, False).holds
    assert not goals.Goal("x", math.nan, 0.0, True).holds and not goals.Goal("x", math.nan, 0.0, False).holds


def test_goals_survive_the_way_from_one_process_to_another(tmp_path, monkeypatch):
    monkeypatch.setattr(goals, "FOUND", [])
    goals.at_most("a time", 0.05, 0.15, "s", "numpy, 0.04 s")
    goals.at_least("a ratio", 21.7, 30)
    goals.unmeasured("a peer", "it is not installed")
    goals.save(tmp_path / "goals.json")
    assert goals.load(tmp_path / "goals.json")[:2] == goals.FOUND[:2]
    assert goals.table(goals.load(tmp_path / "goals.json")).splitlines()[2:] == [
        "| a time | 0.0500 s | ≤ 0.15 s | yes | numpy, 0.04 s |",
        "| a ratio | 21.7 | ≥ 30 | **no** | - |",
        "| a peer | not measured | - | **no** | it is not installed |",
    ]
    assert "3 goals, 2 of them broken" in goals.page({"start": goals.FOUND})


def test_failed_benchmark_does_not_stop_the_others(monkeypatch, capsys):
    held = [goals.Goal("what holds", 1.0, 2.0, True)]
    monkeypatch.setattr(sys, "argv", ["bench", "no_such_benchmark", "another"])
    measured = run._measured
    monkeypatch.setattr(run, "_measured", lambda name: held if name == "another" else measured(name))
    assert run.main() == 4
    given = capsys.readouterr().out
    assert "no_such_benchmark runs to its end | not measured | - | **no**" in given and "what holds" in given
    monkeypatch.setattr(sys, "argv", ["bench", "another"])
    assert run.main() == 0
