"""E1, which senses are needed: exploration never moves the elbow; vision alone, with two encoders, with all, Kalman."""

from collections.abc import Sequence

import numpy as np

from ..types import BodyModel
from .beliefs import Belief, angles, kalman, mean_errors, ours, printed
from .lab import ELSEWHERE, Heard, Lab
from .records import SIDES, Bound, Claim, Experiment, Table, Trial, both, column, errors_table, judge, medians, ratio

SENSES = {
    "v": ("vision",),
    "p1+p3+v": ("shoulder_pan_joint", "elbow_joint", "vision"),
    "p+v": ("encoders", "vision"),
    "p": ("encoders",),
}
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
    beliefs |= {(side, "Kalman on p"): kalman(heard, own, start) for side in SIDES}
    figures = {f"{side} {name}": belief.rmse(SETTLED) for (side, name), belief in beliefs.items()}
    figures |= {f"{side} elbow": _elbow(beliefs[side, "v"]) for side in SIDES}
    figures["equilibrium p"] = printed(heard, paper, SENSES["p"], start, implicit=True).rmse(SETTLED)
    figures |= _sweep(heard, own, start)
    panels = [*(mean_errors(beliefs, side) for side in SIDES), *angles(beliefs, ("p+v", "v"))]
    return {"figures": figures, "panels": panels}


def _elbow(belief: Belief) -> float:
    """Share of the elbow's first error that is still there at the end."""
    return float(abs(belief.error(belief.t[-1] - 1.0)[:, 2].mean()) / OFF)


def _sweep(heard: Heard, body: BodyModel, start: tuple[float, ...]) -> dict[str, float]:
    """RMSE (rad) of Algorithm 1 on p1+p3+v with a learned body, by σ_v."""
    return {f"sigma {s:g}": printed(heard, body, SENSES["p1+p3+v"], start, s).rmse(SETTLED) for s in SWEEP}


def _claims(trials: Sequence[Trial]) -> tuple[Claim, ...]:
    def less(text: str, more: str, fewer: str, said: str = "") -> Claim:
        figures = ratio(trials, f"printed {more}", f"printed {fewer}"), ratio(trials, f"ours {more}", f"ours {fewer}")
        return judge("E1", text, f"error of {more} over error of {fewer}", "1", Bound("≤", 1.0), figures, said)

    def apart(side: str) -> list[float]:
        return [abs(found - 1.0) for found in ratio(trials, f"{side} p", f"{side} Kalman on p")]

    alone = "vision alone cannot find an elbow that exploration did not move"
    same = "encoders alone: practically the Kalman filter"
    stray = "above 1 the belief strays along what it cannot see; ours takes a joint that no encoder speaks of to be "
    stray += "about where it was explored, and here it is: remembered, not seen"
    alike = "in ours vision alone remembers the elbow better than its encoder reads it"
    distance = "how far the errors' ratio is from 1"
    return (
        less("two encoders with vision: less error than vision alone", "p1+p3+v", "v", alike),
        less("all encoders with vision: less error than two of them", "p+v", "p1+p3+v"),
        less("vision with encoders: less error than encoders alone", "p+v", "p", _range(trials)),
        judge("E1", alone, "share of the elbow's first error left", "1", Bound("≥", 0.8), both(trials, "elbow"), stray),
        judge("E1", same, distance, "1", Bound("≤", 0.2), (apart("printed"), apart("ours")), _lag(trials)),
    )


def _lag(trials: Sequence[Trial]) -> str:
    names = ("printed p", "equilibrium p", "printed Kalman on p", "ours p")
    found = [float(np.median(column(trials, name))) for name in names]
    rested = float(np.median([abs(r - 1.0) for r in ratio(trials, "equilibrium p", "printed Kalman on p")]))
    return (
        "errors in rad: Algorithm 1 {:.3f}, with its prediction errors at their equilibrium {:.3f}, Kalman filter "
        "{:.3f}, ours {:.3f}; the constant is σ_p = 1 (s, the time the prediction errors take): with them at their "
        "equilibrium the ratio is {:.3f} from 1"
    ).format(*found, rested)


def _range(trials: Sequence[Trial]) -> str:
    found = ", ".join(f"{error:.3f} at {s:g}" for s, error in medians(trials, "sigma {}", SWEEP).items())
    return f"Algorithm 1 on p1+p3+v with a learned body, error in rad by σ_v (printed: 5): {found}"


def _tables(trials: Sequence[Trial]) -> tuple[Table, ...]:
    return (errors_table("Median error over the seeds, rad", trials, (*SENSES, "Kalman on p")),)


EXPERIMENT = Experiment("E1", "Which senses are needed", _run, _claims, _tables)
