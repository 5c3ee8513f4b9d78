import sys

import pytest

from bodylog.errors import UsageError
from bodylog.report.figures.canvas import open_figure, printable_label


@pytest.mark.parametrize("name", ["f.pdf", "f", "f.jpeg"])
def test_unknown_suffix_lists_the_known_and_writes_nothing(tmp_path, name):
    with pytest.raises(UsageError, match=r"f\.png or .*f\.svg"), open_figure(tmp_path / name, 2, 2):
        pytest.fail("drawn all the same")
    assert not list(tmp_path.iterdir())


def test_missing_matplotlib_gives_the_command_to_type(tmp_path, monkeypatch):
    for name in [*filter(lambda name: name.startswith("matplotlib"), sys.modules), "matplotlib"]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(UsageError, match=r"pip install 'bodylog\[report\]'"), open_figure(tmp_path / "f.png", 2, 2):
        pytest.fail("drawn all the same")


def test_failed_drawing_keeps_the_old_figure(tmp_path):
    (tmp_path / "f.svg").write_text("old")
    with pytest.raises(ZeroDivisionError), open_figure(tmp_path / "f.svg", 2, 2):
        raise ZeroDivisionError
    assert (tmp_path / "f.svg").read_text() == "old" and len(list(tmp_path.iterdir())) == 1


def test_canvas_neither_uses_nor_changes_user_settings(tmp_path):
    import matplotlib

    def draw(name):
        with open_figure(tmp_path / name, 2, 2) as drawing:
            drawing.add_subplot().plot([0, 1], [1, 0])
        return (tmp_path / name).read_bytes()

    plain = draw("plain.svg")
    with matplotlib.rc_context({"axes.facecolor": "pink", "font.size": 30}):
        assert draw("pink.svg") == plain
        assert matplotlib.rcParams["font.size"] == 30


def test_labels_are_one_printable_line_that_a_legend_shows():
    assert printable_label("_hidden") == " _hidden"
    assert printable_label("two\nlines\x1b[31m") == "two lines [31m"
    assert len(printable_label("x" * 1000)) == 40
