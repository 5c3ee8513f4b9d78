"""E1, which senses are needed: exploration never moves the elbow; vision alone, with two encoders, with all, Kalman."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .lab import ELSEWHERE, Belief, Heard, Lab, kalman, ours, printed
from .records import Bound, Claim, Experiment, Table, Trial, column, judge, panel

SENSES = {
    "v": ("vision",),
    "p1+p3+v": ("shoulder_pan_joint", "elbow_joint", "vision"),
    "p+v": ("encoders", "vision"),
    "p": ("encoders",),
}
NAMES = ("shoulder 1", "shoulder 2", "elbow")
OFF = 0.15
"""rad: how far every joint's belief starts from the truth."""
SETTLED = 4.0
"""s: errors count from here."""
SWEEP = (5.0, 1.0, 0.3, 0.1, 0.03, 0.01)
"""σ_v tried in place of the printed 5, in squared image widths."""


def _run(lab: Lab, seed: int) -> Trial:
    heard = lab.heard("horizontal", seed + ELSEWHERE, duration=12.0, noise=0.02)
    own, paper = (lab.body(preset, seed, "horizontal") for preset in ("default", "paper"))
    start = tuple(float(v) for v in heard.true(own.joints, heard.truth.t[:1])[0] + OFF)
    beliefs = {("printed", name): printed(heard, paper, senses, start) for name, senses in SENSES.items()}
    beliefs |= {("ours", name): ours(heard, own, senses, start=start) for name, senses in SENSES.items()}
    beliefs |= {(side, "Kalman on p"): kalman(heard, own, start) for side in ("printed", "ours")}
    figures = {f"{side} {name}": belief.rmse(SETTLED) for (side, name), belief in beliefs.items()}
    figures |= {f"{side} elbow": _elbow(beliefs[side, "v"]) for side in ("printed", "ours")}
    figures["equilibrium p"] = printed(heard, paper, SENSES["p"], start, implicit=True).rmse(SETTLED)
    figures |= _sweep(heard, own, start)
    errors = [_panel(side, beliefs) for side in ("printed", "ours")]
    return {"figures": figures, "panels": [*errors, *(_angle(beliefs, i, name) for i, name in enumerate(NAMES))]}


def _elbow(belief: Belief) -> float:
    """Share of the elbow's first error that is still there at the end."""
    return float(abs(belief.error(belief.t[-1] - 1.0)[:, 2].mean()) / OFF)


def _sweep(heard: Heard, body: Any, start: tuple[float, ...]) -> dict[str, float]:
    """RMSE (rad) of Algorithm 1 on p1+p3+v with a learned body, by σ_v."""
    return {f"sigma {s:g}": printed(heard, body, SENSES["p1+p3+v"], start, s).rmse(SETTLED) for s in SWEEP}


def _panel(side: str, beliefs: dict[tuple[str, str], Belief]) -> dict[str, Any]:
    t = beliefs[side, "p"].t
    chosen = {name: belief for (of, name), belief in beliefs.items() if of == side}
    lines = {name: np.interp(t, b.t, np.abs(b.x - b.true).mean(axis=1)) for name, b in chosen.items()}
    return panel(f"{side}: mean absolute error", "rad", t, lines)


def _angle(beliefs: dict[tuple[str, str], Belief], i: int, name: str) -> dict[str, Any]:
    """One joint as in the paper: what is believed from everything and from vision alone, and the truth."""
    shown = {f"{side} {of}": beliefs[side, of] for side in ("printed", "ours") for of in ("p+v", "v")}
    reference = beliefs["printed", "p+v"]
    lines = {name: np.interp(reference.t, b.t, b.x[:, i]) for name, b in shown.items()}
    return panel(name, "rad", reference.t, lines | {"truth": reference.true[:, i]})


def _claims(trials: Sequence[Trial]) -> tuple[Claim, ...]:
    def ratio(side: str, more: str, less: str) -> list[float]:
        pairs = zip(column(trials, f"{side} {more}"), column(trials, f"{side} {less}"), strict=True)
        return [a / b for a, b in pairs]

    def both(text: str, more: str, less: str, bound: Bound, said: str = "") -> Claim:
        measured = f"error of {more} over error of {less}"
        return judge("E1", text, measured, "1", bound, (ratio("printed", more, less), ratio("ours", more, less)), said)

    def apart(side: str) -> list[float]:
        return [abs(found - 1.0) for found in ratio(side, "p", "Kalman on p")]

    alone = "vision alone cannot find an elbow that exploration did not move"
    same = "encoders alone: practically the Kalman filter"
    elbow = column(trials, "printed elbow"), column(trials, "ours elbow")
    stray = "above 1 the belief strays along what it cannot see; ours takes a joint that no encoder speaks of to be "
    stray += "about where it was explored, and here it is: remembered, not seen"
    alike = "in ours vision alone remembers the elbow better than its encoder reads it"
    distance = "how far the errors' ratio is from 1"
    return (
        both("two encoders with vision: less error than vision alone", "p1+p3+v", "v", Bound("≤", 1.0), alike),
        both("all encoders with vision: less error than two of them", "p+v", "p1+p3+v", Bound("≤", 1.0)),
        both("vision with encoders: less error than encoders alone", "p+v", "p", Bound("≤", 1.0), _range(trials)),
        judge("E1", alone, "share of the elbow's first error left", "1", Bound("≥", 0.8), elbow, stray),
        judge("E1", same, distance, "1", Bound("≤", 0.2), (apart("printed"), apart("ours")), _lag(trials)),
    )


def _lag(trials: Sequence[Trial]) -> str:
    names = ("printed p", "equilibrium p", "printed Kalman on p", "ours p")
    found = [float(np.median(column(trials, name))) for name in names]
    pairs = zip(column(trials, "equilibrium p"), column(trials, "printed Kalman on p"), strict=True)
    rested = float(np.median([abs(a / b - 1.0) for a, b in pairs]))
    return (
        "errors in rad: Algorithm 1 {:.3f}, with its prediction errors at their equilibrium {:.3f}, Kalman filter "
        "{:.3f}, ours {:.3f}; the constant is σ_p = 1 (s, the time the prediction errors take): with them at their "
        "equilibrium the ratio is {:.3f} from 1"
    ).format(*found, rested)


def _range(trials: Sequence[Trial]) -> str:
    found = ", ".join(f"{np.nanmedian(column(trials, f'sigma {s:g}')):.3f} at {s:g}" for s in SWEEP)
    return f"Algorithm 1 on p1+p3+v with a learned body, error in rad by σ_v (printed: 5): {found}"


def _tables(trials: Sequence[Trial]) -> tuple[Table, ...]:
    names = (*SENSES, "Kalman on p")
    rows = [
        (name, *(f"{np.nanmedian(column(trials, f'{side} {name}')):.4f}" for side in ("printed", "ours")))
        for name in names
    ]
    return (Table("Median error over the seeds, rad", ("senses", "printed model", "ours"), tuple(rows)),)


EXPERIMENT = Experiment("E1", "Which senses are needed", _run, _claims, _tables)
