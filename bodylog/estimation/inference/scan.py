"""The Gaussian filter: its dynamics, the readings of stretches of a log side by side, and the trace
that the kernel (kernels.py) makes of them; when repeated sweeps over a log have converged.

State z (K,C) = joint angles, rates[, accelerations][,
encoder offsets]; the last axis C is the stretch.
"""

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, replace
from enum import Enum
from typing import Any

import numpy as np

from ...motion import (
    MOTION_MODELS,
    START_STD,
    WHITE_ACCELERATION,
    MotionModel,
    Stationary,
    WhiteNoise,
)
from ...types import Array
from .kernel_call import bind_kernel_call

MAX_SWEEPS = 25
"""Most sweeps: both methods converge within 13 on 15 simulated and recorded logs."""
CONVERGED_MOVE = 1e-9
"""Once converged, a stretch's start moves by fewer standard
deviations, a frame's linearisation point by fewer rad.
"""
ROUGHLY_CONVERGED_MOVE = 1e-3
"""The same for comparing evidence, for a path through silences and for a delay. With 1e-2 a
smoother keeps a wrong posture in a log whose encoder is off by 0.5 rad in its first two readings.
"""


class DidNotConverge(Exception):
    """Sweeps over the log, or outliers' weights, did not converge."""


def measure_farthest_move(z: Array, p: Array, next_z: Array, next_p: Array) -> float:
    """How far the farthest start moved, and by how much its standard deviation changed, in
    standard deviations.
    """
    std, before = (np.sqrt(np.maximum(np.einsum("iic->ic", cov), 1e-24)) for cov in (next_p, p))
    return float(np.maximum(np.abs((next_z - z) / std), np.abs(before / std - 1.0)).max())


GATE_SIGMA = 5.0
"""Standard deviations: a larger innovation d has its noise
inflated so that its weight falls as (GATE_SIGMA/d)⁴.
"""
FLAT_COST_NATS = 1.0
"""Nats from the gate's ½ GATE² to an outlier's cost anywhere:
one in a hundred in an image of 320×240 px costs 14.
"""


@dataclass(frozen=True, eq=False)
class FilterDynamics:
    """How the state moves: all joints' angles, rates[, accelerations][, encoder offsets].

    process: noise (M,) of joints, rad²/s³ or rad²/s⁵, or (M,C) by candidate · drift: random walk
    (M,) rad²/s of encoder offsets, or None · is_prior (M,) bool: joints whose readings come from
    the posture prior and do not count as evidence · motion: name of their motion model ·
    stationary: motion of joints whose encoders are silent for long, or None.
    """

    process: Array
    drift: Array | None = None
    is_prior: Array | None = None
    motion: str = WHITE_ACCELERATION
    stationary: Stationary | None = None

    @property
    def model(self) -> MotionModel:
        """How joints move."""
        return MOTION_MODELS[self.motion]

    @property
    def order(self) -> int:
        """Number of states of a joint without its offset."""
        return self.model.order

    @property
    def size(self) -> int:
        """Number K of states."""
        return len(self.process) * (self.order + (self.drift is not None))

    @property
    def offset(self) -> int | None:
        """Index of the first encoder offset in the state; None without offsets."""
        return None if self.drift is None else self.order * len(self.process)

    def compute_silent_moves(self, dt: Array, held: Array) -> tuple[Array, Array, Array]:
        """Stationary motion of joints silent for long, held (E,M) bool, within dt (E,) s.

        Returns move (E,S,S,M), shift (E,S,M) and noise (E,S,S,M) of the S states of each joint.
        The move of other joints is NaN.
        """
        assert self.stationary is not None
        m = len(self.process)
        order = self.order
        states = self.size // m
        some = np.flatnonzero(held.any(axis=1))
        move, noise = np.zeros((2, len(dt), states, states, m))
        shift = np.zeros((len(dt), states, m))
        parts = (move[:, :order, :order], shift[:, :order], noise[:, :order, :order])
        for part, step in zip(parts, self.stationary.step(dt[some]), strict=True):
            part[some] = np.moveaxis(step, -1, 0)
        if self.drift is not None:
            move[:, order, order] = 1.0
            noise[:, order, order] = self.drift * dt[:, None]
        np.moveaxis(move, -1, 1)[~held] = np.nan
        return move, shift, noise

    def add_model_moves(self, readings: "FilterReadings") -> "FilterReadings":
        """Add every joint's move to the readings, if the kernel does not know the motion model.

        Candidates, with process noise (M,C) of their own, get readings of their own.
        """
        if type(self.model) is WhiteNoise:
            return readings
        m = len(self.process)
        order = self.order
        states = self.size // m
        process = self.process.reshape(m, -1)
        candidates = process.shape[1] // readings.dt.shape[1]
        if candidates > 1:
            readings = readings.repeat_stretches(candidates)
        dt = readings.dt
        length, stretches = dt.shape
        density = np.broadcast_to(process, (length, m, stretches))
        if readings.process_factor is not None:
            density = density * readings.process_factor
        transition, covariance = (
            np.moveaxis(part(dt.ravel()).reshape(*dt.shape, order, order), 1, -1)[..., None, :]
            for part in (self.model.transition, self.model.covariance)
        )
        move, noise = np.zeros((2, length, states, states, m, stretches))
        move[:, :order, :order] = transition
        noise[:, :order, :order] = covariance * density[:, None, None]
        if self.drift is not None:
            move[:, order, order] = 1.0
            noise[:, order, order] = self.drift[:, None] * dt[:, None]
        shift = np.zeros((length, states, m, stretches))
        if readings.moves is not None:
            silent = np.isfinite(readings.moves[0][:, 0, 0])
            move, shift, noise = (
                np.where(np.expand_dims(silent, (*range(1, part.ndim - 2),)), part, usual)
                for part, usual in zip(readings.moves, (move, shift, noise), strict=True)
            )
        return replace(readings, moves=(move, shift, noise))


@dataclass(frozen=True, eq=False)
class FilterReadings:
    """Measurements, folded (L,…,C): dt (L,C) s · encoders (L,M,C) rad, NaN where silent, with
    variances · T tracks of D rows.

    A track's row reads y (L,T,D,C) = jac (L,T,D,M,C) · x with variance var (L,T,D,C); NaN where
    unseen. reset (L,M,C) bool: joints that restart from a wide prior at an instant, or None ·
    process_factor (L,M,C): on the process variance before an instant, or None for 1 · moves: move
    (L,S,S,M,C), shift (L,S,M,C) and noise (L,S,S,M,C) of the S states of joints before an instant,
    NaN where they move by dt · gate: standard deviations beyond which innovations count as
    outliers.
    """

    dt: Array
    encoders: Array
    encoder_var: Array
    y: Array
    jac: Array
    var: Array
    _: KW_ONLY
    reset: Array | None = None
    process_factor: Array | None = None
    moves: tuple[Array, Array, Array] | None = None
    gate: float = GATE_SIGMA

    def select_instants(self, first: int, last: int) -> "FilterReadings":
        """The readings from the instant `first` to before `last`."""
        parts: dict[str, Any] = {
            k: part[first:last] for k, part in vars(self).items() if isinstance(part, np.ndarray)
        }
        if self.moves is not None:
            parts["moves"] = tuple(part[first:last] for part in self.moves)
        return replace(self, **parts)

    def repeat_stretches(self, count: int) -> "FilterReadings":
        """Each stretch `count` times side by side; what has as many columns already stays."""
        stretches = self.dt.shape[-1]
        parts: dict[str, Any] = {
            k: np.repeat(part, count, axis=-1)
            for k, part in vars(self).items()
            if isinstance(part, np.ndarray) and part.shape[-1] == stretches
        }
        if self.moves is not None:
            parts["moves"] = tuple(np.repeat(part, count, axis=-1) for part in self.moves)
        return replace(self, **parts)


BLOCK_INSTANTS = 512
"""Instants of which covariances and gains are kept at a time, so that they stay in the cache."""


class TraceDetail(Enum):
    """What a trace keeps: the filter's beliefs, also what
    smoothed means need, or also what their covariances need.
    """

    BELIEFS = 0
    MEANS = 1
    COVARIANCES = 2


@dataclass(frozen=True, eq=False)
class FilterTrace:
    """The filtered beliefs of all instants.

    prior (L,M,C) rad, prior_cov (L,M,M,C): of the angles before an instant's readings · z (L,K,C):
    state after them · cov (L,O,O,C): of the angles and, if there are any, encoder offsets after
    them, O = M or 2 M · end_p (K,K,C): covariance of the state at the end · nats (L,C) of the
    readings · encoder_d (L,M,C): innovations of encoders, in standard deviations.

    For the smoother: p (L,O,K,C) or (L,K,K,C), rows of the state's covariance · information
    (L,R,C): inverse noise of each reading, 0 of missing ones · back: gains (L,R,K,C) and weights
    (L,R,C) of readings · marks (B,K,K+1,C): the belief before every BLOCK_INSTANTS instants, the
    upper triangle of its covariance beside its mean.
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

    def select_block(self, at: slice) -> "FilterTrace":
        """The trace of one block of instants: views of all but the covariance at its end."""
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
    prepare_filter(dynamics.add_model_moves(readings), dynamics, z, p, trace, every)()
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
    m = len(dynamics.process)
    move, shift, noise = readings.moves or (None, None, None)
    counted = np.ones(m, bool) if dynamics.is_prior is None else ~dynamics.is_prior
    gains, weights = trace.back or (None, None)
    return bind_kernel_call(
        "filter_instants",
        every=every,
        block=BLOCK_INSTANTS,
        gate=readings.gate,
        outlier_cost=0.5 * GATE_SIGMA * GATE_SIGMA,
        flat=FLAT_COST_NATS,
        dt=readings.dt,
        encoders=readings.encoders,
        encoder_var=readings.encoder_var,
        y=readings.y,
        jac=readings.jac,
        var=readings.var,
        process=np.ascontiguousarray(dynamics.process.reshape(m, -1)),
        drift=dynamics.drift,
        process_factor=readings.process_factor,
        move=move,
        shift=shift,
        noise=noise,
        restart=np.square(START_STD[: dynamics.order]),
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


def hand_over_starts(z: Array, p: Array, trace: FilterTrace) -> tuple[Array, Array]:
    """Starts z (K,C), p (K,K,C) for the next sweep: each stretch starts from its predecessor's
    end, and the first one as before.
    """
    z = z.copy()
    p = p.copy()
    z[:, 1:] = trace.z[-1, :, :-1]
    p[:, :, 1:] = trace.end_p[:, :, :-1]
    return z, p


def advance_starts(z: Array, p: Array, trace: FilterTrace) -> tuple[Array, Array, float]:
    """Starts for the next sweep, and how far the farthest moved; DidNotConverge if rounding left no
    number.
    """
    next_z, next_p = hand_over_starts(z, p, trace)
    move = measure_farthest_move(z, p, next_z, next_p)
    if np.isnan(move):
        raise DidNotConverge("rounding leaves no number")
    return next_z, next_p, move


def restart_filter(
    readings: FilterReadings, dynamics: FilterDynamics, z: Array, p: Array, trace: FilterTrace
) -> None:
    """Filter again, in place, from starts z (K,C), p
    (K,K,C), until a block ends with the belief of before.
    """
    assert trace.marks is not None
    for at, after in zip(trace.blocks, [*trace.marks[1:], None], strict=True):
        part = filter_stretches(
            readings.select_instants(at.start, at.stop),
            dynamics,
            z,
            p,
            TraceDetail.MEANS,
            trace.select_block(at),
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
    length, m, _ = readings.encoders.shape
    k = dynamics.size
    kept = -(-stretches // every)
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
    back = (np.empty((length, rows, k, kept)), np.empty((length, rows, kept)))
    return replace(trace, p=np.empty((length, k, k, kept)), information=information, back=back)
