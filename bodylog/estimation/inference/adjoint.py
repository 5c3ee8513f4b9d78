"""Backward pass of the smoother in Bryson–Frazier form (adjoint.c): it needs the filter's gains, and no inverse."""

import ctypes

import numpy as np

from ...types import Array
from .filter_records import Dynamics, Readings
from .kernel import fields, run
from .motion import EVEN
from .scan import Trace


class _Adjoint(ctypes.Structure):
    _fields_ = fields(
        "length stretches joints rows order offsets tiles even width outputs",
        "",
        "dt encoder_var jac move gains weights nus z p reset end start smooth cov",
    )


def smoothed(readings: Readings, trace: Trace, end: Array, dynamics: Dynamics) -> tuple[Array, Array]:
    """Smoothed states (L,K,C), and adjoints (K,C) before the first instant, from the adjoint at the `end` (K,C)."""
    z = np.empty_like(trace.z)
    return z, _back(readings, trace, np.ascontiguousarray(end)[:, None], dynamics, smooth=z)[:, 0]


def covariances(readings: Readings, trace: Trace, dynamics: Dynamics) -> Array:
    """Smoothed covariances (L,O,O,C) of the angles and, with offsets, of the sums of angle and offset: O = M or 2 M.

    The information Λ of everything after a stretch becomes W + Ψ Λ Ψᵀ at its start, where Ψ maps adjoints at the end
    back to it. With Λ at each stretch's end known, the smoothed covariance is P − P Λ P.
    """
    length, k, c = trace.z.shape
    known = np.zeros((k, 2 * k, c))
    np.einsum("kkc->kc", known[:, k:])[:] = 1.0
    ends = _ends(_back(readings, trace, known, dynamics)) if c > 1 else np.zeros((k, k, 1))
    size = readings.encoders.shape[1] * (1 if dynamics.offset is None else 2)
    cov = np.empty((length, size, size, c))
    _back(readings, trace, ends, dynamics, cov=cov)
    return cov


def _back(
    readings: Readings, trace: Trace, end: Array, dynamics: Dynamics, smooth: Array | None = None,
    cov: Array | None = None,
) -> Array:  # fmt: skip
    """What the adjoint, or W and Ψ, (K,W,C) at the `end` of each stretch are at its start."""
    assert trace.back is not None and trace.p is not None
    (gains, weights, nus), start = trace.back, np.empty_like(end)
    (length, m, shared), c = readings.encoders.shape, end.shape[-1]
    run(
        "adjoint", _Adjoint, length=length, stretches=c, joints=m, rows=weights.shape[1], order=dynamics.order,
        offsets=dynamics.offset is not None, tiles=c // shared, even=EVEN[dynamics.order], width=end.shape[1],
        outputs=0 if cov is None else cov.shape[1], dt=readings.dt, encoder_var=readings.encoder_var,
        jac=readings.jac, move=None if readings.moves is None else readings.moves[0], gains=gains, weights=weights,
        nus=nus, z=trace.z, p=trace.p, reset=readings.reset, end=end, start=start, smooth=smooth, cov=cov,
    )  # fmt: skip
    return start


def _ends(at_start: Array) -> Array:
    """Information (K,K,C) of everything after each stretch, from its W and Ψ (K,2K,C); zero after the last stretch."""
    k, _, c = at_start.shape
    before, ends = np.moveaxis(at_start, -1, 0), np.zeros((c, k, k))
    for j in range(c - 1, 0, -1):
        own, across = before[j, :, :k], before[j, :, k:]
        ends[j - 1] = own + across @ ends[j] @ across.T
    return np.ascontiguousarray(np.moveaxis(ends, 0, -1))


def before(at_start: Array) -> Array:
    """Ends (…,C) for the next round: each stretch ends with its successor's start, the last one with zero."""
    ends = np.zeros_like(at_start)
    ends[..., :-1] = at_start[..., 1:]
    return ends
