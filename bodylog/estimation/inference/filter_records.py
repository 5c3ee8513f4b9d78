"""Inputs of the filter kernel: dynamics and the readings of each stretch."""

from dataclasses import dataclass, field

from ...types import Array


@dataclass(frozen=True, eq=False)
class Dynamics:
    """White acceleration (M,) rad²/s³ · random walk (M,) rad²/s of encoder offsets, or None; or (M,C).

    is_prior (M,) bool: joints whose readings come from the posture prior; they do not count as evidence.
    """

    process: Array
    drift: Array | None = None
    is_prior: Array | None = None

    @property
    def size(self) -> int:
        """Length K of the state."""
        return len(self.process) * (2 if self.drift is None else 3)


@dataclass(frozen=True, eq=False)
class Pooled:
    """Encoder readings since the last instant, folded (L,…,C), per joint with its S = K/M states.

    Two readings of the state at that instant, y, var (L,2,M,C), infinite if absent: of angle + lean (L,M,C) · rate
    (+ offset), and of the rate. Given them the state moves by move (L,S,S,M,C), shift (L,S,M,C) with noise
    (L,S,S,M,C); nats (L,C) remain.
    """

    y: Array
    var: Array
    lean: Array
    move: Array
    shift: Array
    noise: Array
    nats: Array


@dataclass(frozen=True, eq=False)
class Readings:
    """Measurements, folded (L,…,C): dt s · encoders, var (L,M,C), NaN where silent · T tracks of D rows.

    A track's row r reads y (L,T,D,C) = jac (L,T,D,M,C) · x with variance var (L,T,D,C); NaN where unseen.
    reset (L,M,C) bool: joints that restart from a wide prior at an instant, or None.
    more (L,M,C): factor on the process variance before an instant, or None for 1.
    """

    dt: Array
    encoders: Array
    encoder_var: Array
    y: Array
    jac: Array
    var: Array
    reset: Array | None = field(default=None, kw_only=True)
    more: Array | None = field(default=None, kw_only=True)


@dataclass(frozen=True, eq=False)
class KnotReadings(Readings):
    """Readings at knots, with the pooled readings before each in place of dt."""

    pooled: Pooled
