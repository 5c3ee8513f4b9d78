"""Work as a count of calls, which is the same on every machine, where seconds are not."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any


@contextmanager
def at_most(calls: int) -> Iterator[None]:
    """Fail as soon as more functions are called inside than `calls`, so that work without end ends as well."""
    count = 0

    def counting(frame: FrameType, event: str, argument: Any) -> None:
        nonlocal count
        count += event in ("call", "c_call")
        if count > calls:
            raise AssertionError(f"more than {calls} calls")

    before = sys.getprofile()
    sys.setprofile(counting)
    try:
        yield
    finally:
        sys.setprofile(before)
