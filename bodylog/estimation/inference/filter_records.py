"""What the filter kernel reads: how the joints move, and the readings of each stretch."""

from dataclasses import dataclass, field

from ...types import Array


@dataclass(frozen=True, eq=False)
class Dynamics:
    """White acceleration (M,) rad²/s³ of the rates · random walk (M,) rad²/s of encoder offsets or None; or (M,C).

    recalled (M,) bool: joints whose readings are no encoder's but where the arm is wont to be; they are not counted.
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
    """What encoders said since the last instant, folded (L,…,C), per joint with its S = K/M states.

    Two readings of the state then, y, var (L,2,M,C), infinite for none: of angle + lean (L,M,C) · rate (+ offset), and
    of the rate. Given them it moves by move (L,S,S,M,C), shift (L,S,M,C) with noise (L,S,S,M,C); nats (L,C) remain.
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
    """What is heard, folded (L,…,C): dt s · encoders, var (L,M,C), NaN where silent · lines (T tracks of D rows).

    A track's row r reads y (L,T,D,C) = jac (L,T,D,M,C) · x with variance var (L,T,D,C); NaN where unseen.
    anew (L,M,C) bool: joints of which nothing is known any more by then; None where there are none.
    more (L,M,C): how many times the process variance moves joints before an instant; None where that is the usual one.
    """

    dt: Array
    encoders: Array
    encoder_var: Array
    y: Array
    jac: Array
    var: Array
    anew: Array | None = field(default=None, kw_only=True)
    more: Array | None = field(default=None, kw_only=True)


@dataclass(frozen=True, eq=False)
class KnotReadings(Readings):
    """Readings at few instants, with what was heard before each since the last, which stands in for dt."""

    pooled: Pooled
