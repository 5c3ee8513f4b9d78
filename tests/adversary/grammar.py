"""Values that a file may hold: ordinary ones, and hostile ones with a given probability."""

from collections.abc import Sequence
from random import Random
from typing import Any, TypeVar

T = TypeVar("T")

T0 = 1_700_000_000_000_000_000
STEP = 20_000_000
"""ns: the first log time, and the time between messages of one topic."""

FLOATS = (float("nan"), float("inf"), float("-inf"), 1e308, -1e308, 5e-324, 1e-300, 1e300, 1e19, -0.0, 1e9, 2.0**63)
INTEGERS = (-1, 0, 1, 2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**53 + 1, 2**63 - 1, 2**63, 2**64 - 1, -(2**63), 10**400)
TIMES = (0, 1, -1, 2**62, 2**62 + 1, 2**63 - 1, 2**63, 2**64 - 1, -(2**63), 4_294_967_295_999_999_999, T0 * 2)
TEXTS = (
    "",
    "\0",
    "a\0b",
    "\n",
    "a\nb",
    "\x1b[31m",
    "\u202egnp",
    "🤖" * 9,
    "<script>alert(1)</script>",
    "../../etc/passwd",
    "/",
    "//",
    "%s%n",
    "{x}",
    "[0]",
    "a.b[1:]",
    "a" * 300,
    "é" * 5000,
    "/bodylog/joint_states",
    "/bodylog/track/x",
    "nan",
    "1e999",
    "null",
    "CON",
    "a/b",
    " ",
    "\ufeff",
    "joint_0",
    "\"'\\",
    "]]>",
)
BYTES = (b"\xff\xfe", b"\x80abc", b"\xed\xa0\x80", b"a\xc3", b"\xf8\x88\x80\x80\x80")
"""No UTF-8."""


class Draw:
    """A seeded random source; `chance` is the probability of a hostile value."""

    def __init__(self, seed: int, chance: float) -> None:
        self.random, self.chance = Random(seed), chance

    def hostile(self, times: float = 1.0) -> bool:
        """Whether the next value is hostile."""
        return self.random.random() < self.chance * times

    def of(self, values: Sequence[T]) -> T:
        """One of the values."""
        return self.random.choice(values)

    def number(self, usual: float) -> float:
        """A float."""
        return self.of(FLOATS) if self.hostile() else usual

    def integer(self, usual: int, low: int = -(10**401), high: int = 10**401) -> int:
        """A whole number; hostile ones are also between `low` and `high`."""
        return self.of([n for n in INTEGERS if low <= n <= high]) if self.hostile() else usual

    def time(self, usual: int, low: int = 0, high: int = 2**64 - 1) -> int:
        """A log time in ns."""
        return self.of([n for n in TIMES if low <= n <= high]) if self.hostile() else usual

    def text(self, usual: str) -> str:
        """A name or another text."""
        if not self.hostile():
            return usual
        return self.of(TEXTS) if self.random.random() < 0.8 else usual + self.of(TEXTS)

    def raw(self, usual: str) -> bytes:
        """The bytes of a text, which may not be UTF-8."""
        if self.hostile(0.3):
            return self.of(BYTES)
        return self.text(usual).encode("utf-8", "replace")

    def count(self, usual: int) -> int:
        """The declared length of a sequence."""
        hostile = [0, 1, usual + 1, max(usual - 1, 0), 2**16, 2**31 - 1, 2**32 - 1]
        return self.of(hostile) if self.hostile() else usual

    def noise(self, most: int) -> bytes:
        """Random bytes."""
        return self.random.randbytes(self.random.randint(0, most))

    def json(self, depth: int = 0) -> Any:
        """Any JSON value."""
        kind = self.random.randint(0, 7 if depth < 3 else 4)
        if kind == 0:
            return self.of(FLOATS)
        if kind == 1:
            return self.of(INTEGERS)
        if kind == 2:
            return self.of((*TEXTS, "\ud800", "a\udfffb"))
        if kind in (3, 4):
            return self.of((None, True, False, [], {}))
        if kind == 5:
            return [self.json(depth + 1) for _ in range(self.random.randint(0, 4))]
        if kind == 6:
            return deep(self.of((10, 400, 900)))
        return {str(self.of(TEXTS)): self.json(depth + 1) for _ in range(self.random.randint(0, 4))}


def deep(depth: int) -> list[Any]:
    """A list in a list in a list."""
    value: list[Any] = []
    for _ in range(depth):
        value = [value]
    return value
