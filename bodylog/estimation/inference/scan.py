"""The Gaussian filter: stretches of a log side by side, by the kernel (scan.c).

State z (K,C) = joint angles, rates[, accelerations][,
encoder offsets]; the last axis C is the stretch.
"""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from ...types import Array
from .convergence import CONVERGED_MOVE, measure_farthest_move
from .filter_records import FLAT_COST_NATS, GATE_SIGMA, FilterDynamics, FilterReadings
from .kernel import bind_kernel_call, list_struct_fields
from .reacquisition import START_STD

BLOCK_INSTANTS = 512
"""Instants of which covariances and gains are kept at a time, so that they stay in the cache."""


class _Scan(ctypes.Structure):
    _fields_ = list_struct_fields(
        "length stretches joints tracks rows order offsets tiles every own_processes p_rows block",
        "gate most flat",
        "dt encoders encoder_var y jac var process drift more move shift noise restart reset "
        "counted start_z start_p "
        "prior prior_cov z cov p end_p nats encoder_d information gains weights marks",
    )


class TraceDetail(Enum):
    """What a trace keeps: the filter's beliefs, also what
    smoothed means need, or also what their covariances need.
    """

    BELIEFS = 0
    MEANS = 1
    COVARIANCES = 2


@dataclass(frozen=True, eq=False)
class FilterTrace:
    """Per instant: prior mean and covariance of x, posterior
    state z, nats, and covariances cov (L,O,O,C) of angles.

    With offsets also theirs: O = M or 2 M · end_p (K,K,C): covariance of the state at the end. For
    the smoother: p (L,O,K,C) or (L,K,K,C), rows of the state's covariance · information (L,R,C):
    inverse noise of each reading, 0 of missing ones · back: gains (L,R,K,C) and weights (L,R,C)
    of readings · marks (B,K,K+1,C): the belief before every BLOCK_INSTANTS instants, the upper
    triangle of its covariance beside its mean.
    """

    prior: Array
    prior_cov: Array
    z: Array
    cov: Array
    end_p: Array
    nats: Array
    encoder_d: Array
    p: Array | None = None
    information: Array | None = None
    back: tuple[Array, Array] | None = None
    marks: Array | None = None

    @property
    def blocks(self) -> list[slice]:
        """The instants of each mark."""
        return [
            slice(at, min(at + BLOCK_INSTANTS, len(self.z)))
            for at in range(0, len(self.z), BLOCK_INSTANTS)
        ]

    def between(self, at: slice) -> "FilterTrace":
        """Views of one block of what a smoother's means need."""
        parts = {
            name: part[at]
            for name, part in vars(self).items()
            if part is not None and len(part) == len(self.z)
        }
        assert self.marks is not None
        return replace(
            self,
            **parts,
            end_p=self.end_p.copy(),
            marks=self.marks[at.start // BLOCK_INSTANTS :][:1],
        )

    def without_gains(self) -> "FilterTrace":
        """The trace without what only the backward pass needs, most of its memory."""
        return replace(self, p=None, back=None, marks=None)


def filter_stretches(
    readings: FilterReadings,
    dynamics: FilterDynamics,
    z: Array,
    p: Array,
    keep: TraceDetail = TraceDetail.BELIEFS,
    into: FilterTrace | None = None,
    every: int = 1,
) -> FilterTrace:
    """Filter every stretch from its own start z (K,C), p (K,K,C).

    Candidates stand side by side: several stretches to each of the readings, with their own process
    and frame variances. Only every `every`-th stretch keeps more than nats. `into`: a trace of the
    same shape to overwrite, as fresh memory costs as much as the arithmetic.
    """
    trace = into or allocate_trace(readings, dynamics, z.shape[1], every, keep)
    prepare_filter(dynamics.with_moves(readings), dynamics, z, p, trace, every)()
    return trace


def prepare_filter(
    readings: FilterReadings,
    dynamics: FilterDynamics,
    z: Array,
    p: Array,
    trace: FilterTrace,
    every: int = 1,
) -> Callable[[], None]:
    """The filter as a call that reads and writes these arrays."""
    (length, m, shared), c = readings.encoders.shape, z.shape[1]
    _, tracks, rows, _ = readings.y.shape
    move, shift, noise = readings.moves or (None, None, None)
    counted = np.ones(m, bool) if dynamics.is_prior is None else ~dynamics.is_prior
    gains, weights = trace.back or (None, None)
    return bind_kernel_call(
        "scan",
        _Scan,
        length=length,
        stretches=c,
        joints=m,
        tracks=tracks,
        rows=rows,
        order=dynamics.order,
        offsets=dynamics.drift is not None,
        tiles=c // shared,
        every=every,
        own_processes=dynamics.process.ndim > 1,
        p_rows=0 if trace.p is None else trace.p.shape[1],
        block=BLOCK_INSTANTS,
        gate=readings.gate,
        most=GATE_SIGMA * GATE_SIGMA,
        flat=FLAT_COST_NATS,
        dt=readings.dt,
        encoders=readings.encoders,
        encoder_var=readings.encoder_var,
        y=readings.y,
        jac=readings.jac,
        var=readings.var,
        process=np.ascontiguousarray(dynamics.process),
        drift=dynamics.drift,
        more=readings.more,
        move=move,
        shift=shift,
        noise=noise,
        restart=np.square(START_STD),
        reset=readings.reset,
        counted=counted,
        start_z=np.ascontiguousarray(z),
        start_p=np.ascontiguousarray(p),
        prior=trace.prior,
        prior_cov=trace.prior_cov,
        z=trace.z,
        cov=trace.cov,
        p=trace.p,
        end_p=trace.end_p,
        nats=trace.nats,
        encoder_d=trace.encoder_d,
        information=trace.information,
        gains=gains,
        weights=weights,
        marks=trace.marks,
    )


def restart_filter(
    readings: FilterReadings, dynamics: FilterDynamics, z: Array, p: Array, trace: FilterTrace
) -> None:
    """Filter again, in place, from starts z (K,C), p
    (K,K,C), until a block ends with the belief of before.
    """
    assert trace.marks is not None
    for at, after in zip(trace.blocks, [*trace.marks[1:], None], strict=True):
        part = filter_stretches(
            readings.between(at.start, at.stop),
            dynamics,
            z,
            p,
            TraceDetail.MEANS,
            trace.between(at),
        )
        z = part.z[-1]
        p = part.end_p
        if after is None:
            trace.end_p[:] = p
        elif measure_farthest_move(after[:, -1], after[:, :-1], z, p) < CONVERGED_MOVE:
            return


def allocate_trace(
    readings: FilterReadings,
    dynamics: FilterDynamics,
    stretches: int,
    every: int = 1,
    keep: TraceDetail = TraceDetail.BELIEFS,
) -> FilterTrace:
    """Room for the trace of so many stretches, of which every `every`-th is kept."""
    (length, m, _), k, kept = readings.encoders.shape, dynamics.size, -(-stretches // every)
    o = m if dynamics.drift is None else 2 * m
    rows = m + readings.y.shape[1] * readings.y.shape[2]
    trace = FilterTrace(
        np.empty((length, m, kept)),
        np.empty((length, m, m, kept)),
        np.empty((length, k, kept)),
        np.empty((length, o, o, kept)),
        np.empty((k, k, kept)),
        np.empty((length, stretches)),
        np.empty((length, m, kept)),
    )
    if keep is TraceDetail.BELIEFS:
        return trace
    information = np.empty((length, rows, kept))
    if keep is TraceDetail.MEANS:
        marks = np.empty((-(-length // BLOCK_INSTANTS), k, k + 1, kept))
        return replace(
            trace, p=np.empty((length, o, k, kept)), information=information, marks=marks
        )
    back = np.empty((length, rows, k, kept)), np.empty((length, rows, kept))
    return replace(trace, p=np.empty((length, k, k, kept)), information=information, back=back)
