"""The filter one instant after the other: one step, for a log and beside a robot."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...types import Array
from ..noise.correlated_noise import PendingFrame
from ..noise.posture_prior import PosturePrior
from . import instant
from .convergence import RESTING, SETTLED
from .encoder_steps import EncoderSteps
from .filter_records import Dynamics
from .gate import GATE
from .initial_path import prior_of
from .instant import Line
from .motion import EVEN
from .reacquisition import SILENCE, open_joints, reacquired


@dataclass(eq=False, slots=True)
class State:
    """After an instant t (s; −∞ before the first): belief (K,K+1), the rows of the covariance, each with the mean last.

    borne (M) s: time at which each encoder last confirmed the belief, −∞ for never · seen: last frame of each track ·
    uneven: instants since the covariance was made symmetric. Of this instant: nats · encoder_d (M) and errors of
    tracks, in standard deviations · lost (M,) bool: joints re-initialised · held (M,) bool: joints silent for long
    before it · point (M,) rad of its tangents · lines: the tracks' ungated lines if held joints were hardly determined.
    """

    t: float
    belief: Array
    borne: Sequence[float]
    seen: Mapping[Any, PendingFrame] = field(default_factory=dict)
    uneven: int = 0
    nats: float = 0.0
    encoder_d: Sequence[float] = ()
    lost: Array | None = None
    held: Array | None = None
    errors: Mapping[Any, Array] = field(default_factory=dict)
    point: Array | None = None
    lines: Mapping[Any, Line] | None = None


class SequentialFilter:
    """Steps from an instant to the next, with frames linearised until the belief moves less than `rest` of its std."""

    def __init__(self, dynamics: Dynamics, posture: PosturePrior | None, rest: float = SETTLED) -> None:
        """Dynamics, and the posture prior of joints without an encoder."""
        self._steps, self._dynamics, self._posture, self._rest = EncoderSteps(dynamics), dynamics, posture, rest

    def first(self, start: Array) -> State:
        """The state before any measurement, at the angles `start` (M,) rad."""
        z, p = prior_of(start, self._dynamics)
        return State(-math.inf, np.column_stack([p, z]), [-math.inf] * len(start))

    def step(
        self, before: State, t: float, readings: Sequence[float], var: Sequence[float],
        frames: Mapping[Any, PendingFrame], more: Array | None = None,
    ) -> State:  # fmt: skip
        """The state after readings (M) rad, NaN where silent, with variances var, and frames of tracks at t (s).

        more (M,): factor on the process variance.
        """
        dt, order, borne = t - before.t if before.t > -math.inf else 0.0, self._dynamics.order, before.borne
        quiet, held, numbers, lost = not t - min(borne) <= SILENCE, None, 0, None
        if quiet:
            ages = t - np.array(borne)
            numbers = sum(len(frame.value) for frame in before.seen.values() if t - frame.t <= SILENCE)
            held = found if (found := open_joints(ages, numbers)).any() else None
        belief, uneven = self._steps.moved(before.belief, dt, more, held), (before.uneven + 1) % EVEN[order]
        if not uneven:  # before rounding errors grow
            belief[:, :-1] = 0.5 * (belief[:, :-1] + belief[:, :-1].T)
        confirmed: Iterable[bool] = [reading == reading for reading in readings]
        if quiet:
            lost, confirmed = reacquired(
                t, dt, ages, belief, np.array(readings), np.array(var), before.seen, bool(frames), order
            )
        if self._posture is not None and dt > 0.0:
            readings, var = (part.tolist() for part in self._posture.read(np.array(readings), np.array(var), dt))
        noise, d, nats = self._steps.gated(belief, readings, var)
        # an outlier confirms nothing: a belief that rejects an encoder for long is in doubt as after its silence
        sound = (sure and not abs(x) > GATE for sure, x in zip(confirmed, d, strict=True))
        borne = [t if sure else last for sure, last in zip(sound, borne, strict=True)]
        after = State(t, belief, borne, before.seen, uneven, nats, d, lost, held)
        if frames:
            self._see(after, frames, readings, noise, numbers > 0 and held is not None)
        after.nats += self._steps.condition(belief, readings, noise)
        return after

    def _see(
        self, after: State, frames: Mapping[Any, PendingFrame], readings: Sequence[float], noise: Sequence[float],
        adrift: bool,
    ) -> None:  # fmt: skip
        """Condition the belief of a state on frames, in place; adrift: along statistical lines, not tangents."""
        belief, m, seen = after.belief, len(readings), after.seen
        sights = [replace(f, memory=seen[track].memory) if track in seen else f for track, f in frames.items()]
        given = belief.copy()
        self._steps.condition(given, readings, noise)
        after.errors = dict(zip(frames, instant.errors(m, belief, sights), strict=True))
        if adrift:
            after.point, lines = instant.statistical_lines(m, given, sights)
            after.lines = dict(zip(frames, lines, strict=True))
        else:
            after.point, lines = instant.tangents(m, belief, given, sights, RESTING * self._rest)
        after.nats += instant.condition(belief, [instant.gated(line, belief) for line in lines])
        memories = (replace(sight, memory=line.memory) for sight, line in zip(sights, lines, strict=True))
        after.seen = {**seen, **dict(zip(frames, memories, strict=True))}
