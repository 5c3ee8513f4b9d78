"""One instant at a time: the same filter in plain matrices, linearised anew until the belief of this instant rests."""

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...types import Array
from ..noise.correlated_noise import Memory, Sight
from .conditioning import GATE
from .scan import Dynamics

ITERATIONS = 40
RESTING = 1e-12
"""rad: how little the point of linearisation may still move."""


@dataclass(frozen=True, eq=False)
class Moment:
    """After an instant: state z (K,), p (K,K) · nats · point (M,) of linearisation · what each track remembers now.

    Errors in standard deviations: encoder_d (M,), NaN where silent, and `errors` (2,) of each track · lines: the tracks
    as heard, but for the gate.
    """

    z: Array
    p: Array
    nats: float
    point: Array
    encoder_d: Array
    errors: tuple[Array, ...]
    memories: tuple[Memory, ...]
    lines: "Lines | None" = None


class Motion:
    """How a state moves with time: constant velocity, exact discretisation, in plain matrices."""

    def __init__(self, dynamics: Dynamics) -> None:
        """Of dynamics with process (M,)."""
        k, m = dynamics.size, len(dynamics.process)
        angles, rates = np.arange(m), np.arange(m, 2 * m)
        self.joints, self.offsets, self.recalled = m, k > 2 * m, dynamics.recalled
        self._still, self._shift, self._spread = np.eye(k), np.zeros((k, k)), np.zeros((3, k, k))
        self._shift[angles, rates] = 1.0
        self._spread[0, rates, rates] = dynamics.process
        self._spread[1, angles, rates] = self._spread[1, rates, angles] = dynamics.process / 2.0
        self._spread[2, angles, angles] = dynamics.process / 3.0
        if dynamics.drift is not None:
            self._spread[0, range(2 * m, k), range(2 * m, k)] = dynamics.drift

    def move(self, z: Array, p: Array, dt: float, more: Array | None = None) -> tuple[Array, Array]:
        """z (K,) and p (K,K) a time dt (s) later, the process variance being `more` (M,) times as large."""
        linear, square, cube = self._spread
        f = self._still + dt * self._shift
        spread = dt * (linear + dt * (square + dt * cube))
        if more is not None:
            spread[: 2 * self.joints] *= np.tile(more, 2)[:, None]
        p = f @ p @ f.T + spread
        return f @ z, 0.5 * (p + p.T)

    def recalling(self, joints: Array) -> "Motion":
        """The same where what is said of these joints, too, (M,) bool, is no encoder's."""
        other = copy.copy(self)
        other.recalled = joints if self.recalled is None else self.recalled | joints
        return other


@dataclass(frozen=True, eq=False)
class Lines:
    """Tracks as straight lines about one point (M,): y (T,2) = jac (T,2,M) x with variance var (T,2); memory of it."""

    point: Array
    y: Array
    jac: Array
    var: Array
    memories: tuple[Memory, ...]


def hear(
    motion: Motion, z: Array, p: Array, encoders: Array, encoder_var: Array, sights: Sequence[Sight],
    resting: float = RESTING, adrift: bool = False,
) -> Moment:  # fmt: skip
    """What comes of z (K,), p (K,K) once encoders (M,) rad, NaN where silent, and sights are heard.

    `resting` (rad) is how little the point of linearisation may still move · adrift: a tangent would not do.
    """
    encoder_var, encoder_d = _gated_encoders(motion, z, p, encoders, encoder_var)
    told = _encoders(motion, z, p, encoders, encoder_var)
    if not sights:
        return Moment(*told, told[0][: motion.joints], encoder_d, (), ())
    whole, errors = _secants(motion.joints, (z, p), told[:2], sights) if adrift else (None, ())
    if whole is None:
        lines, errors = _rested(motion.joints, (z, p), told[:2], sights, resting)
    else:
        lines = replace(whole, var=_gated(*_news(motion.joints, (z, p), whole), whole.var))
    z, p, seen = _seen(z, p, lines)
    z, p, nats = _encoders(motion, z, p, encoders, encoder_var)
    return Moment(z, p, seen + nats, lines.point, encoder_d, errors, lines.memories, whole)


def _gated_encoders(motion: Motion, z: Array, p: Array, said: Array, var: Array) -> tuple[Array, Array]:
    """Encoder variances (M,) after gating, and the innovations in standard deviations (M,)."""
    m, diagonal = motion.joints, np.diagonal(p)
    s, nu = diagonal[:m] + var, said - z[:m]
    if motion.offsets:
        s, nu = s + diagonal[2 * m :] + 2.0 * np.diagonal(p[:m, 2 * m :]), nu - z[2 * m :]
    d = nu / np.sqrt(s)
    gated, own = var + s * _excess(d * d), motion.recalled
    return (gated, d) if own is None else (np.where(own, var, gated), np.where(own, np.nan, d))


def _excess(d2: Array) -> Array:
    """By how many prior variances the noise must grow: 0 inside the gate, (d/GATE)⁴ − 1 outside; NaN is inside."""
    return np.asarray(np.square(np.fmax(d2 / GATE**2, 1.0)) - 1.0)


def _encoders(motion: Motion, z: Array, p: Array, said: Array, var: Array) -> tuple[Array, Array, float]:
    """z, p given one encoder after the other, and the nats of those that are not recalled."""
    z, p, m, nats = z.copy(), p.copy(), motion.joints, 0.0
    for j in np.flatnonzero(np.isfinite(said)):
        ph, nu = p[:, j].copy(), float(said[j] - z[j])
        if motion.offsets:
            ph += p[:, 2 * m + j]
            nu -= float(z[2 * m + j])
        s = float(ph[j] + (ph[2 * m + j] if motion.offsets else 0.0) + var[j])
        if not s > 0.0:
            raise np.linalg.LinAlgError(f"the variance {s:.3g} rad² is foretold of encoder {j + 1}")
        gain = ph / s
        z += gain * nu
        p -= gain[:, None] * ph
        if motion.recalled is None or not motion.recalled[j]:
            nats += 0.5 * (nu * nu / s + math.log(2.0 * math.pi * s))
    return z, p, nats


def _rested(
    m: int, prior: tuple[Array, Array], told: tuple[Array, Array], sights: Sequence[Sight], resting: float
) -> tuple[Lines, tuple[Array, ...]]:
    """The sights' lines about where the belief rests, or moves least, that they make of what the encoders `told`.

    And their errors in standard deviations. These and the gate are by the `prior`, so that order is no matter.
    """
    x, errors = prior[0][:m], np.empty((len(sights), 2))
    went = last = np.zeros(m)
    least, best = np.inf, None
    for iteration in range(ITERATIONS):
        lines, model_var = _lines(x, sights)
        lean, nu = _news(m, prior, lines)
        if iteration == 0:
            errors = _apart(lean, nu, sights, model_var)
        lines = replace(lines, var=_gated(lean, nu, lines.var))
        ph, cov, left = _foretold(*told, lines)
        move = told[0][:m] + ph[:m] @ np.linalg.solve(cov, left) - x
        size = float(np.abs(move).max())
        if best is None or size < least:
            least, best = size, lines
        if size < resting:
            break
        went, last = _accelerated(move, last, went), move
        x = x + went
    assert best is not None
    return best, tuple(errors)


def _secants(
    m: int, prior: tuple[Array, Array], told: tuple[Array, Array], sights: Sequence[Sight]
) -> tuple[Lines, tuple[Array, ...]]:
    """The sights' lines through x ± √M σ along each axis of what the encoders `told`; errors by the prior's tangents.

    What a line misses there is noise: a wide belief's tangent says what no picture shows. Rows are turned such that
    their noise is independent.
    """
    at, model_var = _lines(prior[0][:m], sights)
    errors = _apart(*_news(m, prior, at), sights, model_var)
    x, (var, axes) = told[0][:m], np.linalg.eigh(told[1][:m, :m])
    steps = np.sqrt(m * np.maximum(var, np.finfo(float).tiny))[:, None] * axes.T
    y, jac, noise, memories = [], [], [], []
    for sight in sights:
        *_, own, memory = sight.at(x)
        there, back = np.split(sight.model.predict(np.concatenate([x + steps, x - steps]))[0], 2)
        middle, slope = 0.5 * (there + back), np.linalg.solve(steps, 0.5 * (there - back)).T
        missed = middle - middle.mean(axis=0)
        spread, turn = np.linalg.eigh(missed.T @ missed / m + np.diag(own))
        y.append(turn.T @ (sight.value - middle.mean(axis=0) + slope @ x))
        jac.append(turn.T @ slope)
        noise.append(spread)
        memories.append(memory)
    return Lines(x, np.array(y), np.array(jac), np.array(noise), tuple(memories)), tuple(errors)


def _news(m: int, prior: tuple[Array, Array], lines: Lines) -> tuple[Array, Array]:
    """H P Hᵀ (T,2,2) of the lines, and what they say beyond the prior (T,2)."""
    z, p = prior
    return lines.jac @ p[:m, :m] @ lines.jac.transpose(0, 2, 1), lines.y - lines.jac @ z[:m]


def _apart(lean: Array, nu: Array, sights: Sequence[Sight], model_var: Array) -> Array:
    """News nu (T,2) in standard deviations, as perception and the model have these."""
    pixels = np.array([sight.var for sight in sights])
    return np.asarray(nu / np.sqrt(np.einsum("tdd->td", lean) + pixels + model_var))


def _accelerated(move: Array, last: Array, went: Array) -> Array:
    """How far to go where Gauss–Newton says `move` (M,), and said `last` before one went `went`: Anderson mixing."""
    turn = move - last
    size = turn @ turn
    return move if size == 0.0 or not went.any() else move - (turn @ move / size) * (went + turn)


def _lines(x: Array, sights: Sequence[Sight]) -> tuple[Lines, Array]:
    """The tracks' lines about x, and the model's variance (T,2) there."""
    *found, memories = zip(*(sight.at(x) for sight in sights), strict=True)
    mean, jac, model, var = (np.array(part) for part in found)
    return Lines(x, np.array([sight.value for sight in sights]) - mean + jac @ x, jac, var, memories), model


def _gated(lean: Array, nu: Array, var: Array) -> Array:
    """Variances (T,2) of tracks, each gated as a whole; H P Hᵀ lean (T,2,2), innovations nu (T,2)."""
    a, b, c = lean[:, 0, 0] + var[:, 0], lean[:, 0, 1], lean[:, 1, 1] + var[:, 1]
    d2 = (c * nu[:, 0] ** 2 - 2.0 * b * nu[:, 0] * nu[:, 1] + a * nu[:, 1] ** 2) / (a * c - b * b)
    return np.asarray(var + np.stack([a, c], axis=1) * _excess(d2)[:, None])


def _foretold(z: Array, p: Array, lines: Lines) -> tuple[Array, Array, Array]:
    """Of all rows R of the lines: P Hᵀ (K,R), H P Hᵀ + R (R,R), innovations (R,)."""
    m = lines.jac.shape[2]
    h = lines.jac.reshape(-1, m)
    ph = p[:, :m] @ h.T
    return ph, h @ ph[:m] + np.diag(lines.var.ravel()), lines.y.ravel() - h @ z[:m]


def _seen(z: Array, p: Array, lines: Lines) -> tuple[Array, Array, float]:
    """z, p given the lines, and their nats."""
    ph, s, nu = _foretold(z, p, lines)
    gain = np.linalg.solve(s, ph.T).T
    nats = 0.5 * (nu @ np.linalg.solve(s, nu) + np.linalg.slogdet(2.0 * np.pi * s)[1])
    return z + gain @ nu, p - gain @ ph.T, float(nats)
