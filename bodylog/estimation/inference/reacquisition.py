"""Re-acquisition: detect a belief that lost the arm,
at first or while encoders were silent, and reset it.

Images alone may leave a direction undetermined or have several
solutions, and a belief linearised at the wrong one is overconfident.
If a single encoder is wrong, no posture fits both it and the images.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ...motion import START_STD
from ...types import Array, Finding
from ...wording import list_in_words
from ..measurements.long_arrays import find_finite_rows
from ..measurements.records import Encoders, Evidence
from ..noise.correlated_noise import PendingFrame
from .filter_pass import GATE_SIGMA

LONG_SILENCE_S = 0.5
"""s: after a longer silence an encoder must confirm the belief before the gate may reject it. With
0.25 s errors of 177 drawn logs stay; with 1 s smoothed ones are 4 % larger in silences of 2 s, and
20 % larger by a frozen encoder.

A live filter's readings may be as late: they come before their encoder counts as silent.
"""


def find_lost_joints(
    t: float,
    ages: Array,
    z: Array,
    p: Array,
    readings: Array,
    var: Array,
    seen: Mapping[Any, PendingFrame],
    now: bool,
    order: int,
) -> tuple[Array | None, Array]:
    """Joints (M,) bool that a belief z (K,), p (K,K) has lost
    by t (s), or None; encoders (M,) bool that confirm it.

    ages (M,) s: since each encoder confirmed the belief · readings (M,) rad, NaN where silent, with
    variances var · seen: last frame of each track · now: whether there are frames at t · order: of
    the motion. A joint is lost if its standard deviation exceeds a turn when something is measured.
    """
    present = np.isfinite(readings)
    m = len(readings)
    lost = (p.diagonal()[:m] > math.tau**2) & (present | now)
    confirmed = present & (ages <= LONG_SILENCE_S)
    if not lost.any():
        lost, confirmed = _test_lost_joints(
            t, ages > LONG_SILENCE_S, z, p, readings, var, seen, order
        )
    return lost if lost.any() else None, confirmed


def _test_lost_joints(
    t: float,
    mute: Array,
    z: Array,
    p: Array,
    readings: Array,
    var: Array,
    seen: Mapping[Any, PendingFrame],
    order: int,
) -> tuple[Array, Array]:
    """Joints (M,) bool that the belief has lost, and encoders
    that confirm it, after some were `mute` (M,) for long.

    The belief is lost if a wide prior for these joints makes
    all readings likelier, and the images agree with that.
    """
    m = len(readings)
    present = np.isfinite(readings)
    # a wide belief follows a reading, so the reading does not confirm it
    tested = present & mute & (np.diagonal(p)[:m] < START_STD[0] ** 2)
    if not tested.any():
        return tested, present & ~mute
    rows = np.eye(m, len(z)) + np.eye(m, len(z), order * m)
    h = rows[present]
    noise = np.diag(var[present])
    nats = _compute_innovation_nats((readings - rows @ z)[present], h @ p @ h.T + noise)
    x, cov = _restart_joints(z, p, mute, readings, order)
    total = h @ cov @ h.T + noise
    # encoders that were not mute still contradict the reset belief
    if _compute_innovation_nats((readings - rows @ x)[present], total) >= nats:
        return np.zeros(m, bool), present & ~mute | tested
    gain = np.linalg.solve(total, h @ cov).T
    x = x + gain @ (readings[present] - h @ x)
    cov = cov - gain @ h @ cov
    agrees = all(
        _agrees_with_frame(x, cov, m, t - sight.t, sight, order) for sight in seen.values()
    )
    return mute & agrees, present & ~mute


def find_open_joints(ages: Array, numbers: Array | int) -> Array:
    """Joints (…,M) bool that images leave open: they were read last `ages` (…,M) s ago, long
    before now, and are no fewer than the `numbers` (…) that the images give.

    ages is infinite before the first reading.
    """
    silent = np.isfinite(ages) & (ages > LONG_SILENCE_S)
    return np.asarray(silent & (numbers <= silent.sum(axis=-1))[..., None])


def find_silent_joints(t: Array, evidence: Evidence) -> Array:
    """Joints (E,M) bool whose encoders, read before, have been silent for long at times t (E,) s.

    Of an encoder that froze or died it is known from its last sound reading on.
    """
    assert evidence.encoders is not None
    durations = _measure_reading_ages(t, evidence.encoders)
    stopped = evidence.stopped_encoders
    if stopped.any():
        durations = np.where(stopped, measure_reading_gaps(t, evidence.encoders), durations)
    return np.asarray(durations > LONG_SILENCE_S)


def find_joints_left_open(t: Array, evidence: Evidence, missing: int = 0) -> Array:
    """Silent joints (E,M) bool at times t (E,) s that images
    of the time before, with no more numbers, leave open.

    missing: numbers by which they are too few, at least: with none, single postures may look the
    same; with 1, a continuum does.
    """
    assert evidence.encoders is not None
    numbers = np.zeros(len(t))
    for sighting in evidence.sightings:
        times = sighting.t[find_finite_rows(sighting.values)]
        recent = np.abs(_measure_time_since_last(times, t)) <= LONG_SILENCE_S
        numbers += sighting.values.shape[1] * recent
    return find_open_joints(_measure_reading_ages(t, evidence.encoders), numbers + missing)


def extend_open_silence(t: Array, held: Array) -> Array:
    """Joints (E,M) bool in or shortly before or after an
    open silence at times t (E,) s; held (E,M) bool: in it.

    A joint is held only a while after its last reading.
    """
    known = [np.append(t[column], np.inf) for column in held.T]
    return np.stack(
        [
            times[np.searchsorted(times, t - LONG_SILENCE_S)] <= t + 2.0 * LONG_SILENCE_S
            for times in known
        ],
        axis=1,
    )


def _measure_reading_ages(t: Array, encoders: Encoders) -> Array:
    """Times (E,M) s since each encoder's last reading before t (E,) s; −∞ before the first."""
    return np.stack(
        [
            _measure_time_since_last(encoders.t[np.isfinite(column)], t)
            for column in encoders.values.T
        ],
        axis=1,
    )


def measure_reading_gaps(t: Array, encoders: Encoders) -> Array:
    """Times (E,M) s between each encoder's readings before and from t (E,) s on; −∞ before the
    first, ∞ after the last.
    """
    known = [np.append(encoders.t[np.isfinite(column)], np.inf) for column in encoders.values.T]
    ahead = np.stack([times[np.searchsorted(times, t)] - t for times in known], axis=1)
    ages = _measure_reading_ages(t, encoders)
    return np.asarray(np.add(ages, ahead, where=np.isfinite(ages), out=ages))


def _measure_time_since_last(known: Array, t: Array) -> Array:
    """Times (E,) s since the last of the `known`
    times (N,) before t (E,) s; −∞ before the first.
    """
    return np.asarray(t - np.concatenate([[np.inf], known])[np.searchsorted(known, t)])


def warn_of_resets(names: tuple[str, ...], t: Array, reset: Array) -> Iterator[Finding]:
    """A warning for joints reset at some of the instants t (E,) s, reset (E,M) bool."""
    at = np.flatnonzero(reset.any(axis=1))
    joints = ", ".join(names[j] for j in np.flatnonzero(reset.any(axis=0)))
    if len(at):
        times = list_in_words([f"{t[k]:.3f}" for k in at], " times", unit=" s")
        yield Finding(
            "warning",
            f"belief: lost {joints} until {times} and reset there by the encoders; the angles "
            "just before are wrong",
        )


def _restart_joints(
    z: Array, p: Array, joints: Array, readings: Array, order: int
) -> tuple[Array, Array]:
    """A belief z (K,), p (K,K) of which `joints` (M,)
    bool restart from the prior, at their readings if any.
    """
    m = len(joints)
    gone = np.concatenate([*[joints] * order, np.zeros(len(z) - order * m, bool)])
    p = p * ~(gone[:, None] | gone)
    p[gone, gone] = np.repeat(np.square(START_STD[:order]), joints.sum())
    offset = z[order * m :] if len(z) > order * m else 0.0
    z = np.where(gone & (np.arange(len(z)) >= m), 0.0, z)
    z[:m] = np.where(joints & np.isfinite(readings), readings - offset, z[:m])
    return z, p


def _compute_innovation_nats(nu: Array, s: Array) -> float:
    """Nats of innovations nu (R,) with covariance s (R,R), without constants."""
    return float(nu @ np.linalg.solve(s, nu) + np.linalg.slogdet(s)[1])


def _agrees_with_frame(
    z: Array, p: Array, m: int, age: float, sight: PendingFrame, order: int
) -> bool:
    """Whether a belief agrees with a frame seen `age` s before."""
    states = order * m
    back = np.hstack([np.eye(m), -age * np.eye(m), 0.5 * age**2 * np.eye(m)])[:, :states]
    x = back @ z[:states]
    cov = back @ p[:states, :states] @ back.T
    mean, jac, model = sight.predict_single(x)
    nu = sight.value - mean
    s = jac @ cov @ jac.T + np.diag(model + sight.var)
    return float(nu @ np.linalg.solve(s, nu)) <= GATE_SIGMA**2
