"""E5, the rubber hand: the arm is hidden and stroked,
the image shows a hand that strokes another place.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ..types import Array
from . import readings
from .cases import build_cases, explore_by_preset, place_of_touched_skin, run_study
from .claims import Bound, Claim, Control
from .drawn import SIZE
from .e4_refinement import RefinementLogs
from .judging import judge_own_claim, judge_paper_claim
from .lab import NAMES, Lab, ObservedLog
from .records import (
    Experiment,
    ExperimentReadings,
    TextTable,
    Trial,
    build_panel,
    by_reading,
    figure_column,
    name_figure,
    shown_reading_key,
)

DURATION = 20.0
CALM = 5.0
"""s: duration, and time before the first touch."""
RHYTHMS = ("synchronous", "asynchronous")
SIDES = {"left": -1.0, "right": 1.0}
DISPLACEMENT = 0.12 * SIZE[0]
"""px: displacement of the hand's image."""
OWN_NOISE = 0.01
"""rad: the encoders' noise in these logs."""
MIN_DRIFT_SHARE = 0.01
"""Share of the displacement below which a drift counts as zero."""
CONCERNED = (
    "sigma_n",
    "integration",
    "lambda",
    "noise",
    "b_1",
    "o_v",
    "s_t",
    "sigma_t",
    "a_2",
    "b_2",
)


def record_strokes(lab: Lab, seed: int, rhythm: str, side: str) -> ObservedLog:
    """The log of one seed, rhythm and side."""
    return lab.observed("rubber-hand", seed, duration=DURATION, variant=rhythm, place=side)


def _run_rubber_hand(lab: Lab, seed: int, tried: ExperimentReadings) -> Trial:
    known = explore_by_preset(lab.body("paper", seed))
    body = lab.body("default", seed, touched=True)
    figures: dict[str, float] = {}
    courses: dict[str, tuple[Array, Array, Array]] = {}
    for rhythm in RHYTHMS:
        for side, sign in SIDES.items():
            log = record_strokes(lab, seed, rhythm, side)
            figures[f"{rhythm} {side} weight"] = float(
                np.mean([pair.weight for pair in log.features.synchrony])
            )
            logs = RefinementLogs(
                log, OWN_NOISE, place_of_touched_skin(body), seed, sign * DISPLACEMENT
            )
            found = run_study(tried.all, logs.signals, build_cases(known, ("p", "p+t")))
            for reading in tried.all:
                key = readings.reading_key(reading)
                made = found[key].x["p+t"], found[key].x["p"]
                moved = known.map(reading).at(made[0])[:, 0] - known.map(reading).at(made[1])[:, 0]
                t = found[key].signals.t
                figures[name_figure(key, f"{rhythm} {side}")] = (
                    sign * final_drift(t, moved) / DISPLACEMENT
                )
                figures[name_figure(key, f"{rhythm} {side} rad")] = float(
                    np.abs((made[0] - made[1])[t >= CALM]).max()
                )
                if key == tried.keys[0]:
                    courses[f"{rhythm} {side}"] = t, made[0] - made[1], moved
    return {
        "figures": figures | _combine_sides(figures, tried),
        "panels": _rubber_hand_panels(courses),
    }


def final_drift(t: Array, drift: Array) -> float:
    """The drift of greatest size after the calm; NaN when the belief diverged."""
    late = drift[t >= CALM]
    return float(late[np.abs(late).argmax()]) if np.isfinite(late).all() else float("nan")


def _combine_sides(figures: Mapping[str, float], tried: ExperimentReadings) -> dict[str, float]:
    """Per reading: the lesser drift of both sides toward
    the hand, and the greater one of asynchronous strokes.
    """
    found = {}
    for key in (readings.reading_key(reading) for reading in tried.all):
        both = {r: [figures[name_figure(key, f"{r} {side}")] for side in SIDES] for r in RHYTHMS}
        found[name_figure(key, "lesser")] = float(np.min(both["synchronous"]))
        found[name_figure(key, "asynchronous")] = float(np.max(np.abs(both["asynchronous"])))
    return found


def _rubber_hand_panels(courses: Mapping[str, tuple[Array, Array, Array]]) -> list[dict[str, Any]]:
    t = next(iter(courses.values()))[0]
    panels = [
        build_panel(
            "drift of the effector, printed model",
            "px",
            t,
            {k: u for k, (_, _, u) in courses.items()},
            "6b",
        )
    ]
    for i, joint in enumerate(NAMES):
        panels.append(
            build_panel(
                f"{joint}, moved by touch",
                "rad",
                t,
                {k: x[:, i] for k, (_, x, _) in courses.items()},
                "6b",
            )
        )
    return panels


def _claim_rubber_hand(trials: Sequence[Trial], tried: ExperimentReadings) -> tuple[Claim, ...]:
    drifts = Control(
        "lesser drift of both sides, synchronous",
        "of the displacement",
        Bound("≥", MIN_DRIFT_SHARE),
        "lesser",
    )
    rows: tuple[tuple[str, str, Bound, str, tuple[Control, ...]], ...] = (
        (
            "with synchronous strokes the belief drifts toward the seen hand, whichever its side",
            "lesser drift toward the hand of left and right, over the displacement",
            Bound("≥", MIN_DRIFT_SHARE),
            "lesser",
            (),
        ),
        (
            "with asynchronous strokes it hardly does",
            "greater drift of both sides, over the displacement",
            Bound("≤", MIN_DRIFT_SHARE),
            "asynchronous",
            (drifts,),
        ),
    )
    figures = by_reading(trials)
    papers = (
        judge_paper_claim(
            f"E5.{k}",
            text,
            measured,
            "1",
            bound,
            figure,
            figures,
            tried.keys,
            tried.swept,
            controls,
        )
        for k, (text, measured, bound, figure, controls) in enumerate(rows, 1)
    )
    return (*papers, *_own_synchrony_claims(trials))


def _own_synchrony_claims(trials: Sequence[Trial]) -> Iterator[Claim]:
    """Perception's synchrony weight, by rhythm of the strokes."""
    rows = (
        (
            "synchronous",
            "perception takes strokes seen in time with the skin for the same event",
            Bound("≥", 0.7),
        ),
        ("asynchronous", "and strokes seen 0.4 to 1 s late not", Bound("≤", 0.1)),
    )
    for k, (rhythm, text, bound) in enumerate(rows, 3):
        sides = (figure_column(trials, f"{rhythm} {side} weight") for side in SIDES)
        weights = [float(np.mean(row)) for row in zip(*sides, strict=True)]
        yield judge_own_claim(f"E5.{k}", text, "mean synchrony weight", "1", bound, weights)


def _tabulate_rubber_hand(trials: Sequence[Trial]) -> tuple[TextTable, ...]:
    def cell(name: str) -> str:
        return f"{np.nanmedian(figure_column(trials, name_figure(shown_reading_key(trials), name))):+.4f}"

    rows = [
        (
            r,
            s,
            f"{np.median(figure_column(trials, f'{r} {s} weight')):.3f}",
            cell(f"{r} {s}"),
            cell(f"{r} {s} rad"),
        )
        for r in RHYTHMS
        for s in SIDES
    ]
    head = (
        "strokes",
        "hand seen",
        "synchrony weight",
        "drift toward it over the displacement",
        "largest move of a joint, rad",
    )
    return (TextTable("The printed model, medians over the seeds", head, tuple(rows)),)


EXPERIMENT = Experiment(
    "E5", "The rubber hand", _run_rubber_hand, _claim_rubber_hand, CONCERNED, _tabulate_rubber_hand
)
