"""The filter beside a live robot: one step per instant, the same belief as the batch filter's."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import LogError, UsageError
from ..settings import Estimation
from ..types import Array, BodyModel
from .alike import PAST, Memory, Sight
from .bias import WALKS
from .instant import hear
from .outset import OFFSET_STD, START_STD
from .scan import Dynamics


@dataclass(frozen=True, eq=False)
class Belief:
    """At t (s): angles x (M,) rad · rates (M,) rad/s · cov (M,M) rad² of the angles · free energy (nats) of t."""

    t: float
    x: Array
    rate: Array
    cov: Array
    free_energy: float


class Estimator:
    """A filter fed as readings come: `est.step(t, joints=…, effector=…)`; noise is the body's own."""

    def __init__(self, body: BodyModel, settings: Estimation | None = None) -> None:
        """A filter for `body`; of the settings, `bias` "on" and `start` count."""
        settings = settings or Estimation()
        m = len(body.joints)
        if settings.start is not None and len(settings.start) != m:
            raise UsageError(f"start: {len(settings.start)} angles given, the body has {m} joints")
        drift = np.full(m, WALKS[1]) if settings.bias == "on" else None
        self._body, self._start = body, settings.start
        self._dynamics = Dynamics(np.array(body.noise.process, float), drift)
        self._state: tuple[float, Array, Array] | None = None
        self._memory: dict[str, Memory] = {}
        self.skipped = 0

    def step(
        self, t: float, joints: Sequence[float] | Mapping[str, float] | None = None, **sights: Sequence[float] | None
    ) -> Belief:
        """The belief after all that is heard at t (s): joints rad, in the body's order or by name; tracks (u, v) px.

        None, or NaN, is what was not heard; a time before the last is skipped and counted. LogError without a start.
        """
        encoders = self._encoders(joints)
        last, z, p = self._state or (t, *self._prior(encoders))
        if t < last:
            self.skipped += 1
            t, encoders, sights = last, np.full(len(encoders), np.nan), {}
        seen = {name: self._sight(name, value, t) for name, value in sights.items() if value is not None}
        seen = {name: sight for name, sight in seen.items() if sight.seen}
        var = np.array(self._body.noise.encoder, float)
        _, trace = hear(self._dynamics, z, p, t - last, encoders, var, list(seen.values()))
        z, p, m = trace.z[0, :, 0], trace.p[0, :, :, 0], len(encoders)
        self._memory |= {name: sight.after(z[:m]) for name, sight in seen.items()}
        self._state = (t, z, p)
        return Belief(t, z[:m], z[m : 2 * m], p[:m, :m], float(trace.nats[0, 0]))

    def _encoders(self, joints: Sequence[float] | Mapping[str, float] | None) -> Array:
        names = self._body.joints
        if joints is None:
            return np.full(len(names), np.nan)
        if isinstance(joints, Mapping):
            return np.array([joints.get(name, np.nan) for name in names], float)
        if len(joints) != len(names):
            raise UsageError(f"joints: {len(joints)} angles given, the body has {', '.join(names)}")
        return np.array(joints, float)

    def _prior(self, encoders: Array) -> tuple[Array, Array]:
        start = encoders if self._start is None else np.array(self._start, float)
        if not np.isfinite(start).all():
            raise LogError("joints: no reading tells where the arm starts; give `start`, one angle in rad per joint")
        z = np.concatenate([start, np.zeros(self._dynamics.size - len(start))])
        std = np.full(len(z), START_STD)
        std[2 * len(start) :] = OFFSET_STD
        return z, np.diag(std**2)

    def _sight(self, name: str, value: Sequence[float], t: float) -> Sight:
        if name not in self._body.senses:
            raise UsageError(f"{name}: the body has no such sense; it has {', '.join(self._body.senses)}")
        var = np.array(self._body.noise.senses.get(name, (1.0, 1.0)), float)
        pace, memory = PAST * self._dynamics.process, self._memory.get(name, Memory())
        return Sight(self._body.senses[name], t, np.array(value, float), var, pace, 0.0, memory)
