"""Encoder noise and constant encoder offsets, learned from still poses.

Linearised at the angles found, the residuals ν = y − g(x̂) − J (z − x̂) are normal with mean −J b and covariance C = J
Σ Jᵀ + R, for encoder variances Σ and offsets b. Both maximise the likelihood of all ν.
"""

from dataclasses import dataclass, replace

import numpy as np

from ...types import Array, Fault, Finding
from ..faults.threshold import FAR, LEAST, NATS, SIGMAS
from .solve import Poses, Solved, solved

WIDE = 0.05
"""rad: initial std of encoder noise."""
WIDTH = 2.0
"""Prior std of the logarithm of an encoder's std, about the body's."""
FEWEST = 3
"""Fewest poses with encoders and positions from which encoder noise is learned."""


@dataclass(frozen=True, eq=False)
class Encoding:
    """variance (M,) rad² · offset (M,) rad and its variance (M,) rad², 0 where fixed · free (M,) bool."""

    variance: Array
    offset: Array
    offset_var: Array
    free: Array
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True, eq=False)
class _Rows:
    """ν (P,K), Jacobian (P,K,M) and variance R (P,K), infinite where unseen, at the poses that have both."""

    nu: Array
    jac: Array
    var: Array


def learned(poses: Poses, known: Array, names: tuple[str, ...], noise: bool, bias: str) -> Encoding:
    """Learn variances from `known` (M,) rad² if `noise`, and offsets as `bias` (auto, on, off) allows."""
    m = len(known)
    found = Encoding(known, np.zeros(m), np.zeros(m), np.full(m, bias == "on"))
    whole = np.flatnonzero(np.isfinite(poses.z).all(axis=1) & np.isfinite(poses.y).any(axis=1))
    if len(whole) < FEWEST or not (noise or bias != "off"):
        return replace(found, free=np.zeros(m, bool))
    at: Array | None = None
    begin = [np.log(known), np.full(m, 2.0 * np.log(WIDE))]
    for turn in range(3):
        wide = np.maximum(found.variance, WIDE**2) if turn == 0 else found.variance
        at = solved(poses, wide, found.offset, at).x
        rows = _rows(poses, solved(poses, wide, found.offset, at), whole)
        found = _chosen(rows, known, names, noise, bias, begin)
        begin = [np.log(found.variance)]
    return found


def _rows(poses: Poses, at: Solved, whole: Array) -> _Rows:
    """Residuals against the encoders at the poses `whole` (P'), with outliers' variances raised."""
    seen = np.isfinite(poses.y)
    var = np.where(seen, at.var / np.maximum(at.weight, 1e-12), np.inf)
    nu = at.r - np.einsum("pkm,pm->pk", at.jac, np.nan_to_num(poses.z) - at.x)
    return _Rows(np.where(seen, nu, 0.0)[whole], at.jac[whole], var[whole])


def _chosen(rows: _Rows, known: Array, names: tuple[str, ...], noise: bool, bias: str, begin: list[Array]) -> Encoding:
    """Noise and offsets of greatest evidence; with `auto`, one offset after the other while each wins NATS.

    The search for the noise starts at each of `begin`. Offsets are tried that win at the present noise. Where another
    joint's offset explains nearly as much, none is chosen.
    """
    free, findings = np.full(len(known), bias == "on"), list[Finding]()
    value, log_var = _best(rows, known, free, noise, begin)
    while bias == "auto" and not free.all():
        more = {j: free | (np.arange(len(known)) == j) for j in np.flatnonzero(~free).tolist()}
        now = _evidence(log_var, rows, free)[0]
        likely = {j: one for j, one in more.items() if _evidence(log_var, rows, one)[0] > now}
        trials = {j: _best(rows, known, one, noise, [*begin, log_var]) for j, one in likely.items()}
        if not trials:
            break
        best = max(trials, key=lambda j: trials[j][0])
        if trials[best][0] - value < NATS:
            break
        near = [names[j] for j in trials if trials[best][0] - trials[j][0] < NATS]
        if len(near) > 1:
            text = f"an offset of {', '.join(near)} explains these poses equally well; another track would decide"
            findings.append(Finding("warning", f"encoders: {text}"))
            break
        free[best] = True
        value, log_var = trials[best]
    variance = np.exp(log_var)
    offset, cov = _offsets(rows, variance, free)
    return Encoding(variance, offset, np.diag(cov), free, tuple(findings))


def _best(rows: _Rows, known: Array, free: Array, noise: bool, begin: list[Array]) -> tuple[float, Array]:
    """Greatest evidence (nats) with offsets `free` (M,), and the ln variances (M,) of encoders where it is reached."""
    from scipy.optimize import minimize

    first = np.log(known)
    if not noise:
        return _evidence(first, rows, free)[0], first

    def loss(log_var: Array) -> tuple[float, Array]:
        value, slope = _evidence(log_var, rows, free)
        away = (log_var - first) / (2.0 * WIDTH)
        return -value + 0.5 * float(away @ away), -slope + away / (2.0 * WIDTH)

    bounds = [(2.0 * np.log(1e-6), 2.0 * np.log(10.0))] * len(first)  # rad
    found = [minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds) for start in begin]
    best = min(found, key=lambda one: float(one.fun))
    return -float(best.fun), np.asarray(best.x)


def _evidence(log_var: Array, rows: _Rows, free: Array) -> tuple[float, Array]:
    """ln density (nats) of all ν, offsets integrated out, and its gradient in ln of the encoders' variances (M,)."""
    variance = np.exp(log_var)
    inner = _inner(rows, variance)
    a, w, constant = inner
    score, info = w.sum(axis=0), a.sum(axis=0)
    value = constant
    slope = 0.5 * variance * (np.square(w) - np.einsum("pmm->pm", a)).sum(axis=0)
    if not free.any():
        return value, slope
    offset, cov = _offsets(rows, variance, free, inner)
    chosen = np.ix_(free, free)
    count = int(free.sum())
    value += 0.5 * float(score[free] @ cov[chosen] @ score[free])
    value -= 0.5 * float(np.linalg.slogdet(np.eye(count) + FAR**2 * info[chosen])[1])
    # with offsets, ν + J b replaces ν, and their spread adds to C⁻¹'s trace
    moved = w + np.einsum("pij,j->pi", a, offset)
    spread = np.einsum("pij,jk,pik->pi", a, cov, a)
    slope = 0.5 * variance * (np.square(moved) + spread - np.einsum("pmm->pm", a)).sum(axis=0)
    return value, slope


def _inner(rows: _Rows, variance: Array) -> tuple[Array, Array, float]:
    """Jᵀ C⁻¹ J (P,M,M), Jᵀ C⁻¹ ν (P,M), and ln density (nats) of all ν without offsets, by Woodbury's identity."""
    scaled = rows.jac / rows.var[..., None]
    raw = np.einsum("pki,pkj->pij", scaled, rows.jac)
    side = np.einsum("pki,pk->pi", scaled, rows.nu)
    middle = np.linalg.inv(raw + np.diag(1.0 / variance))
    a = raw - raw @ middle @ raw
    w = side - np.einsum("pij,pjk,pk->pi", raw, middle, side)
    seen = np.isfinite(rows.var)
    square = (np.where(seen, rows.nu**2 / rows.var, 0.0)).sum() - np.einsum("pi,pij,pj->", side, middle, side)
    logdet = np.log(2.0 * np.pi * rows.var[seen]).sum() - np.linalg.slogdet(middle)[1].sum()
    logdet += len(rows.nu) * np.log(variance).sum()
    return a, w, -0.5 * float(square + logdet)


def _offsets(
    rows: _Rows, variance: Array, free: Array, inner: tuple[Array, Array, float] | None = None
) -> tuple[Array, Array]:
    """Offsets (M,) rad and their covariance (M,M), 0 except for the free ones."""
    a, w, _ = inner or _inner(rows, variance)
    offset, cov = np.zeros(len(free)), np.zeros((len(free), len(free)))
    if free.any():
        chosen = np.ix_(free, free)
        cov[chosen] = np.linalg.inv(a.sum(axis=0)[chosen] + np.eye(int(free.sum())) / FAR**2)
        offset[free] = -cov[chosen] @ w.sum(axis=0)[free]
    return offset, cov


def faults(names: tuple[str, ...], found: Encoding, since: float) -> tuple[Fault, ...]:
    """Encoders with a significant offset in all poses."""
    std = np.sqrt(found.offset_var)
    certain = found.free & (np.abs(found.offset) > np.maximum(LEAST, SIGMAS * std))
    return tuple(
        Fault("encoders", names[j], "offset", since, float(found.offset[j]), "rad") for j in np.flatnonzero(certain)
    )
