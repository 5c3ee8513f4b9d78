"""The live filter beside a robot, with the same belief as the filter of a log: one step an instant.

Readings, angles by joint and positions by track, are checked, counted and filtered. Late ones are
inserted at their time, and the later ones of the last instants applied again.
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
from .faults.offset_changes import RANDOM_WALKS
from .inference.filter_pass import FilterDynamics
from .inference.reacquisition import LONG_SILENCE_S
from .inference.sequential import SequentialFilter, State
from .inference.tangents import correlate_errors
from .measurements.gather import choose_senses, read_given_start
from .measurements.track import choose_pixel_variance
from .methods.table import METHODS
from .noise import noise_model
from .noise.correlated_noise import LastFrame, PendingFrame
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


class LiveInputs:
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
        self._typed_variance = {
            name: noise_model.find_typed_variance(settings, name) for name in self.models
        }
        self._counts: dict[str, dict[str, int]] = {}

    def parse_readings(
        self, joints: Angles | None, places: Mapping[str, Place | None]
    ) -> Observation:
        """Convert readings to arrays; UsageError or ModelError where they do not fit the body."""
        return Observation(
            None if joints is None else self._parse_angles(joints),
            {
                name: self._parse_place(name, place)
                for name, place in places.items()
                if place is not None
            },
        )

    def _parse_angles(self, given: Angles) -> Array:
        """Angles (M,) rad, NaN where missing."""
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

    def _parse_place(self, name: str, given: Place) -> tuple[Array, Array]:
        """A place (D,) px or mm, and its variance (D,)."""
        if name not in self.models:
            raise UsageError(
                f"{name}: the body has no such sense; it has "
                f"{', '.join(self.models) or 'joints alone'}"
            )
        axes = self.models[name].outputs
        count = len(axes)
        unit = "m" if TRACK_AXES[count][1] == "mm" else "px"
        sizes: tuple[int, ...] = (2 * count,)
        possible = f"({', '.join(axes)}, {', '.join(f'std_{axis}' for axis in axes)}) in {unit}"
        if name != "touch":
            sizes = (count, 2 * count)
            possible = f"({', '.join(axes)}) or {possible}"
        numbers = _parse_numbers(name, given, sizes, possible) * (MM_PER_M if unit == "m" else 1.0)
        place = numbers[:count]
        std = numbers[count:] if len(numbers) == 2 * count else None
        typed = self._typed_variance[name]
        if typed is not None:
            return place, np.full(count, typed)
        if name == "touch" and std is not None:
            return place, np.square(std)
        noise = np.array(self._noise.get(name, (1.0,) * count), float)
        return place, choose_pixel_variance(std, self.models[name], noise)

    def accept_readings(self, t: float, given: Observation, late: bool) -> Observation:
        """Keep the readings of time t (s) that may be used; count the others by reason."""
        places = {
            name: (place, var)
            for name, (place, var) in given.places.items()
            if self._accept_place(name, t, place, late)
        }
        angles = None if given.angles is None else self._accept_angles(t, given.angles, late)
        return Observation(angles, places)

    def _accept_place(self, name: str, t: float, place: Array, late: bool) -> bool:
        """Whether a track's place may be used."""
        after = t > self._newest.get(name, -np.inf)
        if after and not late:
            self._newest[name] = t
        rejected = {
            "too late": late,
            "time runs backwards": not after,
            "out of view": not np.isfinite(place).all(),
        }
        return self._count_reading(name, {**rejected, "not asked for": name not in self.wanted})

    def _accept_angles(self, t: float, x: Array, late: bool) -> Array:
        """Angles (M,) rad, NaN where they may not be used."""
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
        accepted = self._count_reading("encoders", {**rejected, "not asked for": not any(usable)})
        return x if accepted and all(usable) else np.where(np.array(usable) & accepted, x, np.nan)

    def _count_reading(self, sense: str, rejected: Mapping[str, bool]) -> bool:
        """Count a reading as accepted or by its first reason for rejection; whether accepted."""
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
    """The numbers given, as many as one of the sizes; UsageError otherwise."""
    try:
        found = np.asarray(given, float)
    except (TypeError, ValueError):
        found = np.empty((0, 0))
    if found.ndim != 1 or len(found) not in sizes:
        raise UsageError(f"{what}: {' '.join(str(given).split())[:80]} found, possible: {possible}")
    return found


@dataclass(eq=False)
class LiveInstant:
    """Time t (s), the state after it, and its readings:
    angles (M,) rad, NaN where missing, or None, and frames.
    """

    t: float
    after: State
    angles: Array | None = None
    frames: Mapping[str, PendingFrame] = field(default_factory=dict)
    nats: float = 0.0

    def add_readings(self, angles: Array | None, frames: Mapping[str, PendingFrame]) -> None:
        """Add readings of the same time."""
        if self.angles is not None and angles is not None:
            angles = np.where(np.isfinite(angles), angles, self.angles)
        self.angles = self.angles if angles is None else angles
        self.frames = {**self.frames, **frames}


class ReplayBuffer:
    """The instants of the last `lag` seconds, at least one, and the one before them."""

    def __init__(
        self, first: State, lag: float, step: Callable[[State, LiveInstant], State]
    ) -> None:
        """Only the `first` state; `step` gives the state after an instant from the one before."""
        self._instants = [LiveInstant(first.t, first)]
        self._lag = lag
        self._step = step

    @property
    def last_state(self) -> State:
        """The state now."""
        return self._instants[-1].after

    def is_too_late(self, t: float) -> bool:
        """Whether t (s) is before all instants that can be recomputed."""
        return t <= self._instants[0].t

    def insert_readings(
        self, t: float, angles: Array | None, frames: Mapping[str, PendingFrame]
    ) -> tuple[State, State, float]:
        """Insert readings at t (s) and recompute all later
        instants: the states after t and now, and the nats added.
        """
        at = bisect_left(self._instants, t, key=lambda instant: instant.t)
        if at == len(self._instants) or self._instants[at].t > t:
            self._instants.insert(at, LiveInstant(t, self._instants[at - 1].after))
        self._instants[at].add_readings(angles, frames)
        nats = 0.0
        for before, instant in pairwise(self._instants[at - 1 :]):
            instant.after = self._step(before.after, instant)
            nats += instant.after.nats - instant.nats
            instant.nats = instant.after.nats
        then = self._instants[at].after
        now = self.last_state
        while len(self._instants) > 2 and self._instants[1].t < now.t - self._lag:
            del self._instants[0]
        return then, now, nats


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
        _refuse_whole_log_settings(settings)
        if not lag >= 0:
            raise UsageError(f"lag: {lag} found, a time of at least 0 s is possible")
        self._body = body
        self._settings = settings
        self._lag = lag
        noise_model.check_typed_variances(
            settings, body.joints, [name for name in body.senses if name != "encoders"]
        )
        noise = noise_model.with_typed_noise(
            carry_noise_model(body, learned), settings, body.joints
        )
        self._noise = noise
        self._stated = noise.stated_covariance(np.ones((len(body.joints),) * 2))
        self._inputs = LiveInputs(body, settings, to_angles)
        self._correlations = {
            name: correlate_errors(noise, name, model)
            for name, model in self._inputs.models.items()
        }
        self._first_angles = np.full(len(body.joints), np.nan)
        self._given_start = read_given_start(settings, body.joints)
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
        return self._step_together([(require_finite_time(t), joints, places)])

    def _step_together(
        self, parts: Sequence[tuple[float, Angles | None, Mapping[str, Place | None]]]
    ) -> Belief:
        """The belief after readings of several times (s): each a time, joints and places."""
        given = [(t, self._inputs.parse_readings(joints, places)) for t, joints, places in parts]
        if self._buffer is None:
            self._waiting += given
            while self._waiting[0][0] < max(t for t, _ in given) - self._lag:
                self._inputs.accept_readings(*self._waiting.pop(0), late=True)
            self._buffer = self._begin_buffer(
                [readings.angles for _, readings in given if readings.angles is not None]
            )
            given = self._waiting
            self._waiting = []
        beliefs = [self._filter_readings(self._buffer, t, readings) for t, readings in given]
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

    def _filter_readings(self, buffer: ReplayBuffer, t: float, given: Observation) -> Belief:
        """The belief now, after readings of the time t (s)."""
        late = buffer.is_too_late(t)
        accepted = self._inputs.accept_readings(t, given, late)
        if late:
            return self._build_belief(buffer.last_state, 0.0, {})
        frames = {
            name: self._build_frame(name, t, place, var)
            for name, (place, var) in accepted.places.items()
        }
        then, now, nats = buffer.insert_readings(t, accepted.angles, frames)
        errors = {name: then.errors[name] for name in frames}
        if accepted.angles is not None:
            errors["encoders"] = np.array(then.encoder_d)
        return self._build_belief(now, nats, errors, then.lost)

    def _build_frame(self, name: str, t: float, place: Array, var: Array) -> PendingFrame:
        """A track's frame at t (s), of place (D,) and variance (D,)."""
        scale = self._noise.scale.get(name, 1.0)
        return PendingFrame(
            self._inputs.models[name], t, place, scale * var, self._correlations[name], LastFrame()
        )

    def _build_belief(
        self, now: State, nats: float, errors: Mapping[str, Array], lost: Array | None = None
    ) -> Belief:
        """The public record of a state."""
        names = self._body.joints
        m = len(names)
        z = now.z.copy()
        cov = now.p[:m, :m]
        cov = (
            self._stated * cov if now.held is None else self._noise.stated_covariance(cov, now.held)
        )
        offset = self._noise.order * m
        bias = z[offset:] if len(z) > offset else None
        return Belief(now.t, z[:m], z[m : 2 * m], cov, nats, errors, bias, lost, names)

    def _begin_buffer(self, readings: Sequence[Array]) -> ReplayBuffer:
        """A buffer with the initial belief alone; `readings` (M,) rad of this call.

        LogError while a joint has not been read.
        """
        names = self._body.joints
        noise = self._noise
        for angles in readings:
            known = np.isfinite(self._first_angles)
            self._first_angles = np.where(known, self._first_angles, angles)
        x = self._first_angles if self._given_start is None else self._given_start
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
        stationary = build_stationary_motion(inputs.wanted, x, noise)
        dynamics = FilterDynamics(noise.process, drift, is_prior, noise.motion, stationary)
        sequential = SequentialFilter(dynamics, posture)
        var = noise.encoder.tolist()
        nothing = [np.nan] * len(names)

        def filter_instant(before: State, at: LiveInstant) -> State:
            readings = nothing if at.angles is None else at.angles.tolist()
            ages = [at.t - t for t in before.read_t]
            silent = [LONG_SILENCE_S < age < inf for age in ages]
            factor = np.where(silent, noise.burst_factor, 1.0) if any(silent) else None
            return sequential.filter_instant(before, at.t, readings, var, at.frames, factor)

        return ReplayBuffer(sequential.build_first_state(x), self._lag, filter_instant)


def _refuse_whole_log_settings(settings: EstimationSettings) -> None:
    """UsageError for settings that need the whole log."""
    able = tuple(name for name, method in METHODS.items() if method.live)
    possible = {"method": able, "precision": ("model",), "bias": ("off", "on"), "motion": ("auto",)}
    for name, values in possible.items():
        if (found := getattr(settings, name)) not in values:
            raise UsageError(
                f"{name}: {found!r} needs the whole log; possible live: {' or '.join(values)}"
            )
