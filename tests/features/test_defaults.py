"""What is followed where nothing is configured: what moves as the joints do, or what the body was learned with."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bodylog import pipeline
from bodylog.body import storage
from bodylog.body_model import BodyModel, Noise, TouchConstants
from bodylog.features import defaults as default_features
from bodylog.recording import recording
from bodylog.settings import ColourSettings, Settings, settings_as_values
from bodylog.sources import ColourSource, TagSource
from bodylog.types import Recording
from tests.changed_recordings import change_recording
from tests.perception import films as candidates


@pytest.fixture
def film(monkeypatch: pytest.MonkeyPatch) -> Recording:
    """What every path is read as: green, red and yellow things that the joints do not move, and a tag that they do."""
    found = candidates.film(tag=7, arm=False)
    monkeypatch.setattr(recording, "read_recording", lambda _path, settings, *_: change_recording(found, settings=settings))
    return found


def test_guess_follows_the_arms_tag_instead_of_green(film: Recording) -> None:
    read, found = pipeline.observe(Path("log.mcap"), Settings(), guess=True)
    first, second = (finding.text for finding in found.findings[:2])
    assert "effector: green is not the arm's: it does not move as the joints do" in first and "tag = 7" in first
    assert "effector: not followed: " in second and "yellow: it stands still" in second and "hand" not in second
    assert read.facts.settings.features == {"effector": TagSource(7, "apriltag_36h11")}
    assert found.health["effector"].used > 110 and found.effector is not None
    assert default_features.features_of_log(read, Settings()).features == read.facts.settings.features
    known = json.dumps({"settings": json.dumps(settings_as_values(read.facts.settings))})
    learned = replace(_model(), provenance=json.loads(known))
    assert default_features.features_of_body(learned, Settings()).features == read.facts.settings.features


def test_configured_features_are_not_guessed(film: Recording) -> None:
    read, found = pipeline.observe(Path("log.mcap"), Settings(colours=ColourSettings(effector="yellow")), guess=True)
    assert not read.facts.settings.features and not any("is not the arm's" in one.text for one in found.findings)
    body = json.dumps({"features": {"effector": {"tag": 9, "dictionary": "4x4_50"}}, "colours": {}})
    own = Settings(features={"effector": ColourSource("blue")})
    assert default_features.features_of_body(replace(_model(), provenance={"settings": body}), own) is own


@pytest.mark.soak
def test_body_learned_from_a_tag_needs_no_configuration(tmp_path: Path, run_cli) -> None:
    typed = ("--size", "640x480", "--feature", "tag", "--clutter")
    assert run_cli("record", "babble", "-o", tmp_path / "explore.mcap", "--duration", 30, "--seed", 4, *typed) == 0
    assert run_cli("record", "reach", "-o", tmp_path / "reach.mcap", "--duration", 6, "--seed", 5, *typed) == 0
    assert run_cli("fit", tmp_path / "explore.mcap", "-o", tmp_path / "body.npz") == 0
    learned = storage.load_body(tmp_path / "body.npz")
    assert default_features.features_of_body(learned, Settings()).features == {"effector": TagSource(7, "apriltag_36h11")}
    typed = ("estimate", tmp_path / "reach.mcap", "--body", tmp_path / "body.npz", "-o", tmp_path / "out.mcap")
    assert run_cli(*typed) == 0
    found = pipeline.observe(tmp_path / "out.mcap", Settings())[1].tracks["effector"]
    assert np.isfinite(found.values).all(axis=1).sum() > 60


@pytest.mark.parametrize("settings", ["{}", "no JSON", '{"features": 3}', '{"features": {"a": {"tag": -1}}}'])
def test_provenance_that_names_no_source_leaves_the_default(settings: str) -> None:
    learned = replace(_model(), provenance={"settings": settings})
    assert default_features.features_of_body(learned, Settings()) == Settings()


def test_guess_keeps_the_green_ball_of_the_arm(arm: Path) -> None:
    read, found = pipeline.observe(arm / "explore.mcap", Settings(), guess=True)
    _, plain = pipeline.observe(arm / "explore.mcap", Settings())
    assert not read.facts.settings.features and found.effector is not None and plain.effector is not None
    assert found.effector.values.tobytes() == plain.effector.values.tobytes()


def _model() -> BodyModel:
    return BodyModel((), {}, Noise((), {}, ()), TouchConstants(1, 1), {})
