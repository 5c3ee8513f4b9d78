"""A belief that lost the arm, at first or while encoders were silent: told by what these say, where pictures agree.

Pictures alone may leave a direction unknown or have several solutions, and a belief linearised at the wrong one is
sure of it. Of one encoder that lies no posture is in line with what was seen.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...types import Array, Finding
from ..noise.correlated_noise import LastFrame, PendingFrame
from ..noise.posture_prior import PosturePrior

START_STD = 1.0
"""rad and rad/s: how little is known of angles and rates before the first reading."""
SURE = 0.5
"""Share of that which must not be left for a reading to bear a belief out rather than to make it."""
SILENCE = 0.5
"""s: after a longer one an encoder is to bear out the belief before this may contradict it."""
VAGUE = 100.0
"""rad: a belief less sure of an angle holds nothing of it; its variance would soon swallow a reading's by rounding."""
NAMED = 3
"""Times that are named of those at which a belief was lost."""
APART = 3.0
"""Standard deviations by which a posture disagrees with what was seen."""


@dataclass(frozen=True, eq=False)
class AcquisitionState:
    """When each encoder bore out the belief last, (M,) s, −∞ for never, and what was last seen of each track.

    loose (M,) bool: joints that were adrift by the last picture, and have not been borne out since.
    """

    borne: Array
    seen: Mapping[Any, PendingFrame]
    loose: Array

    @staticmethod
    def begun(joints: int) -> "AcquisitionState":
        """Before the first instant."""
        return AcquisitionState(np.full(joints, -np.inf), {}, np.zeros(joints, bool))

    def mute(self, t: float) -> Array:
        """Joints (M,) bool whose encoders have long said nothing by t (s), or have been contradicting since then."""
        return np.asarray(t - self.borne > SILENCE)

    def adrift(self, t: float) -> Array:
        """Joints (M,) bool silent for long by t (s) that what is seen, no more numbers than joints, hardly holds."""
        silent = self.mute(t) & np.isfinite(self.borne)
        numbers = sum(len(sight.value) for sight in self.seen.values() if t - sight.t <= SILENCE)
        return np.asarray(silent & (0 < numbers <= silent.sum()))

    def reminded(self, t: float, wont: PosturePrior | None, said: Array, var: Array) -> tuple[Array, Array, Array]:
        """Readings said (M,) rad, NaN if silent, and variances with reminders of joints adrift by t (s); of which."""
        if wont is None:
            return said, var, np.zeros(len(said), bool)
        last = np.maximum(self.borne, max((sight.t for sight in self.seen.values()), default=-np.inf))
        return wont.remind(said, var, self.adrift(t), t - last)

    def remembered(self, track: Any, sight: PendingFrame) -> PendingFrame:
        """A sight of a track with what is remembered of its last one."""
        return replace(sight, memory=self.seen[track].memory) if track in self.seen else sight

    def after(
        self, t: float, borne: Array, here: Mapping[Any, PendingFrame], memories: Iterable[LastFrame]
    ) -> "AcquisitionState":
        """The same once encoders bore the belief out at t (s), (M,) bool, and sights were heard and left memories."""
        seen = {track: replace(sight, memory=left) for (track, sight), left in zip(here.items(), memories, strict=True)}
        loose = (self.adrift(t) if seen else self.loose) & ~borne
        return AcquisitionState(np.where(borne, t, self.borne), {**self.seen, **seen} if seen else self.seen, loose)

    def judge(
        self, t: float, z: Array, p: Array, said: Array, var: Array, seen: bool
    ) -> tuple[Array | None, Array]:  # fmt: skip
        """Joints (M,) bool that the belief z (K,), p (K,K) lost by t (s), or None; those whose encoders bear it out.

        These read `said` (M,), NaN where silent, with variances var; `seen`: there is a picture. A joint is lost that
        has become vague by the time something is heard of it. Where some are mute, the belief is lost, too, if what
        all say is likelier by one that knows nothing of these joints, and pictures agree with that.
        """
        heard, mute, m = np.isfinite(said), self.mute(t), len(said)
        vague = (np.diagonal(p)[:m] > VAGUE**2) & (heard | seen)
        if vague.any():
            return vague, heard & ~mute
        # a belief that knows nothing is made by a reading, not borne out
        tested = heard & mute & (np.diagonal(p)[:m] < (SURE * START_STD) ** 2)
        if not tested.any():
            return None, heard & ~mute
        rows = np.eye(m, len(z)) + np.eye(m, len(z), 2 * m)
        h, nu, noise = rows[heard], (said - rows @ z)[heard], np.diag(var[heard])
        x, cov = z.copy(), p.copy()
        forget(x, cov, mute, said, 0.0)
        anew = h @ cov @ h.T + noise
        # encoders that were not mute still contradict the belief that starts again
        if _nats((said - rows @ x)[heard], anew) >= _nats(nu, h @ p @ h.T + noise):
            return None, heard & ~mute | tested
        gain = np.linalg.solve(anew, h @ cov).T
        x, cov = x + gain @ (said[heard] - h @ x), cov - gain @ h @ cov
        lost = all(_agree(x, cov, m, t - sight.t, sight) for sight in self.seen.values())
        return mute if lost else None, heard & ~mute


def named(names: tuple[str, ...], t: Array, anew: Array) -> Iterator[Finding]:
    """A warning for joints lost at some of the instants t (E,) s, anew (E,M) bool."""
    at, joints = np.flatnonzero(anew.any(axis=1)), ", ".join(names[j] for j in np.flatnonzero(anew.any(axis=0)))
    if len(at):
        more = f" and {len(at) - NAMED} times more" if len(at) > NAMED else ""
        times = ", ".join(f"{t[k]:.3f}" for k in at[:NAMED])
        text = f"belief: lost {joints} until {times} s{more}, begun anew there by what encoders say; angles just before"
        yield Finding("warning", f"{text} are wrong")


def forget(z: Array, p: Array, joints: Array, said: Array, dt: Array | float) -> None:
    """Of `joints` (M,…) let z (K,…) and p (K,K,…), in place, know what they did before any reading but the one `said`.

    That is where they begin; those of which nothing is said, NaN, stay where they were a step dt (…) s before.
    """
    m = len(joints)
    gone = np.zeros(z.shape, bool)
    gone[:m] = gone[m : 2 * m] = joints
    p *= ~(gone[:, None] | gone[None])
    np.einsum("kk...->k...", p)[:] += START_STD**2 * gone
    offset = z[2 * m :] if len(z) > 2 * m else 0.0
    z[:m] -= joints * (dt * z[m : 2 * m])
    z[:m] = np.where(joints & np.isfinite(said), said - offset, z[:m])
    z[m : 2 * m] *= ~joints


def _nats(nu: Array, s: Array) -> float:
    """Of innovations nu (R,) with covariance s (R,R), but for what does not depend on these."""
    return float(nu @ np.linalg.solve(s, nu) + np.linalg.slogdet(s)[1])


def _agree(z: Array, p: Array, m: int, age: float, sight: PendingFrame) -> bool:
    """Whether a belief agrees with what was seen `age` s before."""
    back = np.concatenate([np.eye(m), -age * np.eye(m)], axis=1)
    x, cov = back @ z[: 2 * m], back @ p[: 2 * m, : 2 * m] @ back.T
    mean, jac, model = (part[0] for part in sight.model.predict(x[None]))
    nu, s = sight.value - mean, jac @ cov @ jac.T + np.diag(model + sight.var)
    return float(nu @ np.linalg.solve(s, nu)) <= APART**2
