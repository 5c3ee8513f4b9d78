"""Beliefs of a solved log at all its instants: filtered (given the past) or smoothed (given the whole log)."""

from dataclasses import dataclass

import numpy as np

from ...linear_algebra import selected_inverse
from ...types import Array
from .banded import System
from .interior import between, smoothed, smoothed_cov
from .solver import Solved


@dataclass(frozen=True, eq=False)
class Instants:
    """At E instants: states (E,M,S) and angles' cov (E,M,M); angles and cov before the instant; nats (E,).

    error (E,M): encoders' innovations in standard deviations, NaN where silent · offset, offset_var (E,M): filtered
    encoder offsets, where there are any.
    """

    states: Array
    cov: Array
    before: Array
    before_cov: Array
    nats: Array
    error: Array
    offset: Array
    offset_var: Array


def given_past(solved: Solved) -> Instants:
    """Filtered beliefs."""
    forth, knots = solved.forth, solved.log.chain.knots
    m, s = solved.log.chain.motion.joints, solved.log.chain.motion.states
    mean, cov = solved.past
    states, spread = knots.unfold(forth.state), knots.unfold(forth.cov)
    states[knots.events] = np.moveaxis(mean[:, 1:], -1, 0).reshape(-1, m, s)
    spread[knots.events] = np.moveaxis(cov[::s, ::s, 1:], -1, 0)
    prior, prior_cov = knots.unfold(forth.prior)[:, :, 0], knots.unfold(forth.prior_cov)
    return Instants(states, spread, prior, prior_cov, *_by_instant(solved))


def given_all(solved: Solved) -> Instants:
    """Smoothed beliefs."""
    chain = solved.log.chain
    m, s, knots = chain.motion.joints, chain.motion.states, chain.knots
    own, across = (
        np.ascontiguousarray(np.moveaxis(part, 0, -1)).reshape(m, s, m, s, -1)
        for part in marginals(solved.factor.system)
    )
    path, at = between(chain.motion, chain.slots, solved.bridge), solved.nominal.reshape(m, s, -1)
    states = knots.unfold(smoothed(path, at))
    cov = knots.unfold(smoothed_cov(path, own, across))
    return Instants(states, cov, states[:, :, 0], cov, *_by_instant(solved))


def _by_instant(solved: Solved) -> tuple[Array, Array, Array, Array]:
    """Nats (E,), encoder innovations, filtered offsets and their variances (E,M) of all instants."""
    forth, log = solved.forth, solved.log
    knots = log.chain.knots
    total = forth.total - log.chain.slots.var + log.var
    error = knots.unfold(forth.innovation / np.sqrt(total))
    return knots.unfold(forth.nats), error, knots.unfold(forth.state)[:, :, -1], knots.unfold(forth.offset_var)


def marginals(given: System) -> tuple[Array, Array]:
    """Smoothed covariances (B,K,K) of the knots, and (B−1,K,K) of each with the next."""
    k, knots = given.pull.shape
    s, m = given.shape
    upper = np.zeros((knots - 1, k, k))
    for j in range(m):
        own = slice(j * s, j * s + s)
        upper[:, own, own] = np.moveaxis(given.ahead.across[:, :, j], -1, 0)
    return selected_inverse(np.ascontiguousarray(np.moveaxis(given.own, -1, 0)), upper)
