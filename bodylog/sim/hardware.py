"""Errors of real joints and encoders: play, sag, stick-slip,
encoder errors that last, and how they are typed.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..choices import HARDWARE
from ..errors import UsageError
from ..types import Array
from .plan import describe_unknown_name

EXAMPLE = "play=0.25,sag=0.3,correlated=0.002@2s"
OUTLIER_RAD = 0.2
"""How far an outlier of an encoder is off."""
PICK_UP_S = 0.2
"""s from the first touch of a payload until the arm carries its whole weight."""


@dataclass(frozen=True)
class Hardware:
    """How joints turn and how they are read; 0 where an error is absent.

    play: between motor and link, from one end to the other, rad · sag, payload: of a joint that
    holds the whole arm stretched out, rad; the first by the torque of the links' masses, which was
    there when the body was learned, the second by that of a weight at the hand, which was not ·
    payload_s: when that weight is picked up, s; 0 for one that is there from the start · stick:
    how far a joint is driven before it slips, rad · correlated: standard deviation (rad) of an
    Ornstein-Uhlenbeck error of each encoder, and its time constant (s) ·
    counts: an encoder's steps in a turn · tails: degrees of freedom of Student's t in place of
    normal noise · outliers: share of readings that are OUTLIER_RAD off · jitter: standard deviation
    of encoder stamps, s · rolling: from a picture's first row to its last, s.
    """

    play: float = 0.0
    sag: float = 0.0
    payload: float = 0.0
    payload_s: float = 0.0
    stick: float = 0.0
    correlated: float = 0.0
    correlation_s: float = 1.0
    counts: float = 0.0
    tails: float = 0.0
    outliers: float = 0.0
    jitter: float = 0.0
    rolling: float = 0.0

    @property
    def bends(self) -> bool:
        """Whether links are elsewhere than the commanded angles."""
        return bool(self.play or self.sag or self.payload or self.stick)

    @property
    def replaces_noise(self) -> bool:
        """Whether encoders have other errors than independent normal ones."""
        return bool(self.correlated or self.tails or self.outliers)

    def carries_payload(self, t: Array) -> Array:
        """The share (N,) of the payload's weight that is carried at times t (N,) s."""
        if not self.payload_s:
            return np.ones(len(t))
        return np.asarray(np.clip((t - self.payload_s) / PICK_UP_S, 0.0, 1.0))


@dataclass(frozen=True)
class ErrorRange:
    """Sizes of an error that can be typed: up to `most`,
    0 or from `least`, in units of `unit` rad or 1.
    """

    most: float
    least: float = 0.0
    unit: float = 1.0


_DEGREE = float(np.deg2rad(1.0))
RANGES: Mapping[str, ErrorRange] = {
    "play": ErrorRange(20.0, unit=_DEGREE),
    "sag": ErrorRange(20.0, unit=_DEGREE),
    "payload": ErrorRange(20.0, unit=_DEGREE),
    "stick": ErrorRange(20.0, unit=_DEGREE),
    "correlated": ErrorRange(1.0),
    "counts": ErrorRange(1e9, least=4.0),
    "tails": ErrorRange(100.0, least=2.1),
    "outliers": ErrorRange(1.0),
    "jitter": ErrorRange(0.1),
    "rolling": ErrorRange(0.1),
}
_NUMBER = r"[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?"
_MOST_S = 1e4
_TIMED = {
    "correlated": ("a standard deviation in rad, @, and a time constant", "0.002@2s"),
    "payload": ("degrees, or degrees, @, and a time from which it is carried,", "0.5@8s"),
}
"""Of errors with a time: what is possible, and an example."""


def parse_hardware(text: str) -> Hardware:
    """The errors in NAME=NUMBER,…, where correlated is RAD@S, and payload
    may be DEGREES@S; UsageError in one line for anything else.
    """
    values: dict[str, float] = {}
    for item in text.split(",") if text else ():
        name, given = _split_item(item)
        if name in values:
            raise UsageError(f"--hardware: {name} is given twice; type: --hardware {name}={given}")
        if name == "correlated":
            given, values["correlation_s"] = _split_seconds(name, given)
        elif name == "payload" and "@" in given:
            given, values["payload_s"] = _split_seconds(name, given)
        values[name] = RANGES[name].unit * _number_in_range(name, given)
    return Hardware(**values)


def _split_item(item: str) -> tuple[str, str]:
    """The name of an error, and the text of its size."""
    name, equals, given = item.strip().partition("=")
    if name not in HARDWARE:
        raise UsageError(
            f"--hardware: {describe_unknown_name('error', name, HARDWARE)}; type: --hardware "
            f"{EXAMPLE}"
        )
    if not equals:
        raise UsageError(
            f"--hardware: {name} has no size; possible: {_possible_sizes(name)}; type: "
            f"--hardware {EXAMPLE}"
        )
    return name, given


def _split_seconds(name: str, given: str) -> tuple[str, float]:
    """The text of an error's size, and the seconds after it."""
    what, example = _TIMED[name]
    found = re.fullmatch(rf"(\S+)@({_NUMBER})s?", given)
    seconds = float(found[2]) if found else 0.0
    if found is None or not 0.0 < seconds <= _MOST_S:
        raise UsageError(
            f"--hardware: {name} is {given!r}; possible: {what} above 0 to {_MOST_S:g} s; type: "
            f"--hardware {name}={example}"
        )
    return found[1], seconds


def _number_in_range(name: str, given: str) -> float:
    value = float(given) if re.fullmatch(_NUMBER, given) else -1.0
    size = RANGES[name]
    if not (value == 0.0 or size.least <= value <= size.most) or value < 0.0:
        raise UsageError(
            f"--hardware: {name} is {given!r}; possible: {_possible_sizes(name)}; type: "
            f"--hardware {EXAMPLE}"
        )
    return value


def _possible_sizes(name: str) -> str:
    size = RANGES[name]
    return f"{f'0, or {size.least:g}' if size.least else '0'} to {size.most:g} ({HARDWARE[name]})"


def add_stick(commanded: Array, stick: float) -> Array:
    """Angles (N,M) of joints that hold still until the
    commanded ones (N,M) are `stick` rad away, then go there.
    """
    return _follow_beyond_deadband(commanded, stick, to=0.0) if stick else commanded


def add_play(motors: Array, play: float) -> Array:
    """Angles (N,M) of links that follow motors' (N,M) once these are half the play (rad) off."""
    return _follow_beyond_deadband(motors, play / 2, to=play / 2) if play else motors


def _follow_beyond_deadband(leading: Array, most: float, to: float) -> Array:
    """Angles that stay until the leading ones (N,M) are more
    than `most` rad away, then move to `to` rad from them.
    """
    following = leading.copy()
    for k in range(1, len(leading)):
        away = leading[k] - following[k - 1]
        stays = np.abs(away) <= most
        following[k] = np.where(stays, following[k - 1], leading[k] - to * np.sign(away))
    return following


def encoder_noise(
    hardware: Hardware,
    white: float,
    shape: tuple[int, int],
    rate_hz: float,
    rng: np.random.Generator,
) -> Array:
    """Errors (N,M) rad of encoders read rate_hz times a
    second, of which `white` rad is independent noise.
    """
    from scipy.signal import lfilter

    tails = hardware.tails
    # Student's t has the variance ν / (ν − 2)
    unit = (
        rng.standard_t(tails, shape) / np.sqrt(tails / (tails - 2.0))
        if tails
        else rng.standard_normal(shape)
    )
    noise = white * unit
    if hardware.correlated:
        kept = float(np.exp(-1.0 / (rate_hz * hardware.correlation_s)))
        # the first from the stationary distribution
        driven = (
            rng.standard_normal(shape)
            * np.append(1.0, np.full(shape[0] - 1, np.sqrt(1.0 - kept**2)))[:, None]
        )
        noise += hardware.correlated * np.asarray(lfilter([1.0], [1.0, -kept], driven, axis=0))
    if hardware.outliers:
        noise += (
            OUTLIER_RAD * rng.choice([-1.0, 1.0], shape) * (rng.random(shape) < hardware.outliers)
        )
    return np.asarray(noise)


def rounded_to_counts(hardware: Hardware, angles: Array) -> Array:
    """Angles (N,M) rad as an encoder with this many counts in a turn gives them."""
    if not hardware.counts:
        return angles
    step = 2.0 * np.pi / hardware.counts
    return np.asarray(np.round(angles / step) * step)
