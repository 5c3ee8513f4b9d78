"""E2, non-linear proprioception: encoders read the square
of the angle; the belief starts wrong, one sign included.

The arm stands still for 5 s and then moves, as in the paper.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from ..body_model import BodyModel
from ..settings import EstimationSettings
from ..types import Array
from . import drawn, readings
from .beliefs import BeliefWithTruth, belief_with_truth, estimate_with_settings
from .cases import (
    ExplorationSamples,
    StudyBeliefs,
    build_case,
    explore_by_preset,
    run_study,
    sample_signals,
)
from .claims import Bound, Claim, Control
from .judging import judge_own_claim, judge_paper_claim
from .lab import NAMES, Lab, ObservedLog
from .printed import Case, Signals
from .readings import Reading
from .records import (
    Experiment,
    ExperimentReadings,
    Trial,
    build_panel,
    by_reading,
    figure_column,
    name_figure,
)

START = (-0.8, 0.70, 0.60)
"""rad: the paper's prior, which has the wrong sign for shoulder 2."""
CONVERGED_RAD = 0.05
"""rad: a belief's size this close to the truth's has converged."""
BEGINS = 5.0
"""s when the arm starts moving."""
CONCERNED = ("sigma_n", "sigma_v", "integration", "lambda", "speed", "noise")
"""Constants that the claims may depend on; the prior is printed here."""


class _NonlinearLogs:
    """The logs of one seed by speed, noise and the encoders' reading: squares or angles."""

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self.made: dict[tuple[float, float, bool], tuple[ObservedLog, Signals]] = {}

    def both(self, reading: Reading, square: bool = True) -> tuple[ObservedLog, Signals]:
        period, noise = (readings.reading_number(reading, name) for name in ("speed", "noise"))
        assert period is not None and noise is not None
        if (period, noise, square) not in self.made:
            observed = drawn.draw_log(period, noise, self.seed, begins=BEGINS, square=square)
            self.made[period, noise, square] = observed, sample_signals(observed)
        return self.made[period, noise, square]


def _run_nonlinear(lab: Lab, seed: int, tried: ExperimentReadings) -> Trial:
    known = explore_by_preset(lab.body("paper", seed))
    logs = _NonlinearLogs(seed)
    found = run_study(
        tried.all, lambda r: logs.both(r)[1], lambda r, s: {"p": _nonlinear_case(known, r, True)}
    )
    plain = run_study(
        tried.all,
        lambda r: logs.both(r, False)[1],
        lambda r, s: {n: _nonlinear_case(known, r, False, n) for n in ("p", "p+v")},
    )
    figures: dict[str, float] = {}
    for reading in tried.all:
        key = readings.reading_key(reading)
        figures |= {
            name_figure(key, name): value
            for name, value in _nonlinear_figures(found[key], plain[key]).items()
        }
    observed = logs.both(tried.decide[0])[0]
    body = with_squared_encoders(lab.body("default", seed))
    beliefs = {
        "encoders": descend_from_start(observed, body, ("encoders",), START)[0],
        "vision": choose_signs(observed, body),
    }
    figures |= {
        f"ours {name}": _largest_mean_error(belief.x - belief.true)
        for name, belief in beliefs.items()
    }
    return {"figures": figures, "panels": _nonlinear_panels(found[tried.keys[0]], beliefs)}


def _nonlinear_case(
    known: ExplorationSamples, reading: Reading, square: bool, senses: str = "p"
) -> Case:
    start = np.array(START) if square else np.array(START) * [1.0, -1.0, 1.0]
    return build_case(known, reading, senses, start, square=square)


def _nonlinear_figures(made: StudyBeliefs, plain: StudyBeliefs) -> dict[str, float]:
    t = made.signals.t
    x = made.x["p"]
    true = made.signals.true
    still = t < BEGINS
    moving = t >= BEGINS + drawn.SETTLING / 2
    return {
        "converged": time_to_converge(t[still], x[still], true[still]),
        "shoulder": float(abs(x[still][-20:, 1].mean() - abs(true[0, 1]))),
        "slower": _moving_error(made, "p", moving) / _moving_error(plain, "p+v", moving),
        "slower than p": _moving_error(made, "p", moving) / _moving_error(plain, "p", moving),
        "signed": float(abs(x[still][-20:, [0, 2]] - true[still][-20:, [0, 2]]).max()),
    }


def _moving_error(made: StudyBeliefs, senses: str, rows: Array) -> float:
    """Error (rad) of the angles' absolute values, which squares determine, while the arm moves."""
    return float(np.sqrt(np.mean((np.abs(made.x[senses]) - np.abs(made.signals.true))[rows] ** 2)))


def time_to_converge(t: Array, x: Array, true: Array) -> float:
    """Seconds until every joint's size stays within CONVERGED_RAD of the truth's; infinite if
    never, NaN if it diverged.
    """
    if np.isnan(x).any():
        return float("nan")
    beyond = np.flatnonzero(~(np.abs(np.abs(x) - np.abs(true)).max(axis=1) < CONVERGED_RAD))
    if not len(beyond):
        return 0.0
    return float(t[beyond[-1] + 1] - t[0]) if beyond[-1] + 1 < len(t) else float("inf")


@dataclass(frozen=True)
class SquaredEncoders:
    """A forward model of M encoders that read x²."""

    outputs: tuple[str, ...]

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        """At x (N,M) rad: x² · its Jacobian (N,M,M) · no model variance."""
        return x * x, 2.0 * x[:, :, None] * np.eye(x.shape[1]), np.zeros(x.shape)


def with_squared_encoders(body: BodyModel) -> BodyModel:
    """The body with encoders that read x²."""
    return replace(body, senses={**body.senses, "encoders": SquaredEncoders(body.joints)})


def descend_from_start(
    observed: ObservedLog, body: BodyModel, senses: tuple[str, ...], start: tuple[float, ...]
) -> tuple[BeliefWithTruth, float]:
    """Our predictive coding from `start`, and its mean
    free energy (nats) while the arm stands still.
    """
    settings = EstimationSettings(method="predictive-coding", senses=senses, start=start)
    found = estimate_with_settings(observed, body, settings)
    rest = (found.joints.t >= BEGINS / 2) & (found.joints.t < BEGINS)
    return belief_with_truth(found, observed), float(found.free_energy[rest].mean())


def choose_signs(observed: ObservedLog, body: BodyModel) -> BeliefWithTruth:
    """The belief of least free energy, of those started
    at every choice of signs of the encoders' roots.
    """
    assert observed.features.joints is not None
    columns = [observed.features.joints.names.index(name) for name in body.joints]
    size = np.sqrt(np.abs(np.median(observed.features.joints.values[:100, columns], axis=0)))
    starts = [tuple((size * signs).tolist()) for signs in product((-1.0, 1.0), repeat=len(size))]
    tried = [descend_from_start(observed, body, ("encoders", "vision"), start) for start in starts]
    return min(tried, key=lambda pair: pair[1])[0]


def _largest_mean_error(error: Array) -> float:
    """Largest joint's mean absolute error (rad) over the second half of the log."""
    return float(np.abs(error[len(error) // 2 :]).mean(axis=0).max())


def _nonlinear_panels(
    made: StudyBeliefs, beliefs: dict[str, BeliefWithTruth]
) -> list[dict[str, Any]]:
    t = made.signals.t
    x = made.x["p"]
    true = made.signals.true
    panels = []
    for i, name in enumerate(NAMES):
        lines = {
            "printed": x[:, i] ** 2,
            "ours with vision": beliefs["vision"].at(t)[:, i] ** 2,
            "truth": true[:, i] ** 2,
        }
        panels.append(build_panel(f"{name}, what its encoder reads", "rad²", t, lines, "5a"))
    lines = {
        "printed": x[:, 1],
        "ours with vision": beliefs["vision"].at(t)[:, 1],
        "truth": true[:, 1],
    }
    return [*panels, build_panel("shoulder 2, the angle", "rad", t, lines, "5a")]


def _claim_nonlinear(trials: Sequence[Trial], tried: ExperimentReadings) -> tuple[Claim, ...]:
    figures = by_reading(trials)
    close = Control(
        "error of the joints whose sign was right", "rad", Bound("≤", CONVERGED_RAD), "signed"
    )
    still = tried.restricted("integration", "lambda", "noise")
    alone = np.median(figures(tried.keys[0], "slower than p"))
    slower = (
        f"over that of p alone it is {alone:.2f}: the slope of x² is 2x, above 1 where |x| > ½ rad"
    )
    rows: tuple[
        tuple[str, str, str, Bound, str, ExperimentReadings, tuple[Control, ...], str], ...
    ] = (
        (
            "the belief converges in the first 5 s",
            "seconds until within 0.05 rad",
            "s",
            Bound("≤", BEGINS),
            "converged",
            still,
            (),
            "",
        ),
        (
            "squares hide the sign: shoulder 2 settles at +0.869, the truth being −0.869",
            "distance from +0.869 after 5 s",
            "rad",
            Bound("≤", CONVERGED_RAD),
            "shoulder",
            still,
            (close,),
            "",
        ),
        (
            "the reaction is slower than in the previous experiment, which had p+v",
            "error while moving over that of p+v with encoders that read angles",
            "1",
            Bound("≥", 1.0),
            "slower",
            tried,
            (),
            slower,
        ),
    )
    papers = (
        judge_paper_claim(
            f"E2.{k}",
            text,
            measured,
            unit,
            bound,
            figure,
            figures,
            part.keys,
            part.swept,
            controls,
            why,
        )
        for k, (text, measured, unit, bound, figure, part, controls, why) in enumerate(rows, 1)
    )
    return (*papers, *_own_nonlinear_claims(trials))


def _own_nonlinear_claims(trials: Sequence[Trial]) -> Iterator[Claim]:
    error = "largest joint's mean error", "rad"
    yield judge_own_claim(
        "E2.4",
        "our predictive coding on encoders alone does not find the sign either",
        *error,
        Bound("≥", 1.0),
        figure_column(trials, "ours encoders"),
    )
    yield judge_own_claim(
        "E2.5",
        "vision gives the sign: only one root explains the image",
        *error,
        Bound("≤", CONVERGED_RAD),
        figure_column(trials, "ours vision"),
        "of the eight choices of sign the one of least free energy is taken",
    )


EXPERIMENT = Experiment(
    "E2", "Non-linear proprioception", _run_nonlinear, _claim_nonlinear, CONCERNED
)
