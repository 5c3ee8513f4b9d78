"""E4, refinement from a wrong prior: a still arm, whose first readings, where belief starts, are 0.1 to 0.2 rad off.

They come right after half a second; the hand's strokes begin at 3 s.
"""

from collections.abc import Sequence

import numpy as np

from .lab import Lab, ours, printed, typed
from .records import Bound, Claim, Experiment, Table, Trial, column, judge, panel

SENSES = {
    "p": ("encoders",),
    "p+t": ("encoders", "touch"),
    "p+v": ("encoders", "vision"),
    "p+v+t": ("encoders", "vision", "touch"),
}
WORTH = 0.99
"""A sense adds accuracy when it takes off at least a hundredth of the error."""
DURATION, SINCE = 16.0, 1.0
"""s: how long, and from when on errors count."""


def _run(lab: Lab, seed: int) -> Trial:
    heard = lab.heard("biased-start", seed, duration=DURATION, variant="settling")
    own, paper = lab.body("default", seed), lab.body("paper", seed)
    beliefs = {("printed", name): printed(heard, typed(paper), senses) for name, senses in SENSES.items()}
    beliefs |= {("fitted", name): printed(heard, own, senses) for name, senses in SENSES.items()}
    beliefs |= {("ours", name): ours(heard, own, senses) for name, senses in SENSES.items()}
    figures = {f"{side} {name}": belief.rmse(SINCE) for (side, name), belief in beliefs.items()}
    panels = []
    for side in ("printed", "ours"):
        t = beliefs[side, "p"].t
        shown = {name: b for (of, name), b in beliefs.items() if of == side}
        lines = {name: np.interp(t, b.t, np.abs(b.x - b.true).mean(axis=1)) for name, b in shown.items()}
        panels.append(panel(f"{side}: mean absolute error", "rad", t, lines))
    return {"figures": figures, "panels": panels}


def _claims(trials: Sequence[Trial]) -> tuple[Claim, ...]:
    def ratio(side: str, more: str, less: str) -> list[float]:
        pairs = zip(column(trials, f"{side} {more}"), column(trials, f"{side} {less}"), strict=True)
        return [a / b for a, b in pairs]

    def said(more: str, less: str) -> str:
        found = np.nanmedian(ratio("fitted", more, less))
        told = f"Algorithm 1 with a body and touch constants that are learned instead of printed: {found:.3f}"
        return f"{told}; the strokes fall some cm beside the effector's own point" if "t" in more else told

    def claim(what: str, more: str, less: str) -> Claim:
        figures = ratio("printed", more, less), ratio("ours", more, less)
        text, measured = f"{what}, the prior being wrong", f"error of {more} over error of {less}"
        return judge("E4", text, measured, "1", Bound("≤", WORTH), figures, said(more, less))

    return (
        claim("vision adds accuracy to encoders", "p+v", "p"),
        claim("touch adds accuracy to encoders and vision", "p+v+t", "p+v"),
        claim("touch adds accuracy to encoders alone", "p+t", "p"),
    )


def _tables(trials: Sequence[Trial]) -> tuple[Table, ...]:
    rows = [
        (name, *(f"{np.nanmedian(column(trials, f'{side} {name}')):.4f}" for side in ("printed", "fitted", "ours")))
        for name in SENSES
    ]
    head = ("senses", "printed model", "printed model, learned body", "ours")
    return (Table("Median error from 1 s on, rad", head, tuple(rows)),)


EXPERIMENT = Experiment("E4", "Refinement from a wrong prior", _run, _claims, _tables)
