"""The figures: what they say, and that the same figures give the same bytes."""

import re

from bodylog.experiments import draw
from bodylog.experiments.records import Bound, judge, panel


def words(path):
    """What the text of an SVG says: matplotlib keeps each text as a comment beside its outlines."""
    return set(re.findall(r"<!-- (.*?) -->", path.read_text(), re.S))


def test_costs_are_lines_with_their_exponents(tmp_path):
    costs = {"learn 400": 1e-3, "learn 800": 8e-3, "predict ours 100": 1e-5, "predict ours 200": 2e-5}
    trial = {"figures": {**costs, "learn exponent": 3.0, "predict ours exponent": 1.0}}
    draw.curves([trial] * 3, tmp_path / "c.svg")
    assert {"learn: exponent 3.00", "predict ours: exponent 1.00"} <= words(tmp_path / "c.svg")


def test_truth_is_dashed_and_every_panel_drawn(tmp_path):
    shown = [panel(f"panel {k}", "rad", [0.0, 1.0, 2.0], {"truth": [0, 1, 2], "ours": [0, 1, 1]}) for k in range(3)]
    draw.traces(shown, tmp_path / "t.svg")
    text = (tmp_path / "t.svg").read_text()
    assert {"panel 0", "panel 1", "panel 2", "truth", "ours"} <= words(tmp_path / "t.svg")
    assert text.count("stroke-dasharray") >= 3


def test_a_dot_per_seed_and_the_bound_same_bytes_twice(tmp_path):
    claim = judge("E0", "text", "what", "rad", Bound("≤", 0.5), ([0.1, 0.2, float("nan")], [0.3, 4.0, 100.0]))
    for name in ("a.svg", "b.svg"):
        draw.spreads([claim], tmp_path / name)
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
    assert "1. what: ≤ 0.5 rad" in words(tmp_path / "a.svg")
