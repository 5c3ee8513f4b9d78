"""docs/paper.md says where each figure and equation of the paper is, by number and by label."""

import re
from pathlib import Path

import pytest

from tests.defined_names import ROOT, list_defined_names

SOURCE = ROOT.parent / "shared" / "paper" / "lanillos2018.tex"
PAGE = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")
TABLE = PAGE.split("## The paper by number")[1].split("\n## ")[0]
ROWS = [
    [cell.strip() for cell in line.strip("|\n").split("|")] for line in TABLE.splitlines() if line.startswith("| ")
][1:]


@pytest.fixture(scope="module")
def source():
    if not SOURCE.is_file():
        pytest.skip("the paper's LaTeX (../shared/paper) is not at hand")
    return SOURCE.read_text(encoding="utf-8")


def test_paper_table_has_every_label(source):
    labels = {name for name in re.findall(r"\\label\{([^}]*)\}", source) if not name.startswith("sec:")}
    listed = {label for row in ROWS for label in re.findall(r"`([\w:]+)`", row[1])}
    assert len(labels) > 25 and listed == labels


def test_equations_have_the_numbers_latex_gives_them(source):
    """One number for every line of an equation or align that has no \\nonumber."""
    text = re.sub(r"(?<!\\)%.*", "", source)
    text = re.sub(r"\\begin\{array\}.*?\\end\{array\}", "", text, flags=re.DOTALL)
    counted, found = 0, {}
    for kind, body in re.findall(r"\\begin\{(equation|align)\}(.*?)\\end\{\1\}", text, re.DOTALL):
        lines = body.split(r"\\") if kind == "align" else [body]
        numbers = []
        for line in lines:
            if "\\nonumber" not in line:
                counted += 1
                numbers.append(counted)
        label = re.search(r"\\label\{([^}]*)\}", body)
        if label:
            found[label[1]] = numbers[-1]
    given = {
        label: int(row[0].split("(")[-1].rstrip(")")) for row in ROWS for label in re.findall(r"`(eq:\w+)`", row[1])
    }
    assert given == found
    everywhere = {int(n) for row in ROWS for n in re.findall(r"\((\d+)\)", row[0])}
    assert everywhere == set(range(1, counted + 1))


def test_figures_have_the_numbers_latex_gives_them(source):
    figures = re.findall(r"\\begin\{figure\*?\}.*?\\end\{figure\*?\}", source, re.DOTALL)
    found = {re.findall(r"\\label\{([^}]*)\}", body)[-1]: k for k, body in enumerate(figures, 1)}
    given = {
        label: int(re.match(r"Fig\. (\d)", row[0])[1]) for row in ROWS for label in re.findall(r"`(fig:\w+)`", row[1])
    }
    assert given == found


def test_paper_figures_with_data_are_redrawn():
    drawn = set()
    for path in (ROOT / "bodylog" / "experiments").glob("*.py"):
        drawn |= set(re.findall(r'"([3-6][a-d])"', path.read_text(encoding="utf-8")))
    assert drawn == {re.match(r"Fig\. (\w+)", row[0])[1] for row in ROWS if re.match(r"Fig\. [3-6]", row[0])}


@pytest.mark.parametrize(
    "place", sorted({pair for row in ROWS for pair in re.findall(r"`([\w/]+\.py)` `([\w.]+)`", row[3])})
)
def test_paper_page_names_existing_functions(place):
    file, name = place
    assert name in list_defined_names(ROOT / "bodylog" / Path(file))
