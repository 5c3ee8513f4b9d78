"""Write the tables of the pages on the paper from what
reproduce left in a folder (the argument), and the readings.

Rows of experiments that were not run there stay as they are.
"""

import csv
import json
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from bodylog.experiments.baselines import ROWS
from bodylog.experiments.judging import median_interval
from bodylog.experiments.readings import CONSTANTS

DOCS = Path(__file__).parent
PAGE = DOCS / "paper.md"
CLAIMS = ("<!-- claims -->\n", "<!-- end of claims -->\n")
READINGS = ("<!-- readings -->\n", "<!-- end of readings -->\n")
ERRATA = ("<!-- errata -->\n", "<!-- end of errata -->\n")
DRIFT = ("<!-- drift -->\n", "<!-- end of drift -->\n")
BASELINES = ("<!-- baselines -->\n", "<!-- end of baselines -->\n")
OWN_COLUMNS = 5
OTHER_COLUMNS = 7
"""Columns of the tables of our own claims and of comparisons."""
SEEDS = "Seeds by experiment: "
PIXELAI_SEEDS = 10
"""Seeds that its documented run has."""
Row = Mapping[str, Any]


def readings() -> str:
    """What the paper leaves open."""
    rows = [
        (
            constant.symbol,
            f"`{name}`",
            constant.printed,
            constant.place,
            _values(constant.values),
            constant.why,
        )
        for name, constant in CONSTANTS.items()
    ]
    return table(("", "name", "printed", "where", "readings", "why the first is the centre"), rows)


def _values(values: Mapping[str, str]) -> str:
    return "; ".join(f"`{name}`: {text}" for name, text in values.items())


def claims(found: Sequence[Row], page: str) -> str:
    """Three tables: the paper's claims, our own, and
    comparisons; rows of other experiments as on the `page`.
    """
    run = {claim["id"].partition(".")[0] for claim in found}
    old = [
        line
        for line in page.splitlines(keepends=True)
        if (name := _experiment(line)) and name not in run
    ]
    own_rows, other_rows = (
        "".join(line for line in old if (line.count(" | ") == columns - 1))
        for columns in (OWN_COLUMNS, OTHER_COLUMNS)
    )
    kinds = {
        kind: [claim for claim in found if claim["kind"] == kind]
        for kind in ("paper", "own", "comparison")
    }
    head = (
        "",
        "claim",
        "must be",
        "at the centre",
        "kept",
        "refuted",
        "not tested",
        "verdict",
        "turns",
    )
    parts = [
        "**The paper's claims**\n\n" + table(head, [_paper(claim) for claim in kinds["paper"]])
    ]
    parts.append(
        "**Readings that do not keep a claim**\n\n" + table(("", "why"), _reasons(kinds["paper"]))
    )
    own = [
        (c["id"], _wording(c), c["bound"], _first(c), f"**{c['verdict']}**") for c in kinds["own"]
    ]
    owned = table(("", "claim", "must be", "found", "verdict"), own) + own_rows
    parts.append("**Our own claims**, of our default\n\n" + owned)
    head = ("", "claim", "must be", "figures", "same", "different", "verdict")
    others = [_comparison(claim) for claim in kinds["comparison"]]
    return "\n".join([*parts, "**Beside others' figures**\n\n" + table(head, others) + other_rows])


def _experiment(line: str) -> str:
    """The experiment of a claim's row, or nothing."""
    row = re.match(r"\| (\w+)\.\d+ \|", line)
    return row[1] if row else ""


def seeds(found: Sequence[Row], page: str) -> str:
    """How many seeds each experiment's figures are of;
    PixelAI's, one per joint, are means over ten seeds.
    """
    counts = {
        name: int(count)
        for count, names in re.findall(r"(\d+) \(([\w, ]+)\)[;.]? ", page.split(SEEDS)[-1])
        for name in names.split(", ")
    }
    for claim in found:
        for one in claim["outcomes"].values():
            name = claim["id"].partition(".")[0]
            counts[name] = len(one["figures"])
    by: dict[int, list[str]] = {}
    for name, count in counts.items():
        if name not in ("E6", "PixelAI"):
            by.setdefault(count, []).append(name)
    listed = "; ".join(
        f"{count} ({', '.join(names)})" for count, names in sorted(by.items(), reverse=True)
    )
    return (
        f"{SEEDS}{listed}; PixelAI's figures are one per joint, means over {PIXELAI_SEEDS} seeds "
        "and all starts.\n"
    )


def errata(found: Sequence[Row]) -> str:
    """The errata that have figures, as rows."""
    rows = [_erratum(claim) for claim in found if claim["kind"] == "erratum"]
    return table(("printed", "derivation", "as printed", "as run here"), rows)


def _erratum(claim: Row) -> tuple[str, ...]:
    unit = "" if claim["unit"] == "1" else f" {claim['unit']}"
    printed, run = (
        (f"{who}: " if "as " not in who else "") + _figure(one) + unit
        for who, one in claim["outcomes"].items()
    )
    return claim["text"], claim["explanation"], f"{claim['measured']}: {printed}", run


def _paper(claim: Row) -> tuple[str, ...]:
    outcomes = claim["outcomes"]
    counts = claim["counts"]
    numbers = tuple(
        str(counts[state]) if outcomes else "" for state in ("kept", "refuted", "untested")
    )
    control = f" (control: {'; '.join(claim['controls'])})" if claim["controls"] else ""
    text = claim["text"] + (
        f": {claim['explanation']}" if not outcomes else f": {_measured(claim)}{control}"
    )
    return (
        claim["id"],
        text,
        claim["bound"],
        _first(claim),
        *numbers,
        f"**{claim['verdict']}**",
        claim["turns"],
    )


def _reasons(found: Sequence[Row]) -> list[tuple[str, str]]:
    """A row for each claim that some reading refutes or does not test."""
    return [
        (claim["id"], "; ".join(claim["reasons"]))
        for claim in found
        if claim["outcomes"] and claim["reasons"]
    ]


def _comparison(claim: Row) -> tuple[str, ...]:
    figures = "; ".join(f"{who}: {_figure(one)}" for who, one in claim["outcomes"].items())
    return (
        claim["id"],
        _wording(claim),
        claim["bound"],
        figures,
        claim["shared"],
        claim["differences"],
        f"**{claim['verdict']}**",
    )


def _wording(claim: Row) -> str:
    return f"{claim['text']}: {_measured(claim)}"


def _measured(claim: Row) -> str:
    return claim["measured"] + ("" if claim["unit"] == "1" else f", {claim['unit']}")


def _first(claim: Row) -> str:
    """The centre's, or that of the only reading."""
    found = claim["outcomes"]
    return _figure(found.get("centre") or next(iter(found.values()))) if found else ""


def _figure(one: Row) -> str:
    if one["median"] is None:
        return "diverged"
    median, low, high = (float(number) for number in (one["median"], *one["interval"]))
    return f"{median:.3g} ({low:.3g} to {high:.3g})"


def figures(folder: Path, experiment: str) -> dict[str, list[float]]:
    """Every figure of an experiment, a value for each seed."""
    found: dict[str, list[float]] = {}
    with (folder / "data" / "figures.csv").open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            if row["experiment"] == experiment:
                found.setdefault(row["figure"], []).append(float(row["value"] or "nan"))
    return found


def drift(found: Mapping[str, Sequence[float]]) -> str:
    """The rubber hand's drift by what was swept, a table each."""
    count = len(next(iter(found.values())))
    units = {
        "asynchrony": "late by, s",
        "displacement": "aside by, in 16 cm",
        "noise": "noise on the encoders, rad",
    }
    parts = [
        f"Medians over {count} seeds, a hand on the right; in brackets the interval of the "
        "median.\n"
    ]
    for what, unit in units.items():
        names = sorted(
            (n for n in found if n.startswith(f"{what} ") and n.endswith(" right")),
            key=lambda n: float(n.split()[-2]),
        )
        rows = [
            (n.split()[-2], *(_spread(found[f"{n}{kind}"]) for kind in ("", " px", " cm", " rad")))
            for n in names
        ]
        parts.append(
            table(
                (unit, "share of the displacement", "px", "cm", "largest move of a joint, rad"),
                rows,
            )
        )
    parts.append(both_curves(found))
    return "\n".join(parts)


def both_curves(found: Mapping[str, Sequence[float]]) -> str:
    """Drift over displacement, cm: a common cause taken for granted, and inferred."""
    names = sorted(
        (n for n in found if re.fullmatch(r"displacement \S+ right", n)),
        key=lambda n: float(n.split()[1]),
    )
    rows = []
    for name in names:
        aside = median(found[f"{name} cm"]) / median(found[name])
        rows.append(
            (f"{aside:.3g}", *(_spread(found[f"{kind}{name} cm"]) for kind in ("", "inferred ")))
        )
    return table(
        (
            "aside by, cm",
            "drift, cm: common cause taken for granted",
            "drift, cm: inferred, prior 0.5",
        ),
        rows,
    )


def baselines(found: Mapping[str, Sequence[float]]) -> str:
    """The error of every method over the logs, and of the oracle."""
    rows = [(name, _spread(found[name])) for name in ROWS]
    count = len(found["filter"])
    return table(
        (
            f"error over three joints, {count} reaches of 20 s",
            "rad: median (95 % interval of the median)",
        ),
        rows,
    )


def _spread(values: Sequence[float]) -> str:
    low, high = median_interval(values)
    digits = ".3g" if abs(median(values)) >= 0.0005 else ".1g"
    return f"{median(values):{digits}} ({low:{digits}} to {high:{digits}})"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Rows of text as Markdown."""
    return _line(head) + "|" + "---|" * len(head) + "\n" + "".join(map(_line, rows))


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"


def between(text: str, marks: tuple[str, str], part: str) -> str:
    """The text with `part` between two marks."""
    before, rest = text.split(marks[0])
    return before + marks[0] + part + marks[1] + rest.split(marks[1])[1]


if __name__ == "__main__":
    out = Path(sys.argv[1])
    judged = json.loads((out / "claims.json").read_text(encoding="utf-8"))
    page = PAGE.read_text(encoding="utf-8")
    old = page.split(CLAIMS[0])[1].split(CLAIMS[1])[0]
    parts = {PAGE: {READINGS: readings()}}
    if missing := {"paper", "erratum"} - {claim["kind"] for claim in judged}:
        print(f"{out}: no claims of the kind {', '.join(sorted(missing))}; the tables of claims stay")
    else:
        parts[PAGE] |= {
            CLAIMS: claims(judged, old) + "\n" + seeds(judged, old),
            ERRATA: errata(judged),
        }
    if rubber := figures(out, "Rubber-hand"):
        parts[DOCS / "rubber-hand.md"] = {DRIFT: drift(rubber)}
    if baseline := figures(out, "Baselines"):
        parts[PAGE][BASELINES] = baselines(baseline)
    for path, marked in parts.items():
        text = path.read_text(encoding="utf-8")
        for marks, part in marked.items():
            text = between(text, marks, part)
        path.write_text(text, encoding="utf-8")
