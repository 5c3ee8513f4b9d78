"""E5, the rubber hand: the arm is hidden and stroked, the picture shows a hand stroking another place."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..estimation.measurements.touch import LEAST
from ..types import Array, BodyModel
from .beliefs import Belief, noisier, ours, printed, shaped, typed
from .lab import Heard, Lab
from .records import Bound, Claim, Experiment, Table, Trial, column, judge, medians, panel

DURATION, CALM = 20.0, 5.0
"""s: how long, and how long nothing touches."""
RHYTHMS, SIDES = ("synchronous", "asynchronous"), {"left": -1.0, "right": 1.0}
PLACES = {**SIDES, "centre": 1.0}
"""Where the hand is seen, and the sign of a drift toward it; at the centre it is where it is felt."""
TOUCHED, HIDDEN = ("encoders", "touch"), ("encoders",)
FAINT = 0.001
"""px: no drift is taken to be less."""
WIDTHS = (12.0, 25.0, 50.0, 100.0)
"""px: widths of f_s tried, b_1 = 1/(2 width²)."""
NOISES = (0.03, 0.1, 0.3)
"""rad: noise added to the encoders, which have 0.01 of their own."""


def _run(lab: Lab, seed: int) -> Trial:
    own, paper = lab.body("default", seed, touched=True), lab.body("paper", seed)
    figures: dict[str, float] = {}
    lines: dict[str, dict[str, Array]] = {"printed": {}, "ours": {}}
    for rhythm in RHYTHMS:
        for place, sign in PLACES.items():
            heard = lab.heard("rubber-hand", seed, duration=DURATION, variant=rhythm, place=place)
            figures[f"{rhythm} {place} weight"] = float(np.mean([pair.weight for pair in heard.features.synchrony]))
            drifts = {"printed": _literal(heard, typed(paper)), "ours": _likely(heard, own)}
            for of, (t, drift) in drifts.items():
                figures[f"{of} {rhythm} {place}"] = sign * final(t, drift)
                lines[of][f"{rhythm} {place}"] = np.interp(drifts["printed"][0], t, drift)
            if place in SIDES:
                figures |= {
                    f"width {w:g} {rhythm} {place}": sign * final(*_literal(heard, shaped(own, w))) for w in WIDTHS
                }
    figures |= _noisy(lab, own, seed)
    t = drifts["printed"][0]
    return {"figures": figures, "panels": [panel(f"{of}: drift of the effector", "px", t, lines[of]) for of in lines]}


def _noisy(lab: Lab, body: BodyModel, seed: int) -> dict[str, float]:
    """Our drift (px) toward a hand on the right in time with the skin, by the noise added to the encoders."""
    heard = lab.heard("rubber-hand", seed, duration=DURATION, variant="synchronous", place="right")
    return {f"noise {s:g}": final(*_likely(noisier(heard, s, seed), body)) for s in NOISES}


def _literal(heard: Heard, body: BodyModel) -> tuple[Array, Array]:
    return _drift(printed(heard, body, _senses(heard)), printed(heard, body, HIDDEN), body)


def _likely(heard: Heard, body: BodyModel) -> tuple[Array, Array]:
    return _drift(ours(heard, body, _senses(heard)), ours(heard, body, HIDDEN), body)


def _senses(heard: Heard) -> tuple[str, ...]:
    """With touch, unless no touch counts: the estimate refuses to be asked for a sense that has nothing to say."""
    return TOUCHED if any(pair.weight > LEAST for pair in heard.features.synchrony) else HIDDEN


def _drift(touched: Belief, alone: Belief, body: BodyModel) -> tuple[Array, Array]:
    """How far touch moves the believed effector sideways: t (N,) s and u with touch minus u without (N,) px."""
    model = body.senses["effector"]
    return touched.t, model.predict(touched.x)[0][:, 0] - model.predict(alone.x)[0][:, 0]


def final(t: Array, drift: Array) -> float:
    """The drift (px) of greatest size after the calm."""
    late = drift[t >= CALM]
    return float(late[np.abs(late).argmax()])


def _claims(trials: Sequence[Trial]) -> tuple[Claim, ...]:
    weights = {rhythm: _mean(trials, [f"{rhythm} {side} weight" for side in SIDES]) for rhythm in RHYTHMS}
    least = _least(trials, "printed"), _least(trials, "ours")
    ratios = _ratios(trials, "printed"), _ratios(trials, "ours")
    same = "strokes seen in time with the skin are taken for the same event"
    other = "strokes seen 0.4 to 1 s late are not"
    others = f"others report 22 to 31; drifts below 0.001 px count as that; {_ratio_range(trials)}"
    return (
        _weight(same, Bound("≥", 0.7), weights["synchronous"]),
        _weight(other, Bound("≤", 0.1), weights["asynchronous"]),
        judge("E5", "the belief drifts toward the seen hand: the drift's sign follows its side",
              "lesser drift toward the hand of left and right", "px", Bound("≥", 0.01), least,
              f"{_range(trials)}; {_trust(trials)}"),
        judge("E5", "hardly so when asynchronous", "synchronous over asynchronous drift", "1",
              Bound("≥", 20.0), ratios, others),
    )  # fmt: skip


def _ratios(trials: Sequence[Trial], of: str) -> list[float]:
    """Synchronous over asynchronous drift toward the hand, each the mean of both sides."""
    with_it, against = (_mean(trials, [f"{of} {rhythm} {side}" for side in SIDES]) for rhythm in RHYTHMS)
    return [a / max(abs(b), FAINT) for a, b in zip(with_it, against, strict=True)]


def _weight(text: str, bound: Bound, found: list[float]) -> Claim:
    return judge("E5", text, "mean synchrony weight", "1", bound, (found, found), "both models share perception")


def _mean(trials: Sequence[Trial], names: list[str]) -> list[float]:
    return [float(np.mean(row)) for row in zip(*(column(trials, name) for name in names), strict=True)]


def _least(trials: Sequence[Trial], of: str) -> list[float]:
    sides = [column(trials, f"{of} synchronous {side}") for side in SIDES]
    return [float(np.min(row)) for row in zip(*sides, strict=True)]


def _range(trials: Sequence[Trial]) -> str:
    found = {w: float(np.median(_mean(trials, [f"width {w:g} synchronous {s}" for s in SIDES]))) for w in WIDTHS}
    told = ", ".join(f"{drift:.2f} px at {w:g} px" for w, drift in found.items())
    why = "the constants are a_1 = 0.001 and b_1 = 1"
    return f"{why}: with a_1 = 1 and a learned body, drift by the width 1/√(2 b_1): {told}"


def _ratio_range(trials: Sequence[Trial]) -> str:
    found = {w: float(np.median(_ratios(trials, f"width {w:g}"))) for w in WIDTHS}
    return "as printed, with a_1 = 1, by the width: " + ", ".join(f"{r:.0f} at {w:g} px" for w, r in found.items())


def _trust(trials: Sequence[Trial]) -> str:
    found = medians(trials, "noise {}", NOISES)
    told = ", ".join(f"{drift:.2f} px with {s:g} rad more" for s, drift in found.items())
    return f"ours by the encoders' noise, 0.01 rad being their own: {told}"


def _tables(trials: Sequence[Trial]) -> tuple[Table, ...]:
    def cell(of: str, rhythm: str, side: str) -> str:
        return f"{np.median(column(trials, f'{of} {rhythm} {side}')):+.3f}"

    rows: list[tuple[Any, ...]] = [
        (rhythm, side, f"{np.median(column(trials, f'{rhythm} {side} weight')):.3f}", cell("printed", rhythm, side),
         cell("ours", rhythm, side)) for rhythm in RHYTHMS for side in PLACES
    ]  # fmt: skip
    head = ("strokes", "hand seen", "synchrony weight", "printed: drift toward it, px", "ours: drift toward it, px")
    return (Table("Medians over the seeds", head, tuple(rows)),)


EXPERIMENT = Experiment("E5", "The rubber hand", _run, _claims, _tables)
