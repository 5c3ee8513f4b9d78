"""Running experiments: what is done once is not done again, and gives the same bytes."""

import json
from dataclasses import replace

import pytest

from bodylog.errors import UsageError
from bodylog.experiments import EXPERIMENTS, run, run_reproduction
from bodylog.experiments.records import Experiment


def test_squared_encoders_lose_the_sign_and_vision_restores_it(small):
    _, claims, calls = small
    assert [claim.id for claim in claims] == [f"E2.{k}" for k in range(1, 6)]
    by = {claim.id: claim for claim in claims}
    assert [by[name].verdict for name in ("E2.1", "E2.2", "E2.4")] == ["kept", "kept", "holds"]
    assert by["E2.5"].outcomes["default"].median < 0.2 < 1.0 < by["E2.4"].outcomes["default"].median
    assert list(by["E2.1"].outcomes) == ["speed=4"] and list(by["E2.5"].outcomes) == ["default"]
    assert calls == [("E2 seed 0", 1, 1)]


def test_second_run_computes_nothing_and_keeps_bytes(small, monkeypatch):
    wish, claims, _ = small
    names = ("index.html", "claims.json", "data/E2.csv", "data/figures.csv", "data/outcomes.csv")
    before = [(wish.out / name).read_bytes() for name in names]
    monkeypatch.setitem(run.EXPERIMENTS, "E2", replace(EXPERIMENTS["E2"], run=_never))
    assert run_reproduction(wish) == claims
    assert [(wish.out / name).read_bytes() for name in names] == before


def test_interrupted_run_continues_at_its_place(small, monkeypatch):
    wish, _, _ = small
    made = []
    monkeypatch.setattr(run.Lab, "log", lambda *args, **options: _never())
    monkeypatch.setitem(run.EXPERIMENTS, "E9", Experiment("E9", "", _second_fails(made), lambda trials, calls: ()))
    monkeypatch.setitem(run.EXPERIMENTS, "E2", EXPERIMENTS["E2"])
    wish = replace(wish, names=("E9",), seeds=3)
    with pytest.raises(KeyboardInterrupt):
        list(run._iterate_finished(wish, [("E9", seed) for seed in range(3)]))
    list(run._iterate_finished(wish, [("E9", seed) for seed in range(3)]))
    assert made == [0, 1, 1, 2]


def _second_fails(made):
    def once(lab, seed, calls):
        made.append(seed)
        if made == [0, 1]:
            raise KeyboardInterrupt
        return {"figures": {}, "panels": []}

    return once


def _never(*_):
    raise AssertionError("computed again")


def test_reproduce_names_missing_packages_before_any_run(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "find_spec", lambda name: None)
    with pytest.raises(UsageError, match=r"needs PyBullet; type: pip install 'bodylog\[sim\]'"):
        run_reproduction(run.Reproduction(tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_another_picture_size_reading_or_setting_is_another_trial(small):
    wish, _, _ = small
    assert wish.lab.key({}) != replace(wish.lab, size=(160, 120)).key({})
    paths = {run.trial_path(replace(wish, reading=reading), "E2", 0) for reading in (None, {}, {"speed": "4"})}
    assert len(paths) == 3
    other = replace(wish, setting=replace(wish.setting, noise=(0.1,)))
    assert wish.key("Rubber-hand") != other.key("Rubber-hand") and wish.key("E2") == other.key("E2")


def test_reading_option_selects_one_reading_or_all(small):
    wish, _, _ = small
    assert len(wish.readings_of("E2").decide) == 1 and not wish.readings_of("E2").sweep
    every = replace(wish, reading=None)
    tried = every.readings_of("E1")
    assert len(tried.decide) >= 15 and tried.sweep and len(every.readings_of("PixelAI").decide) == 1


def test_kept_trials_hold_no_bare_nan(small):
    wish, _, _ = small
    text = run.trial_path(wish, "E2", 0).read_text()
    json.loads(text, parse_constant=lambda found: pytest.fail(found))


def test_unknown_experiment_lists_the_known_ones():
    with pytest.raises(
        UsageError, match=r"'E7'.*Data, E1, E2, E3, E4, E5, E6, Rubber-hand, PixelAI, Baselines, Errata, Real"
    ):
        run.choose_experiments(["E7"])
    assert run.choose_experiments(["e3", "E1"]) == ("E1", "E3") and run.choose_experiments(["rubber-hand"]) == ("Rubber-hand",)
    assert run.choose_experiments([]) == tuple(name for name in EXPERIMENTS if name != "Real")


def test_command_takes_a_reading_and_explains_a_wrong_one(tmp_path, capsys, run_cli):
    assert run_cli("reproduce", "E2", "-o", tmp_path, "--reading", "sigma_n=loud") == 2
    assert "possible: amplitude, noise, learned" in capsys.readouterr().err
    assert run_cli("reproduce", "rubber-hand", "-o", tmp_path, "--asynchrony", "0,fast") == 2
    assert "numbers from 0 to 5 are expected" in capsys.readouterr().err
    assert run_cli("reproduce", "real", "-o", tmp_path / "out") == 2
    assert "type: --data DIR" in capsys.readouterr().err
