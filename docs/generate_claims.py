"""Write the reproduced table of docs/method.md from what reproduce left in a folder (the argument)."""

import json
import sys
from pathlib import Path
from typing import Any

PAGE = Path(__file__).parent / "method.md"
MARK = "<!-- claims -->\n"
HEAD = "| | claim | must be | printed model | ours | verdict |\n|---|---|---|---|---|---|\n"
APART = ("Errata",)
"""Experiments the page has a table of its own for."""


def table(claims: list[dict[str, Any]]) -> str:
    """The claims as rows, numbered within their experiment."""
    counts: dict[str, int] = {}
    rows = []
    for claim in claims:
        name = claim["experiment"]
        counts[name] = counts.get(name, 0) + 1
        if name not in APART:
            rows.append(_row(f"{name} {counts[name]}", claim))
    return HEAD + "\n".join(rows) + "\n"


def _row(number: str, claim: dict[str, Any]) -> str:
    unit = "" if claim["unit"] == "1" else f", {claim['unit']}"
    said = f"{claim['text']}: {claim['measured']}{unit}"
    figures = (_spread(claim, side) for side in ("printed", "ours"))
    return f"| {number} | {said} | {claim['bound']} | {' | '.join(figures)} | **{claim['verdict']}** |"


def _spread(claim: dict[str, Any], side: str) -> str:
    if side not in claim["spread"]:
        return "see `cost.json`"
    middle, least, most = (float("nan") if figure is None else figure for figure in claim["spread"][side])
    return f"{middle:.3g} ({least:.3g} to {most:.3g})"


if __name__ == "__main__":
    before, after = PAGE.read_text(encoding="utf-8").split(MARK)
    found = json.loads((Path(sys.argv[1]) / "claims.json").read_text(encoding="utf-8"))
    PAGE.write_text(before + MARK + table(found) + "\n" + after.split("\n\n", 1)[1], encoding="utf-8")
