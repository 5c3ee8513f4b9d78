"""E3, an encoder drifts after learning: shoulder 1
by 0.3 rad between 8 s and 24 s, in joint angles.

The drift's effect is the belief minus the belief about the same log without the drift.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ..types import Array
from . import drawn, readings
from .beliefs import BeliefWithTruth, believe_by_default
from .cases import build_cases, explore_by_preset, run_study, sample_signals
from .claims import Bound, Claim, Control
from .judging import judge_own_claim, judge_paper_claim
from .lab import Lab, ObservedLog
from .printed import Signals
from .readings import Reading
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

DRIFT = 0.3
BEGINS = 8.0
FULL = 24.0
"""rad at the end · s when it begins · s when it is complete, from when on effects count."""
SECONDS = 32.0
MIN_INDUCED_BIAS_RAD = 0.01
"""rad: a smaller bias of another joint counts as zero."""
CONCERNED = ("sigma_n", "sigma_v", "mu_x", "integration", "lambda", "speed", "noise")


def add_drift(observed: ObservedLog) -> ObservedLog:
    """The log with the drift in its first encoder's readings."""
    joints = observed.features.joints
    assert joints is not None
    values = joints.values.copy()
    values[:, 0] += DRIFT * np.clip((joints.t - BEGINS) / (FULL - BEGINS), 0.0, 1.0)
    return replace(
        observed, features=replace(observed.features, joints=replace(joints, values=values))
    )


class _DriftLogs:
    """The logs of one seed by speed and noise, with and without the drift."""

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self.made: dict[tuple[float, float, bool], tuple[ObservedLog, Signals]] = {}

    def both(self, reading: Reading, sound: bool) -> tuple[ObservedLog, Signals]:
        period, noise = (readings.reading_number(reading, name) for name in ("speed", "noise"))
        assert period is not None and noise is not None
        if (period, noise, sound) not in self.made:
            observed = drawn.draw_log(period, noise, self.seed, seconds=SECONDS)
            observed = observed if sound else add_drift(observed)
            self.made[period, noise, sound] = observed, sample_signals(observed)
        return self.made[period, noise, sound]

    def signals(self, reading: Reading, sound: bool) -> Signals:
        return self.both(reading, sound)[1]


def _run_drift(lab: Lab, seed: int, tried: ExperimentReadings) -> Trial:
    known = explore_by_preset(lab.body("paper", seed))
    logs = _DriftLogs(seed)
    found = {
        sound: run_study(
            tried.all, partial(logs.signals, sound=sound), build_cases(known, ("p", "p+v"))
        )
        for sound in (True, False)
    }
    figures: dict[str, float] = {}
    for reading in tried.all:
        key = readings.reading_key(reading)
        ill = found[False][key]
        sound = found[True][key]
        t = ill.signals.t
        figures |= {
            name_figure(key, k): v
            for k, v in measure_drift_effects(t, ill.x["p+v"], sound.x["p+v"]).items()
        }
        figures[name_figure(key, "alone")] = measure_drift_effects(t, ill.x["p"], sound.x["p"])[
            "left"
        ]
    body = lab.body("default", seed)
    decisive = tried.decide[0]
    beliefs = {
        sound: believe_by_default(logs.both(decisive, sound)[0], body, ("encoders", "vision"))
        for sound in (True, False)
    }
    whole = beliefs[False]
    figures |= {
        f"ours {k}": abs(v)
        for k, v in measure_drift_effects(whole.t, whole.x, beliefs[True].at(whole.t)).items()
    }
    first = found[False][tried.keys[0]]
    return {"figures": figures, "panels": _drift_panels(first.signals, first.x, whole)}


def measure_drift_effects(t: Array, x: Array, sound: Array) -> dict[str, float]:
    """Share of the drift left in shoulder 1, and the bias
    (rad) it induces on shoulder 2 and on the other joints.
    """
    late = (x - sound)[t >= FULL].mean(axis=0)
    return {
        "left": float(late[0] / DRIFT),
        "second": float(abs(late[1])),
        "others": float(np.abs(late[1:]).max()),
    }


def _drift_panels(
    sensed: Signals, made: Mapping[str, Array], own_belief: BeliefWithTruth
) -> list[dict[str, Any]]:
    t = sensed.t
    true = sensed.true
    panels = []
    for i, name in enumerate(("shoulder 1", "shoulder 2")):
        lines = {
            "p": made["p"][:, i],
            "p+v": made["p+v"][:, i],
            "ours p+v": own_belief.at(t)[:, i],
            "truth": true[:, i],
        }
        panels.append(build_panel(name, "rad", t, lines, "5b"))
        panels.append(
            build_panel(
                f"{name}, error",
                "rad",
                t,
                {k: v - true[:, i] for k, v in lines.items() if k != "truth"},
                "5b",
            )
        )
    return panels


def _claim_drift(trials: Sequence[Trial], tried: ExperimentReadings) -> tuple[Claim, ...]:
    figures = by_reading(trials)
    there = Control("share of the drift that encoders alone leave", "1", Bound("≥", 0.8), "alone")
    reduced = Control("share of the drift left", "1", Bound("≤", 0.9), "left")
    return (
        judge_paper_claim(
            "E3.1",
            "vision reduces the drift of shoulder 1 by at least a tenth",
            "share of the drift left",
            "1",
            Bound("≤", 0.9),
            "left",
            figures,
            tried.keys,
            tried.swept,
            (there,),
        ),
        judge_paper_claim(
            "E3.2",
            "it nicely reduces it: by half at least",
            "share of the drift left",
            "1",
            Bound("≤", 0.5),
            "left",
            figures,
            tried.keys,
            tried.swept,
            (there,),
        ),
        judge_paper_claim(
            "E3.3",
            "the price is a bias on shoulder 2",
            "bias of shoulder 2 that the drift induces",
            "rad",
            Bound("≥", MIN_INDUCED_BIAS_RAD),
            "second",
            figures,
            tried.keys,
            tried.swept,
            (there, reduced),
        ),
        judge_own_claim(
            "E3.4",
            "ours leaves at most a twentieth of the drift",
            "share of the drift left",
            "1",
            Bound("≤", 0.05),
            figure_column(trials, "ours left"),
        ),
        judge_own_claim(
            "E3.5",
            "ours biases no other joint",
            "largest bias induced on another joint",
            "rad",
            Bound("≤", MIN_INDUCED_BIAS_RAD),
            figure_column(trials, "ours others"),
        ),
    )


def _tabulate_drift(trials: Sequence[Trial]) -> tuple[TextTable, ...]:
    def row(name: str, own_name: str, unit: str) -> tuple[str, str, str]:
        return (
            unit,
            f"{np.median(figure_column(trials, name_figure(shown_reading_key(trials), name))):.4f}",
            f"{np.median(figure_column(trials, own_name)):.4f}",
        )

    rows = (
        row("left", "ours left", "share of the drift left in shoulder 1"),
        row("second", "ours second", "bias of shoulder 2, rad"),
        row("others", "ours others", "largest bias of another joint, rad"),
    )
    return (TextTable("Medians over the seeds", ("", "printed model", "ours"), rows),)


EXPERIMENT = Experiment(
    "E3", "A drifting encoder", _run_drift, _claim_drift, CONCERNED, _tabulate_drift
)
