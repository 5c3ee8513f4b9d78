"""The page: self-contained, escaped, and without times that differ from run to run."""

import csv
import json
import re

from bodylog.experiments import tables
from bodylog.experiments.claims import Bound
from bodylog.experiments.judging import (
    judge_comparison,
    judge_erratum,
    judge_own_claim,
    judge_paper_claim,
    judge_variants,
)
from bodylog.experiments.readings import CONSTANTS


def test_page_needs_no_network(small):
    wish, claims, _ = small
    html = (wish.out / "index.html").read_text()
    assert not re.search(r"(?:src|href)=\"(?!data:)", html) and not re.search(
        r"(https?:)?//[a-z]", _words(html)
    )
    assert html.count("data:image/png;base64,") == 1 and html.count('class="panels"') == 1
    assert len(html.encode()) < 3_000_000
    assert all(claim.text in html for claim in claims)
    kept = json.loads((wish.out / "claims.json").read_text())
    assert [claim["verdict"] for claim in kept] == [claim.verdict for claim in claims]


def _words(html):
    """The page without what is in base64 and without its script's comments."""
    return re.sub(r'base64,[^"]*|"[A-Za-z0-9+/=]{40,}"|^// .*$', "", html, flags=re.MULTILINE)


def test_claims_name_reading_bound_figure_and_interval(small):
    wish, _, _ = small
    for claim in json.loads((wish.out / "claims.json").read_text()):
        assert {"id", "kind", "bound", "unit", "outcomes"} <= set(claim)
        for reading, found in claim["outcomes"].items():
            assert (
                reading in ("speed=4", "default")
                and len(found["interval"]) == 2
                and found["figures"]
            )
            assert found["interval"][0] <= found["median"] <= found["interval"][1]


def test_page_lists_open_constants_with_their_readings(small):
    wish, _, _ = small
    html = (wish.out / "index.html").read_text()
    assert all(f"<td>{name}</td>" in html for name in CONSTANTS)


def test_page_has_tables_of_its_figures_numbers(small):
    wish, _, _ = small
    with open(wish.out / "data" / "E2.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["figure"] for row in rows} == {"5a"} and {"truth", "printed"} <= {
        row["line"] for row in rows
    }
    assert all(float(row["at"]) >= 0 for row in rows)
    with open(wish.out / "data" / "figures.csv", encoding="utf-8", newline="") as file:
        found = {(row["reading"], row["figure"]) for row in csv.DictReader(file)}
    assert {("speed=4", "converged"), ("", "ours vision")} <= found
    with open(wish.out / "data" / "outcomes.csv", encoding="utf-8", newline="") as file:
        assert {row["state"] for row in csv.DictReader(file)} <= {"kept", "refuted", "not tested"}


HOSTILE = "<script>alert(1)</script>"
LOW = {HOSTILE: [0.0]}


def test_whatever_a_claim_says_stays_text():
    bound = Bound("≤", 1.0)
    cells = (HOSTILE, HOSTILE, HOSTILE, HOSTILE, bound)
    claims = [judge_own_claim(*cells, [0.0], HOSTILE), judge_comparison(*cells, LOW, HOSTILE, HOSTILE),
              judge_erratum(*cells, LOW, HOSTILE), judge_variants(*cells, {"a": [2.0], HOSTILE: [0.0]}, HOSTILE, HOSTILE),
              judge_paper_claim(*cells, HOSTILE, lambda key, name: (0.0,), ["centre"], explanation=HOSTILE)]  # fmt: skip
    assert "<script" not in tables.claim_tables(claims)
    assert "<script" not in "".join(map(tables.outcomes_table, claims))


def test_page_has_the_three_counts_and_the_reasons():
    figures = {"centre": 0.0, "sigma_v=widths": 2.0, "sigma_v=pixels": float("nan")}
    claim = judge_paper_claim(
        "E0.1",
        "text",
        "what",
        "1",
        Bound("≤", 1.0),
        "it",
        lambda key, name: (figures[key],),
        list(figures),
    )
    table = tables.claim_tables([claim])
    assert "<th>kept</th><th>refuted</th><th>not tested</th>" in table
    assert (
        "<td>1</td><td>1</td><td>1</td>" in table and "the model diverged, in 1 of 1 seeds" in table
    )
