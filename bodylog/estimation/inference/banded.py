"""Block tridiagonal information matrix over knots, factored by LAPACK's banded Cholesky.

A knot's K = M S states are ordered joint by joint. Motion couples each joint only with itself, so the band is narrow.
"""

from dataclasses import dataclass

import numpy as np

from ...types import Array
from .bridge import Information
from .small import outer, spd_inverse

CHUNK = 512
"""Knots inverted at a time, so that they fit into the processor's cache."""


@dataclass(frozen=True, eq=False)
class System:
    """B knots: own information (K,K,B), right-hand side `pull` (K,B), information `ahead` of the next intervals."""

    own: Array
    pull: Array
    ahead: Information

    @property
    def shape(self) -> tuple[int, int]:
        """Number S of states per joint and number M of joints."""
        return len(self.ahead.across), self.ahead.across.shape[2]


def joints_apart(own: Array, states: int) -> Array:
    """View (S,S,M,B) of the diagonal joint blocks of (K,K,B)."""
    m, knots = len(own) // states, own.shape[-1]
    return np.asarray(np.einsum("jajbk->abjk", own.reshape(m, states, m, states, knots)))


def system(ahead: Information, joints: int) -> System:
    """The system of motion and encoders; the caller adds the prior to `own` and `pull`."""
    s, knots = len(ahead.across), ahead.across.shape[-1] + 1
    own, pull = np.zeros((joints * s, joints * s, knots)), np.zeros((joints * s, knots))
    alone, each = joints_apart(own, s), pull.reshape(joints, s, knots).swapaxes(0, 1)
    alone[..., :-1] += ahead.before
    alone[..., 1:] += ahead.after
    each[..., :-1] += ahead.pull_before
    each[..., 1:] += ahead.pull_after
    return System(own, pull, ahead)


@dataclass(frozen=True, eq=False)
class Factor:
    """Upper band of the Cholesky factor (kd+1, B K) of a system, and the forward solution (B K,)."""

    system: System
    band: Array
    forward: Array

    def solution(self) -> Array:
        """Means (K,B) given the whole log."""
        from scipy.linalg.blas import dtbsv

        k, knots = self.system.pull.shape
        return np.ascontiguousarray(dtbsv(len(self.band) - 1, self.band, self.forward).reshape(knots, k).T)

    def filtered(self) -> tuple[Array, Array]:
        """Means (K,B) and covariances (K,K,B) of the knots given the measurements up to each."""
        k, knots = self.system.pull.shape
        s, m = self.system.shape
        width, ahead = len(self.band) - 1, self.system.ahead
        upper, forward = self.band.T.reshape(knots, k, width + 1), self.forward.reshape(knots, k)
        mean, cov = np.empty((k, knots)), np.empty((k, k, knots))
        for begin in range(0, knots, CHUNK):
            part = slice(begin, min(begin + CHUNK, knots))
            schur, pull = _schur(upper[part], forward[part])
            rest = slice(begin, min(begin + CHUNK, knots - 1))
            few = rest.stop - begin
            joints_apart(schur, s)[..., :few] -= ahead.before[..., rest]
            pull.reshape(m, s, -1).swapaxes(0, 1)[..., :few] -= ahead.pull_before[..., rest]
            cov[..., part] = spd_inverse(schur)
            mean[:, part] = (cov[..., part] * pull[None]).sum(axis=1)
        return mean, cov


def _schur(upper: Array, forward: Array) -> tuple[Array, Array]:
    """Uᵀ U (K,K,N) and Uᵀ y (K,N) of the factor's diagonal blocks, in band storage (N,K,kd+1), and y (N,K)."""
    knots, k, band = upper.shape
    schur, pull = np.zeros((k, k, knots)), np.zeros((k, knots))
    for row in range(k):
        u = np.ascontiguousarray(np.stack([upper[:, c, band - 1 - (c - row)] for c in range(row, min(k, row + band))]))
        reach = slice(row, row + len(u))
        schur[reach, reach] += outer(u, u)
        pull[reach] += u * forward[:, row]
    return schur, pull


def factored(given: System) -> Factor:
    """Cholesky factor of the system; LinAlgError if it is not positive definite."""
    from scipy.linalg.blas import dtbsv
    from scipy.linalg.lapack import dpbtrf

    k, knots = given.pull.shape
    s, m = given.shape
    width = k + s - 1
    band = np.zeros((knots, k, width + 1))
    for row in range(k):
        for column in range(row, k):
            band[:, column, width - (column - row)] = given.own[row, column]
    for j in range(m):
        for a in range(s):
            for b in range(s):
                band[1:, j * s + b, s - 1 - b + a] = given.ahead.across[a, b, j]
    found, failed = dpbtrf(band.reshape(knots * k, width + 1).T, lower=0, overwrite_ab=1)
    if failed:
        raise np.linalg.LinAlgError(f"state {failed % k} of knot {failed // k} is not determined")
    forward = dtbsv(width, found, np.ascontiguousarray(given.pull.T).ravel(), trans=1)
    return Factor(given, found, np.asarray(forward))
