"""The filter one instant after the other: one step, for a log and beside a robot."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from ...types import Array
from ..noise.correlated_noise import PendingFrame
from ..noise.posture_prior import PosturePrior
from .convergence import CONVERGED_MOVE
from .filter_records import FilterDynamics
from .gate import GATE_SIGMA
from .initial_path import state_prior
from .instant import Line, find_tangent_point, standardise_innovations, statistical_lines
from .reacquisition import LONG_SILENCE_S, find_lost_joints, open_joints
from .step import FilterStep, SteppedBelief


@dataclass(eq=False, slots=True)
class State:
    """After an instant t (s; −∞ before the first): belief z (K,), p (K,K).

    borne (M) s: time at which each encoder last confirmed the belief, −∞ for never ·
    seen: last frame of each track. Of this instant: nats · encoder_d (M) and errors of
    tracks, in standard deviations · lost (M,) bool: joints re-initialised · held (M,)
    bool: joints silent for long before it · point (M,) rad of its tangents · lines: the
    tracks' lines if held joints were hardly determined.
    """

    t: float
    z: Array
    p: Array
    borne: Sequence[float]
    seen: Mapping[Any, PendingFrame] = field(default_factory=dict)
    nats: float = 0.0
    encoder_d: Sequence[float] = ()
    lost: Array | None = None
    held: Array | None = None
    errors: Mapping[Any, Array] = field(default_factory=dict)
    point: Array | None = None
    lines: Mapping[Any, Line] | None = None


class SequentialFilter:
    """Steps from an instant to the next, with frames
    linearised until their point moves less than `rest` (rad).
    """

    def __init__(
        self, dynamics: FilterDynamics, posture: PosturePrior | None, rest: float = CONVERGED_MOVE
    ) -> None:
        """Dynamics, and the posture prior of joints without an encoder."""
        self._dynamics = dynamics
        self._posture = posture
        self._rest = rest
        self._steps = dict[tuple[int, int], FilterStep]()

    def first(self, start: Array) -> State:
        """The state before any measurement, at the angles `start` (M,) rad."""
        return State(-math.inf, *state_prior(start, self._dynamics), [-math.inf] * len(start))

    def step(
        self,
        before: State,
        t: float,
        readings: Sequence[float] | Array,
        var: Sequence[float] | Array,
        frames: Mapping[Any, PendingFrame],
        more: Array | None = None,
    ) -> State:
        """The state after readings (M) rad, NaN where silent,
        with variances var, and frames of tracks at t (s).

        more (M,): factor on the process variance.
        """
        dt = t - before.t if before.t > -math.inf else 0.0
        borne = before.borne
        moved = partial(self._stepped, before.z, before.p, dt, more=more)
        held = None
        numbers = 0
        lost = None
        confirmed: Iterable[bool] = [reading == reading for reading in readings]
        if not t - min(borne) <= LONG_SILENCE_S:
            ages = t - np.array(borne)
            numbers = sum(
                len(frame.value) for frame in before.seen.values() if t - frame.t <= LONG_SILENCE_S
            )
            held = found if (found := open_joints(ages, numbers)).any() else None
            prior = moved([math.nan] * len(borne), var, held=held)
            lost, confirmed = find_lost_joints(
                t,
                ages,
                prior.z,
                prior.p,
                np.array(readings),
                np.array(var),
                before.seen,
                bool(frames),
                self._dynamics.order,
            )
        if self._posture is not None and dt > 0.0:
            readings, var = self._posture.read(np.array(readings), np.array(var), dt)
        given = partial(moved, readings, var, lost=lost, held=held)
        after = State(t, before.z, before.p, [], before.seen, lost=lost, held=held)
        belief = given()
        if frames:
            belief = self._see(after, belief, frames, given, numbers > 0 and held is not None)
        after.z, after.p, after.nats, after.encoder_d = (
            belief.z,
            belief.p,
            belief.nats,
            belief.d.tolist(),
        )
        # an outlier confirms nothing: a belief that rejects
        # an encoder for long is in doubt as after its silence
        sound = (
            sure and not abs(x) > GATE_SIGMA
            for sure, x in zip(confirmed, after.encoder_d, strict=True)
        )
        after.borne = [t if sure else last for sure, last in zip(sound, borne, strict=True)]
        return after

    def _stepped(
        self,
        z: Array,
        p: Array,
        dt: float,
        readings: Sequence[float] | Array,
        var: Sequence[float] | Array,
        lines: Sequence[Line] = (),
        **joints: Array | None,
    ) -> SteppedBelief:
        shape = len(lines), max((len(line.y) for line in lines), default=0)
        if shape not in self._steps:
            self._steps[shape] = FilterStep(self._dynamics, *shape)
        return self._steps[shape](z, p, dt, readings, var, lines, **joints)

    def _see(
        self,
        after: State,
        encoded: SteppedBelief,
        frames: Mapping[Any, PendingFrame],
        given: Callable[..., SteppedBelief],
        adrift: bool,
    ) -> SteppedBelief:
        """The belief by frames too, noted in the state;
        adrift: along statistical lines, not tangents.

        encoded: the belief by the encoders alone · given: the one by lines too.
        """
        m = len(encoded.x)
        seen = after.seen
        sights = [
            replace(f, memory=seen[track].memory) if track in seen else f
            for track, f in frames.items()
        ]
        after.errors = dict(
            zip(frames, standardise_innovations(encoded.x, encoded.cov, sights), strict=True)
        )
        if adrift:
            after.point, lines = encoded.z[:m], statistical_lines(m, encoded.z, encoded.p, sights)
            after.lines = dict(zip(frames, lines, strict=True))
        else:
            after.point, lines = find_tangent_point(
                encoded.x, sights, lambda lines: given(lines=lines).z[:m], self._rest
            )
        memories = (
            replace(sight, memory=line.memory) for sight, line in zip(sights, lines, strict=True)
        )
        after.seen = {**seen, **dict(zip(frames, memories, strict=True))}
        return given(lines=lines)
