import re
from dataclasses import replace

import numpy as np
import pytest

from bodylog.errors import LogError, ModelError
from bodylog.report.figures.figures import body_figure, estimate_figure, recording_figure
from tests.changed_recordings import change_recording

from .records import UNSEEN, Blind, Bowl, body, estimate, features, recording

HOSTILE = ("$\\frac{", "_hidden", "</text><script>", "名前", "a" * 500, "line\nbreak")


def words(path):
    """What the text of an SVG says: matplotlib keeps each text as a comment beside its outlines."""
    return re.findall(r"<!-- (.*?) -->", path.read_text(), re.S)


def axes_of(path):
    return len(re.findall(r'<g id="axes_\d+">', path.read_text()))


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_same_log_same_bytes(tmp_path, suffix):
    first, second = tmp_path / f"1{suffix}", tmp_path / f"2{suffix}"
    for out in (first, second):
        recording_figure(recording(), features(), out)
    assert first.read_bytes() == second.read_bytes()
    assert first.stat().st_size > 20_000


def test_recording_figure_shows_every_kind_of_signal(tmp_path):
    recording_figure(recording(), features(), tmp_path / "f.svg")
    reported = words(tmp_path / "f.svg")
    assert {"joints, rad", "pixels", "skin cell", "felt", "seen", "u, pixels", "0.93", "time, s"} <= set(reported)
    assert {"shoulder_pan_joint", "effector u", "hand v", "reach.mcap"} <= set(reported)


@pytest.mark.parametrize(
    ("log", "seen", "count", "absent"),
    [
        ({"skin": None}, {"touches": None, "synchrony": (), "strokes": ()}, 3, {"skin cell", "felt"}),
        ({"joints": None}, {}, 5, {"joints, rad"}),
        ({}, {"tracks": {}, "strokes": (), "synchrony": (), "touches": None}, 3, {"pixels", "u, pixels", "felt"}),
    ],
)
def test_recording_figure_omits_absent_signals(tmp_path, log, seen, count, absent):
    recording_figure(change_recording(recording(), **log), features(**seen), tmp_path / "f.svg")
    assert axes_of(tmp_path / "f.svg") == count  # the colour bar of the skin is one
    assert not absent & set(words(tmp_path / "f.svg"))


@pytest.mark.parametrize("seen", [{}, {"strokes": ()}, {"touches": ()}])
def test_touches_and_strokes_are_drawn_also_where_none_goes_with_another(tmp_path, seen):
    recording_figure(recording(), features(**seen, synchrony=()), tmp_path / "f.svg")
    assert {"felt", "seen"} <= set(words(tmp_path / "f.svg"))


def test_recording_figure_without_features_shows_signals(tmp_path):
    recording_figure(recording(), UNSEEN, tmp_path / "f.svg")
    assert axes_of(tmp_path / "f.svg") == 3


def test_empty_recording_is_refused_by_name(tmp_path):
    with pytest.raises(LogError, match="no joints"):
        recording_figure(change_recording(recording(), joints=None, skin=None), UNSEEN, tmp_path / "f.svg")


@pytest.mark.parametrize("cells", [1, 4, 5, 117])
def test_skin_is_lines_for_few_cells_and_a_picture_for_many(tmp_path, cells):
    skin = recording().signals.skin
    some = replace(skin, values=np.tile(skin.values[:, :1], cells), names=tuple(f"cell {c}" for c in range(cells)))
    recording_figure(change_recording(recording(), skin=some), UNSEEN, tmp_path / "f.svg")
    assert ("skin cell" in words(tmp_path / "f.svg")) == (cells >= 5)


@pytest.mark.parametrize("value", [1e38, -1e38, np.inf, np.nan, np.uint32(0x7F800001).view(np.float32)])
def test_cells_that_read_anything_are_drawn(tmp_path, value):
    skin = recording().signals.skin
    values = skin.values.astype(np.float32)
    values[::7, 3] = values[:, 5] = value
    recording_figure(change_recording(recording(), skin=replace(skin, values=values)), UNSEEN, tmp_path / "f.png")


def test_recording_figure_omits_a_track_without_sightings(tmp_path):
    found = features()
    hand = replace(found.tracks["hand"], values=np.full_like(found.tracks["hand"].values, np.nan))
    recording_figure(recording(), replace(found, tracks={**found.tracks, "hand": hand}), tmp_path / "f.svg")
    assert "effector u" in words(tmp_path / "f.svg") and "hand u" not in words(tmp_path / "f.svg")


def test_names_from_a_log_stay_text(tmp_path):
    recording_figure(change_recording(recording(joints=HOSTILE), name="$x^{<&>"), features(), tmp_path / "f.svg")
    estimate_figure(estimate(joints=HOSTILE), recording(joints=HOSTILE).signals.truth, None, tmp_path / "e.svg")
    for path in (tmp_path / "f.svg", tmp_path / "e.svg"):
        assert "<script" not in path.read_text()
        assert any("$\\frac{" in text for text in words(path))
        assert any("_hidden" in text for text in words(path))


def test_body_surfaces_run_over_the_two_joints_that_moved_most(tmp_path):
    body_figure(body(), tmp_path / "b.svg")
    reported = words(tmp_path / "b.svg")
    assert {"effector u: mean", "effector v: standard deviation"} <= set(reported)
    assert {"shoulder_pan_joint, rad", "shoulder_lift_joint, rad"} <= set(reported)
    assert "elbow_joint, rad" not in reported
    x = np.random.default_rng(0).uniform(-1, 1, (30, 3)) * (0.01, 0.5, 2.0)
    body_figure(body(senses={"effector": Bowl(x)}), tmp_path / "c.svg")
    assert "shoulder_pan_joint, rad" not in words(tmp_path / "c.svg")


def test_body_figure_needs_two_joints_but_no_samples(tmp_path):
    body_figure(body(senses={"touch": Blind()}), tmp_path / "b.png")
    assert (tmp_path / "b.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ModelError, match="1 joint"):
        body_figure(body(joints=("elbow",)), tmp_path / "c.png")
    with pytest.raises(ModelError, match="without a sense"):
        body_figure(body(senses={}), tmp_path / "d.png")


def test_estimate_figure_shows_belief_truth_faults_and_errors(tmp_path):
    log = recording()
    estimate_figure(estimate(), log.signals.truth, log.signals.joints, tmp_path / "e.svg")
    reported = set(words(tmp_path / "e.svg"))
    assert {"belief", "truth", "encoder", "off truth, mrad", "drifting since 8.2 s"} <= reported
    assert {"encoders error, σ", "effector error, σ", "free energy, nats"} <= reported
    assert axes_of(tmp_path / "e.svg") == 3 + 3 + 2 + 1


def test_estimate_figure_without_truth_has_no_deviation(tmp_path):
    estimate_figure(estimate(), None, None, tmp_path / "e.svg")
    assert not {"truth", "encoder", "off truth, mrad"} & set(words(tmp_path / "e.svg"))
    assert axes_of(tmp_path / "e.svg") == 6


def test_long_log_gives_a_small_figure(tmp_path):
    log = recording(duration=2000.0)
    recording_figure(log, features(duration=2000.0), tmp_path / "f.svg")
    estimate_figure(estimate(duration=2000.0), log.signals.truth, log.signals.joints, tmp_path / "e.svg")
    assert max(p.stat().st_size for p in tmp_path.iterdir()) < 3_000_000
