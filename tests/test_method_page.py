"""docs/method.md names the function behind every equation, and docs/paper.md has the whole reproduced table."""

import re

import pytest

from bodylog.experiments import EXPERIMENTS
from tests.defined_names import ROOT, list_defined_names

METHOD = (ROOT / "docs" / "method.md").read_text()
PAPER = (ROOT / "docs" / "paper.md").read_text()
EQUATIONS = METHOD.split("## From equation to function")[1]
ROWS = [line for line in EQUATIONS.splitlines() if re.match(r"\|(?!\s*(equation|what is|-))", line)]
NAMED = sorted({pair for row in ROWS for pair in re.findall(r"`([\w/]+\.py)` `([\w.]+)`", row)})


@pytest.mark.parametrize("row", ROWS)
def test_equations_name_their_functions(row):
    assert re.search(r"`[\w/]+\.py` `[\w.]+`", row)


@pytest.mark.parametrize(("file", "name"), NAMED)
def test_method_page_names_existing_functions(file, name):
    assert name in list_defined_names(ROOT / "bodylog" / file)


VERDICTS = "kept|refuted|not tested|depends on [^*]+|not testable here|holds|does not hold"
PREFIXES = {"Rubber-hand": "RH", "Baselines": "B"}
"""How the claims of an experiment begin where not by its name."""


def test_paper_page_has_a_verdict_per_row():
    tables = PAPER.split("<!-- claims -->")[1].split("<!-- end of claims -->")[0]
    tables = re.sub(r"\*\*Readings that do not keep a claim\*\*.*?(?=\n\*\*)", "", tables, flags=re.DOTALL)
    rows = [line for line in tables.splitlines() if re.match(r"\| \w+\.\d", line)]
    judged = {row.split()[1].partition(".")[0] for row in rows if re.search(rf"\*\*({VERDICTS})\*\*", row)}
    named = {PREFIXES.get(name, name) for name in EXPERIMENTS} - {"Errata", "Real"}
    assert judged == named, "Errata and real robots are tables of their own"
    assert all(re.search(rf"\*\*({VERDICTS})\*\*", row) for row in rows)


def test_dependent_claims_give_their_turning_points():
    rows = [line for line in PAPER.splitlines() if line.startswith("| E") and "**depends on" in line]
    assert rows and all(len(row.split("|")[-2].strip()) > 5 for row in rows)


def test_paper_page_lists_the_available_readings():
    from docs.generate_claims import readings

    assert PAPER.split("<!-- readings -->\n")[1].split("<!-- end of readings -->")[0] == readings()
