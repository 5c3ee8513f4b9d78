"""docs/method.md names the function behind every equation: each is there, and the reproduced table is complete."""

import ast
import re
from pathlib import Path

import pytest

from bodylog.experiments import EXPERIMENTS

ROOT = Path(__file__).parents[1]
METHOD = (ROOT / "docs" / "method.md").read_text()
EQUATIONS = METHOD.split("## From equation to function")[1].split("\n## ")[0]
ROWS = [line for line in EQUATIONS.splitlines() if line.startswith("|") and not re.match(r"\|\s*(equation|-)", line)]
NAMED = sorted({pair for row in ROWS for pair in re.findall(r"`([\w/]+\.py)` `([\w.]+)`", row)})


def _defined(path: Path) -> set[str]:
    """Functions and classes of a file, methods as Class.method."""
    found = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
            members = [one for one in node.body if isinstance(one, ast.FunctionDef)]
            found |= {f"{node.name}.{one.name}" for one in members} if isinstance(node, ast.ClassDef) else set()
    return found


@pytest.mark.parametrize("row", ROWS)
def test_every_equation_names_its_function(row):
    assert re.search(r"`[\w/]+\.py` `[\w.]+`", row)


@pytest.mark.parametrize(("file", "name"), NAMED)
def test_every_function_named_exists(file, name):
    assert name in _defined(ROOT / "bodylog" / file)


def test_the_reproduced_table_has_every_experiment_and_a_verdict_per_row():
    table = METHOD.split("<!-- claims -->")[1].split("\n\n")[0]
    rows = [line for line in table.splitlines() if re.match(r"\| [A-Z]", line)]
    judged = {row.split()[1] for row in rows if re.search(r"\*\*(confirmed|corrected|refuted)\*\*", row)}
    assert judged == set(EXPERIMENTS) - {"Errata"}, "Errata are a table of their own"
    assert len(rows) == table.count("**") / 2
