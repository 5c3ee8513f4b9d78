"""The table of experiments: one file and one line each."""

from . import (
    baselines,
    data,
    e1_ablation,
    e2_nonlinear,
    e3_drift,
    e4_refinement,
    e5_rubber_hand,
    e6_cost,
    errata,
    pixelai,
    real,
    rubber_hand,
)
from .records import Experiment

EXPERIMENTS: dict[str, Experiment] = {
    "Data": data.EXPERIMENT,
    "E1": e1_ablation.EXPERIMENT,
    "E2": e2_nonlinear.EXPERIMENT,
    "E3": e3_drift.EXPERIMENT,
    "E4": e4_refinement.EXPERIMENT,
    "E5": e5_rubber_hand.EXPERIMENT,
    "E6": e6_cost.EXPERIMENT,
    "Rubber-hand": rubber_hand.EXPERIMENT,
    "PixelAI": pixelai.EXPERIMENT,
    "Baselines": baselines.EXPERIMENT,
    "Errata": errata.EXPERIMENT,
    "Real": real.EXPERIMENT,
}

RUN_ONLY_WHEN_NAMED = ("Real",)
"""Experiments that run only when they are named."""

UNSEEDED = ("E6", "Real")
"""Experiments that draw no random number: they run once."""
