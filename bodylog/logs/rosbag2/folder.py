"""Read a rosbag2 folder as one log: files in the order
of metadata.yaml if that is right, topics merged.
"""

import re
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from ...errors import InputError, LogError
from ...io import atomic_files, yaml_text
from ...io.contained import is_inside
from ..diagnostics import Diagnostics
from ..limits import Input
from ..mcap.survey import widen_time_span
from ..protocol import Log
from ..records import Batch, Finding, Topic
from ..topics import TopicTable

SUFFIXES = (".db3", ".mcap", ".db3.zstd", ".mcap.zstd", ".db3.zst", ".mcap.zst")
METADATA = "metadata.yaml"

_LONGEST = 1 << 20
"""Bytes: a topic takes about 2 kB, most of it QoS,
and pure Python parses a megabyte in some seconds.
"""


class Rosbag2Log:
    """One rosbag2 folder; see protocol.Log. Its files are opened one at a time."""

    format = "rosbag2"

    def __init__(
        self, path: Path, strict: bool, limits: Input, open_file: Callable[[Path, bool, Input], Log]
    ) -> None:
        """Survey every file with `open_file`; LogError when
        none is readable, or when strict and one is not.
        """
        self.path = path
        self._strict = strict
        self._open = open_file
        self._diagnostics = Diagnostics(path, strict, limits)
        self._members: list[tuple[Path, dict[int, int]]] = []
        self._findings: dict[Finding, None] = {}
        self._spans: dict[int, tuple[int, int]] = {}
        self._unsaid: set[int] = set()
        topics = TopicTable()
        times = []
        for member in list_member_files(path, self._diagnostics):
            times += self._survey(member, topics)
        if not self._members:
            raise LogError(
                f"{path}: none of its files can be read: {self._diagnostics.findings[-1].text}"
            )
        self.topics: tuple[Topic, ...] = topics.all()
        self.start_ns = min(times, default=0)
        self.end_ns = max(times, default=0)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Problems found so far; further reading may add to them."""
        return (*self._diagnostics.findings, *self._findings)

    def batches(self, ids: Collection[int] | None = None) -> Iterator[Batch]:
        """Messages of the topics `ids` (None: all), file
        after file, one batch per topic and chunk or block.
        """
        for member, topic_of in self._members:
            inner = [own for own, topic in topic_of.items() if ids is None or topic in ids]
            if inner:
                with self._open(member, self._strict, self._diagnostics.limits) as log:
                    for batch in log.batches(inner):
                        yield replace(batch, topic_id=topic_of[batch.topic_id])
                    self._findings.update(dict.fromkeys(log.findings))

    def spans(self) -> dict[int, tuple[int, int]]:
        """First and last log time (ns) by topic id, if every file with the topic gives them."""
        return {topic: span for topic, span in self._spans.items() if topic not in self._unsaid}

    def close(self) -> None:
        """Do nothing: no file stays open between batches."""

    def __enter__(self) -> "Rosbag2Log":
        """Return the log."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the log."""
        self.close()

    def _survey(self, member: Path, topics: TopicTable) -> list[int]:
        """Add one file's topics; returns its first and last log time (ns), if it has messages."""
        try:
            log = self._open(member, self._strict, self._diagnostics.limits)
        except InputError as problem:
            self._diagnostics.add_loss(
                len(self._members), member.stat().st_size, None, None, str(problem)
            )
            return []
        with log:
            topic_of = {}
            spans = log.spans()
            for topic in log.topics:
                properties = (
                    topic.name,
                    topic.type,
                    topic.encoding,
                    topic.definition,
                    topic.definition_encoding,
                )
                topic_of[topic.id] = topics.add(*properties, topic.messages, topic.metadata)
                if topic.id in spans:
                    widen_time_span(self._spans, topic_of[topic.id], spans[topic.id])
                elif topic.messages:
                    self._unsaid.add(topic_of[topic.id])
            self._members.append((member, topic_of))
            self._findings.update(dict.fromkeys(log.findings))
            return [log.start_ns, log.end_ns] if any(topic.messages for topic in log.topics) else []


def list_member_files(path: Path, diagnostics: Diagnostics) -> list[Path]:
    """The log files of a folder, in order; LogError when there are none."""
    found = sorted(
        (p for p in path.iterdir() if p.is_file() and p.name.endswith(SUFFIXES)), key=_natural_order
    )
    if outside := [p.name for p in found if not is_inside(p, path)]:
        diagnostics.warn(
            f"{', '.join(outside[:5])}: links out of the folder; not read; type the file's own name"
        )
        found = [p for p in found if p.name not in outside]
    plain = {p.name for p in found}
    found = [p for p in found if not (p.suffix in (".zstd", ".zst") and p.stem in plain)]
    if not found:
        names = ", ".join(sorted(p.name for p in path.iterdir())[:5]) or "nothing"
        raise LogError(
            f"{path}: a folder without .db3 or .mcap files (it holds {names}); name a log or "
            "rosbag2 folder"
        )
    named = _files_in_metadata(
        metadata_of(path, diagnostics).get("relative_file_paths"), diagnostics
    )
    listed = [
        p
        for name in named
        for p in found
        if p.name in (name, f"{name}.zstd", f"{name}.zst") or p.stem == name
    ]
    missing = len(named) - len(listed)
    if not named or not listed:
        return found
    others = [p for p in found if p not in listed]
    if missing > 0:
        diagnostics.warn(
            f"{METADATA} names {missing} files that are missing; the existing log files are read"
        )
        return sorted({*listed, *others}, key=_natural_order)
    if others:
        diagnostics.info(
            f"{METADATA} does not name {', '.join(p.name for p in others[:5])}; left out"
        )
    return list(dict.fromkeys(listed))


def _files_in_metadata(listed: Any, diagnostics: Diagnostics) -> list[str]:
    """The file names that metadata.yaml lists; none, with a warning, if it has no list of texts."""
    if listed is None or (
        isinstance(listed, list) and all(isinstance(name, str) for name in listed)
    ):
        return [Path(name).name for name in listed or ()]
    diagnostics.warn(
        f"{METADATA}: relative_file_paths is {str(listed)[:60]!r}; a list of names is "
        "possible; it is not used"
    )
    return []


def metadata_of(path: Path, diagnostics: Diagnostics) -> dict[str, Any]:
    """The content of metadata.yaml; empty, with a warning, when it is missing or unreadable."""
    file = path / METADATA
    if not file.is_file() or not is_inside(file, path):
        diagnostics.warn(f"there is no {METADATA}; all logs in the folder are read as one")
        return {}
    try:
        fields = _parse_cached_yaml(atomic_files.read_limited_text(file, _LONGEST))[
            "rosbag2_bagfile_information"
        ]
        if isinstance(fields, dict):
            return fields
        raise ValueError("no table rosbag2_bagfile_information")
    except Exception as problem:
        # whatever is wrong with this file (also RecursionError), the log is read without it
        diagnostics.warn(
            f"{METADATA} is not readable ({type(problem).__name__}); the files' own contents "
            "are used"
        )
        return {}


@lru_cache(maxsize=4)
def _parse_cached_yaml(text: str) -> Any:
    """The value of a YAML text, kept: a folder's is read several times."""
    return yaml_text.parse_yaml_text(text)


def _natural_order(path: Path) -> list[tuple[int, str]]:
    return [
        (int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)
    ]
