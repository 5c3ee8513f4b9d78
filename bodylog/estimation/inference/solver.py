"""Belief about a whole log by Gauss–Newton on its banded information matrix: filtered or smoothed."""

from dataclasses import dataclass, replace
from math import factorial

import numpy as np

from ...types import Array
from .banded import Factor, factored
from .bridge import Bridge
from .convergence import DidNotConverge
from .images import RESTING, Images
from .interior import Forward, forward, predicted, seen
from .mixture import inlier, raised
from .posed import Chain, Rows, fade, posed
from .small import spd_inverse

SWEEPS = 30
ROUNDS = 12
"""Most rounds of outlier weighting."""
ROUNDING = 1e-5
"""rad: smaller moves that no longer shrink come from rounding, where joints rest and process noise is small."""
ROW = 2
"""Most consecutive readings of one encoder that can be outliers on the same side."""
SAME = 1e-2
"""Tolerance on outliers' weights."""


@dataclass(frozen=True, eq=False)
class Log:
    """One log to be solved: its chain, images by track, and variances (M,) rad² of the exploring encoders.

    slots_var: encoders' variances without outliers · density: of outliers, for encoders (per rad) and for each track
    (per px²).
    """

    chain: Chain
    images: tuple[Images, ...]
    encoder: Array
    slots_var: Array
    density: tuple[float, ...]

    @property
    def errors(self) -> int:
        """Number of unit error states of all images."""
        return sum(len(one.y) for one in self.images if one.errors)

    def rows(self) -> list[Rows]:
        """All tracks' linear rows."""
        found: list[Rows] = []
        for k, one in enumerate(self.images):
            found.append(one.rows([other for other in self.images[:k] if other.errors], self.encoder))
        return found


@dataclass(frozen=True, eq=False)
class TrackInnovations:
    """One track's innovations (D,F) before each image, their covariance (D,D,F), nats (F,)."""

    innovation: Array
    total: Array
    nats: Array


@dataclass(frozen=True, eq=False)
class Solved:
    """Nominal states (K,B) at the knots, about which rows are linearised; the last factor, and the filter's results.

    past: filtered means (K,B) and covariances (K,K,B) of the knots · sights: innovations of each track.
    """

    log: Log
    nominal: Array
    factor: Factor
    bridge: Bridge
    past: tuple[Array, Array]
    forth: Forward
    sights: tuple[TrackInnovations, ...]


def solve(log: Log, nominal: Array, smooth: bool) -> Solved:
    """Solve from nominal states (K,B): images are linearised at the filtered means, or along the smoothed path.

    DidNotConverge if it does not converge.
    """
    for _ in range(ROUNDS):
        found = log.chain.bridge(remember=smooth)
        nominal, factor, past = _swept(log, found, nominal, smooth)
        forth, sights = judged(log, past)
        solved = Solved(log, nominal, factor, found, past, forth, sights)
        log, changed = weighed(solved)
        if changed < SAME:
            return solved
    return solved


def points(chain: Chain, one: Images, nominal: Array) -> Array:
    """Angles (M,F) at a track's images, from nominal states (K,B)."""
    s, states = chain.motion.states, nominal[: chain.motion.joints * chain.motion.states]
    found = states[::s][:, one.knots]
    if one.early.any():
        found = found + sum(
            states[lag::s][:, one.knots] * (one.early**lag / factorial(lag)) for lag in range(1, chain.motion.order)
        )
    return np.asarray(found)


def _swept(log: Log, found: Bridge, nominal: Array, smooth: bool) -> tuple[Array, Factor, tuple[Array, Array]]:
    """Converged nominal states (K,B), the factor about them, and the filtered knots."""
    s, step, last, factor = log.chain.motion.states, np.inf, np.inf, None
    angles = slice(0, log.chain.motion.joints * s, s)
    for _ in range(SWEEPS):
        moved = any([one.follow(points(log.chain, one, nominal)) for one in log.images])
        rounding = step < ROUNDING and step > 0.5 * last
        if factor is not None and (rounding or (step < RESTING and not moved)):
            break
        factor, about = factored(posed(log.chain, found, log.rows(), nominal)[0]), nominal
        mean, cov = (factor.solution(), None) if smooth else filtered(log, factor, nominal)
        step, last, nominal = float(np.abs(mean[angles]).max()), step, nominal + mean
        if not np.isfinite(step):
            break
    else:
        raise DidNotConverge(f"no rest after {SWEEPS} sweeps, last move {step:.2g} rad")
    assert factor is not None
    if cov is None:
        mean, cov = filtered(log, factor, about)
        return nominal, factor, (about + mean, cov)
    return nominal, factor, (nominal, cov)


def filtered(log: Log, factor: Factor, about: Array) -> tuple[Array, Array]:
    """Filtered deviations (K,B) from nominal states and covariances (K,K,B) of the knots; knot 0 is the prior."""
    mean, cov = factor.filtered()
    size, s = log.chain.mean.size, log.chain.motion.states
    mean[:size, 0], cov[..., 0] = log.chain.mean.ravel() - about[:size, 0], np.eye(len(mean))
    for j, own in enumerate(log.chain.cov):
        cov[j * s : j * s + s, j * s : j * s + s, 0] = own
    mean[size:, 0] = -about[size:, 0]
    return mean, cov


def judged(log: Log, past: tuple[Array, Array]) -> tuple[Forward, tuple[TrackInnovations, ...]]:
    """Predictions and innovations of every measurement, from the filtered knots."""
    motion, rows, units = log.chain.motion, log.rows(), log.errors
    kappa = fade(rows, units, past[0].shape[1])
    forth = forward(motion, log.chain.slots, past[0][:, :-1], past[1][..., :-1], kappa)
    belief, sights = forth.end.copy() if len(rows) > 1 else forth.end, []
    for one, row, density in zip(log.images, rows, log.density[1:], strict=True):
        h, index = row.of_states(motion)
        innovation, total = predicted(forth.end[..., row.knots - 1], h, index, row.y, row.white - one.extra)
        one.weight = inlier(*distance(innovation, total), len(total), density)[0]
        if len(rows) > 1:
            after, left, spread = seen(belief[..., row.knots - 1], h, index, row.y, row.white)
            belief[..., row.knots - 1] = after
            np.einsum("ddf->df", spread)[:] -= one.extra
        else:
            left, spread = innovation, total
        sights.append(TrackInnovations(innovation, total, inlier(*distance(left, spread), len(total), density)[1]))
    return mixed(log, forth), tuple(sights)


def distance(innovation: Array, total: Array) -> tuple[Array, Array]:
    """νᵀ S⁻¹ ν and ln|S| (F,) of innovations (D,F) and their covariances (D,D,F)."""
    inverse, logdet = spd_inverse(total)
    return np.einsum("df,def,ef->f", innovation, inverse, innovation), logdet


def weighed(solved: Solved) -> tuple[Log, float]:
    """The log with outliers' noise inflated, and the largest relative change of a variance."""
    log, chain = solved.log, solved.log.chain
    var = softened(log, solved.forth)
    changed = float(np.abs(log.slots_var / var - log.slots_var / chain.slots.var).max(initial=0.0))
    for one, sight in zip(log.images, solved.sights, strict=True):
        own = np.einsum("ddf->df", sight.total)
        extra = raised(np.zeros_like(own), own, np.minimum(2.0 * one.weight, 1.0))
        changed = max(changed, float(np.abs(own / (own + extra) - own / (own + one.extra)).max(initial=0.0)))
        one.extra = extra
    return replace(log, chain=replace(chain, slots=replace(chain.slots, var=var))), changed


def softened(log: Log, forth: Forward) -> Array:
    """Variances (L,M,B) of encoder readings, inflated where these are likely outliers.

    At most two consecutive ones: if a third is off on the same side, the joint moves so.
    """
    base, own = log.slots_var, _own_total(log, forth)
    nu = np.where(np.isfinite(forth.innovation), forth.innovation, 0.0)
    weight = np.minimum(2.0 * inlier(nu * nu / own, np.log(own), 1, log.density[0])[0], 1.0)
    if (weight == 1.0).all():
        return base
    knots = log.chain.knots
    present, off = knots.unfold(np.isfinite(forth.innovation)), knots.unfold(np.where(weight < 1.0, np.sign(nu), 0.0))
    for column, known in zip(off.T, present.T, strict=True):
        at = np.flatnonzero(known)
        column[at[_lasting(column[at])]] = 0.0
    weight = np.where(knots.fold(off, 0.0) == 0.0, 1.0, weight)
    return raised(base, own, weight)


def _lasting(off: Array) -> Array:
    """Readings (N,), given as sign of the outlier or 0, that are at least the third in a row on the same side."""
    begins = np.flatnonzero(np.append(True, np.diff(off) != 0.0))
    place = np.arange(len(off)) - np.repeat(begins, np.diff(np.append(begins, len(off))))
    return np.asarray((off != 0.0) & (place >= ROW))


def _own_total(log: Log, forth: Forward) -> Array:
    """Variances (L,M,B) of innovations without outlier inflation, 1 where there is no reading."""
    return np.where(np.isfinite(forth.total), forth.total - log.chain.slots.var + log.slots_var, 1.0)


def mixed(log: Log, forth: Forward) -> Forward:
    """The same beliefs, with outliers' nats by the mixture."""
    off = np.isfinite(forth.total) & (log.chain.slots.var > log.slots_var)
    if not off.any():
        return forth
    own, nu = _own_total(log, forth), np.where(off, forth.innovation, 0.0)
    total = np.where(off, forth.total, 1.0)
    cost = inlier(nu * nu / own, np.log(own), 1, log.density[0])[1]
    more = np.where(off, cost - 0.5 * (nu * nu / total + np.log(2.0 * np.pi * total)), 0.0)
    return replace(forth, nats=forth.nats + more.sum(axis=1))
