"""The live filter: one step per instant, with the same belief as the batch filter."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...body_model import BodyModel
from ...errors import LogError, UsageError
from ...settings import EstimationSettings
from ...types import Array, Health
from ..faults.encoder_offset import RANDOM_WALKS
from ..inference.filter_records import FilterDynamics
from ..inference.reacquisition import LONG_SILENCE_S
from ..inference.sequential import SequentialFilter, State
from ..measurements.gather import given_start
from ..methods.table import METHODS
from ..noise import typed
from ..noise.correlated_noise import ErrorCorrelation, LastFrame, PendingFrame, correlation_length
from ..noise.noise_model import carry_noise_model
from ..noise.posture_prior import build_posture_prior, build_stationary_motion
from .inputs import Angles, Inputs, Observation, Place, ToAngles, require_finite_time
from .replay_buffer import Instant, ReplayBuffer


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
        typed.check_typed_variances(
            settings, body.joints, [name for name in body.senses if name != "encoders"]
        )
        self._noise = noise = typed.with_typed_noise(
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
            given_start(settings, body.joints),
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
        order = noise.order
        posture = build_posture_prior(inputs.silent, inputs.wanted, noise.process, x, order)
        is_prior = None if posture is None else posture.joints
        dynamics = FilterDynamics(
            noise.process, drift, is_prior, order, build_stationary_motion(inputs.wanted, x, noise)
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
    possible = {"method": able, "precision": ("model",), "bias": ("off", "on")}
    for name, values in possible.items():
        if (found := getattr(settings, name)) not in values:
            raise UsageError(
                f"{name}: {found!r} needs the whole log; possible live: {' or '.join(values)}"
            )
