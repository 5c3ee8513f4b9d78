import base64
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from bodylog.report.viewers.image_overlay import OverlayPicture, draw_pictures
from bodylog.types import Fault, FaultKind, Health, Score, Stroke, Synchrony, Touch
from tests.changed_recordings import change_recording
from tests.report.pages import HOSTILE, LIMIT, hostile_parts, plotted, report, titles

from .records import SCORES, UNSEEN, estimate, features, recording, series


def numbers(trace, span):
    t = np.frombuffer(base64.b64decode(trace["t"]), "<u4") / (2**32 - 1) * (span[1] - span[0]) + span[0]
    return t, np.frombuffer(base64.b64decode(trace["y"]), "<f4")


class Elements(HTMLParser):
    """Tags and attributes of a page as a browser would see them."""

    def __init__(self, page):
        super().__init__()
        self.found = []
        self.feed(page)

    def handle_starttag(self, tag, attributes):
        self.found.append((tag, dict(attributes)))


def test_same_input_same_bytes(tmp_path):
    drawn = draw_pictures(recording(), features(), estimate())
    first, second = (report(tmp_path / name, pictures=drawn, provenance={"version": "1"}) for name in ("a", "b"))
    assert first == second
    assert len(first) > 100_000


def test_page_shows_every_part(tmp_path):
    drawn = draw_pictures(recording(), features(), estimate(), 6)
    page = report(tmp_path / "r.html", pictures=drawn, provenance={"sha256": "ab"})
    assert titles(page) == [
        *(f"{name}{what}" for name in recording().signals.joints.names for what in (", rad", " minus truth, rad")),
        "encoders: prediction error, standard deviations",
        "effector: prediction error, standard deviations",
        "free energy, nats",
        "effector u, px",
        "effector v, px",
        "hand u, px",
        "hand v, px",
        "skin, 0..1",
        "touches felt, strokes seen",
        "synchrony, 0..1",
        "seen minus felt, s",
    ]
    first = plotted(page)["panels"][0]
    assert [(trace["name"], trace["kind"]) for trace in first["traces"]] == [
        ("encoder", "line"), ("2σ", "band"), ("belief", "line"), ("truth", "dashes")
    ]  # fmt: skip
    assert [mark["ink"] for mark in plotted(page)["marks"]] == ["felt"] * 5 + ["seen"] * 5 + ["fault"]
    words = ("0.0068 rad", "rmse/joint", "drift", "8.250 s", "60 not seen", "3 not finite", "/joint_states", "sha256")
    for reported in words:
        assert reported in page
    assert page.count("data:image/jpeg;base64,") == 6


def test_cards_are_the_main_figures_and_scores_stand_in_a_table(tmp_path):
    page = report(tmp_path / "r.html", headline={"faults": "none found", "delay": "<42 ms"})
    cards = "<div><b>none found</b>faults</div><div><b>&lt;42 ms</b>delay</div>"
    assert f'<div class="cards">{cards}</div>' in page
    assert "<h2>Scores</h2>" in page and "<tr><td>rmse/joint</td><td>0.0068 rad</td></tr>" in page


def test_scores_in_parts_are_one_row_per_part(tmp_path):
    page = report(tmp_path / "r.html", scores=(*SCORES, Score("nees/joint/wrist", 2.0, "1")))
    assert "<tr><th>part</th><th>rmse/joint</th><th>nees/joint</th></tr>" in page
    assert "<tr><td>elbow_joint</td><td>0.0071 rad</td><td>1.25</td></tr>" in page
    assert "<tr><td>wrist</td><td>–</td><td>2</td></tr>" in page


def test_page_omits_a_track_without_sightings(tmp_path):
    found = features()
    hand = replace(found.tracks["hand"], values=np.full_like(found.tracks["hand"].values, np.nan))
    page = report(tmp_path / "r.html", features=replace(found, tracks={**found.tracks, "hand": hand}))
    assert "effector u, px" in titles(page) and "hand u, px" not in titles(page)


def test_page_keeps_the_estimates_numbers(tmp_path):
    belief = estimate()
    data = plotted(report(tmp_path / "r.html"))
    t, y = numbers(data["panels"][0]["traces"][2], data["span"])
    assert np.allclose(t, belief.joints.t, atol=1e-8) and np.allclose(y, belief.joints.values[:, 0], atol=1e-6)
    off = numbers(data["panels"][1]["traces"][2], data["span"])[1]
    assert np.allclose(off, belief.joints.values[:, 0] - recording().signals.truth.values[:, 0], atol=1e-6)
    band = data["panels"][0]["traces"][1]
    high = np.frombuffer(base64.b64decode(band["high"]), "<f4")
    assert np.allclose((high - numbers(band, data["span"])[1]) / 4, np.sqrt(belief.cov[:, 0, 0]), atol=1e-6)


def test_predicted_track_has_a_band_with_its_variance(tmp_path):
    belief = estimate()
    expected = belief.predicted["effector"]
    blunt = replace(belief, predicted={"effector": replace(expected, std=None)})
    for reported, kinds in ((belief, ["band", "line", "dots"]), (blunt, ["line", "dots"])):
        data = plotted(report(tmp_path / "r.html", estimate=reported))
        panel = next(panel for panel in data["panels"] if panel["title"] == "effector v, px")
        assert [trace["kind"] for trace in panel["traces"]] == kinds
        low = numbers(panel["traces"][0], data["span"])[1]
        width = 4.0 if kinds[0] == "band" else 0.0
        assert np.allclose(low, expected.values[:, 1] - width, atol=1e-4)


def test_page_keeps_gaps_in_tracks(tmp_path):
    data = plotted(report(tmp_path / "r.html"))
    seen = next(panel for panel in data["panels"] if panel["title"] == "hand u, px")["traces"][0]
    t, y = numbers(seen, data["span"])
    assert (np.isnan(y) == ((t > 6) & (t < 8 - 1e-6))).all()


def test_page_omits_absent_parts(tmp_path):
    bare = change_recording(recording(), truth=None, skin=None, health={}, findings=(), roles={})
    page = report(tmp_path / "r.html", recording=bare, features=UNSEEN, scores=())
    assert titles(page)[:3] == [f"{name}, rad" for name in bare.signals.joints.names]
    assert not any("truth" in title or "px" in title or "skin" in title for title in titles(page))
    for absent in ("<h2>Pictures", "<h2>Touches", "<h2>Provenance", "<h2>Remarks", "Health of the log"):
        assert absent not in page


def test_page_without_plots_has_no_script(tmp_path):
    bare, nothing = change_recording(recording(), truth=None, skin=None, joints=None), np.full((1000, 3), np.nan)
    found = estimate(errors={}, free_energy=nothing[:, 0], cov=nothing[:, :, None] * nothing[:, None])
    found = replace(found, joints=replace(found.joints, values=nothing))
    page = report(tmp_path / "r.html", recording=bare, features=UNSEEN, estimate=found)
    assert "<script" not in page and "<canvas" not in page and "Health of the log" in page


def test_page_needs_no_network(tmp_path):
    page = report(tmp_path / "r.html", pictures=draw_pictures(recording(), features(), estimate()))
    assert not re.search(r"(https?:)?//[a-z]", re.sub(r'base64,[^"]*|"[A-Za-z0-9+/=]{40,}"', "", page))
    loading = [(tag, at) for tag, at in Elements(page).found if "src" in at or tag in ("link", "iframe", "object")]
    assert all(tag == "img" and at["src"].startswith("data:image/jpeg;base64,") for tag, at in loading)


def test_hostile_names_stay_text(tmp_path):
    page = report(tmp_path / "r.html", **hostile_parts())
    found = Elements(page).found
    assert [at.get("type") for tag, at in found if tag == "script"] == ["application/json", None]
    assert [at for tag, at in found if tag == "img" and "onerror" in at] == []
    assert not re.search("[\x00\u2028\u202e]", page)
    assert plotted(page)["panels"][0]["title"] == f"{HOSTILE}, rad"
    assert not set("<>&") & set(page.split('id="data">')[1].split("</script>")[0])


@pytest.mark.parametrize("seed", range(3))
def test_long_wide_and_busy_logs_stay_below_the_limit(tmp_path, seed):
    rng = np.random.default_rng(seed)
    names = tuple(f"joint_{m}_of_a_long_named_robot" for m in (7, 64, 200)[seed : seed + 1] for m in range(m))
    duration = (1200.0, 60.0, 20.0)[seed]
    log = recording(seed, duration, names)
    noise = [OverlayPicture(float(k), rng.integers(0, 255, (360, 480, 3), dtype=np.uint8), "noise") for k in range(6)]
    n = 20_000
    touches = tuple(Touch(i * 1e-3, i * 1e-3 + 1e-4, tuple(range(117)), 1.0, 0, i) for i in range(n))
    strokes = tuple(Stroke(i * 1e-3, i * 1e-3 + 1e-4, (0.0, 0.0), (1.0, 1.0)) for i in range(n))
    pairs = tuple(Synchrony(i, i, 1 / 3, 1 / 3) for i in range(n))
    busy = features(seed, duration, touches=touches, strokes=strokes, synchrony=pairs)
    crowded = change_recording(log, health={f"/topic/{i}" * 30: Health(1, 1) for i in range(5000)})
    belief = estimate(seed, duration, names)
    page = report(tmp_path / "r.html", recording=crowded, features=busy, estimate=belief, pictures=noise)
    assert len(page.encode()) <= LIMIT
    assert "and 4800 more" in page and "Drawn: the first 2000 of 20000 touches." in page


def test_numbers_that_are_none_do_not_break_the_page(tmp_path):
    belief = estimate()
    wild = belief.free_energy.copy()
    wild[::7], wild[1::7], wild[2::7] = np.inf, -np.inf, 1e300
    broken = replace(
        belief,
        free_energy=wild,
        cov=np.full_like(belief.cov, np.nan),
        faults=(Fault("encoders", "elbow", FaultKind.FROZEN, np.nan, np.nan, "rad"),),
    )
    page = report(tmp_path / "r.html", estimate=broken, scores=(Score("nees/joint", np.nan, "1"),))
    data = plotted(page)
    assert all(np.isfinite([mark["from"], mark["to"]]).all() for mark in data["marks"])
    energy = next(panel for panel in data["panels"] if panel["title"].startswith("free energy"))["traces"][0]
    assert np.isfinite(numbers(energy, data["span"])[1]).sum() == (np.abs(wild) < 1e38).sum()


@pytest.mark.parametrize("start_ns", [0, -5, 2**62, -(2**62)])
def test_header_shows_any_start_time(tmp_path, start_ns):
    assert "mcap" in report(tmp_path / "r.html", recording=replace(recording(), start_ns=start_ns))


def test_page_of_one_instant_has_a_time_axis(tmp_path):
    one = series(np.array([0.0]), np.zeros((1, 1)), ("a",), "rad")
    instant = change_recording(recording(), joints=one, truth=None, skin=None, duration_s=0.0)
    found = estimate(joints=("a",), errors={}, cov=np.ones((1, 1, 1)), free_energy=np.zeros(1))
    found = replace(found, joints=one)
    page = report(tmp_path / "r.html", estimate=found, features=UNSEEN, recording=instant)
    assert plotted(page)["span"] == [0.0, 1.0]
