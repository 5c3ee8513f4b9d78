"""What all logs in one memory-mapped file share."""

from pathlib import Path
from typing import Self

from .diagnostics import Diagnostics
from .limits import Input
from .records import Finding
from .storage.mmapped import check_untruncated, map_file


class MappedLog:
    """A mapped file, what is wrong with it, and its end; see protocol.Log."""

    def __init__(self, path: Path, strict: bool, source: Path | None, limits: Input) -> None:
        """Map `source` (default: `path`)."""
        self.path = path
        self._diagnostics = Diagnostics(path, strict, limits)
        self._data = map_file(source or path)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Problems found so far; further reading may add to them."""
        return self._diagnostics.findings

    def close(self) -> None:
        """Close the file; batches still held keep their bytes."""
        self._data = memoryview(b"")

    def __enter__(self) -> Self:
        """Return the log."""
        return self

    def __exit__(self, _kind: object, problem: BaseException | None, _trace: object) -> None:
        """Close the file; LogError when it was truncated meanwhile."""
        data = self._data
        self.close()
        check_untruncated(data, self.path, problem)
