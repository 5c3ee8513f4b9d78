"""Joint angles from noisy encoders: integrated-Wiener
motion, both variances by evidence, posterior at any time.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...linear_algebra import selected_inverse
from ...motion import (
    band_storage,
    motion_covariance,
    motion_log_determinant,
    motion_precision,
    motion_transition,
    solve_banded_system,
)
from ...types import Array

_BIN_S = 0.01
_NEAR = 0.25
_DIFFUSE = 1e-8
_STIFFEST = {2: -30.0, 3: -20.0}
_LOOSEST = 14.0
_STRIDE = 4.0
_REACH = 20.0
_CHUNK = 64
_NEGLIGIBLE = 1e-4


@dataclass(frozen=True, eq=False)
class ReadingChain:
    """A signal on time nodes: t (K,) s · gap (K-1,) in
    `unit` s · count (K,) readings of a node, total (K,) rad.

    Readings are relative to `centre`, their mean. squares is the sum of their squares after each
    node's slope is removed; degrees is the number of degrees of freedom left for the noise.
    """

    t: Array
    gap: Array
    unit: float
    count: Array
    total: Array
    squares: float
    degrees: float
    centre: float


@dataclass(frozen=True)
class WhiteMotion:
    """Motion whose `order`-th derivative is white: process
    density (rad²/s^(2·order−1)) and encoder variance (rad²).
    """

    order: int
    process: float
    encoder: float
    evidence: float
    std_error: tuple[float, float]


@dataclass(frozen=True, eq=False)
class _System:
    """A chain's motion of unit density: precision in bands
    (2p, K p), right-hand side (K p,1), its ln determinant.
    """

    signal: ReadingChain
    band: Array
    right: Array
    logdet: float


def build_reading_chain(t: Array, z: Array) -> ReadingChain:
    """Group readings z (N,) rad at t (N,) s into nodes of 10 ms, or of a quarter step."""
    sound = np.isfinite(t) & np.isfinite(z)
    order = np.argsort(t[sound], kind="stable")
    t = t[sound][order]
    z = z[sound][order]
    centre = float(z.mean())
    unit, node = _assign_nodes(t)
    # a repeated message is not a second reading
    fresh = np.append(True, (np.diff(node) > 0) | (np.diff(z) != 0))
    t = t[fresh]
    z = z[fresh] - centre
    node = node[fresh]
    count = np.bincount(node).astype(float)
    total = np.bincount(node, z)
    times = np.bincount(node, t) / count
    early = t - times[node]
    rest = z - (total / count)[node]
    moment = np.bincount(node, early**2)
    lean = np.bincount(node, early * rest)
    slope = np.divide(lean, moment, out=np.zeros_like(lean), where=moment > 0)
    scatter = float(np.square(rest - slope[node] * early)[count[node] > 2].sum())
    squares = float((total**2 / count).sum()) + scatter
    degrees = len(count) + np.maximum(count - 2, 0).sum()
    return ReadingChain(
        times, np.diff(times) / unit, unit, count, total, squares, float(degrees), centre
    )


def _assign_nodes(t: Array) -> tuple[float, Array]:
    """The usual step between nodes, s, and the node (N,) of each reading at t (N,) s ascending."""
    steps = np.diff(t)
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
    if usual > 0.6 * _BIN_S:
        return usual, np.cumsum(np.diff(t, prepend=-np.inf) >= _NEAR * usual) - 1
    node = np.unique(np.floor((t - t[0]) / _BIN_S), return_inverse=True)[1]
    count = np.bincount(node)
    gap = np.diff(np.bincount(node, t) / count, prepend=-np.inf)
    return _BIN_S, (np.cumsum(gap >= _NEAR * _BIN_S) - 1)[node]


def fit_white_motion(
    signals: Sequence[ReadingChain], order: int, with_errors: bool = True
) -> WhiteMotion:
    """Process and encoder variance of greatest evidence
    over all chains; encoder profiled out, ratio searched.

    with_errors: standard errors too, which take a third of the time; else they are infinite.
    """
    from scipy.optimize import minimize_scalar

    unit = max(signal.unit for signal in signals)
    systems = [_build_system(signal, order) for signal in signals]
    grid = np.arange(_STIFFEST[order], _LOOSEST, _STRIDE)
    best = float(
        grid[int(np.argmax([_profile_evidence(systems, order, unit, r)[0] for r in grid]))]
    )
    low = max(best - _STRIDE, _STIFFEST[order])
    high = best + _STRIDE
    found = minimize_scalar(
        lambda r: -_profile_evidence(systems, order, unit, r)[0],
        bounds=(low, high),
        method="bounded",
        options={"xatol": 1e-2},
    )
    ratio = float(found.x)
    value, variance = _profile_evidence(systems, order, unit, ratio)
    density = float(np.exp(ratio) * variance / unit ** (2 * order - 1))
    unknown = float("inf"), float("inf")
    errors = _std_error(systems, order, unit, ratio, density, variance) if with_errors else unknown
    return WhiteMotion(order, density, variance, value, errors)


def smooth_angles(signal: ReadingChain, motion: WhiteMotion, at: Array) -> tuple[Array, Array]:
    """Mean (K,) rad and variance (K,) rad² of the angle
    at the times `at` (K,) s; NaN outside the readings.
    """
    order = motion.order
    ratio = _log_noise_ratio(signal, motion)
    diagonal, upper, right = _posterior_precision(signal, order, ratio)
    state = solve_banded_system(band_storage(diagonal, upper), right)[1].reshape(-1, order)
    own, between = selected_inverse(diagonal, upper)
    left, early, late = _locate_in_chain(signal, at)
    from_left, from_right, rest = _interpolate_between_nodes(early, late, order, ratio)
    mean = (from_left * state[left] + from_right * state[left + 1]).sum(axis=1)
    cross = np.einsum("ki,kij,kj->k", from_left, between[left], from_right)
    spread = np.einsum("ki,kij,kj->k", from_left, own[left], from_left) + 2.0 * cross + rest
    spread += np.einsum("ki,kij,kj->k", from_right, own[left + 1], from_right)
    outside = (at < signal.t[0]) | (at > signal.t[-1])
    return np.where(outside, np.nan, signal.centre + mean), np.where(
        outside, np.nan, motion.encoder * spread
    )


def covariance_between_times(
    signal: ReadingChain, motion: WhiteMotion, at: Array
) -> tuple[Array, Array, Array]:
    """Posterior covariance of the angle between times `at`
    (K,) s ascending: row i > column j, value (L,) rad².
    """
    order = motion.order
    ratio = _log_noise_ratio(signal, motion)
    reach = int(np.ceil(_REACH * np.exp(-ratio / (2 * order)))) + 1
    diagonal, upper, _ = _posterior_precision(signal, order, ratio)
    left, early, late = _locate_in_chain(signal, at)
    from_left, from_right, _ = _interpolate_between_nodes(early, late, order, ratio)
    parts = []
    for start in range(0, len(at), _CHUNK):
        stop = min(start + _CHUNK, len(at))
        low = max(left[start] - reach, 0)
        high = min(left[stop - 1] + 2 + reach, len(signal.t))
        first, last = np.searchsorted(left, [low, high - 1])
        right = np.zeros((high - low, order, last - first))
        columns = np.arange(last - first)
        right[left[first:last] - low, :, columns] = from_left[first:last]
        right[left[first:last] - low + 1, :, columns] = from_right[first:last]
        flat = right.reshape(-1, last - first)
        own = slice(start - first, stop - first)
        _, solved = solve_banded_system(
            band_storage(diagonal[low:high], upper[low : high - 1]), flat[:, own]
        )
        parts.append(_significant_entries(flat.T @ solved, first, start))
    i, j, value = (np.concatenate(part) for part in zip(*parts, strict=True))
    return i, j, motion.encoder * value


def _significant_entries(block: Array, first: int, start: int) -> tuple[Array, Array, Array]:
    """Non-negligible entries below the diagonal of a slab
    whose rows start at `first` and columns at `start`.
    """
    i, j = np.nonzero(np.abs(block) > _NEGLIGIBLE * block.max())
    below = i + first > j + start
    return i[below] + first, j[below] + start, block[i[below], j[below]]


def _locate_in_chain(signal: ReadingChain, at: Array) -> tuple[Array, Array, Array]:
    """Node to the left of each time (K,), and the times
    since it and to the next, in the chain's unit.
    """
    left = np.clip(np.searchsorted(signal.t, at, side="right") - 1, 0, len(signal.gap) - 1)
    early = np.clip((at - signal.t[left]) / signal.unit, 0.0, signal.gap[left])
    return left, early, signal.gap[left] - early


def _log_noise_ratio(signal: ReadingChain, motion: WhiteMotion) -> float:
    return float(
        np.log(motion.process / motion.encoder) + (2 * motion.order - 1) * np.log(signal.unit)
    )


def _interpolate_between_nodes(
    early: Array, late: Array, order: int, ratio: float
) -> tuple[Array, Array, Array]:
    """The angle between two nodes: weights (K,p) of the
    left and right state, and the remaining variance (K,).
    """
    here = motion_covariance(order, early)
    there = motion_covariance(order, late)
    out = motion_transition(order, early)
    on = motion_transition(order, late)
    whole = np.matmul(np.matmul(on, here), on.transpose(0, 2, 1)) + there
    gain = np.linalg.solve(whole, np.matmul(on, here)).transpose(0, 2, 1)
    from_left = out - np.matmul(gain, np.matmul(on, out))
    rest = here - np.matmul(gain, np.matmul(on, here))
    return from_left[:, 0], gain[:, 0], np.maximum(rest[:, 0, 0], 0.0) * np.exp(ratio)


def _profile_evidence(
    systems: Sequence[_System], order: int, unit: float, ratio: float
) -> tuple[float, float]:
    """Log evidence with the encoder variance profiled out,
    and that variance; −inf where it cannot be computed.
    """
    try:
        count, misfit, volume = _evidence_terms(systems, order, unit, ratio)
    except np.linalg.LinAlgError:
        return float("-inf"), 0.0
    variance = max(misfit / count, 1e-18)
    return float(
        -0.5 * (count * np.log(2 * np.pi * variance) + misfit / variance + volume)
    ), variance


def _evidence_terms(systems: Sequence[_System], order: int, unit: float, ratio: float) -> Array:
    """Degrees of freedom, squared misfit for unit encoder
    variance, ln|posterior precision| − ln|prior precision|.

    ratio is ln(process/encoder) with time in `unit` s.
    """
    total = np.zeros(3)
    for system in systems:
        signal = system.signal
        own = ratio + (2 * order - 1) * float(np.log(signal.unit / unit))
        band = system.band * np.exp(-own)
        band[-1, :order] += _DIFFUSE
        band[-1, ::order] += signal.count
        logdet, mean = solve_banded_system(band, system.right)
        misfit = max(signal.squares - float(np.vdot(system.right, mean)), 0.0)
        before = order * float(np.log(_DIFFUSE)) - len(signal.gap) * order * own + system.logdet
        total += signal.degrees, misfit, logdet - before
    return total


def _build_system(signal: ReadingChain, order: int) -> _System:
    right = np.zeros((len(signal.t) * order, 1), order="F")
    right[::order, 0] = signal.total
    band = band_storage(*motion_precision(order, signal.gap))
    return _System(signal, band, right, motion_log_determinant(order, signal.gap))


def _posterior_precision(
    signal: ReadingChain, order: int, ratio: float
) -> tuple[Array, Array, Array]:
    """Posterior precision in units of the encoder's: diagonal
    (K,p,p), upper (K-1,p,p); right-hand side (K p,1).
    """
    diagonal, upper = (part * np.exp(-ratio) for part in motion_precision(order, signal.gap))
    diagonal[0] += _DIFFUSE * np.eye(order)
    diagonal[:, 0, 0] += signal.count
    right = np.zeros((len(signal.t) * order, 1))
    right[::order, 0] = signal.total
    return diagonal, upper, right


def _std_error(
    systems: Sequence[_System],
    order: int,
    unit: float,
    ratio: float,
    density: float,
    variance: float,
) -> tuple[float, float]:
    """Standard errors of (process, encoder) from the
    curvature of the evidence in their logarithms.
    """

    def value(process: float, encoder: float) -> float:
        count, misfit, volume = _evidence_terms(systems, order, unit, ratio + process - encoder)
        log_variance = np.log(variance) + encoder
        return float(-0.5 * (count * log_variance + misfit / np.exp(log_variance) + volume))

    h = 0.05
    centre = value(0.0, 0.0)
    pp = (value(h, 0.0) - 2 * centre + value(-h, 0.0)) / h**2
    ee = (value(0.0, h) - 2 * centre + value(0.0, -h)) / h**2
    pe = (value(h, h) - value(h, -h) - value(-h, h) + value(-h, -h)) / (4 * h**2)
    area = pp * ee - pe**2
    if not (pp < 0 and ee < 0 and area > 0):  # at the edge of the search the process is unknown
        return float("inf"), float(
            variance * np.sqrt(2.0 / sum(system.signal.degrees for system in systems))
        )
    return float(density * np.sqrt(-ee / area)), float(variance * np.sqrt(-pp / area))
