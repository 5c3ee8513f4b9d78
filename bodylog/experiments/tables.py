"""The page's tables: claims of the paper, our own,
comparisons and errata, and the readings they were judged in.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from html import escape

from .claims import DEPENDS, KEPT, REFUTED, UNTESTED, Claim, Outcome
from .readings import CONSTANTS
from .records import TextTable

KINDS = {
    "paper": "The paper's claims",
    "own": "Our own claims",
    "comparison": "Beside others' figures",
    "erratum": "Errata",
}
"""A table each, in this order."""
STATES = (KEPT, REFUTED, UNTESTED)
"""What readings do to a claim: a column each."""


def claim_tables(claims: Sequence[Claim]) -> str:
    """The claims as tables, one for each kind there is."""
    makers = {
        "paper": _paper_table,
        "own": _own_table,
        "comparison": _comparison_table,
        "erratum": _erratum_table,
    }
    parts = []
    for kind, title in KINDS.items():
        found = [claim for claim in claims if claim.kind == kind]
        if found:
            parts.append(makers[kind](title, found))
    return "\n".join(parts)


def _paper_table(title: str, claims: Sequence[Claim]) -> str:
    head = ("", "claim", "measured", "must be", *STATES, "at the first reading", "verdict")
    rows = [
        (
            *_claim_cells(claim),
            *_state_counts(claim),
            _first_outcome_text(claim),
            _verdict_text(claim),
        )
        for claim in claims
    ]
    return _html_cells_table(title, head, rows)


def _own_table(title: str, claims: Sequence[Claim]) -> str:
    head = ("", "claim", "measured", "must be", "ours", *STATES, "verdict")
    rows = [
        (
            *_claim_cells(claim),
            _first_outcome_text(claim),
            *_state_counts(claim),
            _verdict_text(claim),
        )
        for claim in claims
    ]
    return _html_cells_table(title, head, rows)


def _comparison_table(title: str, claims: Sequence[Claim]) -> str:
    head = ("", "claim", "measured", "must be", "figures", "same", "different", *STATES, "verdict")
    rows = [
        (
            escape(claim.id),
            _claim_text(claim),
            _measured_text(claim),
            escape(claim.bound),
            _all_outcomes_text(claim),
            escape(claim.shared),
            escape(claim.differences),
            *_state_counts(claim),
            _verdict_text(claim),
        )
        for claim in claims
    ]
    return _html_cells_table(title, head, rows)


def _erratum_table(title: str, claims: Sequence[Claim]) -> str:
    head = ("", "printed", "measured", "must be", "figures", "derivation")
    rows = [
        (
            *_claim_cells(replace(claim, explanation="")),
            _all_outcomes_text(claim),
            escape(claim.explanation),
        )
        for claim in claims
    ]
    return _html_cells_table(title, head, rows)


def readings_table() -> str:
    """Every open constant: the paper's words, where, its readings, the centre and why."""
    head = ("constant", "name", "printed", "where", "readings, the centre first", "why the centre")
    rows = []
    for name, constant in CONSTANTS.items():
        meanings = "<br>".join(
            f"<b>{escape(v)}</b>: {escape(text)}" for v, text in constant.values.items()
        )
        words = (constant.symbol, name, constant.printed, constant.place)
        rows.append((*map(escape, words), meanings, escape(constant.why)))
    return _html_cells_table("What the paper leaves open", head, rows)


def outcomes_table(claim: Claim) -> str:
    """Each reading's and swept number's outcome of one claim."""
    rows = [(escape(key), *_outcome_cells(one)) for key, one in claim.outcomes.items()]
    for name, swept in claim.sweeps.items():
        rows += [
            (
                f"{CONSTANTS[name].symbol} = {number:g} ({escape(CONSTANTS[name].unit)})",
                *_outcome_cells(one),
            )
            for number, one in swept
        ]
    head = (
        "reading",
        "median",
        "95 % interval",
        "seeds that test it",
        "seeds that keep it",
        "",
        "why",
    )
    return _html_cells_table(
        f"{escape(claim.id)}: {escape(claim.measured)}, must be {escape(claim.bound)}", head, rows
    )


def plain_table(table: TextTable) -> str:
    """A table of an experiment."""
    return _html_cells_table(
        escape(table.caption),
        tuple(map(escape, table.head)),
        [tuple(map(escape, row)) for row in table.rows],
    )


def _outcome_cells(one: Outcome) -> tuple[str, ...]:
    low, high = one.interval
    return (
        f"{one.median:.3g}",
        f"{low:.3g} to {high:.3g}",
        str(one.tested_seeds),
        str(one.kept_seeds),
        one.state,
        escape(one.reason),
    )


def _claim_cells(claim: Claim) -> tuple[str, ...]:
    return escape(claim.id), _claim_text(claim), _measured_text(claim), escape(claim.bound)


def _claim_text(claim: Claim) -> str:
    soft = [claim.explanation, *(f"control: {control}" for control in claim.controls)]
    return escape(claim.text) + "".join(
        f'<br><span class="soft">{escape(line)}</span>' for line in soft if line
    )


def _measured_text(claim: Claim) -> str:
    return escape(claim.measured if claim.unit in ("1", "") else f"{claim.measured}, {claim.unit}")


def _state_counts(claim: Claim) -> tuple[str, ...]:
    """The three counts, in the order of STATES."""
    return str(claim.counts.kept), str(claim.counts.refuted), str(claim.counts.untested)


def _first_outcome_text(claim: Claim) -> str:
    return _outcome_figure_text(next(iter(claim.outcomes.values()))) if claim.outcomes else ""


def _all_outcomes_text(claim: Claim) -> str:
    return "<br>".join(
        f"{escape(who)}: {_outcome_figure_text(one)}" for who, one in claim.outcomes.items()
    )


def _outcome_figure_text(one: Outcome) -> str:
    low, high = one.interval
    return f'{one.median:.3g} <span class="soft">({low:.3g} to {high:.3g})</span>'


def _verdict_text(claim: Claim) -> str:
    soft = [line for line in (claim.turns, *claim.reasons) if line]
    return f"<b>{escape(claim.verdict)}</b>" + "".join(
        f'<br><span class="soft">{escape(line)}</span>' for line in soft
    )


def _html_cells_table(caption: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of cells that are HTML already."""

    def row(tag: str, cells: Sequence[str]) -> str:
        return f"<tr>{''.join(f'<{tag}>{cell}</{tag}>' for cell in cells)}</tr>"

    return f"<table><caption>{caption}</caption>{row('th', head)}{''.join(row('td', cells) for cells in rows)}</table>"


def count_paper_verdicts(claims: Sequence[Claim]) -> Mapping[str, int]:
    """How many of the paper's claims have which kind of verdict."""
    found: dict[str, int] = {}
    for claim in claims:
        if claim.kind == "paper":
            verdict = "depends on a reading" if claim.verdict.startswith(DEPENDS) else claim.verdict
            found[verdict] = found.get(verdict, 0) + 1
    return found
