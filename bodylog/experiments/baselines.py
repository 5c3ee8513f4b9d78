"""Baselines: our filter and smoother, encoders alone, the printed model, and an oracle."""

from collections.abc import Sequence

import numpy as np

from ..types import Array
from .beliefs import BeliefWithTruth, believe_by_default
from .cases import build_case, explore_by_preset, sample_signals
from .claims import Bound, Claim
from .judging import judge_own_claim, median_interval
from .lab import JOINTS, OTHER_LOG_SEED, Lab, ObservedLog
from .oracle import OracleBeliefs, OracleInputs, estimate_by_oracle
from .printed import filter_encoders, run_printed_model
from .records import Experiment, ExperimentReadings, TextTable, Trial, figure_column

DURATION = 20.0
SINCE = 2.0
"""s: duration of a reach, hidden for two seconds in its middle, and start of the errors counted."""
ENCODER_STD = 0.02
"""rad: noise as recorded."""
ROWS = (
    "raw encoders",
    "Kalman filter of the paper, encoders alone",
    "printed model, centre",
    "filter, encoders alone",
    "filter",
    "smoother, encoders alone",
    "smoother",
    "oracle filter, encoders alone",
    "oracle filter",
    "oracle smoother, encoders alone",
    "oracle smoother",
)


def _run_baselines(lab: Lab, seed: int, tried: ExperimentReadings) -> Trial:
    observed = lab.observed("reach", seed + OTHER_LOG_SEED, duration=DURATION, noise=ENCODER_STD)
    body = lab.body("default", seed)
    log = sample_signals(observed)
    start = observed.true(JOINTS, observed.truth.t[:1])[0]
    figures = {
        "raw encoders": _rms_error(_raw_encoder_errors(observed)),
        "printed model, centre": log.error(
            run_printed_model(
                log, [build_case(explore_by_preset(lab.body("paper", seed)), {}, "p+v", start)]
            ).x[0],
            SINCE,
        ),
    }
    figures["Kalman filter of the paper, encoders alone"] = log.error(
        filter_encoders(log, start), SINCE
    )
    for method, name in (("filter", "filter"), ("smoother", "smoother")):
        figures[f"{name}, encoders alone"] = _belief_error(
            believe_by_default(observed, body, ("encoders",), method=method)
        )
        figures[name] = _belief_error(
            believe_by_default(observed, body, ("encoders", "vision"), method=method)
        )
    figures |= _oracle_figures(observed)
    return {"figures": figures, "panels": []}


def _belief_error(belief: BeliefWithTruth) -> float:
    return belief.rmse(SINCE)


def _raw_encoder_errors(observed: ObservedLog) -> Array:
    joints = observed.features.joints
    assert joints is not None
    columns = [joints.names.index(name) for name in JOINTS]
    return np.asarray(
        (joints.values[:, columns] - observed.true(JOINTS, joints.t))[joints.t >= SINCE]
    )


def _rms_error(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _oracle_figures(observed: ObservedLog) -> dict[str, float]:
    figures: dict[str, float] = {}
    for vision, name in ((False, ", encoders alone"), (True, "")):
        sensed = oracle_inputs(observed, vision)
        found = estimate_by_oracle(sensed)
        figures |= {
            f"oracle {kind}{name}": _rms_error(error)
            for kind, error in _oracle_errors(observed, sensed, found).items()
        }
        figures[f"order{name}"] = float(found.order)
    return figures


def _oracle_errors(
    observed: ObservedLog, sensed: OracleInputs, found: OracleBeliefs
) -> dict[str, Array]:
    late = sensed.t >= SINCE
    true = observed.true(JOINTS, sensed.t)
    return {"filter": (found.filtered - true)[late], "smoother": (found.smoothed - true)[late]}


def oracle_inputs(observed: ObservedLog, vision: bool) -> OracleInputs:
    """The oracle's inputs from a log: encoders, and the tracked effector with its true variance."""
    from .drawn import place_in_image

    joints = observed.features.joints
    track = observed.features.effector
    assert joints is not None and track is not None
    t = np.unique(np.concatenate([joints.t, track.t])) if vision else np.unique(joints.t)
    encoders = np.full((len(t), len(JOINTS)), np.nan)
    seen = np.full((len(t), 2), np.nan)
    encoders[np.searchsorted(t, joints.t)] = joints.values[
        :, [joints.names.index(name) for name in JOINTS]
    ]
    off = track.values - place_in_image(observed.true(JOINTS, track.t))
    if vision:
        seen[np.searchsorted(t, track.t)] = track.values
    return OracleInputs(t, encoders, seen, ENCODER_STD**2, np.nanmean(off**2, axis=0))


def _claim_baselines(trials: Sequence[Trial], tried: ExperimentReadings) -> tuple[Claim, ...]:
    def over(more: str, less: str) -> list[float]:
        return [
            a / b
            for a, b in zip(figure_column(trials, more), figure_column(trials, less), strict=True)
        ]

    return (
        judge_own_claim(
            "B.1",
            "vision takes more off our filter's error than encoders alone do",
            "error over that of encoders alone",
            "1",
            Bound("≤", 1.0),
            over("filter", "filter, encoders alone"),
        ),
        judge_own_claim(
            "B.2",
            "the filter errs at most a tenth more than an oracle's",
            "error over the oracle's",
            "1",
            Bound("≤", 1.1),
            over("filter", "oracle filter"),
        ),
        judge_own_claim(
            "B.3",
            "the smoother errs at most a fifth more than an oracle's",
            "error over the oracle's",
            "1",
            Bound("≤", 1.2),
            over("smoother", "oracle smoother"),
        ),
    )


def _tabulate_baselines(trials: Sequence[Trial]) -> tuple[TextTable, ...]:
    def row(name: str) -> tuple[str, str, str]:
        values = figure_column(trials, name)
        low, high = median_interval(values)
        return name, f"{np.median(values):.4f}", f"{low:.4f} to {high:.4f}"

    jerk = float(np.mean([order == 3.0 for order in figure_column(trials, "order")]))
    caption = (
        f"Error over three joints, rad, over {len(trials)} reaches; the oracle's motion is white "
        f"jerk in {jerk:.0%}"
    )
    return (
        TextTable(
            caption,
            ("", "median", "95 % interval of the median"),
            tuple(row(name) for name in ROWS),
        ),
    )


EXPERIMENT = Experiment(
    "Baselines",
    "Encoders alone, and what could be known",
    _run_baselines,
    _claim_baselines,
    (),
    _tabulate_baselines,
)
