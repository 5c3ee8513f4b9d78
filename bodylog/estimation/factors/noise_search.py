"""Noise by evidence: variances, lasting errors and their
time constants, each the most probable one given the log.

The gradient of −ln p of the measurements is the expected gradient of the factors' cost
under the posterior (Fisher's identity), so one solve gives it for all parameters.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np

from ...bfgs import minimise_with_bfgs
from ...types import Array
from ..noise.lasting_error import LONGEST_S
from .columns import Path
from .condensed_slopes import Expected, measure_condensed_slopes
from .condensing import PairFactors, PassedSteps
from .elimination import Smoothed, eliminate_states, smooth_knots
from .encoder_error import JointNoise
from .factor_problem import (
    ANY_ERRORS,
    FactorProblem,
    Linearised,
    Noise,
    build_system,
    linearise_problem,
)
from .gauss_newton import path_from_beliefs
from .load import FIRST_BEND

LOG_SCALE = (0.0, 1.0)
"""Mean and standard deviation of the logarithm of the factor on the variance of images."""
LOG_GROUP = (float(np.log(FIRST_BEND)), 1.5)
"""The same of ln σ of what links bend by (rad): 0.25 to 100 mrad."""
FEWEST_READINGS = 5.0
"""Readings that a lasting error outlasts at least: a shorter one is white noise."""
FLAT_NATS = 1e-3
"""Twice what the last step of the search may gain: parameters are then within √0.001 = 0.03
standard deviations of the most probable ones.
"""
WHITE_SPREAD = ANY_ERRORS.seconds[1]
"""Standard deviation of the logarithm of the variance of readings about its value without errors
that last, as wide as that of τ. Where such errors take all noise of readings, the log says nothing
of that variance, and a search without a prior ends anywhere.
"""
LEAST_PROCESS = 1e-3
"""rad²/s⁵ of a joint that hardly moves. With knots 4 ms apart the information of its motion is
10¹² times that of a reading of 1 mrad, and rounding errs by 10⁻⁴ of the reading's; at 10⁻⁶ it
errs by a tenth.
"""
_SPAN = 1e4
"""Factor by which variances may differ from those with which the search begins: exact readings
would let theirs fall for ever."""


@dataclass(frozen=True, eq=False)
class Learned:
    """Noise by evidence, the path that it gives, −ln p of log
    and noise, and the columns' sizes (C,) with their cov.

    schur (1+C,1+C): what the log says of them, as in `Eliminated` · curvature {pair of parameters}
    of −ln p by their logarithms, as the search saw it.
    """

    noise: Noise
    path: Path
    nats: float
    sizes: Array
    sizes_cov: Array
    schur: Array
    curvature: Mapping[tuple[str, str], float] = field(default_factory=dict)


def learn_noise(
    problem: FactorProblem,
    noise: Noise,
    path: Path,
    step_s: float,
    rounds: int,
    curvature: Mapping[tuple[str, str], float],
    flat: float = FLAT_NATS,
) -> Learned:
    """The most probable noise, from `noise` on; step_s: the encoders' usual step · rounds: times
    that the log is linearised about what the last noise gives · curvature: as `Learned` has it ·
    flat: twice what the last step of the search may gain, nats.
    """
    names, table = _tabulate_parameters(problem, noise, step_s)
    begin, unit, least, most, mean, std = table.T
    guess = np.diag(unit**-2.0)
    for i, j in product(range(len(names)), repeat=2):
        guess[i, j] = curvature.get((names[i], names[j]), guess[i, j])
    for _ in range(rounds):
        linear = linearise_problem(problem, path, noise)

        def weigh_with_prior(p: Array, linear: Linearised = linear) -> tuple[float, Array]:
            nats, slope = _weigh_log(linear, p)
            away = (p - mean) / std
            return nats + float(0.5 * away @ away), slope + away / std

        found = minimise_with_bfgs(
            weigh_with_prior, np.clip(begin, least, most), least, most, guess, flat, 1.0
        )
        begin = found.at
        guess = found.curvature
        noise = _build_noise(found.at, noise)
        system = build_system(replace(linear, noise=noise))
        eliminated = eliminate_states(system)
        beliefs = smooth_knots(system, eliminated)
        path = path_from_beliefs(problem, noise, beliefs)
    return Learned(
        noise,
        path,
        found.loss,
        beliefs.sizes[0],
        beliefs.sizes_cov[0],
        eliminated.schur,
        dict(zip(product(names, names), guess.ravel().tolist(), strict=True)),
    )


def _list_lasting_stds(joints: JointNoise) -> Array:
    """Standard deviations (L,) rad of the lasting errors that are learned."""
    return np.empty(0) if joints.error is None else joints.error[joints.learned]


def _tabulate_parameters(
    problem: FactorProblem, noise: Noise, step_s: float
) -> tuple[tuple[str, ...], Array]:
    """Names of each logarithm, white (M,), process (M,), [σ (L,), τ (),] scales and groups, and
    (P,6): its value, about how far it is known, its limits, and its mean and standard deviation
    before the log.
    """
    joints = noise.joints
    usual = joints if noise.usual is None else noise.usual
    read = np.maximum(np.isfinite(problem.values).sum(axis=0), 2.0)
    seen = np.array([max(images.values.size, 2) for images in problem.images], float)
    wide = np.log(_SPAN)
    white = np.log(usual.white)
    process = np.log(usual.process)
    least = np.log(LEAST_PROCESS)
    # a variance of n readings is known to √(2/n)
    sure = np.sqrt(2.0 / read)
    table: dict[str, tuple[Any, ...]] = {
        "white": (np.log(joints.white), sure, white - wide, white + wide, white, WHITE_SPREAD),
        "process": (np.log(joints.process), 0.15, least, process + wide, 0.0, np.inf),
    }
    errors = _list_lasting_stds(joints)
    if len(errors):
        ends = np.log(FEWEST_READINGS * step_s), np.log(LONGEST_S)
        table["error"] = (np.log(errors), 0.4, np.log(1e-6), np.log(0.3), *noise.prior.error)
        seconds = np.log(joints.seconds[joints.learned][:1])
        table["seconds"] = (seconds, 0.4, *ends, *noise.prior.seconds)
    table["scale"] = (np.log(noise.scales), np.sqrt(2.0 / seen), -wide, wide, *LOG_SCALE)
    table["group"] = (np.log(noise.groups), 0.4, np.log(1e-5), np.log(0.3), *LOG_GROUP)
    rows = {name: np.column_stack(np.broadcast_arrays(*row)) for name, row in table.items()}
    names = tuple(f"{name} {k}" for name, own in rows.items() for k in range(len(own)))
    return names, np.concatenate(list(rows.values()))


def _build_noise(p: Array, like: Noise) -> Noise:
    """The noise of logarithms (P,), as `_tabulate_parameters` lists them."""
    joints = like.joints
    m = len(joints.white)
    white = np.exp(p[:m])
    process = np.exp(p[m : 2 * m])
    rest = p[2 * m :]
    made = replace(joints, white=white, process=process)
    count = len(_list_lasting_stds(joints))
    if count:
        assert joints.error is not None
        error = joints.error.copy()
        seconds = joints.seconds.copy()
        error[joints.learned] = np.exp(rest[:count])
        seconds[joints.learned] = np.exp(rest[count])
        made = replace(made, error=error, seconds=seconds)
        rest = rest[count + 1 :]
    factors = np.exp(rest).tolist()
    first = len(like.scales)
    return replace(like, joints=made, scales=tuple(factors[:first]), groups=tuple(factors[first:]))


def _weigh_log(linear: Linearised, p: Array) -> tuple[float, Array]:
    """−ln p of the log for noise of these logarithms, and its gradient (P,)."""
    posed = replace(linear, noise=_build_noise(p, linear.noise))
    passed = PassedSteps()
    system = build_system(posed, passed)
    eliminated = eliminate_states(system)
    beliefs = smooth_knots(system, eliminated)
    return eliminated.nats, _measure_slopes(posed, beliefs, system.joints, passed)


def _measure_slopes(
    linear: Linearised, beliefs: Smoothed, pairs: PairFactors, passed: PassedSteps
) -> Array:
    """Gradient of −ln p of the log by all logarithms."""
    joints = linear.noise.joints
    expected = _expect_moments(linear, beliefs)
    by = measure_condensed_slopes(linear.readings, joints, pairs, passed, expected)
    parts = [by["white"] + _measure_knot_slopes(linear, beliefs), by["process"]]
    if len(_list_lasting_stds(joints)):
        assert joints.error is not None
        p = joints.state_count
        square = expected.pairs[p - 1, p - 1, 0]
        first = 1.0 - square * joints.start_precision[:, -1, -1]
        parts += [
            (by["error"] + first)[joints.learned],
            by["seconds"][joints.learned].sum(keepdims=True),
        ]
    parts += [_measure_scale_slopes(linear, beliefs), _measure_group_slopes(linear, beliefs)]
    return np.concatenate(parts)


def _expect_moments(linear: Linearised, beliefs: Smoothed) -> Expected:
    """Second moments of neighbouring joint states and the columns' sizes."""
    p = linear.noise.joints.state_count
    m = len(linear.problem.start)
    sizes = beliefs.sizes[0]
    sizes_cov = beliefs.sizes_cov[0]
    c = np.concatenate([[1.0], -sizes])
    columns = np.outer(c, c)
    columns[1:, 1:] += sizes_cov
    shared = beliefs.shared[:, : m * p].reshape(len(beliefs.mean), m, p, len(sizes))
    mean = beliefs.split_joints(linear.noise.joints)
    own, next_to = (
        np.einsum("kapaq->kapq", cov[:, : m * p, : m * p].reshape(-1, m, p, m, p))
        for cov in (beliefs.cov, beliefs.between)
    )
    z = np.concatenate([mean[:-1], mean[1:]], axis=-1)
    x = np.concatenate([shared[:-1], shared[1:]], axis=-2)
    cov = np.block([[own[:-1], next_to], [next_to.swapaxes(-1, -2), own[1:]]])
    pairs = cov + z[..., :, None] * z[..., None, :] + x @ sizes_cov @ x.swapaxes(-1, -2)
    with_columns = z[..., :, None] * c
    with_columns[..., 1:] += x @ sizes_cov
    pairs = np.ascontiguousarray(np.moveaxis(pairs, (2, 3), (0, 1)))
    with_columns = np.ascontiguousarray(np.moveaxis(with_columns, (2, 3), (0, 1)))
    return Expected(pairs, with_columns, columns)


def _measure_knot_slopes(linear: Linearised, beliefs: Smoothed) -> Array:
    """Slopes (M,) by the logarithms of the variance of readings, of those at knots."""
    readings = linear.readings
    joints = linear.noise.joints
    knots = np.arange(len(readings.t))
    rows = joints.build_reading_rows(np.zeros(len(knots)))
    rows = joints.place_rows_on_knots(rows, beliefs.mean.shape[1])
    mean, cov = beliefs.project_rows(rows, knots, readings.at_knot[..., 1:])
    square = np.square(readings.at_knot[..., 0] - mean) + np.einsum("kmm->km", cov)
    slopes = readings.knot_believed - readings.knot_weight / joints.white * square
    return np.asarray(0.5 * slopes.sum(axis=0))


def _measure_group_slopes(linear: Linearised, beliefs: Smoothed) -> Array:
    """Slopes by the logarithms of the groups' standard deviations."""
    columns = linear.problem.columns
    means = np.array([column.mean for column in columns])
    square = np.square(beliefs.sizes[0] - means) + np.diag(beliefs.sizes_cov[0])
    slopes = np.zeros(len(linear.noise.groups))
    shares = square / linear.noise.list_column_stds(columns) ** 2
    for column, one in zip(columns, shares, strict=True):
        if column.group is not None:
            slopes[column.group] += 1.0 - one
    return slopes


def _measure_scale_slopes(linear: Linearised, beliefs: Smoothed) -> Array:
    """Slopes by the logarithms of the factors on images' variances."""
    found = []
    for images, rows, scale in zip(
        linear.problem.images, linear.rows, linear.noise.scales, strict=True
    ):
        mean, cov = beliefs.project_rows(rows.slopes, images.knots, rows.right[..., 1:])
        square = np.square(rows.right[..., 0] - mean) + np.einsum("fdd->fd", cov)
        share = images.believed[:, None]
        found.append(0.5 * float((share * (1.0 - square / (scale * rows.var))).sum()))
    return np.array(found)
