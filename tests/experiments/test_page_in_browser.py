"""The page as a browser shows it: no complaint, panels of one experiment move together, names stay text."""

import numpy as np
import pytest

from bodylog.experiments import page
from bodylog.experiments.claims import Bound
from bodylog.experiments.judging import judge_own_claim
from bodylog.experiments.records import Experiment, ExperimentReadings, TextTable, build_panel
from tests.report import browser
from tests.report.browser import BLANK, DRAWN, RANGES, drag_across
from tests.report.pages import HOSTILE

pytestmark = pytest.mark.skipif(
    not (browser.DRIVER and browser.BROWSER), reason="needs chromium and chromedriver on the path"
)


@pytest.fixture(scope="module")
def window():
    with browser.page() as opened:
        yield opened


@pytest.fixture
def opened(tmp_path, monkeypatch, window):
    """A page of two experiments, whose names and figures nobody chose kindly."""
    for name in ("first", "second"):
        experiment = Experiment(name, HOSTILE, lambda lab, seed, tried: {}, _claims, (), _tables)
        monkeypatch.setitem(page.EXPERIMENTS, name, experiment)
    tried = dict.fromkeys(("first", "second"), ExperimentReadings(({},)))
    page.write_reproduction_page(tmp_path, {"first": [_trial(20.0)] * 3, "second": [_trial(12.0)] * 3}, tried, 3, "320×240")
    window.open(tmp_path / "index.html")
    return window


def _trial(end):
    t = np.arange(0.0, end, 0.1)
    lines = {HOSTILE: np.sin(t), "true": np.where(t > 5, np.nan, np.cos(t))}
    return {"figures": {"a": 0.5}, "panels": [build_panel(HOSTILE, "rad", t, lines), build_panel("flat", "px", t, {"a": 0 * t})]}


def _claims(trials, tried):
    figures = [trial["figures"]["a"] for trial in trials]
    return (judge_own_claim(HOSTILE, HOSTILE, HOSTILE, HOSTILE, Bound("≤", 1.0), figures, HOSTILE),)


def _tables(trials):
    return (TextTable(HOSTILE, (HOSTILE, "b"), ((HOSTILE, "1"),)),)


def test_page_opens_without_errors_and_draws_every_panel(opened):
    assert opened.complaints() == []
    sizes = opened.run("return [...document.querySelectorAll('canvas')].map((c) => [c.width, c.height])")
    assert len(sizes) == 4 and not set(opened.run(DRAWN)) & {opened.run(BLANK, *size) for size in sizes}
    assert opened.run("return document.images.length === 2 && [...document.images].every((i) => i.naturalWidth > 500)")


def test_zooming_moves_the_panels_of_the_same_experiment_and_no_others(opened):
    before = opened.run(RANGES)
    assert [view[1] for view in before] == pytest.approx([19.9, 19.9, 11.9, 11.9], abs=0.01)
    drag_across(opened, 2, 0.3, 0.5)
    zoomed = opened.run(RANGES)
    assert zoomed[:2] == before[:2] and zoomed[2] == zoomed[3]
    assert 2 < zoomed[3][0] < 4.5 and 4.5 < zoomed[3][1] < 7
    opened.press("0")
    assert opened.run(RANGES) == before and opened.complaints() == []


def test_hostile_names_stay_text(opened):
    assert opened.run("return window.hit === undefined && document.querySelectorAll('img[onerror]').length === 0")
    assert opened.run("return document.querySelector('.panel b').textContent") == f"{HOSTILE}, rad"
    assert "<img src=x onerror=window.hit=1>" in opened.run("return document.querySelector('h2').textContent")
