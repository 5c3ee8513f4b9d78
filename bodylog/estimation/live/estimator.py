"""The live filter: one step per instant, with the same belief as the batch filter."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...body_model import BodyModel, ForwardModel
from ...errors import LogError, UsageError
from ...settings import Estimation
from ...types import Array, Health
from ..faults.encoder_offset import WALKS
from ..inference import initial_path
from ..inference.encoder_steps import EncoderSteps, even
from ..inference.filter_records import Dynamics
from ..inference.instant import hear
from ..inference.motion import Motion
from ..inference.reacquisition import SILENCE, VAGUE, AcquisitionState, forget
from ..inference.scan import EVEN
from ..methods.table import METHODS
from ..noise import typed
from ..noise.correlated_noise import PAST, ErrorCorrelation, LastFrame, PendingFrame, reach
from ..noise.noise_model import NoiseModel, carried
from ..noise.posture_prior import PosturePrior, prior_of, stationary
from .inputs import Angles, Inputs, Observation, Place, ToAngles, finite
from .replay_buffer import Instant, ReplayBuffer, State

GIVEN = Estimation(precision="model", bias="off")
"""Settings of a filter without knowledge of the future."""
LAG = 0.5
"""s: the longest delay of a reading."""


@dataclass(frozen=True, eq=False)
class Belief:
    """At t (s): angles x (M,) rad · rates (M,) rad/s · cov (M,M) rad² of the angles · encoders' bias (M,) rad or None.

    free_energy (nats) of the readings given the earlier ones · errors {sense: (D,) standard deviations} of that instant
    · lost: joints (M,) bool that were re-initialised at that instant, or None.
    """

    t: float
    x: Array
    rate: Array
    cov: Array
    free_energy: float
    errors: Mapping[str, Array]
    bias: Array | None = None
    lost: Array | None = None


class Estimator:
    """A filter fed as readings arrive: `est.step(t, joints=…, effector=…)`; noise is the body's own, or a log's."""

    def __init__(
        self, body: BodyModel, settings: Estimation | None = None, lag: float = LAG, to_angles: ToAngles = np.asarray,
        learned: Mapping[str, Any] | None = None,
    ) -> None:  # fmt: skip
        """A filter for `body` with the senses, start and bias of `settings`; readings may be up to `lag` s late.

        `to_angles` converts encoder readings to angles · `learned`: settings of an estimate, whose variances are used.
        UsageError for settings that need the whole log, and for variances of another body.
        """
        settings = settings or GIVEN
        _needs_no_log(settings, body)
        if not lag >= 0:
            raise UsageError(f"lag: {lag} found, a time of at least 0 s is possible")
        self._body, self._settings, self._lag = body, settings, lag
        typed.check(settings, body.joints, [name for name in body.senses if name != "encoders"])
        self._precision = typed.precision(carried(body, learned), settings, body.joints)
        self._stated = self._precision.of(np.ones((len(body.joints),) * 2))
        self._inputs = Inputs(body, settings, to_angles)
        self._first = np.full(len(body.joints), np.nan)
        self._buffer: ReplayBuffer | None = None
        self._waiting: list[tuple[float, Observation]] = []

    @property
    def used(self) -> Mapping[str, Health]:
        """Counts of used and rejected readings, by sense."""
        return self._inputs.used

    def step(self, t: float, joints: Angles | None = None, **places: Place | None) -> Belief:
        """The belief after all readings up to t (s): joints in rad, places (u, v) or (u, v, std_u, std_v) in px.

        None, or NaN, is a missing reading. Readings may arrive out of order by up to `lag` s; the belief is about the
        latest instant. UsageError or ModelError for readings that do not fit the body. LogError until every joint has
        been read once; earlier readings are then applied together.
        """
        return self._step_all([(finite(t), joints, places)])

    def _step_all(self, parts: Sequence[tuple[float, Angles | None, Mapping[str, Place | None]]]) -> Belief:
        """The belief after readings of several times (s): each a time, joints and places."""
        given = [(t, self._inputs.read(joints, places)) for t, joints, places in parts]
        if self._buffer is None:
            self._waiting += given
            while self._waiting[0][0] < max(t for t, _ in given) - self._lag:
                self._inputs.accept(*self._waiting.pop(0), late=True)
            self._buffer = self._begin([one.angles for _, one in given if one.angles is not None])
            given, self._waiting = self._waiting, []
        beliefs = [self._hear(self._buffer, *one) for one in given]
        if len(beliefs) == 1:
            return beliefs[0]
        errors = {name: error for belief in beliefs[-len(parts) :] for name, error in belief.errors.items()}
        return replace(beliefs[-1], free_energy=sum(belief.free_energy for belief in beliefs), errors=errors)

    def _hear(self, buffer: ReplayBuffer, t: float, given: Observation) -> Belief:
        late = buffer.late(t)
        accepted = self._inputs.accept(t, given, late)
        if late:
            return self._belief(buffer.last, 0.0, {})
        then, now, nats = buffer.add(t, accepted)
        names = {*accepted.places, *(("encoders",) if accepted.angles is not None else ())}
        shown = {name: np.asarray(error) for name, error in then.errors.items() if name in names}
        return self._belief(now, nats, shown, then.lost)

    def _belief(self, now: State, nats: float, errors: Mapping[str, Array], lost: Array | None = None) -> Belief:
        m, z = len(self._body.joints), now.belief[:, -1].copy()
        first = self._precision.order * m
        bias = z[first:] if len(z) > first else None
        cov = self._stated * now.belief[:m, :m]
        if now.held is not None and now.held.any():
            cov = self._precision.of(now.belief[:m, :m], now.held)
        return Belief(now.t, z[:m], z[m : 2 * m], cov, nats, errors, bias, lost)

    def _begin(self, readings: Sequence[Array]) -> ReplayBuffer:
        """An empty buffer with the initial belief; `readings` (M,) rad of this call."""
        names, given, precision = self._body.joints, self._settings.start, self._precision
        for angles in readings:
            self._first = np.where(np.isfinite(self._first), self._first, angles)
        x = self._first if given is None else np.array(given, float)
        if not np.isfinite(x).all():
            unknown = ", ".join(name for name, angle in zip(names, x, strict=True) if not np.isfinite(angle))
            raise LogError(f"joints: no reading of {unknown} yet; pass every joint once, or set `start`")
        drift = np.full(len(names), WALKS[1]) if self._settings.bias == "on" else None
        process, order, near = precision.process, precision.order, precision.near
        posture = prior_of(self._inputs.silent, self._inputs.wanted, process, x, order)
        resting = stationary(self._inputs.wanted, x, precision)
        dynamics = Dynamics(process, drift, None if posture is None else posture.joints, order, resting)
        models = self._inputs.models
        like = {n: ErrorCorrelation(process, reach(m), near.get(n, 0.0), PAST, order=order) for n, m in models.items()}
        one = _Filter(Motion(dynamics), EncoderSteps(dynamics, precision.encoder), posture, precision, like, models)
        z, p = initial_path.prior_of(x, dynamics)
        watch = AcquisitionState.initial(len(x))
        first = State(-np.inf, np.column_stack([p, z]), watch, watch.borne.tolist())
        return ReplayBuffer(first, self._lag, one.hear)


@dataclass(frozen=True, eq=False)
class _Filter:
    """One step of the filter."""

    motion: Motion
    steady: EncoderSteps
    posture: PosturePrior | None
    precision: NoiseModel
    like: Mapping[str, ErrorCorrelation]
    models: Mapping[str, ForwardModel]

    def hear(self, before: State, at: Instant) -> State:
        """The state after an instant, from the state before it."""
        return self._by_encoders(before, at) or self._by_all(before, at)

    def _by_encoders(self, before: State, at: Instant) -> State | None:
        """The fast step for encoders alone, if all of them recently confirmed the belief; else None."""
        t = at.t
        if at.places or self.posture is not None or not t - before.oldest <= SILENCE:
            return None
        belief, uneven = self.steady.moved(before.belief, t - before.t), (before.uneven + 1) % EVEN[self.motion.order]
        if not uneven:
            even(belief)
        if max(belief.diagonal().tolist()[: self.steady.joints]) > VAGUE**2:
            return None
        if at.angles is None:
            return State(t, belief, before.watch, before.borne, before.oldest, uneven)
        angles = at.angles.tolist()
        try:
            nats, d = self.steady.condition(belief, angles)
        except ArithmeticError:
            return None  # the full step reports the error
        borne = [t if reading == reading else last for reading, last in zip(angles, before.borne, strict=True)]
        return State(t, belief, before.watch, borne, min(borne), uneven, nats, {"encoders": d})

    def _by_all(self, before: State, at: Instant) -> State:
        dt = at.t - before.t if np.isfinite(before.t) else 0.0
        watch, motion, var = replace(before.watch, borne=np.array(before.borne)), self.motion, self.precision.encoder
        angles = np.full(len(var), np.nan) if at.angles is None else at.angles
        held = watch.held(at.t)
        z, p = motion.move(before.belief[:, -1], before.belief[:, :-1], dt, held=held)
        lost, borne = watch.judge(at.t, z, p, angles, var, bool(at.places), motion.order)
        if lost is not None:
            forget(z, p, lost, angles, dt, motion.order)
        here = {name: self._frame(name, at.t, *place, watch.seen.get(name)) for name, place in at.places.items()}
        if self.posture is not None and dt > 0.0:
            angles, var = self.posture.read(angles, var, dt)
        adrift = bool(here) and watch.adrift(at.t)
        found = hear(motion, z, p, angles, var, list(here.values()), adrift=adrift)
        errors = dict(zip(at.places, found.errors, strict=True)) | {"encoders": found.encoder_d}
        watch = watch.after(at.t, borne, here, found.memories)
        belief = np.empty(before.belief.shape)
        belief[:, :-1], belief[:, -1] = found.p, found.z
        borne = watch.borne.tolist()
        return State(at.t, belief, watch, borne, min(borne), 0, found.nats, errors, lost, held)

    def _frame(self, name: str, t: float, place: Array, var: Array, last: PendingFrame | None) -> PendingFrame:
        """A frame at t (s), with the track's last one."""
        scale, memory = self.precision.scale.get(name, 1.0), LastFrame() if last is None else last.memory
        return PendingFrame(self.models[name], t, place, scale * var, self.like[name], memory)


def _needs_no_log(settings: Estimation, body: BodyModel) -> None:
    """UsageError for settings that need the whole log."""
    able = tuple(name for name, method in METHODS.items() if method.live)
    possible = {"method": able, "precision": ("model",), "bias": ("off", "on")}
    for name, values in possible.items():
        if (found := getattr(settings, name)) not in values:
            raise UsageError(f"{name}: {found!r} needs the whole log; possible live: {' or '.join(values)}")
    if settings.start is not None and len(settings.start) != len(body.joints):
        raise UsageError(f"start: {len(settings.start)} angles given, the body has {len(body.joints)} joints")
