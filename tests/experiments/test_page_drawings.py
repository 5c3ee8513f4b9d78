"""The figures: what they say, and that the same figures give the same bytes."""

import re

from bodylog.experiments import page
from bodylog.experiments.claims import Bound
from bodylog.experiments.judging import judge_paper_claim
from bodylog.experiments.records import build_panel


def words(path):
    """What the text of an SVG says: matplotlib keeps each text as a comment beside its outlines."""
    return set(re.findall(r"<!-- (.*?) -->", path.read_text(), re.S))


def test_truth_is_dashed_and_every_panel_drawn(tmp_path):
    lines = {"truth": [0, 1, 2], "ours": [0, 1, 1]}
    shown = [build_panel(f"panel {k}", "rad", [0.0, 1.0, 2.0], lines, f"{k}a") for k in range(3)]
    page.draw_traces(shown, tmp_path / "t.svg")
    text = (tmp_path / "t.svg").read_text()
    assert {"Fig. 0a panel 0", "Fig. 1a panel 1", "Fig. 2a panel 2", "truth", "ours"} <= words(tmp_path / "t.svg")
    assert text.count("stroke-dasharray") >= 3


def claim():
    by = {"centre": 0.1, "sigma_v=pixels": float("nan"), "sigma_v=widths": 40.0, "sigma_v=20": 0.2, "sigma_v=320": 30.0}
    swept = [("sigma_v", 20.0, "sigma_v=20"), ("sigma_v", 320.0, "sigma_v=320")]
    tried = [key for key in by if not key.endswith("0")]
    return judge_paper_claim("E0.1", "text", "what", "rad", Bound("≤", 0.5), "it", lambda key, name: (by[key],) * 3, tried, swept)


def test_spreads_draw_readings_and_bound_with_identical_bytes(tmp_path):
    for name in ("a.svg", "b.svg"):
        page.draw_spreads([claim()], tmp_path / name)
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
    assert {"E0.1 what: ≤ 0.5 rad", "centre", "sigma_v=widths"} <= words(tmp_path / "a.svg")


def test_sweeps_label_the_swept_axis(tmp_path):
    page.draw_sweeps([claim()], tmp_path / "s.svg")
    assert {"E0.1 what", "σ_v: unit in px"} <= words(tmp_path / "s.svg")
