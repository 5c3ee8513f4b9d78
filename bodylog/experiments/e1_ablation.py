"""E1, which senses are needed: exploration never moves the
elbow; vision alone, with two encoders, with all, Kalman.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from ..evaluation.scores import root_mean_square
from ..types import Array
from . import drawn, readings
from .beliefs import BeliefWithTruth, believe_by_default
from .cases import (
    ExplorationSamples,
    StudyBeliefs,
    build_cases,
    explore_by_preset,
    run_study,
    sample_signals,
)
from .claims import Bound, Claim, Control
from .judging import judge_own_claim, judge_paper_claim
from .lab import NAMES, Lab, ObservedLog
from .printed import Signals, filter_encoders
from .readings import Reading
from .records import (
    Experiment,
    ExperimentReadings,
    TextTable,
    Trial,
    build_panel,
    by_reading,
    figure_column,
    figure_ratios,
    name_figure,
    shown_reading_key,
)

SENSES = ("v", "p1+p3+v", "p+v", "p")
OURS = {
    "v": ("vision",),
    "p1+p3+v": ("shoulder_pan_joint", "elbow_joint", "vision"),
    "p+v": ("encoders", "vision"),
    "p": ("encoders",),
}
START_ERROR_RAD = 0.15
"""rad: initial error of every joint's belief."""
SIDEWAYS = (True, True, False)
"""The elbow does not move, in exploration and in the test."""
FAST = "4"
SLOW = "60"
"""s: the periods of fast and slow dynamics that are compared."""
CONCERNED = ("sigma_n", "sigma_v", "mu_x", "integration", "lambda", "speed", "noise")


class AblationLogs:
    """The logs of one seed by speed and noise, each drawn once, and where a belief starts."""

    def __init__(self, seed: int, moving: tuple[bool, bool, bool] = SIDEWAYS) -> None:
        """Draw no log yet."""
        self.seed = seed
        self.moving = moving
        self.made: dict[tuple[float, float], tuple[ObservedLog, Signals]] = {}

    def observed(self, reading: Reading) -> ObservedLog:
        """The log of this reading."""
        return self._both(reading)[0]

    def signals(self, reading: Reading) -> Signals:
        """Its signals on the printed grid."""
        return self._both(reading)[1]

    def _both(self, reading: Reading) -> tuple[ObservedLog, Signals]:
        period, noise = (readings.reading_number(reading, name) for name in ("speed", "noise"))
        assert period is not None and noise is not None
        if (period, noise) not in self.made:
            observed = drawn.draw_log(period, noise, self.seed, self.moving)
            self.made[period, noise] = observed, sample_signals(observed)
        return self.made[period, noise]


def _run_ablation(lab: Lab, seed: int, tried: ExperimentReadings) -> Trial:
    known = explore_by_preset(lab.body("paper", seed, "horizontal"))
    logs = AblationLogs(seed)
    found = run_study(tried.all, logs.signals, build_cases(known, SENSES, START_ERROR_RAD))
    lags = {speed: _error_at_speed(known, logs, tried.all, speed) for speed in (FAST, SLOW)}
    figures: dict[str, float] = {}
    for reading in tried.all:
        key = readings.reading_key(reading)
        figures |= {
            name_figure(key, name): value for name, value in _ablation_figures(found[key]).items()
        }
        figures[name_figure(key, "slow")] = lags[FAST][key] / lags[SLOW][key]
    own_figures, beliefs = _ablation_by_default(lab, seed, logs.observed(tried.decide[0]))
    return {
        "figures": figures | own_figures,
        "panels": _ablation_panels(found[tried.keys[0]], beliefs),
    }


def _error_at_speed(
    known: ExplorationSamples, logs: AblationLogs, tried: Sequence[Reading], speed: str
) -> dict[str, float]:
    """Error (rad) of p+v by reading, at another speed."""
    moved = {readings.reading_key(reading): {**reading, "speed": speed} for reading in tried}
    found = run_study(
        list(moved.values()), logs.signals, build_cases(known, ["p+v"], START_ERROR_RAD)
    )
    return {
        key: found[readings.reading_key(reading)].error("p+v", drawn.SETTLING)
        for key, reading in moved.items()
    }


def _ablation_figures(made: StudyBeliefs) -> dict[str, float]:
    found = {name: made.error(name, drawn.SETTLING) for name in SENSES}
    beside = filter_encoders(made.signals, made.signals.true[0] + START_ERROR_RAD)
    found["Kalman"] = made.signals.error(beside, drawn.SETTLING)
    for more, fewer in (("p1+p3+v", "v"), ("p+v", "p1+p3+v"), ("p+v", "p")):
        found[f"{more} over {fewer}"] = found[more] / found[fewer]
    found["elbow left"] = share_of_error_left(made.signals.t, made.x["v"], made.signals.true)
    found |= {f"followed {i + 1}": share_of_motion_followed(made, "v", i) for i in (0, 1)}
    found["apart"] = abs(found["p"] / found["Kalman"] - 1.0)
    found["differ"] = (
        root_mean_square((made.x["p"] - beside)[made.signals.t >= drawn.SETTLING]) / found["Kalman"]
    )
    return found


def share_of_error_left(t: Array, x: Array, true: Array) -> float:
    """Share of the elbow's initial error that remains in the last second."""
    return float(abs((x - true)[t >= t[-1] - 1.0, 2].mean()) / START_ERROR_RAD)


def share_of_motion_followed(made: StudyBeliefs, name: str, joint: int) -> float:
    """Share of a joint's true motion that a belief
    follows: the slope of belief over truth once settled.
    """
    late = made.signals.t >= drawn.SETTLING
    true = made.signals.true[late, joint]
    x = made.x[name][late, joint]
    return float(np.cov(x, true)[0, 1] / np.var(true, ddof=1))


def _ablation_by_default(
    lab: Lab, seed: int, observed: ObservedLog
) -> tuple[dict[str, float], dict[str, BeliefWithTruth]]:
    body = lab.body("default", seed, "horizontal")
    start = tuple(
        float(v) for v in observed.true(body.joints, observed.truth.t[:1])[0] + START_ERROR_RAD
    )
    beliefs = {
        name: believe_by_default(observed, body, senses, start=start)
        for name, senses in OURS.items()
    }
    figures = {f"ours {name}": belief.rmse(drawn.SETTLING) for name, belief in beliefs.items()}
    joints = observed.features.joints
    assert joints is not None
    figures["encoders"] = root_mean_square(
        (joints.values - observed.true(joints.names, joints.t))[joints.t >= drawn.SETTLING]
    )
    return figures, beliefs


def _ablation_panels(
    made: StudyBeliefs, beliefs: Mapping[str, BeliefWithTruth]
) -> list[dict[str, Any]]:
    t = made.signals.t
    true = made.signals.true
    beside = {**made.x, "Kalman": filter_encoders(made.signals, true[0] + START_ERROR_RAD)}
    panels = []
    for i, joint in enumerate(NAMES):
        lines = {name: made.x[name][:, i] for name in ("v", "p1+p3+v", "p+v")}
        lines |= {"ours p+v": beliefs["p+v"].at(t)[:, i], "truth": true[:, i]}
        panels.append(build_panel(f"{joint}, estimated", "rad", t, lines, "4a"))
    lines = {name: np.abs(x - true).mean(axis=1) for name, x in beside.items()}
    lines["ours p+v"] = np.abs(beliefs["p+v"].at(t) - true).mean(axis=1)
    panels.append(build_panel("estimation error", "rad", t, lines, "4b"))
    errors = made.errors["p+v"]
    panels.append(
        build_panel(
            "error dynamics e_p of p+v",
            "1/rad",
            t,
            {n: errors[:, i] for i, n in enumerate(NAMES)},
            "4c",
        )
    )
    panels.append(
        build_panel(
            "error dynamics e_v of p+v",
            "1/unit",
            t,
            {n: errors[:, 3 + i] for i, n in enumerate("uv")},
            "4c",
        )
    )
    return panels


def _claim_ablation(trials: Sequence[Trial], tried: ExperimentReadings) -> tuple[Claim, ...]:
    figures = by_reading(trials)

    def claim(
        number: int,
        text: str,
        measured: str,
        bound: Bound,
        figure: str,
        *controls: Control,
        without: tuple[str, ...] = (),
    ) -> Claim:
        part = tried.restricted(*(name for name in CONCERNED if name not in without))
        return judge_paper_claim(
            f"E1.{number}",
            text,
            measured,
            "1",
            bound,
            figure,
            figures,
            part.keys,
            part.swept,
            controls,
        )

    found = [
        Control(
            f"share of shoulder {i}'s motion that vision alone follows",
            "1",
            Bound("≥", 0.5),
            f"followed {i}",
        )
        for i in (1, 2)
    ]
    near = Control("error of p+v", "rad", Bound("≤", START_ERROR_RAD), "p+v")
    return (
        claim(
            1,
            "two encoders with vision err less than vision alone",
            "error of p1+p3+v over that of v",
            Bound("≤", 1.0),
            "p1+p3+v over v",
        ),
        claim(
            2,
            "all encoders with vision err less than two of them",
            "error of p+v over that of p1+p3+v",
            Bound("≤", 1.0),
            "p+v over p1+p3+v",
            near,
        ),
        claim(
            3,
            "vision with encoders errs less than encoders alone",
            "error of p+v over that of p",
            Bound("≤", 1.0),
            "p+v over p",
            near,
        ),
        claim(
            4,
            "vision alone does not find an elbow that exploration did not move, and finds "
            "the shoulders",
            "share of the elbow's first error left",
            Bound("≥", 0.8),
            "elbow left",
            *found,
            without=("noise",),
        ),
        claim(
            5,
            "encoders alone are practically the Kalman filter",
            "how far the ratio of their errors is from 1",
            Bound("≤", 0.2),
            "apart",
            without=("sigma_n", "sigma_v"),
        ),
        claim(
            6,
            "the dynamics are slow where big changes occur (the paper's own word)",
            "error of p+v at a period of 4 s over that at 60 s",
            Bound("≥", 2.0),
            "slow",
            without=("speed",),
        ),
        *_own_ablation_claims(trials),
    )


def _own_ablation_claims(trials: Sequence[Trial]) -> tuple[Claim, ...]:
    over = partial(figure_ratios, trials)
    explanation = (
        "vision alone takes a joint no encoder reads to be about where it was explored: "
        "remembered, not seen"
    )
    return (
        judge_own_claim(
            "E1.7",
            "our p+v errs less than the raw encoders",
            "error over the encoders'",
            "1",
            Bound("≤", 0.5),
            over("ours p+v", "encoders"),
        ),
        judge_own_claim(
            "E1.8",
            "our p+v errs less than our p",
            "error of p+v over that of p",
            "1",
            Bound("≤", 1.0),
            over("ours p+v", "ours p"),
            explanation,
        ),
    )


def _tabulate_ablation(trials: Sequence[Trial]) -> tuple[TextTable, ...]:
    def cell(name: str) -> str:
        return f"{np.nanmedian(figure_column(trials, name)):.4f}"

    rows = [
        (name, cell(name_figure(shown_reading_key(trials), name)), cell(f"ours {name}"))
        for name in SENSES
    ]
    rows += [
        ("Kalman on p", cell(name_figure(shown_reading_key(trials), "Kalman")), ""),
        ("raw encoders", "", cell("encoders")),
    ]
    return (
        TextTable(
            "Median error over the seeds, rad", ("senses", "printed model", "ours"), tuple(rows)
        ),
    )


EXPERIMENT = Experiment(
    "E1", "Which senses are needed", _run_ablation, _claim_ablation, CONCERNED, _tabulate_ablation
)
