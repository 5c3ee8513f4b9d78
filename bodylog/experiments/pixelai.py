"""A comparison with PixelAI: four joints, vision only, a still arm, starts wrong by three sizes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..sim.arms import ARMS
from ..types import Array
from .beliefs import believe_by_default
from .cases import build_case, explore_by_preset, sample_signals
from .claims import Bound, Claim
from .judging import judge_comparison
from .lab import JOINTS, Lab
from .printed import run_printed_model
from .records import Experiment, ExperimentReadings, TextTable, Trial, figure_column

FOUR = (*JOINTS, "wrist_1_joint")
EXPLORATION_FACTOR = 3
"""Factor on the exploration's duration for a body of four joints."""
STARTS = 3
"""Wrong starts per seed and level."""
PUBLISHED = {"one": (0.26, 0.94), "all": (0.39, 1.57), "elsewhere": (5.0, 18.0)}
"""Degrees: mean absolute error per joint, best and worst
joint, of PixelAI (simulated Nao) at its three levels.
"""
SETTLED_S = 1.5
"""s: errors count from here."""
CONVERGED_DEG = 2.0
"""Degrees: a start whose every joint ends this near has converged."""
SIDES = ("printed", "ours")
IN_USE = {"sigma_n": "learned", "sigma_v": "pixels", "integration": "implicit"}
"""The reading with the printed model's least error:
vision has the largest weight, its map is learned.
"""
_LEAST, _MOST = np.deg2rad([5.0, 10.0])
_BOX = 0.7 * np.array(ARMS["ur5"].swing[:4])


def _draw_one_joint_error(rng: np.random.Generator) -> Array:
    return np.asarray(np.where(np.arange(4) == rng.integers(4), _draw_all_joint_errors(rng), 0.0))


def _draw_all_joint_errors(rng: np.random.Generator) -> Array:
    return np.asarray(rng.choice([-1.0, 1.0], 4) * rng.uniform(_LEAST, _MOST, 4))


def _draw_other_posture_error(rng: np.random.Generator) -> Array:
    return np.asarray((rng.uniform(-1.0, 1.0, 4) - rng.uniform(-1.0, 1.0, 4)) * _BOX)


LEVELS: dict[str, Callable[[np.random.Generator], Array]] = {
    "one": _draw_one_joint_error,
    "all": _draw_all_joint_errors,
    "elsewhere": _draw_other_posture_error,
}


def _run_pixelai(lab: Lab, seed: int, tried: ExperimentReadings) -> Trial:
    # vision is the only sense: at half size, a still
    # disc's centre error would become the joints' error
    lab = replace(lab, markers={"marker": "blue"}, size=(640, 480))
    observed = lab.observed("wrong-start", seed, duration=2.0, variant="all", marker=True)
    options: dict[str, Any] = {
        "variant": "four",
        "marker": True,
        "duration": EXPLORATION_FACTOR * lab.exploration,
        "joints": FOUR,
    }
    known = explore_by_preset(lab.body("paper", seed, **options))
    body = lab.body("default", seed, **options)
    truth = observed.true(FOUR, observed.truth.t[:1])[0]
    rng = np.random.default_rng([seed, 77])
    starts = {(level, k): truth + off(rng) for level, off in LEVELS.items() for k in range(STARTS)}
    log = sample_signals(observed, FOUR)
    made = run_printed_model(
        log, [build_case(known, IN_USE, "v", start) for start in starts.values()]
    ).x
    late = log.t >= SETTLED_S
    errors = {
        ("printed", *at): _mean_error_degrees((x - log.true)[late])
        for at, x in zip(starts, made, strict=True)
    }
    for at, start in starts.items():
        belief = believe_by_default(
            observed, body, ("vision",), start=tuple(start.tolist()), rate=20.0
        )
        errors["ours", *at] = _mean_error_degrees(belief.error(SETTLED_S))
    return {"figures": _pixelai_figures(errors), "panels": []}


def _pixelai_figures(errors: Mapping[tuple[str, str, int], Array]) -> dict[str, float]:
    figures: dict[str, float] = {}
    for side in SIDES:
        for level in LEVELS:
            found = np.array([errors[side, level, k] for k in range(STARTS)])
            figures |= {
                f"{side} {level} joint {j + 1}": float(v) for j, v in enumerate(found.mean(axis=0))
            }
            figures[f"{side} {level} converged"] = float((found < CONVERGED_DEG).all(axis=1).mean())
    return figures


def _mean_error_degrees(error: Array) -> Array:
    """Mean absolute error (degrees) of each joint."""
    return np.asarray(np.rad2deg(np.abs(error).mean(axis=0)))


def mean_joint_errors(trials: Sequence[Trial], side: str, level: str) -> list[float]:
    """Mean absolute error (degrees) of each joint over all seeds and starts."""
    return [float(np.mean(figure_column(trials, f"{side} {level} joint {j}"))) for j in range(1, 5)]


SHARED_SETUP = (
    "four joints of an arm, vision alone, an arm at rest, starts 5 to 10° off or elsewhere, "
    "forward model learned"
)
DIFFERENT_SETUP = (
    "a UR5 here, a simulated Nao there; places of two coloured balls here, the whole image "
    "there; a Gaussian process "
    "here, a deconvolutional network there"
)


def _claim_pixelai(trials: Sequence[Trial], tried: ExperimentReadings) -> tuple[Claim, ...]:
    def claim(number: int, level: str, what: str, which: int) -> Claim:
        limit = PUBLISHED[level][which]
        text = (
            f"{what}: every joint's mean error is below {limit:g}°, the "
            f"{('best', 'worst')[which]} joint published"
        )
        figures = {f"{side}, by joint": mean_joint_errors(trials, side, level) for side in SIDES}
        return judge_comparison(
            f"PixelAI.{number}",
            text,
            "mean absolute error by joint",
            "°",
            Bound("≤", limit),
            figures,
            SHARED_SETUP,
            DIFFERENT_SETUP,
        )

    levels = {
        "one": "one joint 5 to 10° off",
        "all": "all four 5 to 10° off",
        "elsewhere": "another random pose",
    }
    rows = [(level, what, which) for level, what in levels.items() for which in (1, 0)]
    return tuple(claim(number, *row) for number, row in enumerate(rows, 1))


def _tabulate_pixelai(trials: Sequence[Trial]) -> tuple[TextTable, ...]:
    rows = []
    for level, (best, worst) in PUBLISHED.items():
        for side in SIDES:
            share = f"{np.mean(figure_column(trials, f'{side} {level} converged')):.0%}"
            found = [f"{v:.2f}" for v in mean_joint_errors(trials, side, level)]
            rows.append((level, side, *found, f"{best:g} to {worst:g}", share))
    head = ("start", "model", "joint 1", "joint 2", "joint 3", "joint 4", "published", "converged")
    return (TextTable("Mean absolute error, degrees", head, tuple(rows)),)


EXPERIMENT = Experiment(
    "PixelAI", "Vision only, wrong starts", _run_pixelai, _claim_pixelai, (), _tabulate_pixelai
)
