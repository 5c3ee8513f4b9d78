"""The data of the paper's figure 3: joints and sightings,
the learned map, the skin, touches and strokes.

Also the claims of the paper that no simulation can decide.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .. import pipeline
from ..settings import Settings
from ..types import Array, Features, Recording
from .cases import ExplorationSamples, explore_by_preset, sample_signals
from .claims import Claim
from .drawn import effector_position
from .judging import untestable_claim
from .lab import NAMES, Lab, ObservedLog
from .records import Experiment, ExperimentReadings, Trial, build_panel

SECONDS = 30.0
CUTS = 5
"""Values of shoulder 2 at which the learned map is cut."""


def _run_data(lab: Lab, seed: int, tried: ExperimentReadings) -> Trial:
    """Drawn for the first seed alone: it shows no figure of merit."""
    if seed:
        return {"figures": {}, "panels": []}
    observed = lab.observed("horizontal", seed, duration=lab.exploration)
    known = explore_by_preset(lab.body("paper", seed, "horizontal"))
    read, features = pipeline.observe(lab.log("touch", seed, duration=SECONDS), Settings())
    return {
        "figures": {},
        "panels": [
            *_exploration_panels(observed),
            *_learned_map_panels(known),
            *_skin_panels(read),
            *_touch_pattern_panels(features),
        ],
    }


def _exploration_panels(observed: ObservedLog) -> list[dict[str, Any]]:
    log = sample_signals(observed)
    joints = {f"{name}, encoder": log.encoders[:, i] for i, name in enumerate(NAMES)}
    joints |= {f"{name}, truth": log.true[:, i] for i, name in enumerate(NAMES)}
    return [
        build_panel("joint angles and encoders", "rad", log.t, joints, "3a"),
        build_panel(
            "end effector, seen",
            "px",
            log.t,
            {name: log.place[:, i] for i, name in enumerate("uv")},
            "3a",
        ),
        build_panel(
            "end effector, where it is",
            "m",
            log.t,
            dict(zip("xyz", effector_position(log.true).T, strict=True)),
            "3a",
        ),
    ]


def _learned_map_panels(known: ExplorationSamples) -> list[dict[str, Any]]:
    """u over shoulder 1 at some angles of shoulder 2, from
    46 samples by greatest evidence: mean, and deviation.
    """
    from ..body.gp.fit import samples_without_noise, train_gp

    gp = train_gp(samples_without_noise(known.x, known.y), ("u", "v"), "px")
    low = known.x.min(axis=0)
    high = known.x.max(axis=0)
    across = np.linspace(low[0] - 0.2, high[0] + 0.2, 80)
    means = dict[str, Array]()
    spreads = dict[str, Array]()
    for second in np.linspace(low[1], high[1], CUTS):
        mean, _, variance = gp.predict(
            np.column_stack([across, np.full(80, second), np.full(80, known.home[2])])
        )
        name = f"shoulder 2 = {second:.2f} rad"
        means[name] = mean[:, 0]
        spreads[name] = np.sqrt(variance[:, 0])
    return [
        build_panel("learned horizontal place, mean", "px", across, means, "3b", "shoulder 1, rad"),
        build_panel("its standard deviation", "px", across, spreads, "3b", "shoulder 1, rad"),
    ]


def _skin_panels(read: Recording) -> list[dict[str, Any]]:
    """All cells, the most active first."""
    assert read.signals.skin is not None
    order = np.argsort(-read.signals.skin.values.max(axis=0), kind="stable")
    cells = {f"cell {k}": read.signals.skin.values[:, k] for k in order.tolist()}
    return [build_panel("skin proximity", "1", read.signals.skin.t, cells, "3c")]


def _touch_pattern_panels(features: Features) -> list[dict[str, Any]]:
    t = np.arange(0.0, SECONDS, 0.02)
    felt = sum(
        (((t >= one.onset) & (t <= one.offset)).astype(float) for one in features.touches or ()),
        np.zeros(len(t)),
    )
    seen = sum(
        (((t >= one.start) & (t <= one.end)).astype(float) for one in features.strokes),
        np.zeros(len(t)),
    )
    panels = [
        build_panel(
            "touch pattern, felt and seen",
            "1",
            t,
            {"felt by the skin": felt, "seen as strokes": seen},
            "3d",
        )
    ]
    hand = features.hand
    if hand is None:
        return panels
    return [
        *panels,
        build_panel(
            "the hand's track",
            "px",
            hand.t,
            {n: hand.values[:, i] for i, n in enumerate("uv")},
            "3d",
        ),
    ]


UNTESTABLE = {
    "the model works on the real TOMM robot's UR-5 arm": (
        "the paper's recordings are not published; `bodylog reproduce real --data DIR` "
        "judges other robots'"
    ),
    "a and b agree with data from human participants": (
        "neither the data nor the fit is printed; readings of a_2 and b_2 stand in"
    ),
    "the illusion is like the one humans have": "there are no human participants; "
    "Rubber-hand gives the robot's side",
    "the model is biologically plausible": "no figure is claimed",
}
"""Claims of the paper that no simulation can decide, and why."""


def _claim_untestable(trials: Sequence[Trial], tried: ExperimentReadings) -> tuple[Claim, ...]:
    return tuple(
        untestable_claim(f"Data.{k}", text, why)
        for k, (text, why) in enumerate(UNTESTABLE.items(), 1)
    )


EXPERIMENT = Experiment("Data", "What is sensed and learned", _run_data, _claim_untestable)
