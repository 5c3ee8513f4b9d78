"""A camera's own clock, from a recorder that is faster than the camera.

A recorder with a regular beat stores the latest picture at each of its instants. The stamp of a new
picture is then late by anything between nothing and one beat, and the lateness drifts like a
sawtooth. Where a regular camera explains which stored frames are new, its clock dates each picture
to a fraction of a beat.
"""

from dataclasses import dataclass

import numpy as np

from ...types import Array

LEAST_NEW = 40
"""Fewest new pictures that tell a clock: fewer leave its phase open by more than they gain."""
LEAST_SHARE_REPEATED = 0.1
"""Share of frames that repeat the one before, from which the stamps are a recorder's and not the
camera's: a few repeats are slips."""
REGULAR_BEATS = 0.1
"""Beats by which a stamp may miss the recorder's grid: more may be times that were truly recorded.
A third of the scatter of stamps that are late by up to one beat."""
REGULAR_SHARE = 0.95
"""Share of the stamps' intervals that are regular, at least."""
JITTER_BEATS = 0.1
"""Standard deviation, in beats, of pictures about their clock: of transport and recorder."""
EARLIEST_SIGMA = 2.5
"""Such deviations by which a picture may be early: 1 in 160 is earlier."""
MISTAKEN_SHARE = 0.1
"""Share of frames that are new or repeated by mistake, where a picture moves slowly or is lost."""
LEAST_EXPLAINED = 0.5
"""Share of the entropy of new and repeated frames that a clock has to explain."""
LEAST_EXPECTED = 0.9
"""Share of new pictures that follow the one before and wait for no longer than one beat, at least:
of 60 drawn regular cameras 0.97 to 1, of 20 whose rate swings by 6 % in 10 s 0.80 to 0.89."""
LONGEST_TO_MEAN = (0.9, 1.12)
"""Periods that are tried, over the mean time between new pictures: some pictures are lost, some
repeats are not seen."""
_SCAN_BEATS = 0.25
"""Beats by which neighbours of the scan drift apart over the whole film."""
_NEAR_BEST = 0.8
"""Concentration of phases, over the best one, from which a period is weighed: a recorder's beat
makes periods alike that lie as far beyond a multiple of it as others lie before."""
_MOST_WEIGHED = 60
_MOST_REFINED = 12
_REFINEMENTS = 6
"""Halvings of the search about the best period and phase."""


@dataclass(frozen=True)
class CameraClock:
    """Pictures reach the recorder at `first_s` (s), and every `period_s` before and after it.

    wait_s: time for which they wait there in the mean until they are stored · early_s: time by
    which they may be early.
    """

    first_s: float
    period_s: float
    wait_s: float
    early_s: float

    def date_pictures(self, t: Array) -> Array:
        """When the clock dates the pictures (N,) s that are first stored at t (N,) s; twice the
        same time says that a picture was stored again.

        Dates are later than the arrivals by the mean wait, so that the mean delay of the stamps
        stays what it is.
        """
        number = _latest_pictures(t, self.first_s, self.period_s, self.early_s)
        return self.first_s + self.wait_s + self.period_s * number


@dataclass(frozen=True, eq=False)
class _Arrivals:
    """Between which stamps (N,) s new pictures reached the recorder, give or take `jitter_s`."""

    after: Array
    until: Array
    jitter_s: float

    @property
    def early_s(self) -> float:
        """Time (s) by which few pictures are earlier than their clock."""
        return EARLIEST_SIGMA * self.jitter_s


def fit_camera_clock(t: Array, repeated: Array) -> CameraClock | None:
    """The clock of a camera whose frames are stamped t (N,) s, ascending, and repeat the one before
    where `repeated` (N,).

    None where stamps are irregular, since they may be the camera's own; where few frames repeat;
    and where no regular clock explains which frames are new. The clock has the largest likelihood
    of new and repeated frames.
    """
    new = np.flatnonzero(~repeated[1:]) + 1
    steps = np.diff(t)
    if len(new) < LEAST_NEW or 1.0 - len(new) / len(steps) < LEAST_SHARE_REPEATED:
        return None
    beat = float(np.median(steps))
    if beat <= 0.0:
        return None
    beats = steps / beat
    if np.mean(np.abs(beats - np.rint(beats)) > REGULAR_BEATS) > 1.0 - REGULAR_SHARE:
        return None
    share = len(new) / len(steps)
    entropy = -len(steps) * (share * np.log(share) + (1.0 - share) * np.log(1.0 - share))
    arrived = _Arrivals(t[new - 1], t[new], JITTER_BEATS * beat)
    period, phase, likelihood = _fit_period_and_phase(arrived, beat)
    if likelihood + entropy < LEAST_EXPLAINED * entropy:
        return None
    number = _latest_pictures(arrived.until, phase, period, arrived.early_s)
    waits = arrived.until - phase - period * number
    first = np.flatnonzero(np.diff(number, prepend=-np.inf))
    within = waits <= arrived.until - arrived.after + arrived.early_s
    follows = np.diff(number, prepend=number[0] - 1.0) == 1.0
    if np.mean(within & follows) < LEAST_EXPECTED:
        return None
    return CameraClock(phase, period, float(np.mean(waits[first])), arrived.early_s)


def _fit_period_and_phase(arrived: _Arrivals, beat: float) -> tuple[float, float, float]:
    """Period and phase (s) at which pictures reach the recorder, and their log likelihood.

    Phases of the middles of the intervals in which pictures arrive are concentrated at the true
    period; the likelihood chooses among such periods.
    """
    middles = 0.5 * (arrived.after + arrived.until)
    span = float(middles[-1] - middles[0])
    mean = span / (len(middles) - 1)
    low, high = (max(ratio * mean, beat) for ratio in LONGEST_TO_MEAN)
    drift = _SCAN_BEATS * beat * mean / span
    periods = np.arange(low, high + drift, drift)
    origin = float(middles[0])
    sums = np.array([np.exp(2j * np.pi * (middles - origin) / one).sum() for one in periods])
    length = np.abs(sums)
    near = np.flatnonzero(length >= _NEAR_BEST * length.max())
    near = np.sort(near[np.argsort(-length[near], kind="stable")[:_MOST_WEIGHED]])
    # phases are those at the film's middle, where they hardly depend on the period
    candidates = []
    for number in near.tolist():
        period = float(periods[number])
        phase = origin + float(np.angle(sums[number])) / (2.0 * np.pi) * period
        phase += period * round((0.5 * span + origin - phase) / period)
        step = (0.0, _SCAN_BEATS * beat)
        candidates.append(_search_around(arrived, (-np.inf, period, phase), step))
    candidates.sort(reverse=True)
    best = candidates[0]
    for found in candidates[:_MOST_REFINED]:
        for halving in range(_REFINEMENTS):
            scale = 0.5**halving
            found = _search_around(arrived, found, (0.5 * scale * drift, 0.2 * scale * beat))
        best = max(best, found)
    return best[1], best[2], best[0]


def _search_around(
    arrived: _Arrivals, found: tuple[float, float, float], step: tuple[float, float]
) -> tuple[float, float, float]:
    """The most likely of 25 clocks about one: log likelihood, period and phase (s), in steps of
    period and phase (s)."""
    best = found
    for longer in (-2.0, -1.0, 0.0, 1.0, 2.0) if step[0] else (0.0,):
        for later in (-2.0, -1.0, 0.0, 1.0, 2.0):
            period = found[1] + longer * step[0]
            phase = found[2] + later * step[1]
            best = max(best, (_weigh_clock(arrived, period, phase), period, phase))
    return best


def _weigh_clock(arrived: _Arrivals, period: float, phase: float) -> float:
    """Log likelihood (nats) of the intervals in which new pictures reached the recorder, each given
    the picture before it."""
    number = _latest_pictures(arrived.until, phase, period, arrived.early_s)
    due = phase + period * number
    within = _arrived_share(arrived.until - due, arrived.jitter_s) - _arrived_share(
        arrived.after - due, arrived.jitter_s
    )
    slips = np.abs(np.diff(number) - 1.0).sum()
    likelihood = np.log(MISTAKEN_SHARE + (1.0 - MISTAKEN_SHARE) * within).sum()
    return float(likelihood + slips * np.log(MISTAKEN_SHARE))


def _latest_pictures(t: Array, first_s: float, period_s: float, early_s: float) -> Array:
    """The number (N,) of the latest picture at stamps t (N,) s of first copies: one that is due
    within `early_s`, unless the next frame shows that one."""
    due = np.floor((t - first_s) / period_s)
    early = np.floor((t - first_s + early_s) / period_s)
    return np.where(np.append(due[1:], np.inf) == early, due, early)


def _arrived_share(late_s: Array, jitter_s: float) -> Array:
    """Probability that a picture has arrived `late_s` after it was due: a logistic, which is within
    0.01 of the normal distribution's integral."""
    return np.asarray(0.5 * (1.0 + np.tanh(0.85 * late_s / jitter_s)))
