"""Frames that several threads decode, given to trackers
in the order of the file by one thread at a time.
"""

from collections.abc import Sequence
from threading import Condition

from ...types import Array
from .contract import Tracker

_MOST_WAITING = 8
"""Lists of frames that may wait before a thread that
brings another is blocked: this bounds the memory.
"""


class InOrder:
    """Takes numbered lists of gray frames from any thread;
    the thread with the next one in order runs the trackers.
    """

    def __init__(self, trackers: Sequence[Tracker]) -> None:
        """Nothing happens before the first list."""
        self._trackers, self._changed = trackers, Condition()
        self._waiting = dict[int, Sequence[Array | None]]()
        self._next = 0
        self._busy = False

    def put(self, number: int, frames: Sequence[Array | None]) -> None:
        """Add the list of that number, counted from 0; returns once only a few lists wait."""
        with self._changed:
            self._waiting[number] = frames
            self._changed.wait_for(lambda: not self._busy or len(self._waiting) <= _MOST_WAITING)
            if self._busy:
                return
            self._busy = True
        try:
            while (due := self._due()) is not None:
                self._add(due)
        except BaseException:
            self._idle()
            raise

    def _due(self) -> Sequence[Array | None] | None:
        """The next list in order; None, and no thread
        is busy any more, where it is not there yet.
        """
        with self._changed:
            due = self._waiting.pop(self._next, None)
            self._next += due is not None
            self._busy = due is not None
            self._changed.notify_all()
            return due

    def _idle(self) -> None:
        with self._changed:
            self._busy = False
            self._changed.notify_all()

    def _add(self, frames: Sequence[Array | None]) -> None:
        for tracker in self._trackers:
            for gray in frames:
                tracker.add(gray)
