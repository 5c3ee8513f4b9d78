"""Tracks of one instant, linearised until the belief converges."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ...types import Array
from ..noise.correlated_noise import LastFrame, PendingFrame
from .convergence import MAX_SWEEPS

NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(5)
WEIGHTS /= WEIGHTS.sum()
PERSISTENCE = 10.0
"""Factor on the time for which the residual of a line lasts, by the belief.

Of 1, 3.3, 10 and 33 on 26 drawn silences of 5 s, filters
have NEES 7.5, 3.4, 1.6, 1.6 and errors of 0.20, 0.18, 0.18,
0.19 rad.
"""


class Line(NamedTuple):
    """A track linearised to D rows: y (D,) = jac (D,M) x with independent variances var (D,).

    memory: of the track.
    """

    jac: Array
    y: Array
    var: Array
    memory: LastFrame


def standardise_innovations(x: Array, cov: Array, sights: Sequence[PendingFrame]) -> list[Array]:
    """Innovations (D,) of each track in standard deviations,
    by angles x (M,) of cov (M,M) before the instant.
    """
    found = []
    for sight in sights:
        mean, jac, model = sight.predicted(x)
        found.append(
            (sight.value - mean) / np.sqrt(((jac @ cov) * jac).sum(axis=1) + sight.var + model)
        )
    return found


def find_tangent_point(
    x: Array,
    sights: Sequence[PendingFrame],
    posterior: Callable[[list[Line]], Array],
    resting: float,
) -> tuple[Array, list[Line]]:
    """The point (M,) where the belief converges to `resting`
    rad, or moves least, and the tracks' tangents there.

    The search starts at the angles x (M,) before the instant;
    `posterior` gives those by all readings and lines.
    """
    went = last = np.zeros(len(x))
    least = math.inf
    best = (x, list[Line]())
    for _ in range(MAX_SWEEPS):
        lines = [_linearise_frame(sight, x) for sight in sights]
        move = posterior(lines) - x
        size = max(map(abs, move.tolist()))
        if not size >= least:
            least = size
            best = (x, lines)
        if size < resting:
            break
        went = _accelerate_step(move, last, went)
        last = move
        x = x + went
    return best


def _linearise_frame(sight: PendingFrame, x: Array) -> Line:
    mean, jac, _, var, memory = sight.at(x)
    return Line(jac, sight.value - mean + jac @ x, var, memory)


def _accelerate_step(move: Array, last: Array, went: Array) -> Array:
    """Next step (M,) from Gauss–Newton's `move`, the
    `last` one and the step taken then: Anderson mixing.
    """
    turn = move - last
    size = turn @ turn
    return move if size == 0.0 or not went.any() else move - (turn @ move / size) * (went + turn)


def statistical_lines(m: int, z: Array, p: Array, sights: Sequence[PendingFrame]) -> list[Line]:
    """Lines of least squared residual over the encoders'
    posterior of M angles: state z (K,), covariance p (K,K).

    The residual is a function of the belief's error, which lasts: with a Gaussian correlation over
    √(variance of the angle / of the rate), it counts √π of that, over the time between frames, as
    often; PERSISTENCE times more, as a wrong belief takes itself for a short one.
    """
    (var, axes), rates = _decompose_covariance(p[:m, :m]), p[m : 2 * m, m : 2 * m]
    if not np.trace(rates) > 0.0:
        raise np.linalg.LinAlgError(f"rates have the variance {np.trace(rates):.3g} rad²/s²")
    # above rounding, which a rate known exactly may take below 0
    rate = max(axes[:, -1] @ rates @ axes[:, -1], np.finfo(float).eps * np.trace(rates))
    lasts = PERSISTENCE * math.sqrt(math.pi * var[-1] / rate)
    often = [1.0 / math.tanh((sight.t - sight.memory.t) / lasts) for sight in sights]
    return [
        linearise_over_belief(sight, z[:m], p[:m, :m], one)
        for sight, one in zip(sights, often, strict=True)
    ]


def _decompose_covariance(cov: Array) -> tuple[Array, Array]:
    """Variances (M,) along the axes (M,M), in columns, of a covariance; above 0."""
    var, axes = np.linalg.eigh(cov)
    return np.maximum(var, np.finfo(float).tiny), axes


def linearise_over_belief(sight: PendingFrame, x: Array, cov: Array, often: float = 1.0) -> Line:
    """A track's line over a belief x (M,) of cov (M,M).

    The residual is added as noise, as the tangent of a wide belief claims
    too much: along each axis of cov, by Gauss–Hermite quadrature, counted
    as `often`. Rows are rotated such that their noise is independent.
    """
    *_, own, memory = sight.at(x)
    var, axes = _decompose_covariance(cov)
    steps = np.sqrt(var)[:, None] * axes.T
    points = x + NODES[:, None, None] * steps
    g = sight.predict(points.reshape(-1, len(x)))[0].reshape(len(NODES), len(x), -1)
    means, slopes = (np.einsum("k,kad->ad", weights, g) for weights in (WEIGHTS, WEIGHTS * NODES))
    missed = np.sqrt(WEIGHTS)[:, None, None] * (g - means - NODES[:, None, None] * slopes)
    slope = np.linalg.solve(steps, slopes).T
    middle = g[len(NODES) // 2, 0]
    middle = middle + (means - middle).sum(axis=0)
    spread, turn = np.linalg.eigh(often * np.einsum("kad,kae->de", missed, missed) + np.diag(own))
    return Line(turn.T @ slope, turn.T @ (sight.value - middle + slope @ x), spread, memory)
