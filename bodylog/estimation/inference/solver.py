"""Belief about a whole log by Gauss–Newton on its banded information matrix: filtered or smoothed."""

from dataclasses import dataclass, replace

import numpy as np

from ...types import Array
from .banded import Factor, factored
from .bridge import Bridge
from .convergence import DidNotConverge
from .interior import Forward, forward
from .mixture import inlier, raised
from .posed import Chain, posed

SWEEPS = 30
ROUNDS = 12
"""Most rounds of outlier weighting."""
RESTING = 1e-6
"""rad: smaller moves end the sweeps."""
ROUNDING = 1e-5
"""rad: smaller moves that no longer shrink come from rounding, where joints rest and process noise is small."""
ROW = 2
"""Most consecutive readings of one encoder that can be outliers on the same side."""
SAME = 1e-2
"""Tolerance on outliers' weights."""
DENSITY = 1.0 / (2.0 * np.pi)
"""Density of encoders' outliers, per rad."""


@dataclass(frozen=True, eq=False)
class Log:
    """One log to be solved: its chain, and the encoders' variances (L,M,B) without outliers."""

    chain: Chain
    var: Array


@dataclass(frozen=True, eq=False)
class Solved:
    """Nominal states (K,B) at the knots; the last factor, and the filter's results.

    past: filtered means (K,B) and covariances (K,K,B) of the knots.
    """

    log: Log
    nominal: Array
    factor: Factor
    bridge: Bridge
    past: tuple[Array, Array]
    forth: Forward


def solve(log: Log, nominal: Array, smooth: bool) -> Solved:
    """Solve from nominal states (K,B), with outliers' noise inflated; DidNotConverge if it does not converge."""
    for _ in range(ROUNDS):
        found = log.chain.bridge(remember=smooth)
        nominal, factor, past = _swept(log, found, nominal, smooth)
        forth = forward(log.chain.motion, log.chain.slots, past[0][:, :-1], past[1][..., :-1])
        solved = Solved(log, nominal, factor, found, past, mixed(log, forth))
        var = softened(log, forth)
        changed = float(np.abs(log.var / var - log.var / log.chain.slots.var).max(initial=0.0))
        log = replace(log, chain=replace(log.chain, slots=replace(log.chain.slots, var=var)))
        if changed < SAME:
            return solved
    return solved


def _swept(log: Log, found: Bridge, nominal: Array, smooth: bool) -> tuple[Array, Factor, tuple[Array, Array]]:
    """Converged nominal states (K,B), the factor about them, and the filtered knots."""
    s, step, last, factor = log.chain.motion.states, np.inf, np.inf, None
    for _ in range(SWEEPS):
        rounding = step < ROUNDING and step > 0.5 * last
        if factor is not None and (rounding or step < RESTING):
            break
        factor, about = factored(posed(log.chain, found, nominal)), nominal
        mean, cov = (factor.solution(), None) if smooth else filtered(log, factor, nominal)
        step, last, nominal = float(np.abs(mean[::s]).max()), step, nominal + mean
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
    s = log.chain.motion.states
    mean[:, 0], cov[..., 0] = log.chain.mean.ravel() - about[:, 0], np.eye(len(mean))
    for j, own in enumerate(log.chain.cov):
        cov[j * s : j * s + s, j * s : j * s + s, 0] = own
    return mean, cov


def softened(log: Log, forth: Forward) -> Array:
    """Variances (L,M,B) of encoder readings, inflated where these are likely outliers.

    At most two consecutive ones: if a third is off on the same side, the joint moves so.
    """
    base, own = log.var, _own_total(log, forth)
    nu = np.where(np.isfinite(forth.innovation), forth.innovation, 0.0)
    weight = np.minimum(2.0 * inlier(nu, own, DENSITY)[0], 1.0)
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
    return np.where(np.isfinite(forth.total), forth.total - log.chain.slots.var + log.var, 1.0)


def mixed(log: Log, forth: Forward) -> Forward:
    """The same beliefs, with outliers' nats by the mixture."""
    off = np.isfinite(forth.total) & (log.chain.slots.var > log.var)
    if not off.any():
        return forth
    own, nu = _own_total(log, forth), np.where(off, forth.innovation, 0.0)
    total = np.where(off, forth.total, 1.0)
    cost = inlier(nu, own, DENSITY)[1]
    more = np.where(off, cost - 0.5 * (nu * nu / total + np.log(2.0 * np.pi * total)), 0.0)
    return replace(forth, nats=forth.nats + more.sum(axis=1))
