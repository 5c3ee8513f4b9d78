"""A log as one linear system about nominal states: motion and encoders between knots, images and errors at knots."""

from dataclasses import dataclass
from math import factorial

import numpy as np

from ...types import Array
from .banded import System, factored, system
from .bridge import Bridge, Slots, bridge, information
from .knots import Knots
from .motion_model import MotionModel
from .small import outer


@dataclass(frozen=True, eq=False)
class Rows:
    """One track's F images, linearised at knots (F,), `early` (F,) s before these: y (D,F) = J (D,M,F) x.

    reads (D,N,F): coefficients of the first N unit error states · white (D,F): variance · kappa (D,F−1), or None.
    """

    knots: Array
    early: Array
    y: Array
    jac: Array
    white: Array
    reads: Array | None = None
    kappa: Array | None = None

    @property
    def errors(self) -> int:
        """Number of this track's unit error states."""
        return 0 if self.reads is None else len(self.y)

    def of_states(self, motion: MotionModel) -> tuple[Array, Array]:
        """H (D,A,F) for the observed states, and their indices (A,) among the K."""
        joints, s = np.arange(motion.joints) * motion.states, motion.states
        parts, index = [self.jac], [joints]
        if self.early.any():
            powers = [self.early**lag / factorial(lag) for lag in range(1, motion.order)]
            parts += [self.jac * power for power in powers]
            index += [joints + lag for lag in range(1, motion.order)]
        if self.reads is not None:
            parts.append(self.reads)
            index.append(motion.joints * s + np.arange(self.reads.shape[1]))
        return np.concatenate(parts, axis=1), np.concatenate(index)


@dataclass(frozen=True, eq=False)
class Chain:
    """A log without its images: motion, knots, slots; mean (M,S) and cov (M,S,S) of the joints at knot 0."""

    motion: MotionModel
    knots: Knots
    slots: Slots
    mean: Array
    cov: Array

    def bridge(self, remember: bool = False) -> Bridge:
        """Integrated encoder readings between knots."""
        return bridge(self.motion, self.slots, remember)


def posed(chain: Chain, found: Bridge, tracks: list[Rows], nominal: Array) -> tuple[System, float]:
    """The system about nominal states (K,B), and its nats apart from the determinant."""
    m, s, knots = chain.motion.joints, chain.motion.states, nominal.shape[1]
    errors = len(nominal) - m * s
    states = np.ascontiguousarray(nominal[: m * s].reshape(m, s, knots).swapaxes(0, 1))
    low, high = states[..., :-1], states[..., 1:]
    between = information(found, low, high)
    kappa = fade(tracks, errors, knots)
    found_system = system(between, m, kappa, nominal[m * s :])
    nats = _motion_nats(found, between.after, between.logdet, low, high)
    nats += _first(chain, found_system, nominal) + _errors_nats(kappa, nominal[m * s :])
    for rows in tracks:
        nats += _add(chain.motion, found_system, rows, nominal)
    return found_system, nats


def energy(chain: Chain, found: Bridge, tracks: list[Rows], nominal: Array) -> float:
    """Laplace's free energy (nats) of the log about nominal states (K,B)."""
    given, nats = posed(chain, found, tracks, nominal)
    factor = factored(given)
    return float(nats + 0.5 * factor.logdet - 0.5 * np.square(factor.forward).sum())


def fade(tracks: list[Rows], errors: int, knots: int) -> Array:
    """Share κ (N,B−1) of each unit error state that is left from one knot to the next."""
    found, first = np.full((errors, knots - 1), 0.5), 0
    for rows in tracks:
        if rows.kappa is None:
            continue
        apart = np.diff(rows.knots)
        each = rows.kappa ** (1.0 / np.maximum(apart, 1))
        between = np.repeat(np.arange(len(apart)), apart)
        found[first : first + rows.errors, rows.knots[0] : rows.knots[-1]] = each[:, between]
        first += rows.errors
    return np.asarray(np.minimum(np.maximum(found, 1e-9), 1.0 - 1e-7))


def _first(chain: Chain, into: System, nominal: Array) -> float:
    """Add the prior of knot 0; its nats."""
    m, s, nats = chain.motion.joints, chain.motion.states, 0.0
    for j, (mean, inverse, cov) in enumerate(zip(chain.mean, np.linalg.inv(chain.cov), chain.cov, strict=True)):
        own = slice(j * s, j * s + s)
        off = nominal[own, 0] - mean
        into.own[own, own, 0] += inverse
        into.pull[own, 0] -= inverse @ off
        nats += 0.5 * float(off @ inverse @ off + np.linalg.slogdet(cov)[1])
    units = np.arange(m * s, len(nominal))
    into.own[units, units, 0] += 1.0
    into.pull[units, 0] -= nominal[units, 0]
    return nats + 0.5 * float(np.square(nominal[units, 0]).sum())


def _motion_nats(found: Bridge, inverse: Array, logdet: float, low: Array, high: Array) -> float:
    """Nats of the states at both ends of all intervals, and of the encoders in between."""
    miss = found.shift + (found.move * low[None]).sum(axis=1) - high
    quadratic = 0.5 * (outer(low, low) * found.info).sum() - (found.pull * low).sum() + found.nats.sum()
    return float(0.5 * (outer(miss, miss) * inverse).sum() + 0.5 * logdet + quadratic)


def _errors_nats(fade: Array, units: Array) -> float:
    """Nats of the unit error states (N,B)."""
    var = 1.0 - fade * fade
    miss = units[:, 1:] - fade * units[:, :-1]
    return 0.5 * float((miss * miss / var + np.log(var)).sum())


def _add(motion: MotionModel, into: System, rows: Rows, nominal: Array) -> float:
    """Add a track's rows; their nats."""
    h, index = rows.of_states(motion)
    left = rows.y - np.einsum("daf,af->df", h, nominal[index][:, rows.knots])
    weighed = h / rows.white[:, None]
    pull, own = np.einsum("daf,df->af", weighed, left), np.einsum("daf,dbf->abf", weighed, h)
    once = len(np.unique(rows.knots)) == len(rows.knots)
    for a, row in enumerate(index):
        _plus(into.pull[row], rows.knots, pull[a], once)
        for b, column in enumerate(index):
            _plus(into.own[row, column], rows.knots, own[a, b], once)
    return 0.5 * float((left * left / rows.white + np.log(2.0 * np.pi * rows.white)).sum())


def _plus(whole: Array, at: Array, some: Array, once: bool) -> None:
    if once:
        whole[at] += some
    else:
        np.add.at(whole, at, some)
