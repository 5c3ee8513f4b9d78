"""A filtered log: the belief at every instant, and the linearisation.

Backward pass of the smoother (adjoint.c): smoothed
means x = z − P λ, where λ is the adjoint, and covariances.

Back over a reading y = H x + n of noise R the adjoint is λ − Hᵀ R⁻¹ (y − H x). The information of
covariances is carried back in Bryson–Frazier form, which needs the filter's gains but no inverse.
"""

import ctypes
from dataclasses import dataclass

import numpy as np

from ...types import Array
from .filter_records import FilterDynamics, FilterReadings
from .folds import Fold
from .kernel import bind_kernel_call, list_struct_fields
from .scan import FilterTrace, TraceDetail, filter_stretches
from .tangents import Tangents


class _Adjoint(ctypes.Structure):
    _fields_ = list_struct_fields(
        "length stretches joints rows order offsets tiles width outputs p_rows",
        "",
        "dt encoders encoder_var y jac move information gains weights z p reset end start "
        "smooth cov",
    )


def smooth_states(
    readings: FilterReadings, trace: FilterTrace, dynamics: FilterDynamics, end: Array | None = None
) -> tuple[Array, Array]:
    """Smoothed means (L,O,C) or (L,K,C) of the states that
    the trace keeps, and adjoints (K,C) before the first one.

    From the adjoint at the `end` (K,C); 0 at the end of a log.
    """
    assert trace.p is not None
    x = np.empty((*trace.p.shape[:2], trace.p.shape[-1]))
    end = np.zeros_like(trace.z[-1]) if end is None else np.ascontiguousarray(end)
    return x, _propagate_adjoint_back(readings, trace, end[:, None], dynamics, smooth=x)[:, 0]


def smooth_with_covariances(
    readings: FilterReadings, trace: FilterTrace, dynamics: FilterDynamics
) -> tuple[Array, Array]:
    """All smoothed states (L,K,C) and the covariances
    (L,O,O,C) of the angles and of what the encoders read.

    The latter, sums of angle and offset, only with offsets: O = M or 2 M. Covariances and gains of
    a block of instants are computed again from the belief before it.
    """
    assert trace.marks is not None
    x = np.empty_like(trace.z)
    cov = np.empty_like(trace.cov)
    into = None
    adjoint = np.zeros_like(trace.z[0])
    information = np.zeros_like(trace.end_p)
    for at, mark in zip(trace.blocks[::-1], trace.marks[::-1], strict=True):
        part = readings.between(at.start, at.stop)
        if into is not None and len(into.z) != at.stop - at.start:
            into = None
        into = filter_stretches(
            part, dynamics, mark[:, -1], mark[:, :-1], TraceDetail.COVARIANCES, into
        )
        x[at], adjoint = smooth_states(part, into, dynamics, adjoint)
        information = _propagate_adjoint_back(part, into, information, dynamics, cov=cov[at])
    return x, cov


def _propagate_adjoint_back(
    readings: FilterReadings,
    trace: FilterTrace,
    end: Array,
    dynamics: FilterDynamics,
    smooth: Array | None = None,
    cov: Array | None = None,
) -> Array:
    """What the adjoint (K,1,C), or the information (K,K,C), at the `end` is at the start."""
    assert trace.information is not None and trace.p is not None
    (gains, weights), start = trace.back or (None, None), np.empty_like(end)
    (length, m, shared), c = readings.encoders.shape, end.shape[-1]
    bind_kernel_call(
        "adjoint",
        _Adjoint,
        length=length,
        stretches=c,
        joints=m,
        rows=trace.information.shape[1],
        order=dynamics.order,
        offsets=dynamics.offset is not None,
        tiles=c // shared,
        width=end.shape[1],
        outputs=0 if cov is None else cov.shape[1],
        p_rows=trace.p.shape[1],
        dt=readings.dt,
        encoders=readings.encoders,
        encoder_var=readings.encoder_var,
        y=readings.y,
        jac=readings.jac,
        move=None if readings.moves is None else readings.moves[0],
        information=trace.information,
        gains=gains,
        weights=weights,
        z=trace.z,
        p=trace.p,
        reset=readings.reset,
        end=end,
        start=start,
        smooth=smooth,
        cov=cov,
    )()
    return start


@dataclass(frozen=True, eq=False)
class Solution:
    """A filtered log: fold, its linearised readings, tangents, trace."""

    fold: Fold
    readings: FilterReadings
    tangents: Tangents
    trace: FilterTrace


@dataclass(frozen=True, eq=False)
class Smooth(Solution):
    """A smoothed log: the last forward pass, and the smoothed state z (L,K,C).

    cov (L,O,O,C): of the angles and, with offsets, of what the encoders read.
    """

    z: Array
    cov: Array


def assemble_smooth(
    fold: Fold,
    readings: FilterReadings,
    tangents: Tangents,
    trace: FilterTrace,
    dynamics: FilterDynamics,
) -> Smooth:
    """The smoothed log, with covariances, of a forward pass."""
    x, cov = smooth_with_covariances(readings, trace, dynamics)
    return Smooth(fold, readings, tangents, trace.without_gains(), x, cov)
