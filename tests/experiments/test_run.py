"""Running experiments: what is done once is not done again, and gives the same bytes."""

import json
from dataclasses import replace

import pytest

from bodylog.errors import UsageError
from bodylog.experiments import EXPERIMENTS, reproduce, run
from bodylog.experiments.records import Experiment


def test_the_squared_encoders_hide_the_sign_and_vision_tells_it(small):
    _, claims, told = small
    assert [claim.experiment for claim in claims] == ["E2"] * 3
    assert claims[1].verdict == "confirmed"
    assert claims[2].printed[0] > 1.0 > 0.05 > claims[2].ours[0]
    assert told == [("E2 seed 0", 1, 1)]


def test_a_second_run_computes_nothing_and_gives_the_same_bytes(small, monkeypatch):
    wish, claims, _ = small
    names = ("index.html", "claims.json")
    before = [(wish.out / name).read_bytes() for name in names]
    monkeypatch.setitem(run.EXPERIMENTS, "E2", replace(EXPERIMENTS["E2"], run=_never))
    assert reproduce(wish) == claims
    assert [(wish.out / name).read_bytes() for name in names] == before


def test_an_interrupted_run_goes_on_where_it_was(small, monkeypatch):
    wish, _, _ = small
    made = []
    monkeypatch.setattr(run.Lab, "log", lambda *args, **options: _never())
    monkeypatch.setitem(run.EXPERIMENTS, "E9", Experiment("E9", "", _second_fails(made), lambda trials: ()))
    monkeypatch.setitem(run.EXPERIMENTS, "E2", EXPERIMENTS["E2"])
    wish = replace(wish, names=("E9",), seeds=3)
    with pytest.raises(KeyboardInterrupt):
        list(run._finished(wish, [("E9", seed) for seed in range(3)]))
    list(run._finished(wish, [("E9", seed) for seed in range(3)]))
    assert made == [0, 1, 1, 2]


def _second_fails(made):
    def once(lab, seed):
        made.append(seed)
        if made == [0, 1]:
            raise KeyboardInterrupt
        return {"figures": {}, "panels": []}

    return once


def _never(*_):
    raise AssertionError("computed again")


def test_what_is_not_installed_is_said_before_anything_runs(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "find_spec", lambda name: None)
    with pytest.raises(UsageError, match=r"pybullet is not installed; type: pip install 'bodylog\[sim\]'"):
        reproduce(run.Reproduction(tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_another_picture_size_is_another_key(small):
    wish, _, _ = small
    assert wish.lab.key({}) != replace(wish, size=(320, 240)).lab.key({})
    assert wish.lab.key({"a": 1}) != wish.lab.key({"a": 2})


def test_kept_trials_hold_no_bare_nan(small):
    wish, _, _ = small
    text = run.trial_path(wish.lab, "E2", 0).read_text()
    json.loads(text, parse_constant=lambda found: pytest.fail(found))


def test_an_unknown_experiment_names_those_there_are(tmp_path):
    with pytest.raises(UsageError, match=r"'E7'.*E1, E2, E3, E4, E5, E6, PixelAI, Errata"):
        run.chosen(["E7"])
    assert run.chosen(["e3", "E1"]) == ("E1", "E3")
    assert run.chosen([]) == tuple(EXPERIMENTS)
