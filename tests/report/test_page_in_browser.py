import pytest

from bodylog.report.viewers.image_overlay import draw_pictures
from tests.report.browser import BLANK, DRAWN, RANGES, SHOW, drag_across
from tests.report.pages import HOSTILE, hostile_parts, report

from .browser import BROWSER, DRIVER, page
from .records import estimate, features, recording

pytestmark = pytest.mark.skipif(not (DRIVER and BROWSER), reason="needs chromium and chromedriver on the path")


@pytest.fixture(scope="module")
def window():
    with page() as opened:
        yield opened


@pytest.fixture
def whole(tmp_path, window):
    """The window with a page of everything in it."""
    report(tmp_path / "r.html", pictures=draw_pictures(recording(), features(), estimate()))
    window.open(tmp_path / "r.html")
    return window


def test_page_opens_without_errors_and_draws_every_panel(whole):
    assert whole.complaints() == []
    sizes = whole.run("return [...document.querySelectorAll('canvas')].map((c) => [c.width, c.height])")
    assert len(sizes) == 17
    assert not set(whole.run(DRAWN)) & {whole.run(BLANK, *size) for size in sizes}
    assert whole.run("return [...document.images].every((i) => i.complete && i.naturalWidth === 480)")


@pytest.mark.parametrize("index", [0, 6, 14])
def test_zooming_one_panel_moves_the_others_and_zero_brings_all_back(whole, index):
    before, drawn = whole.run(RANGES), whole.run(DRAWN)
    assert all(view == pytest.approx([0, 20], abs=0.01) for view in before)
    drag_across(whole, index, 0.3, 0.5)
    zoomed = whole.run(RANGES)
    assert all(view == zoomed[index] for view in zoomed)
    assert 4 < zoomed[index][0] < 7 and 8 < zoomed[index][1] < 11
    whole.run("window.scrollTo(0, 0)")
    assert not any(now == then for now, then in zip(whole.run(DRAWN), drawn, strict=True))
    whole.press("0")
    assert whole.run(RANGES) == before
    whole.drag((1, 1), (2, 1))  # the pointer leaves the panels
    assert whole.run(DRAWN) == drawn
    assert whole.complaints() == []


def test_arrows_and_signs_move_and_zoom_all(whole):
    whole.press("+")
    closer = whole.run(RANGES)
    assert all(view == pytest.approx([4, 16], abs=0.01) for view in closer)
    whole.press("\ue014")  # right arrow
    assert all(view == pytest.approx([6.4, 18.4], abs=0.01) for view in whole.run(RANGES))


def test_cursor_reads_every_panel_at_once(whole):
    left, top, width, height = whole.run(SHOW, 0)
    whole.drag((round(left + width / 2), round(top + height / 2)), (round(left + width / 2), round(top + height / 2)))
    keys = whole.run("return [...document.querySelectorAll('.key')].map((k) => k.textContent)")
    assert all(any(digit in key for digit in "0123456789–") for key in keys if key != "feltseen")


def test_table_link_jumps_to_its_time(whole):
    whole.run("[...document.querySelectorAll('td a')].find((a) => a.textContent === '8.250 s').click()")
    whole.settle()
    assert all(view == pytest.approx([7.75, 8.75], abs=0.01) for view in whole.run(RANGES))


def test_hostile_names_stay_text(tmp_path, window):
    report(tmp_path / "r.html", **hostile_parts())
    window.open(tmp_path / "r.html")
    assert window.complaints() == []
    assert window.run("return window.hit === undefined && document.querySelectorAll('img[onerror]').length === 0")
    assert window.run("return document.querySelector('.panel b').textContent") == f"{HOSTILE}, rad"
    assert "<img src=x onerror=window.hit=1>" in window.run("return document.querySelector('h1').textContent")


def test_injected_script_does_not_run(tmp_path, window):
    text = report(tmp_path / "r.html")
    (tmp_path / "r.html").write_text(text.replace("</body>", "<script>window.hit = 1</script></body>"))
    window.open(tmp_path / "r.html")
    assert window.run("return window.hit === undefined")
    assert any("Content Security Policy" in reported for reported in window.complaints())
