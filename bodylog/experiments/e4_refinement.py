"""E4, refinement from a wrong prior: a still arm, a belief
that starts 0.1 to 0.2 rad off, a hand that strokes it.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ..types import Array
from . import readings
from .beliefs import BeliefWithTruth, add_encoder_noise, believe_by_default
from .cases import (
    StudyBeliefs,
    build_cases,
    explore_by_preset,
    place_hand,
    place_of_touched_skin,
    run_study,
    sample_signals,
)
from .claims import Bound, Claim, Control
from .judging import judge_own_claim, judge_paper_claim
from .lab import NAMES, Lab, ObservedLog
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
    figure_ratios,
    name_figure,
    shown_reading_key,
)

SENSES = ("p", "p+t", "p+v", "p+v+t")
OURS = {
    "p": ("encoders",),
    "p+t": ("encoders", "touch"),
    "p+v": ("encoders", "vision"),
    "p+v+t": ("encoders", "vision", "touch"),
}
WORTHWHILE_RATIO = 0.99
"""A sense adds accuracy when it removes at least 1 % of the error."""
DURATION = 16.0
SETTLED = 4.0
"""s: duration, and from when on our own errors count."""
OWN_NOISE = 0.02
"""rad: the encoders' noise in the log."""
POOR_NOISE_RAD = (0.1, 0.3)
"""rad: noise added for our own claims on touch."""
BODY = ("sigma_n", "sigma_v", "mu_x", "integration", "lambda", "noise")
CONCERNED = (*BODY, "b_1", "o_v", "s_t", "sigma_t", "a_2", "b_2")


class RefinementLogs:
    """The log of one seed with the encoders' noise and the hand's place of a reading.

    own_noise rad: of the recorded encoders · by, aside px: as `place_hand` takes them.
    """

    def __init__(
        self, observed: ObservedLog, own_noise: float, by: Array, seed: int, aside: float = 0.0
    ) -> None:
        """Of this seed; nothing is made yet."""
        self.observed = observed
        self.own_noise = own_noise
        self.by = by
        self.seed = seed
        self.aside = aside
        self.made: dict[tuple[float, str], Signals] = {}

    def signals(self, reading: Reading) -> Signals:
        """Its signals on the printed grid, the hand in the reading of o_v."""
        noise = readings.reading_number(reading, "noise")
        where = readings.reading_value(reading, "o_v")
        assert noise is not None
        if (noise, where) not in self.made:
            observed = sample_signals(with_noise(self.observed, noise, self.own_noise, self.seed))
            self.made[noise, where] = place_hand(observed, reading, self.by, self.aside, self.seed)
        return self.made[noise, where]


def with_noise(observed: ObservedLog, noise: float, own_noise: float, seed: int) -> ObservedLog:
    """The log as if its encoders, which have `own_noise`
    (rad), had `noise`: scaled about the truth, or increased.
    """
    joints = observed.features.joints
    assert joints is not None
    if noise >= own_noise:
        return add_encoder_noise(observed, float(np.sqrt(noise**2 - own_noise**2)), seed)
    true = observed.true(joints.names, joints.t)
    values = true + (joints.values - true) * noise / own_noise
    return replace(
        observed, features=replace(observed.features, joints=replace(joints, values=values))
    )


def _run_refinement(lab: Lab, seed: int, tried: ExperimentReadings) -> Trial:
    observed = lab.observed("touch", seed, duration=DURATION, noise=OWN_NOISE)
    body = lab.body("default", seed, touched=True)
    known = explore_by_preset(lab.body("paper", seed))
    logs = RefinementLogs(observed, OWN_NOISE, place_of_touched_skin(body), seed)
    rng = np.random.default_rng([seed, 4])
    off = rng.choice([-1.0, 1.0], 3) * rng.uniform(0.1, 0.2, 3)
    found = run_study(tried.all, logs.signals, build_cases(known, SENSES, off))
    figures: dict[str, float] = {}
    for reading in tried.all:
        key = readings.reading_key(reading)
        figures |= {
            name_figure(key, name): value for name, value in _refinement_figures(found[key]).items()
        }
    start = tuple((observed.true(body.joints, observed.truth.t[:1])[0] + off).tolist())
    beliefs = {
        name: believe_by_default(observed, body, senses, start=start)
        for name, senses in OURS.items()
    }
    figures |= {f"ours {name}": belief.rmse(SETTLED) for name, belief in beliefs.items()}
    for noise in POOR_NOISE_RAD:
        poor = add_encoder_noise(observed, noise, seed)
        figures |= {
            f"ours {name} {noise:g}": believe_by_default(poor, body, OURS[name], start=start).rmse(
                SETTLED
            )
            for name in ("p", "p+t")
        }
    return {"figures": figures, "panels": _refinement_panels(found[tried.keys[0]], beliefs)}


def _refinement_figures(made: StudyBeliefs) -> dict[str, float]:
    """Errors from the first touch on: before it touch changes
    nothing, and some seconds later p has found the arm.
    """
    first = float(made.signals.t[np.isfinite(made.signals.hand).all(axis=1)][0])
    found = {name: made.error(name, first) for name in SENSES}
    for more, fewer in (("p+v", "p"), ("p+t", "p"), ("p+v+t", "p+v")):
        found[f"{more} over {fewer}"] = found[more] / found[fewer]
    return found


def _refinement_panels(
    made: StudyBeliefs, beliefs: dict[str, BeliefWithTruth]
) -> list[dict[str, Any]]:
    t = made.signals.t
    true = made.signals.true
    panels = []
    for i, joint in enumerate(NAMES):
        lines = {name: made.x[name][:, i] for name in SENSES}
        lines |= {"ours p+v+t": beliefs["p+v+t"].at(t)[:, i], "truth": true[:, i]}
        panels.append(build_panel(f"{joint}, from a biased prior", "rad", t, lines, "6a"))
    lines = {name: np.abs(x - true).mean(axis=1) for name, x in made.x.items()}
    return [*panels, build_panel("mean absolute error", "rad", t, lines, "6a")]


def _claim_refinement(trials: Sequence[Trial], tried: ExperimentReadings) -> tuple[Claim, ...]:
    figures = by_reading(trials)
    found = Control("error of p+v", "rad", Bound("≤", 0.1), "p+v")

    def claim(
        number: int,
        text: str,
        more: str,
        fewer: str,
        *controls: Control,
        names: tuple[str, ...] = CONCERNED,
    ) -> Claim:
        measured = f"error of {more} over that of {fewer}"
        part = tried.restricted(*names)
        bound = Bound("≤", WORTHWHILE_RATIO)
        figure = f"{more} over {fewer}"
        return judge_paper_claim(
            f"E4.{number}",
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

    over = partial(figure_ratios, trials)
    explanation = "ours knows from a log of touches where each cell is seen beside the effector"
    return (
        claim(1, "vision adds accuracy to encoders, the prior being wrong", "p+v", "p", names=BODY),
        claim(2, "touch adds accuracy to encoders, the prior being wrong", "p+t", "p"),
        claim(
            3,
            "touch adds accuracy to encoders and vision, the prior being wrong",
            "p+v+t",
            "p+v",
            found,
        ),
        judge_own_claim(
            "E4.4",
            "vision adds accuracy to encoders",
            "error of p+v over that of p",
            "1",
            Bound("≤", WORTHWHILE_RATIO),
            over("ours p+v", "ours p"),
        ),
        judge_own_claim(
            "E4.5",
            "touch adds accuracy to encoders with 0.1 rad more noise",
            "error of p+t over that of p",
            "1",
            Bound("≤", WORTHWHILE_RATIO),
            over("ours p+t 0.1", "ours p 0.1"),
            explanation,
        ),
        judge_own_claim(
            "E4.6",
            "touch adds accuracy to encoders with 0.3 rad more noise",
            "error of p+t over that of p",
            "1",
            Bound("≤", WORTHWHILE_RATIO),
            over("ours p+t 0.3", "ours p 0.3"),
            explanation,
        ),
    )


def _tabulate_refinement(trials: Sequence[Trial]) -> tuple[TextTable, ...]:
    rows = [
        (
            name,
            *(
                f"{np.nanmedian(figure_column(trials, n)):.4f}"
                for n in (name_figure(shown_reading_key(trials), name), f"ours {name}")
            ),
        )
        for name in SENSES
    ]
    caption = "Median error, rad: the printed model from the first touch on, ours from 4 s on"
    return (TextTable(caption, ("senses", "printed model", "ours"), tuple(rows)),)


EXPERIMENT = Experiment(
    "E4",
    "Refinement from a wrong prior",
    _run_refinement,
    _claim_refinement,
    CONCERNED,
    _tabulate_refinement,
)
