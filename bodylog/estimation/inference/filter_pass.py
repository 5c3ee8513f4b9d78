"""The Gaussian filter: its dynamics, the readings of a log, and the trace that the kernel
(kernels.py) makes of them; when repeated sweeps over a log have converged.

State z (K,) = joint angles, rates[, accelerations][, encoder offsets].
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
"""rad: once converged, a frame's linearisation point moves by less."""
ROUGHLY_CONVERGED_MOVE = 1e-3
"""The same for comparing evidence, for a path through silences and for a delay. With 1e-2 a
smoother keeps a wrong posture in a log whose encoder is off by 0.5 rad in its first two readings.
"""


class DidNotConverge(Exception):
    """Sweeps over the log, or outliers' weights, did not converge."""


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

    process: noise (M,) of joints, rad²/s³ or rad²/s⁵ · drift: random walk (M,) rad²/s of encoder
    offsets, or None · is_prior (M,) bool: joints whose readings come from the posture prior and do
    not count as evidence · motion: name of their motion model · stationary: motion of joints whose
    encoders are silent for long, or None.
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
        """Add every joint's move to the readings, if the kernel does not know the motion model."""
        if type(self.model) is WhiteNoise:
            return readings
        m = len(self.process)
        order = self.order
        states = self.size // m
        length = len(readings.dt)
        density = np.broadcast_to(self.process, (length, m))
        if readings.process_factor is not None:
            density = density * readings.process_factor
        move, noise = np.zeros((2, length, states, states, m))
        move[:, :order, :order] = self.model.transition(readings.dt)[..., None]
        noise[:, :order, :order] = (
            self.model.covariance(readings.dt)[..., None] * density[:, None, None]
        )
        if self.drift is not None:
            move[:, order, order] = 1.0
            noise[:, order, order] = self.drift * readings.dt[:, None]
        shift = np.zeros((length, states, m))
        if readings.moves is not None:
            silent = np.isfinite(readings.moves[0][:, 0, 0])
            move, shift, noise = (
                np.where(np.expand_dims(silent, (*range(1, part.ndim - 1),)), part, usual)
                for part, usual in zip(readings.moves, (move, shift, noise), strict=True)
            )
        return replace(readings, moves=(move, shift, noise))


@dataclass(frozen=True, eq=False)
class FilterReadings:
    """Measurements at L instants: dt (L,) s · encoders (L,M) rad, NaN where silent, with variances
    · T tracks of D rows.

    A track's row reads y (L,T,D) = jac (L,T,D,M) · x with variance var (L,T,D); NaN where unseen.
    reset (L,M) bool: joints that restart from a wide prior at an instant, or None · process_factor
    (L,M): on the process variance before an instant, or None for 1 · moves: move (L,S,S,M), shift
    (L,S,M) and noise (L,S,S,M) of the S states of joints before an instant, NaN where they move by
    dt · gate: standard deviations beyond which innovations count as outliers.
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

    def copy_tracks(self) -> "FilterReadings":
        """The readings with tracks of their own, to write into."""
        return replace(self, y=self.y.copy(), jac=self.jac.copy(), var=self.var.copy())


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

    prior (L,M) rad, prior_cov (L,M,M): of the angles before an instant's readings · z (L,K): state
    after them · cov (L,O,O): of the angles and, if there are any, encoder offsets after them, O = M
    or 2 M · end_p (K,K): covariance of the state at the end · nats (L,) of the readings · encoder_d
    (L,M): innovations of encoders, in standard deviations.

    For the smoother: p (L,O,K) or (L,K,K), rows of the state's covariance · information (L,R):
    inverse noise of each reading, 0 of missing ones · back: gains (L,R,K) and weights (L,R) of
    readings · marks (B,K,K+1): the belief before every BLOCK_INSTANTS instants, its covariance
    beside its mean.
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


def filter_readings(
    readings: FilterReadings,
    dynamics: FilterDynamics,
    z: Array,
    p: Array,
    keep: TraceDetail = TraceDetail.BELIEFS,
    into: FilterTrace | None = None,
) -> FilterTrace:
    """Filter from the start z (K,), p (K,K).

    `into`: a trace of the same shape to overwrite, as fresh memory costs as much as the arithmetic.
    """
    trace = into or allocate_trace(readings, dynamics, keep)
    prepare_filter(dynamics.add_model_moves(readings), dynamics, z, p, trace)()
    return trace


def prepare_filter(
    readings: FilterReadings, dynamics: FilterDynamics, z: Array, p: Array, trace: FilterTrace
) -> Callable[[], None]:
    """The filter as a call that reads and writes these arrays."""
    m = len(dynamics.process)
    move, shift, noise = readings.moves or (None, None, None)
    counted = np.ones(m, bool) if dynamics.is_prior is None else ~dynamics.is_prior
    gains, weights = trace.back or (None, None)
    return bind_kernel_call(
        "filter_instants",
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
        process=dynamics.process,
        drift=dynamics.drift,
        process_factor=readings.process_factor,
        move=move,
        shift=shift,
        noise=noise,
        restart=np.square(START_STD[: dynamics.order]),
        reset=readings.reset,
        counted=counted,
        start_z=z,
        start_p=p,
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


def allocate_trace(
    readings: FilterReadings, dynamics: FilterDynamics, keep: TraceDetail = TraceDetail.BELIEFS
) -> FilterTrace:
    """Room for the trace of the readings."""
    length, m = readings.encoders.shape
    k = dynamics.size
    o = m if dynamics.drift is None else 2 * m
    rows = m + readings.y.shape[1] * readings.y.shape[2]
    trace = FilterTrace(
        np.empty((length, m)),
        np.empty((length, m, m)),
        np.empty((length, k)),
        np.empty((length, o, o)),
        np.empty((k, k)),
        np.empty(length),
        np.empty((length, m)),
    )
    if keep is TraceDetail.BELIEFS:
        return trace
    information = np.empty((length, rows))
    if keep is TraceDetail.MEANS:
        marks = np.empty((-(-length // BLOCK_INSTANTS), k, k + 1))
        return replace(trace, p=np.empty((length, o, k)), information=information, marks=marks)
    back = (np.empty((length, rows, k)), np.empty((length, rows)))
    return replace(trace, p=np.empty((length, k, k)), information=information, back=back)
