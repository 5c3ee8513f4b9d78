"""The rubber hand as an instrument: our default's drift
by asynchrony, displacement, encoder noise and side.

The arm is hidden, still and stroked; the image of the stroking hand is delayed and displaced, as
with a camera feed. Touch's effect is the belief with touch minus the belief without it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..body_model import BodyModel
from ..estimation.measurements.touch import has_weight
from ..perception.touch.matching import match_touches as synchrony
from ..types import Array, Features
from .beliefs import BeliefWithTruth, add_encoder_noise, believe_by_default
from .claims import Bound, Claim
from .drawn import SIZE, px_per_cm
from .e5_rubber_hand import CALM, DISPLACEMENT, SIDES, final_drift, record_strokes
from .judging import judge_own_claim
from .lab import Lab, ObservedLog
from .records import Experiment, ExperimentReadings, TextTable, Trial, build_panel, figure_column

NOISE = 0.1
"""rad: noise added to the encoders in the documented
setting: some degrees, like human proprioception.
"""
PRIOR = 0.5
"""Prior probability of a common cause where it is inferred: both explanations are as likely."""
FAR_CM = 30.0
"""Displacement toward which people's illusion fades (Samad et al. 2015, figure 3)."""
DRIFT_GONE_S = 0.6
"""s: asynchrony at which the drift must be gone."""


@dataclass(frozen=True)
class Setting:
    """Sweeps: asynchronies s · displacements as multiples
    of the recorded one · noises rad, around the documented.
    """

    asynchrony: tuple[float, ...] = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 1.0)
    displacement: tuple[float, ...] = (0.125, 0.25, 0.375, 0.5, 1.0, 1.5, 2.0, 3.0)
    noise: tuple[float, ...] = (0.02, 0.05, 0.1, 0.2, 0.3)


SETTING = Setting()


@dataclass(frozen=True, eq=False)
class TouchDrift:
    """Touch's effect: t (N,) s · px (N,) sideways · rad (N,M)."""

    t: Array
    px: Array
    rad: Array

    @property
    def most(self) -> float:
        """The px of greatest size after the calm."""
        return final_drift(self.t, self.px)

    @property
    def joint(self) -> float:
        """The largest move (rad) of a joint after the calm."""
        return float(np.abs(self.rad[self.t >= CALM]).max())


def displace_hand(log: ObservedLog, delay: float, share: float, side: float) -> ObservedLog:
    """The log with the image of the hand `delay` s later
    and `share` times as far aside; side −1 left, 1 right.
    """
    features = log.features
    hand = features.hand
    assert hand is not None
    aside = np.array([side * (share - 1.0) * DISPLACEMENT, 0.0])
    moved = replace(hand, t=hand.t + delay, values=hand.values + aside)
    strokes = tuple(replace(s, start=s.start + delay, end=s.end + delay) for s in features.strokes)
    found, _ = synchrony(features.touches or (), strokes)
    tracks = {**features.tracks, "hand": moved}
    return replace(log, features=replace(features, tracks=tracks, strokes=strokes, synchrony=found))


def has_weighted_touch(features: Features) -> bool:
    """Whether any touch has a weight: an estimate rejects a requested sense without readings."""
    return any(has_weight(pair) for pair in features.synchrony)


def measure_drift(
    log: ObservedLog, body: BodyModel, alone: BeliefWithTruth, common_cause: float | None = None
) -> TouchDrift:
    """Touch's effect on the belief; `alone` is the belief without touch.

    common_cause: prior probability that touch and stroke have one cause; None takes it for granted.
    """
    sized = replace(log, features=replace(log.features, picture_size=SIZE))
    touched = alone
    if has_weighted_touch(log.features):
        touched = believe_by_default(sized, body, ("encoders", "touch"), common_cause=common_cause)
    model = body.senses["effector"]
    before = alone.at(touched.t)
    px = model.predict(touched.x)[0][:, 0] - model.predict(before)[0][:, 0]
    return TouchDrift(touched.t, px, touched.x - before)


def run_rubber_hand_sweeps(
    lab: Lab, seed: int, tried: ExperimentReadings, setting: Setting = SETTING
) -> Trial:
    """One seed of the instrument."""
    body = lab.body("default", seed, touched=True)
    figures: dict[str, float] = {}
    courses: dict[str, TouchDrift] = {}
    for side, sign in SIDES.items():
        log = record_strokes(lab, seed, "synchronous", side)
        measured = _build_drift_function(log, body, sign, seed)
        for delay in setting.asynchrony:
            courses[f"{side}, {delay:g} s late"] = measured(NOISE, delay, 1.0)
            figures |= _name_drift_figures(
                f"asynchrony {delay:g} {side}", courses[f"{side}, {delay:g} s late"], sign, 1.0
            )
        if side == "right":
            for share in setting.displacement:
                figures |= _name_drift_figures(
                    f"displacement {share:g} {side}", measured(NOISE, 0.0, share), sign, share
                )
                inferred = measured(NOISE, 0.0, share, PRIOR)
                figures |= _name_drift_figures(
                    f"inferred displacement {share:g} {side}", inferred, sign, share
                )
            for noise in setting.noise:
                figures |= _name_drift_figures(
                    f"noise {noise:g} {side}", measured(noise, 0.0, 1.0), sign, 1.0
                )
    figures |= _summarise_asynchrony(figures, setting) | _summarise_fading(figures, setting)
    return {
        "figures": figures,
        "panels": [*_drift_course_panels(courses), _summarise_displacement(figures, setting)],
    }


def _build_drift_function(
    log: ObservedLog, body: BodyModel, sign: float, seed: int
) -> Callable[..., TouchDrift]:
    """drift(noise rad, delay s, share of the displacement, prior of a common cause or None).

    The belief without touch is found once per noise.
    """
    alone: dict[float, tuple[ObservedLog, BeliefWithTruth]] = {}

    def measured(
        noise: float, delay: float, share: float, common_cause: float | None = None
    ) -> TouchDrift:
        if noise not in alone:
            poor = add_encoder_noise(log, noise, seed)
            alone[noise] = poor, believe_by_default(poor, body, ("encoders",))
        poor, without = alone[noise]
        return measure_drift(displace_hand(poor, delay, share, sign), body, without, common_cause)

    return measured


def _name_drift_figures(
    name: str, found: TouchDrift, sign: float, share: float
) -> dict[str, float]:
    """Drift toward the hand: share of the displacement, px,
    cm at the effector's distance, largest move of a joint.
    """
    px = sign * found.most
    return {
        name: px / (share * DISPLACEMENT),
        f"{name} px": px,
        f"{name} cm": px / px_per_cm(),
        f"{name} rad": found.joint,
    }


def _summarise_asynchrony(figures: dict[str, float], setting: Setting) -> dict[str, float]:
    """Over both sides: lesser synchronous drift, greater drift
    at DRIFT_GONE_S s or more, largest rise with asynchrony.
    """
    both = {
        side: [figures[f"asynchrony {d:g} {side}"] for d in setting.asynchrony] for side in SIDES
    }
    mean = np.mean(list(both.values()), axis=0)
    late = [
        abs(found[k])
        for found in both.values()
        for k, d in enumerate(setting.asynchrony)
        if d >= DRIFT_GONE_S
    ]
    return {
        "in time": float(min(found[0] for found in both.values())),
        "late": float(max(late, default=float("nan"))),
        "rise": float(np.diff(mean).max(initial=-np.inf)) if len(mean) > 1 else float("nan"),
    }


def _summarise_fading(figures: dict[str, float], setting: Setting) -> dict[str, float]:
    """With the cause inferred: the largest drift at FAR_CM
    and beyond over the largest of all; none where none is.
    """
    drifts = {
        share: abs(figures[f"inferred displacement {share:g} right cm"])
        for share in setting.displacement
    }
    far = [drift for share, drift in drifts.items() if share * DISPLACEMENT / px_per_cm() >= FAR_CM]
    return {"faded": max(far) / max(drifts.values())} if far else {}


def _summarise_displacement(figures: dict[str, float], setting: Setting) -> dict[str, Any]:
    """Drift over displacement: a common cause taken for granted, and inferred."""
    aside = [share * DISPLACEMENT / px_per_cm() for share in setting.displacement]
    kinds = {
        "common cause taken for granted": "displacement",
        "common cause inferred": "inferred displacement",
    }
    lines = {
        label: [figures[f"{kind} {share:g} right cm"] for share in setting.displacement]
        for label, kind in kinds.items()
    }
    return build_panel(
        "drift by displacement, hand on the right", "cm", aside, lines, axis="cm aside"
    )


def _drift_course_panels(courses: dict[str, TouchDrift]) -> list[dict[str, Any]]:
    first = next(iter(courses.values()))
    late = {name: found.px for name, found in courses.items() if name.startswith("right")}
    sides = {name: found for name, found in courses.items() if name.endswith(" 0 s late")}
    shares = {
        name: np.interp(first.t, found.t, np.abs(found.px) / DISPLACEMENT)
        for name, found in sides.items()
    }
    return [
        build_panel("drift of the effector, hand on the right", "px", first.t, late),
        build_panel("drift in time, over the displacement", "1", first.t, shares),
    ]


def _claim_drift_by_cause(trials: Sequence[Trial], tried: ExperimentReadings) -> tuple[Claim, ...]:
    why = (
        f"documented: {NOISE:g} rad of noise on the encoders, hand "
        f"{DISPLACEMENT / px_per_cm():.0f} cm aside"
    )
    return (
        judge_own_claim(
            "RH.1",
            "synchronous strokes drift the belief by at least 15 % of the displacement, "
            "toward either side",
            "lesser drift of both sides over the displacement",
            "1",
            Bound("≥", 0.15),
            figure_column(trials, "in time"),
            why,
        ),
        judge_own_claim(
            "RH.2",
            "0.6 s late and later they drift it by at most 2 %",
            "greatest drift over the displacement",
            "1",
            Bound("≤", 0.02),
            figure_column(trials, "late"),
            why,
        ),
        judge_own_claim(
            "RH.3",
            "the drift falls with asynchrony",
            "largest rise from one asynchrony to the next",
            "1",
            Bound("≤", 0.0),
            figure_column(trials, "rise"),
            "means of both sides",
        ),
        judge_own_claim(
            "RH.4",
            "the drift's sign follows the side of the hand",
            "share of sides with that sign",
            "1",
            Bound("≥", 1.0),
            [float(v > 0.0) for v in figure_column(trials, "in time")],
        ),
        *_claim_of_fading(trials),
    )


def _claim_of_fading(trials: Sequence[Trial]) -> tuple[Claim, ...]:
    """A claim where the hand was seen far enough aside."""
    if "faded" not in trials[0]["figures"]:
        return ()
    text = (
        f"with a common cause inferred (prior {PRIOR:g}) the drift fades toward {FAR_CM:g} cm aside"
    )
    measured = f"drift from {FAR_CM:g} cm on over the largest"
    return (
        judge_own_claim(
            "RH.5", text, measured, "1", Bound("≤", 0.1), figure_column(trials, "faded")
        ),
    )


def _tabulate_drift_sweeps(trials: Sequence[Trial]) -> tuple[TextTable, ...]:
    head = ("", "share of the displacement", "px", "cm", "largest move of a joint, rad")
    units = {
        "asynchrony": "s late",
        "displacement": f"× {DISPLACEMENT / px_per_cm():.1f} cm aside",
        "inferred displacement": f"× {DISPLACEMENT / px_per_cm():.1f} cm aside",
        "noise": "rad of noise",
    }
    tables = []
    for what, unit in units.items():
        names = [
            n for n in trials[0]["figures"] if n.startswith(f"{what} ") and n.endswith(" right")
        ]
        rows = tuple((f"{name.split()[-2]} {unit}", *_median_cells(trials, name)) for name in names)
        tables.append(
            TextTable(
                f"Drift toward a hand on the right by {what}, medians over the seeds", head, rows
            )
        )
    return tuple(tables)


def _median_cells(trials: Sequence[Trial], name: str) -> tuple[str, ...]:
    values = [
        float(np.median(figure_column(trials, found)))
        for found in (name, f"{name} px", f"{name} cm", f"{name} rad")
    ]
    return f"{values[0]:.3f}", f"{values[1]:.2f}", f"{values[2]:.2f}", f"{values[3]:.4f}"


EXPERIMENT = Experiment(
    "Rubber-hand",
    "The rubber hand as an instrument",
    run_rubber_hand_sweeps,
    _claim_drift_by_cause,
    (),
    _tabulate_drift_sweeps,
)
