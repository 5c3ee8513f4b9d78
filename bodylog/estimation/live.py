"""Readings given to a live filter: angles by joint,
positions by track; checked, counted and filtered.

The live filter: one step per instant, with the same belief as the batch filter.

The last instants of a live filter: late readings
are inserted at their time and later ones re-applied.
"""

from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import inf, isfinite
from typing import Any

import numpy as np

from ..body_model import BodyModel, ForwardModel
from ..errors import LogError, ModelError, UsageError
from ..settings import EstimationSettings
from ..types import MM_PER_M, TRACK_AXES, Array, Health
from .faults.encoder_offset import RANDOM_WALKS
from .inference.reacquisition import LONG_SILENCE_S
from .inference.scan import FilterDynamics
from .inference.sequential import SequentialFilter, State
from .measurements.gather import choose_senses, read_given_start
from .measurements.track import choose_pixel_variance
from .methods.table import METHODS
from .noise import noise_model
from .noise.correlated_noise import ErrorCorrelation, LastFrame, PendingFrame, correlation_length
from .noise.noise_model import carry_noise_model
from .noise.posture_prior import build_posture_prior, build_stationary_motion

Angles = Sequence[float] | Array | Mapping[str, float]
"""rad, in the body's order, or by joint; NaN, or a joint left out, is a missing reading."""
Place = Sequence[float] | Array
"""(u, v) or (u, v, std_u, std_v) px; of a point in space
(x, y, z), or these and their std, m; NaN is not seen.
"""

ToAngles = Callable[[Array], Array]
"""Converts readings (M,) to angles (M,) rad."""


@dataclass(frozen=True, eq=False)
class Observation:
    """Angles (M,) rad, NaN where missing, or None ·
    places {track: (u, v) px and its variance (2,) px², or (x, y, z) mm and mm²}.
    """

    angles: Array | None
    places: Mapping[str, tuple[Array, Array]]


class Inputs:
    """The senses of a body, which of them are used, and counts of each one's readings."""

    def __init__(self, body: BodyModel, settings: EstimationSettings, to_angles: ToAngles) -> None:
        """UsageError for senses in the settings that the body lacks."""
        visual = {name: model for name, model in body.senses.items() if name != "encoders"}
        touch = {"touch": visual["effector"]} if "effector" in visual else {}
        wanted = choose_senses(visual, body, settings)
        self.models: dict[str, ForwardModel] = {**visual, **touch}
        self.wanted = {name: model for name, model in self.models.items() if name in wanted}
        self.silent = np.array([name not in wanted for name in body.joints])
        self._joints = body.joints
        self._noise = body.noise.senses
        self._to_angles = to_angles
        self._newest_angles = [-inf] * len(body.joints)
        self._newest: dict[str, float] = {}
        self._variance = {
            name: noise_model.typed_track_variance(settings, name) for name in self.models
        }
        self._counts: dict[str, dict[str, int]] = {}

    def read(self, joints: Angles | None, places: Mapping[str, Place | None]) -> Observation:
        """Convert readings to arrays; UsageError or ModelError where they do not fit the body."""
        angles = None if joints is None else self._angles(joints)
        return Observation(
            angles,
            {name: self._place(name, one) for name, one in places.items() if one is not None},
        )

    def _angles(self, given: Angles) -> Array:
        names = self._joints
        if isinstance(given, Mapping):
            if not any(name in given for name in names):
                raise ModelError(
                    f"joints: {', '.join(given) or 'none'} found, possible: {', '.join(names)}"
                )
            given = [given.get(name, np.nan) for name in names]
        possible = f"one angle in rad for each of {', '.join(names)}"
        x = self._to_angles(_parse_numbers("joints", given, (len(names),), possible))
        return np.where(np.isfinite(x), x, np.nan)

    def _place(self, name: str, given: Place) -> tuple[Array, Array]:
        if name not in self.models:
            raise UsageError(
                f"{name}: the body has no such sense; it has "
                f"{', '.join(self.models) or 'joints alone'}"
            )
        axes = self.models[name].outputs
        count = len(axes)
        alone, both = (count,), (2 * count,)
        words = f"({', '.join(axes)}, {', '.join(f'std_{axis}' for axis in axes)})"
        unit = "m" if TRACK_AXES[count][1] == "mm" else "px"
        sizes, possible = (
            (both, f"{words} in {unit}")
            if name == "touch"
            else ((*alone, *both), f"({', '.join(axes)}) or {words} in {unit}")
        )
        found = _parse_numbers(name, given, sizes, possible) * (MM_PER_M if unit == "m" else 1.0)
        place = found[:count]
        std = found[count:] if len(found) == 2 * count else None
        if (given_var := self._variance[name]) is not None:
            return place, np.full(count, given_var)
        if name == "touch" and std is not None:
            return place, np.square(std)
        return place, choose_pixel_variance(
            std, self.models[name], np.array(self._noise.get(name, (1.0,) * count), float)
        )

    def accept(self, t: float, given: Observation, late: bool) -> Observation:
        """Keep the readings of time t (s) that may be used; count the others by reason."""
        places = {
            name: one for name, one in given.places.items() if self._accepted(name, t, one[0], late)
        }
        return Observation(
            None if given.angles is None else self._accepted_angles(t, given.angles, late), places
        )

    def _accepted(self, name: str, t: float, place: Array, late: bool) -> bool:
        after = t > self._newest.get(name, -np.inf)
        if after and not late:
            self._newest[name] = t
        rejected = {
            "too late": late,
            "time runs backwards": not after,
            "out of view": not np.isfinite(place).all(),
        }
        return self._count(name, {**rejected, "not asked for": name not in self.wanted})

    def _accepted_angles(self, t: float, x: Array, late: bool) -> Array:
        known = np.isfinite(x).tolist()
        before = self._newest_angles
        fresh = [sure and t > last for sure, last in zip(known, before, strict=True)]
        usable = [new and not off for new, off in zip(fresh, self.silent.tolist(), strict=True)]
        if not late:
            self._newest_angles = [
                t if new else last for new, last in zip(fresh, before, strict=True)
            ]
        rejected = {
            "too late": late,
            "not a number": not any(known),
            "time runs backwards": not any(fresh),
        }
        accepted = self._count("encoders", {**rejected, "not asked for": not any(usable)})
        return x if accepted and all(usable) else np.where(np.array(usable) & accepted, x, np.nan)

    def _count(self, sense: str, rejected: Mapping[str, bool]) -> bool:
        counts = self._counts.setdefault(sense, {})
        reason = next((reason for reason, holds in rejected.items() if holds), "")
        counts[reason] = counts.get(reason, 0) + 1
        return not reason

    @property
    def used(self) -> dict[str, Health]:
        """Counts of used and rejected readings, by sense."""
        return {
            sense: Health(
                sum(counts.values()),
                counts.get("", 0),
                {why: n for why, n in counts.items() if why},
            )
            for sense, counts in self._counts.items()
        }


def require_finite_time(t: float) -> float:
    """Return a time (s) as float; UsageError unless it is finite."""
    if not isinstance(t, int | float | np.number) or not isfinite(t):
        raise UsageError(f"t: {t!r} found, a finite time in s is possible")
    return float(t)


def _parse_numbers(
    what: str, given: Sequence[float] | Array, sizes: tuple[int, ...], possible: str
) -> Array:
    try:
        found = np.asarray(given, float)
    except (TypeError, ValueError):
        found = np.empty((0, 0))
    if found.ndim != 1 or len(found) not in sizes:
        raise UsageError(f"{what}: {' '.join(str(given).split())[:80]} found, possible: {possible}")
    return found


@dataclass(eq=False)
class Instant:
    """Time t (s), the state after it, and its readings:
    angles (M,) rad, NaN where missing, or None, and frames.
    """

    t: float
    after: State
    angles: Array | None = None
    frames: Mapping[str, PendingFrame] = field(default_factory=dict)
    nats: float = 0.0

    def add(self, angles: Array | None, frames: Mapping[str, PendingFrame]) -> None:
        """Add readings of the same time."""
        if self.angles is not None and angles is not None:
            angles = np.where(np.isfinite(angles), angles, self.angles)
        self.angles = self.angles if angles is None else angles
        self.frames = {**self.frames, **frames}


class ReplayBuffer:
    """The instants of the last `lag` seconds, at least one, and the one before them."""

    def __init__(self, first: State, lag: float, step: Callable[[State, Instant], State]) -> None:
        """Only the `first` state; `step` gives the state after an instant from the one before."""
        self._instants = [Instant(first.t, first)]
        self._lag = lag
        self._step = step

    @property
    def last(self) -> State:
        """The state now."""
        return self._instants[-1].after

    def late(self, t: float) -> bool:
        """Whether t (s) is before all instants that can be recomputed."""
        return t <= self._instants[0].t

    def add(
        self, t: float, angles: Array | None, frames: Mapping[str, PendingFrame]
    ) -> tuple[State, State, float]:
        """Insert readings at t (s) and recompute all later
        instants: the states after t and now, and the nats added.
        """
        at = bisect_left(self._instants, t, key=lambda one: one.t)
        if at == len(self._instants) or self._instants[at].t > t:
            self._instants.insert(at, Instant(t, self._instants[at - 1].after))
        self._instants[at].add(angles, frames)
        nats = 0.0
        for before, instant in pairwise(self._instants[at - 1 :]):
            instant.after = self._step(before.after, instant)
            nats += instant.after.nats - instant.nats
            instant.nats = instant.after.nats
        then = self._instants[at].after
        while len(self._instants) > 2 and self._instants[1].t < self.last.t - self._lag:
            del self._instants[0]
        return then, self.last, nats


@dataclass(frozen=True, eq=False)
class Belief:
    """At t (s): angles x (M,) rad · rates (M,) rad/s · cov
    (M,M) rad² of the angles · encoders' bias (M,) rad or None.

    free_energy (nats) of the readings given the earlier ones · errors {sense: (D,) standard
    deviations} of that instant · lost: joints (M,) bool that were re-initialised at that instant,
    or None · joints: names (M,) in the order of x.
    """

    t: float
    x: Array
    rate: Array
    cov: Array
    free_energy: float
    errors: Mapping[str, Array]
    bias: Array | None = None
    lost: Array | None = None
    joints: tuple[str, ...] = ()


class LiveEstimator:
    """A filter fed as readings arrive: `est.step(t, joints=…,
    effector=…)`; noise is the body's own, or a log's.
    """

    def __init__(
        self,
        body: BodyModel,
        settings: EstimationSettings | None = None,
        lag: float = LONG_SILENCE_S,
        to_angles: ToAngles = np.asarray,
        learned: Mapping[str, Any] | None = None,
    ) -> None:
        """A filter for `body` with the senses, start and bias
        of `settings`; readings may be up to `lag` s late.

        `to_angles` converts encoder readings to angles · `learned`:
        settings of an estimate, whose variances are used. UsageError for
        settings that need the whole log, and for variances of another body.
        """
        settings = settings or EstimationSettings(precision="model", bias="off")
        _needs_no_log(settings)
        if not lag >= 0:
            raise UsageError(f"lag: {lag} found, a time of at least 0 s is possible")
        self._body = body
        self._settings = settings
        self._lag = lag
        noise_model.check_typed_variances(
            settings, body.joints, [name for name in body.senses if name != "encoders"]
        )
        self._noise = noise = noise_model.with_typed_noise(
            carry_noise_model(body, learned), settings, body.joints
        )
        self._stated = noise.of(np.ones((len(body.joints),) * 2))
        self._inputs = Inputs(body, settings, to_angles)
        self._like = {
            name: ErrorCorrelation(
                noise.process,
                correlation_length(model),
                noise.near.get(name, 0.0),
                order=noise.order,
            )
            for name, model in self._inputs.models.items()
        }
        self._first, self._given = (
            np.full(len(body.joints), np.nan),
            read_given_start(settings, body.joints),
        )
        self._buffer: ReplayBuffer | None = None
        self._waiting: list[tuple[float, Observation]] = []

    @property
    def used(self) -> Mapping[str, Health]:
        """Counts of used and rejected readings, by sense."""
        return self._inputs.used

    def step(self, t: float, joints: Angles | None = None, **places: Place | None) -> Belief:
        """The belief after all readings up to t (s): joints
        in rad, places (u, v) or (u, v, std_u, std_v) in px.

        None, or NaN, is a missing reading. Readings may arrive out of order by up to
        `lag` s; the belief is about the latest instant. UsageError or ModelError for
        readings that do not fit the body. LogError until every joint has been read
        once; earlier readings are then applied together.
        """
        return self._step_all([(require_finite_time(t), joints, places)])

    def _step_all(
        self, parts: Sequence[tuple[float, Angles | None, Mapping[str, Place | None]]]
    ) -> Belief:
        """The belief after readings of several times (s): each a time, joints and places."""
        given = [(t, self._inputs.read(joints, places)) for t, joints, places in parts]
        if self._buffer is None:
            self._waiting += given
            while self._waiting[0][0] < max(t for t, _ in given) - self._lag:
                self._inputs.accept(*self._waiting.pop(0), late=True)
            self._buffer = self._begin([one.angles for _, one in given if one.angles is not None])
            given = self._waiting
            self._waiting = []
        beliefs = [self._add(self._buffer, *one) for one in given]
        if len(beliefs) == 1:
            return beliefs[0]
        errors = {
            name: error
            for belief in beliefs[-len(parts) :]
            for name, error in belief.errors.items()
        }
        return replace(
            beliefs[-1], free_energy=sum(belief.free_energy for belief in beliefs), errors=errors
        )

    def _add(self, buffer: ReplayBuffer, t: float, given: Observation) -> Belief:
        late = buffer.late(t)
        accepted = self._inputs.accept(t, given, late)
        if late:
            return self._belief(buffer.last, 0.0, {})
        frames = {name: self._frame(name, t, *place) for name, place in accepted.places.items()}
        then, now, nats = buffer.add(t, accepted.angles, frames)
        errors = {name: then.errors[name] for name in frames}
        if accepted.angles is not None:
            errors["encoders"] = np.array(then.encoder_d)
        return self._belief(now, nats, errors, then.lost)

    def _frame(self, name: str, t: float, place: Array, var: Array) -> PendingFrame:
        scale = self._noise.scale.get(name, 1.0)
        return PendingFrame(
            self._inputs.models[name], t, place, scale * var, self._like[name], LastFrame()
        )

    def _belief(
        self, now: State, nats: float, errors: Mapping[str, Array], lost: Array | None = None
    ) -> Belief:
        m = len(self._body.joints)
        z = now.z.copy()
        first = self._noise.order * m
        cov = (
            self._stated * now.p[:m, :m]
            if now.held is None
            else self._noise.of(now.p[:m, :m], now.held)
        )
        bias = z[first:] if len(z) > first else None
        names = self._body.joints
        return Belief(now.t, z[:m], z[m : 2 * m], cov, nats, errors, bias, lost, names)

    def _begin(self, readings: Sequence[Array]) -> ReplayBuffer:
        """An empty buffer with the initial belief; `readings` (M,) rad of this call."""
        names = self._body.joints
        noise = self._noise
        for angles in readings:
            self._first = np.where(np.isfinite(self._first), self._first, angles)
        x = self._first if self._given is None else self._given
        if not np.isfinite(x).all():
            unknown = ", ".join(
                name for name, angle in zip(names, x, strict=True) if not np.isfinite(angle)
            )
            raise LogError(
                f"joints: no reading of {unknown} yet; pass every joint once, or set `start`"
            )
        drift = np.full(len(names), RANDOM_WALKS[1]) if self._settings.bias == "on" else None
        inputs = self._inputs
        posture = build_posture_prior(inputs.silent, inputs.wanted, noise.process, x, noise.order)
        is_prior = None if posture is None else posture.joints
        dynamics = FilterDynamics(
            noise.process,
            drift,
            is_prior,
            noise.motion,
            build_stationary_motion(inputs.wanted, x, noise),
        )
        steps = SequentialFilter(dynamics, posture)
        var = noise.encoder.tolist()
        silence = [np.nan] * len(names)

        def step(before: State, at: Instant) -> State:
            return steps.step(
                before, at.t, silence if at.angles is None else at.angles.tolist(), var, at.frames
            )

        return ReplayBuffer(steps.first(x), self._lag, step)


def _needs_no_log(settings: EstimationSettings) -> None:
    """UsageError for settings that need the whole log."""
    able = tuple(name for name, method in METHODS.items() if method.live)
    possible = {"method": able, "precision": ("model",), "bias": ("off", "on"), "motion": ("auto",)}
    for name, values in possible.items():
        if (found := getattr(settings, name)) not in values:
            raise UsageError(
                f"{name}: {found!r} needs the whole log; possible live: {' or '.join(values)}"
            )
