"""Baselines: our filter and smoother, encoders alone, the printed model, and an oracle."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import factorial

import numpy as np

from ..evaluation.scores import root_mean_square
from ..types import Array
from .beliefs import BeliefWithTruth, believe_by_default
from .cases import build_case, explore_by_preset, sample_signals
from .claims import Bound, Claim
from .drawn import place_in_image
from .judging import judge_own_claim, median_interval
from .lab import JOINTS, OTHER_LOG_SEED, Lab, ObservedLog
from .printed import filter_encoders, run_printed_model
from .records import Experiment, ExperimentReadings, TextTable, Trial, figure_column, figure_ratios

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
DENSITIES = {2: np.geomspace(0.003, 3.0, 7), 3: np.geomspace(0.03, 300.0, 9)}
"""rad²/s³ of white acceleration · rad²/s⁵ of white jerk: tried by order of the motion."""
PASSES = 2
"""Times that frames are linearised again at the smoother's own path."""
STEP = 1e-6
"""rad: step of the camera's numerical slopes."""


@dataclass(frozen=True, eq=False)
class OracleInputs:
    """Readings at times t (E,) s: encoders (E,M) rad,
    place (E,2) px, NaN where absent; and their variances.
    """

    t: Array
    encoders: Array
    place: Array
    encoder_var: float
    pixel_var: Array


@dataclass(frozen=True, eq=False)
class OracleBeliefs:
    """The filter's and the smoother's beliefs: (E,M) rad
    each, and the motion's order of greatest evidence.
    """

    filtered: Array
    smoothed: Array
    order: int


@dataclass(frozen=True, eq=False)
class _FilterPass:
    """A filter's pass: move (E,D,D) · prior, mean (E,Q,D)
    · prior_cov, cov (E,Q,D,D) · evidence (Q,) nats.
    """

    move: Array
    prior: Array
    prior_cov: Array
    mean: Array
    cov: Array
    nats: Array


def _run_baselines(lab: Lab, seed: int, tried: ExperimentReadings) -> Trial:
    observed = lab.observed("reach", seed + OTHER_LOG_SEED, duration=DURATION, noise=ENCODER_STD)
    body = lab.body("default", seed)
    log = sample_signals(observed)
    start = observed.true(JOINTS, observed.truth.t[:1])[0]
    figures = {
        "raw encoders": root_mean_square(_raw_encoder_errors(observed)),
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


def _oracle_figures(observed: ObservedLog) -> dict[str, float]:
    figures: dict[str, float] = {}
    for vision, name in ((False, ", encoders alone"), (True, "")):
        sensed = oracle_inputs(observed, vision)
        found = estimate_by_oracle(sensed)
        figures |= {
            f"oracle {kind}{name}": root_mean_square(error)
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
    over = partial(figure_ratios, trials)
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


def estimate_by_oracle(inputs: OracleInputs) -> OracleBeliefs:
    """The beliefs by the order and density of greatest evidence."""
    runs = {order: _filter_forward(inputs, order, DENSITIES[order], None) for order in DENSITIES}
    order = max(runs, key=lambda o: float(runs[o].nats.max()))
    best = DENSITIES[order][[int(runs[order].nats.argmax())]]
    joints = inputs.encoders.shape[1]
    run = _filter_forward(inputs, order, best, None)
    filtered = run.mean[:, 0, :joints]
    path = None
    for _ in range(PASSES):
        path = _smooth_backward(run)[..., :joints]
        run = _filter_forward(inputs, order, best, path)
    return OracleBeliefs(filtered, _smooth_backward(run)[:, 0, :joints], order)


def discretise_motion(order: int, dt: float, joints: int) -> tuple[Array, Array]:
    """Transition (D,D) and noise (D,D) of unit density over
    dt s, of `order` derivatives driven by white noise.
    """
    move = np.array(
        [
            [dt ** (j - i) / factorial(j - i) if j >= i else 0.0 for j in range(order)]
            for i in range(order)
        ]
    )
    up = [order - 1 - i for i in range(order)]
    noise = [
        [dt ** (a + b + 1) / ((a + b + 1) * factorial(a) * factorial(b)) for b in up] for a in up
    ]
    return np.kron(move, np.eye(joints)), np.kron(np.array(noise), np.eye(joints))


def _filter_forward(
    inputs: OracleInputs, order: int, densities: Array, path: Array | None
) -> _FilterPass:
    joints = inputs.encoders.shape[1]
    count = len(densities)
    first = np.array([column[np.isfinite(column)][0] for column in inputs.encoders.T])
    z = np.tile(np.concatenate([first, np.zeros((order - 1) * joints)]), (count, 1))
    p = np.tile(np.eye(order * joints), (count, 1, 1))
    nats = np.zeros(count)
    rows: tuple[list[Array], ...] = ([], [], [], [], [])
    for k, dt in enumerate(np.diff(inputs.t, prepend=inputs.t[0])):
        move, noise = discretise_motion(order, float(dt), joints)
        z = z @ move.T
        p = move @ p @ move.T + densities[:, None, None] * noise
        prior = z
        prior_cov = p
        at = z[:, :joints] if path is None else path[k]
        z, p, more = _update_with_readings(inputs, k, z, p, at)
        nats = nats + more
        for row, value in zip(rows, (move, prior, prior_cov, z, p), strict=True):
            row.append(value)
    moves, priors, prior_covs, means, covs = (np.array(row) for row in rows)
    return _FilterPass(moves, priors, prior_covs, means, covs, nats)


def _update_with_readings(
    inputs: OracleInputs, k: int, z: Array, p: Array, at: Array
) -> tuple[Array, Array, Array]:
    """One update with all readings of an instant, the
    camera linearised at (Q,M) rad; its evidence (Q,) nats.
    """
    joints = inputs.encoders.shape[1]
    count, size = z.shape
    use = np.flatnonzero(np.isfinite(inputs.encoders[k]))
    h = [np.tile(np.eye(size)[use], (count, 1, 1))]
    y = [np.tile(inputs.encoders[k, use], (count, 1))]
    r = [np.full(len(use), inputs.encoder_var)]
    if np.isfinite(inputs.place[k]).all():
        steps = STEP * np.eye(joints)
        near = at[:, None] + np.concatenate([np.zeros((1, joints)), steps, -steps])
        seen = place_in_image(near.reshape(-1, joints)).reshape(count, -1, 2)
        slope = np.swapaxes(seen[:, 1 : joints + 1] - seen[:, joints + 1 :], 1, 2) / (2.0 * STEP)
        h.append(np.concatenate([slope, np.zeros((count, 2, size - joints))], axis=2))
        y.append(inputs.place[k] - seen[:, 0] + np.einsum("qdm,qm->qd", slope, at))
        r.append(inputs.pixel_var)
    design = np.concatenate(h, axis=1)
    noise = np.diag(np.concatenate(r))
    if not len(noise):
        return z, p, np.zeros(count)
    off = np.concatenate(y, axis=1) - np.einsum("qdk,qk->qd", design, z)
    spread = design @ p @ np.swapaxes(design, 1, 2) + noise
    gain = np.swapaxes(np.linalg.solve(spread, design @ p), 1, 2)
    keep = np.eye(size) - gain @ design
    cov = keep @ p @ np.swapaxes(keep, 1, 2) + gain @ noise @ np.swapaxes(gain, 1, 2)
    scaled = np.linalg.solve(spread, off[..., None])[..., 0]
    nats = -0.5 * ((off * scaled).sum(axis=1) + np.linalg.slogdet(2.0 * np.pi * spread)[1])
    return z + np.einsum("qkd,qd->qk", gain, off), cov, nats


def _smooth_backward(run: _FilterPass) -> Array:
    """The smoothed means (E,Q,D)."""
    smooth = [run.mean[-1]]
    for k in range(len(run.mean) - 2, -1, -1):
        gain = np.swapaxes(
            np.linalg.solve(run.prior_cov[k + 1], run.move[k + 1] @ run.cov[k]), 1, 2
        )
        smooth.append(run.mean[k] + np.einsum("qij,qj->qi", gain, smooth[-1] - run.prior[k + 1]))
    return np.array(smooth[::-1])
