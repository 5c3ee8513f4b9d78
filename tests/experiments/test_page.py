"""The page: self-contained, escaped, and without times that differ from run to run."""

import json
import re

from bodylog.experiments import page
from bodylog.experiments.records import Bound, judge


def test_the_page_needs_nothing_from_outside(small):
    wish, claims, _ = small
    html = (wish.out / "index.html").read_text()
    assert not re.search(r"(?:src|href)=\"(?!data:)", html) and not re.search(r"(https?:)?//[a-z]", _words(html))
    assert html.count("data:image/png;base64,") == 1 and html.count('class="panels"') == 1
    assert len(html.encode()) < 3_000_000
    assert all(claim.text in html for claim in claims)
    kept = json.loads((wish.out / "claims.json").read_text())
    assert [claim["verdict"] for claim in kept] == [claim.verdict for claim in claims]


def _words(html):
    """The page without what is in base64 and without its script's comments."""
    return re.sub(r'base64,[^"]*|"[A-Za-z0-9+/=]{40,}"|^// .*$', "", html, flags=re.MULTILINE)


def test_whatever_a_claim_says_stays_text():
    hostile = "<script>alert(1)</script>"
    claim = judge("E0", hostile, hostile, hostile, Bound("≤", 1.0), ([0.0], [0.0]), hostile)
    assert "<script" not in page.claim_table([claim])


def test_times_are_not_on_the_page():
    claim = judge("E6", "text", "what", "1", Bound("≤", 1.0), ([0.123456], [0.123456]))
    table = page.claim_table([page.withheld(claim)])
    assert "0.123" not in table and "cost.json" in table and "confirmed" in table
