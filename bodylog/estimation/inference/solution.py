"""A solved log, filtered or smoothed, and the backward passes of the smoother (kernels.py): to
smoothed means x = z − P λ, where λ is the adjoint, and to covariances.

Back over a reading y = h x + n of noise R the adjoint is λ − hᵀ R⁻¹ (y − h x). The information of
covariances is carried back in Bryson–Frazier form, which needs the filter's gains but no inverse.
"""

from dataclasses import dataclass, replace

import numpy as np

from ...types import Array
from .filter_pass import FilterDynamics, FilterReadings, FilterTrace, TraceDetail, filter_readings
from .kernel_call import bind_kernel_call
from .tangents import Tangents


def smooth_states(
    readings: FilterReadings, trace: FilterTrace, dynamics: FilterDynamics, end: Array | None = None
) -> tuple[Array, Array]:
    """Smoothed means (L,O) or (L,K) of the states that the trace keeps, and the adjoint (K,) at the
    start, from that at the `end`, which is 0 if nothing follows.
    """
    assert trace.p is not None
    smooth = np.empty(trace.p.shape[:2])
    adjoint = np.zeros(dynamics.size) if end is None else end.copy()
    moves = dynamics.add_model_moves(readings).moves
    bind_kernel_call(
        "carry_adjoint_back",
        dt=readings.dt,
        encoders=readings.encoders,
        y=readings.y,
        jac=readings.jac,
        reset=readings.reset,
        move=None if moves is None else moves[0],
        order=dynamics.order,
        information=trace.information,
        z=trace.z,
        p=trace.p,
        adjoint=adjoint,
        smooth=smooth,
    )()
    return smooth, adjoint


def smooth_with_covariances(
    readings: FilterReadings, trace: FilterTrace, dynamics: FilterDynamics
) -> tuple[Array, Array]:
    """All smoothed states (L,K), and covariances (L,O,O) of the angles and, with offsets, of what
    the encoders read: sums of angle and offset, so that O = M or 2 M.

    Covariances and gains of a block of instants are computed again from the belief before it.
    Without offsets the smoothed covariances overwrite the filtered ones, which nothing reads then.
    """
    assert trace.marks is not None
    x = np.empty_like(trace.z)
    cov = trace.cov if dynamics.drift is None else np.empty_like(trace.cov)
    adjoint = np.zeros(dynamics.size)
    information = np.zeros((dynamics.size, dynamics.size))
    block = None
    for at, mark in zip(trace.blocks[::-1], trace.marks[::-1], strict=True):
        part = readings.select_instants(at.start, at.stop)
        z = mark[:, -1].copy()
        p = mark[:, :-1].copy()
        if block is not None and len(block.z) != len(part.dt):
            block = None  # the last block of a log is shorter
        block = filter_readings(part, dynamics, z, p, TraceDetail.COVARIANCES, block)
        x[at], adjoint = smooth_states(part, block, dynamics, adjoint)
        _carry_information_back(part, block, dynamics, information, cov[at])
    return x, cov


def _carry_information_back(
    readings: FilterReadings,
    trace: FilterTrace,
    dynamics: FilterDynamics,
    information: Array,
    cov: Array,
) -> None:
    """Replace the information (K,K) at the end by that at the start, and write smoothed covariances
    (L,O,O).
    """
    assert trace.back is not None
    gains, weights = trace.back
    moves = dynamics.add_model_moves(readings).moves
    bind_kernel_call(
        "carry_information_back",
        dt=readings.dt,
        encoder_var=readings.encoder_var,
        jac=readings.jac,
        reset=readings.reset,
        move=None if moves is None else moves[0],
        order=dynamics.order,
        gains=gains,
        weights=weights,
        p=trace.p,
        known=information,
        cov=cov,
    )()


@dataclass(frozen=True, eq=False)
class Solution:
    """A filtered log: its linearised readings, tangents, trace."""

    readings: FilterReadings
    tangents: Tangents
    trace: FilterTrace


@dataclass(frozen=True, eq=False)
class Smooth(Solution):
    """A smoothed log: the last forward pass, and the smoothed state z (L,K).

    cov (L,O,O): of the angles and, with offsets, of what the encoders read.
    """

    z: Array
    cov: Array


def assemble_smooth(
    readings: FilterReadings, tangents: Tangents, trace: FilterTrace, dynamics: FilterDynamics
) -> Smooth:
    """The smoothed log, with covariances, of a forward pass."""
    x, cov = smooth_with_covariances(readings, trace, dynamics)
    # without what only the backward pass needs, most of a trace's memory
    trace = replace(trace, p=None, back=None, marks=None)
    return Smooth(readings, tangents, trace, x, cov)
