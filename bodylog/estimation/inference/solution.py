"""A solved log, filtered or smoothed, and the backward pass of the smoother (kernels.py): smoothed
means x = z − P λ, where λ is the adjoint, and covariances.

Back over a reading y = H x + n of noise R the adjoint is λ − Hᵀ R⁻¹ (y − H x). The information of
covariances is carried back in Bryson–Frazier form, which needs the filter's gains but no inverse.
"""

from dataclasses import dataclass, replace

import numpy as np

from ...types import Array
from .filter_problem import Fold
from .kernel_call import bind_kernel_call
from .scan import (
    BLOCK_INSTANTS,
    FilterDynamics,
    FilterReadings,
    FilterTrace,
    TraceDetail,
    filter_stretches,
)
from .tangents import Tangents


def smooth_states(
    readings: FilterReadings,
    trace: FilterTrace,
    end: Array,
    dynamics: FilterDynamics,
    instants: int | None = None,
) -> tuple[Array, Array]:
    """Smoothed means (L,O,C) or (L,K,C) of the states that the trace keeps, and adjoints (K,C) at
    the start, from the adjoints (K,C) at the `end`; of the first `instants` alone, if given.
    """
    assert trace.p is not None
    length, rows, _, stretches = trace.p.shape
    x = np.empty((min(instants or length, length), rows, stretches))
    end = np.ascontiguousarray(end)[:, None]
    return x, _propagate_adjoint_back(readings, trace, end, dynamics, smooth=x)[:, 0]


def compute_start_adjoints(
    readings: FilterReadings, trace: FilterTrace, dynamics: FilterDynamics
) -> Array:
    """Adjoints (K,C) at the start by the first block alone: what comes after it matters little."""
    end = np.zeros_like(trace.z[-1])
    return smooth_states(readings, trace, end, dynamics, BLOCK_INSTANTS)[1]


def smooth_with_covariances(
    readings: FilterReadings, trace: FilterTrace, ends: Array | None, dynamics: FilterDynamics
) -> tuple[Array, Array]:
    """All smoothed states (L,K,C), and covariances (L,O,O,C) of the angles and, with offsets, of
    what the encoders read: sums of angle and offset, so that O = M or 2 M.

    ends (K,C): adjoint at each stretch's end, or None if nothing follows any stretch. Covariances
    and gains of a block of instants are computed again from the belief before it. Without offsets
    the smoothed covariances overwrite the filtered ones, which nothing reads then.
    """
    x = np.empty_like(trace.z)
    cov = trace.cov if dynamics.drift is None else np.empty_like(trace.cov)
    into = None
    adjoint = np.zeros_like(trace.z[0])
    information = np.zeros_like(trace.end_p)
    if ends is not None:
        adjoint = ends
        information = _compute_end_information(_solve_stretch_starts(readings, trace, dynamics))
    for at in trace.blocks[::-1]:
        part, into = _cut_block(readings, trace, at, dynamics, into)
        x[at], adjoint = smooth_states(part, into, adjoint, dynamics)
        information = _propagate_adjoint_back(part, into, information, dynamics, cov=cov[at])
    return x, cov


def _solve_stretch_starts(
    readings: FilterReadings, trace: FilterTrace, dynamics: FilterDynamics
) -> Array:
    """W and Ψ (K,2K,C) at each stretch's start, of the first blocks alone if what comes after them
    is rounding.

    The information Λ of everything after a stretch becomes W + Ψ Λ Ψᵀ at its start, where Ψ maps
    adjoints at the end back to it. The smoothed covariance is P − P Λ P.
    """
    k, c = trace.z.shape[1:]
    end = np.concatenate([np.zeros((k, k, c)), np.repeat(np.eye(k)[..., None], c, axis=-1)], axis=1)
    information = end[:, :k]
    adjoint_map = end[:, k:]
    for at in trace.blocks:
        part = _propagate_adjoint_back(*_cut_block(readings, trace, at, dynamics), end, dynamics)
        information = information + np.einsum(
            "aic,ijc,bjc->abc", adjoint_map, part[:, :k], adjoint_map, optimize=True
        )
        adjoint_map = np.einsum("aic,ijc->ajc", adjoint_map, part[:, k:])
        later = np.einsum("aic,ijc,ajc->ac", adjoint_map, information, adjoint_map, optimize=True)
        if (later <= np.finfo(float).eps * np.einsum("aac->ac", information)).all():
            break
    return np.concatenate([information, adjoint_map], axis=1)


def _cut_block(
    readings: FilterReadings,
    trace: FilterTrace,
    at: slice,
    dynamics: FilterDynamics,
    into: FilterTrace | None = None,
) -> tuple[FilterReadings, FilterTrace]:
    """The readings and the trace, with gains, of a block of instants."""
    assert trace.marks is not None
    part = readings.select_instants(at.start, at.stop)
    mark = trace.marks[at.start // BLOCK_INSTANTS]
    into = into if into is not None and len(into.z) == at.stop - at.start else None
    return part, filter_stretches(
        part, dynamics, mark[:, -1], mark[:, :-1], TraceDetail.COVARIANCES, into
    )


def _propagate_adjoint_back(
    readings: FilterReadings,
    trace: FilterTrace,
    end: Array,
    dynamics: FilterDynamics,
    smooth: Array | None = None,
    cov: Array | None = None,
) -> Array:
    """Adjoints (K,1,C), W (K,K,C), or W and Ψ (K,2K,C) at each stretch's start, from its `end`.

    Of adjoints, smoothed means are written into `smooth` (E,O,C), and the end is after its E
    instants; of W, smoothed covariances into `cov`.
    """
    assert trace.information is not None and trace.p is not None
    gains, weights = trace.back or (None, None)
    start = np.empty_like(end)
    moves = dynamics.add_model_moves(readings).moves
    bind_kernel_call(
        "carry_adjoints_back",
        order=dynamics.order,
        length=len(readings.dt) if smooth is None else len(smooth),
        dt=readings.dt,
        encoders=readings.encoders,
        encoder_var=readings.encoder_var,
        y=readings.y,
        jac=readings.jac,
        move=None if moves is None else moves[0],
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


def _compute_end_information(starts: Array) -> Array:
    """Information (K,K,C) of everything after each stretch, from all W and Ψ (K,2K,C) at starts;
    zero after the last stretch.
    """
    k, _, c = starts.shape
    by_stretch = np.moveaxis(starts, -1, 0)
    ends = np.zeros((c, k, k))
    for j in range(c - 1, 0, -1):
        information = by_stretch[j, :, :k]
        adjoint_map = by_stretch[j, :, k:]
        ends[j - 1] = information + adjoint_map @ ends[j] @ adjoint_map.T
    return np.ascontiguousarray(np.moveaxis(ends, 0, -1))


def hand_back_adjoints(starts: Array) -> Array:
    """Adjoints (K,C) at the ends of stretches for the next round: each stretch ends with its
    successor's start, the last one with zero.
    """
    ends = np.zeros_like(starts)
    ends[..., :-1] = starts[..., 1:]
    return ends


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
    ends: Array | None,
    dynamics: FilterDynamics,
) -> Smooth:
    """The smoothed log, with covariances, of a forward pass
    and the adjoints (K,C) at stretches' ends, or None.
    """
    x, cov = smooth_with_covariances(readings, trace, ends, dynamics)
    # without what only the backward pass needs, most of a trace's memory
    trace = replace(trace, p=None, back=None, marks=None)
    return Smooth(fold, readings, tangents, trace, x, cov)
