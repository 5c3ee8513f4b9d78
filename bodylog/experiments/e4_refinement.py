"""E4, refinement from a wrong prior: a still arm, whose first readings, where belief starts, are 0.1 to 0.2 rad off.

They come right after half a second; the hand's strokes begin at 3 s.
"""

from collections.abc import Sequence

import numpy as np

from ..types import BodyModel
from .beliefs import angles, mean_errors, noisier, ours, printed, shaped, typed
from .lab import Heard, Lab
from .records import SIDES, Bound, Claim, Experiment, Table, Trial, errors_table, judge, ratio, where

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
WIDTHS = (12.0, 25.0, 50.0, 100.0, 200.0)
"""px: widths of f_s tried, b_1 = 1/(2 width²)."""
NOISES = (0.0, 0.1, 0.3)
"""rad: noise added to encoders that have 0.02 of their own."""
POOR = 0.3
"""rad: with so much added, encoders leave something for touch to say."""


def _run(lab: Lab, seed: int) -> Trial:
    heard = lab.heard("biased-start", seed, duration=DURATION, variant="settling")
    own, paper = lab.body("default", seed, touched=True), lab.body("paper", seed)
    beliefs = {("printed", name): printed(heard, typed(paper), senses) for name, senses in SENSES.items()}
    beliefs |= {("ours", name): ours(heard, own, senses) for name, senses in SENSES.items()}
    figures = {f"{side} {name}": belief.rmse(SINCE) for (side, name), belief in beliefs.items()}
    figures |= {f"width {w:g} {name}": _shaped(heard, own, w, name) for w in WIDTHS for name in ("p+t", "p+v+t")}
    figures |= {f"learned {name}": printed(heard, own, SENSES[name]).rmse(SINCE) for name in ("p", "p+v")}
    for noise in NOISES:
        figures |= _noisy(noisier(heard, noise, seed), own, typed(paper), noise)
    panels = [*(mean_errors(beliefs, side) for side in SIDES), *angles(beliefs, ("p", "p+v+t"))]
    return {"figures": figures, "panels": panels}


def _shaped(heard: Heard, body: BodyModel, width: float, name: str) -> float:
    """Error (rad) of Algorithm 1 with a learned body and this width of f_s."""
    return printed(heard, shaped(body, width), SENSES[name]).rmse(SINCE)


def _noisy(heard: Heard, own: BodyModel, paper: BodyModel, noise: float) -> dict[str, float]:
    names = ("p", "p+t")
    found = {f"ours {name} {noise:g}": ours(heard, own, SENSES[name]).rmse(SINCE) for name in names}
    return found | {f"printed {name} {noise:g}": printed(heard, paper, SENSES[name]).rmse(SINCE) for name in names}


def _claims(trials: Sequence[Trial]) -> tuple[Claim, ...]:
    def claim(what: str, more: str, less: str, said: str) -> Claim:
        figures = ratio(trials, f"printed {more}", f"printed {less}"), ratio(trials, f"ours {more}", f"ours {less}")
        measured = f"error of {more.split()[0]} over error of {less.split()[0]}"
        return judge("E4", f"{what}, the prior being wrong", measured, "1", Bound("≤", WORTH), figures, said)

    beside = "ours: vision places the effector to tenths of a px, touch to some px: it adds where vision is silent"
    seen = f"{_widths(trials, 'p+v+t', 'p+v')}; {beside}"
    poor = f"touch adds accuracy to encoders with {POOR:g} rad of noise"
    return (
        claim("vision adds accuracy to encoders", "p+v", "p", ""),
        claim("touch adds accuracy to encoders and vision", "p+v+t", "p+v", seen),
        claim("touch adds accuracy to encoders alone", "p+t", "p", f"{_widths(trials, 'p+t', 'p')}; {_noises(trials)}"),
        claim(poor, f"p+t {POOR:g}", f"p {POOR:g}", _noises(trials)),
    )


def _widths(trials: Sequence[Trial], more: str, less: str) -> str:
    """For which width of f_s the printed form of touch helps."""
    found = {w: float(np.nanmedian(ratio(trials, f"width {w:g} {more}", f"learned {less}"))) for w in WIDTHS}
    told = ", ".join(f"{left:.3f} at {w:g} px" for w, left in found.items())
    holds = where((w for w, left in found.items() if left <= WORTH), " px")
    why = "the constants are a_1 = 0.001 and b_1 = 1; with a_1 = 1 and a learned body, by the width 1/√(2 b_1)"
    return f"{why}: {told}: {holds}; the strokes fall some cm beside the effector's own point"


def _noises(trials: Sequence[Trial]) -> str:
    found = {n: float(np.nanmedian(ratio(trials, f"ours p+t {n:g}", f"ours p {n:g}"))) for n in NOISES}
    told = ", ".join(f"{left:.3f} with {n:g} rad more" for n, left in found.items())
    return f"ours by the encoders' noise, 0.02 rad being their own: {told}"


def _tables(trials: Sequence[Trial]) -> tuple[Table, ...]:
    return (errors_table("Median error from 1 s on, rad", trials, SENSES),)


EXPERIMENT = Experiment("E4", "Refinement from a wrong prior", _run, _claims, _tables)
