"""Examine a log: everything that is wrong with it, and a clean copy of its sound messages."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...errors import LogError
from ...io import episodes
from ..datasets import checks, kinds, lerobot_layout
from ..datasets.checks import Checks
from ..datasets.episode_log import EpisodeLog
from ..diagnostics import Diagnostics
from ..formats import open_log
from ..limits import LIMITS, Input
from ..mcap.checks import check_mcap
from ..mcap.records import is_mcap
from ..protocol import Log, Progress, count_progress
from ..records import Finding
from ..rosbag2.folder import METADATA, list_member_files, metadata_of
from ..storage.mmapped import check_untruncated, map_file
from ..storage.packed_files import is_packed, unpack_file
from .rewrite import rewrite_sound_messages

__all__ = ["examine_log_file", "rewrite_sound_messages"]


@dataclass
class _Seen:
    """One topic as read: messages, how many came before
    their predecessor, and by how much at most (ns).
    """

    messages: int = 0
    late: int = 0
    worst_ns: int = 0
    last_ns: int = -(1 << 63)


class _GroupedFindings:
    """Findings of one kind as one line, with their number."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._texts: dict[str, list[str]] = {}

    def say(self, kind: str, text: str) -> None:
        """Add a finding."""
        self._texts.setdefault(kind, []).append(text)

    def findings(self) -> Iterator[Finding]:
        """One warning per kind."""
        for texts in self._texts.values():
            more = f" (and {len(texts) - 1} more like it)" if len(texts) > 1 else ""
            yield Finding("warning", f"{self._path}: {texts[0]}{more}")


def examine_log_file(
    path: Path, strict: bool = False, limits: Input = LIMITS, progress: Progress | None = None
) -> tuple[Finding, ...]:
    """Read a log to its end and return all its problems;
    LogError if it is no log, or strict and part is lost.
    """
    if several := _list_dataset_episodes(path):
        whole, *found = several
        rest = (
            finding for one in found for finding in examine_log_file(one, strict, limits, progress)
        )
        return tuple(dict.fromkeys((*_examine_every_episode(whole), *rest)))
    groups = _GroupedFindings(path)
    with open_log(path, strict, limits) as log:
        seen = _read_all_messages(log, checks := _episode_checks(log, limits), progress)
        _compare_topic_counts(log, seen, groups)
        for number, text in enumerate(checks.texts() if checks else ()):
            groups.say(f"dataset {number}", text)
        if log.format == "rosbag2":
            _compare_metadata(log, seen, groups)
        own = log.findings
    inner = [found for file in _mcap_files_in(path) for found in _check_mcap_file(file, limits)]
    return tuple(dict.fromkeys((*own, *groups.findings(), *inner)))


def _list_dataset_episodes(path: Path) -> list[Path]:
    """The dataset and its episodes if the path names no single episode; else nothing."""
    if (
        episodes.split_episode_name(path)[1] is not None
        or not path.is_dir()
        or not kinds.is_episode_dataset(path)
    ):
        return []
    there = kinds.episode_numbers(path)
    return [path, *(episodes.name_episode(path, number) for number in there)] if there else []


def _examine_every_episode(folder: Path) -> Iterator[Finding]:
    known = lerobot_layout.read_dataset_layout(folder)
    yield from (Finding("warning", f"{folder}: {text}") for text in checks.of_dataset(known))


def _episode_checks(log: Log, limits: Input) -> Checks | None:
    """The checks of a dataset episode's images and joints."""
    return Checks(log, limits) if isinstance(log, EpisodeLog) else None


def _read_all_messages(
    log: Log, checks: Checks | None, progress: Progress | None
) -> dict[int, _Seen]:
    seen = {topic.id: _Seen() for topic in log.topics}
    for batch in count_progress(log.batches(), progress):
        if checks is not None:
            checks.add(batch)
        one = seen[batch.topic_id]
        times = batch.log_ns
        back = (
            one.last_ns > times[0],
            int(one.last_ns - times[0]) if one.last_ns > times[0] else 0,
        )
        steps = times[1:] - times[:-1]
        one.late += int(back[0]) + int((steps < 0).sum())
        one.worst_ns = max(one.worst_ns, back[1], int(-steps.min()) if len(steps) else 0)
        one.messages += len(times)
        one.last_ns = int(times[-1])
    return seen


def _compare_topic_counts(log: Log, seen: dict[int, _Seen], groups: _GroupedFindings) -> None:
    for topic in log.topics:
        one = seen[topic.id]
        if one.messages != topic.messages:
            groups.say(
                "count",
                f"{topic.name}: {topic.messages} messages are declared, {one.messages} can be read",
            )
        if one.late:
            text = (
                f"{topic.name}: {one.late} messages have a log time before their predecessor's, "
                "by up to"
            )
            groups.say("order", f"{text} {one.worst_ns / 1e9:.6f} s")
        if not topic.definition and not topic.type.endswith("/Empty"):
            groups.say(
                "definition",
                f"{topic.name}: {topic.type or 'its type'} has no definition in the log",
            )


def _compare_metadata(log: Log, seen: dict[int, _Seen], groups: _GroupedFindings) -> None:
    """Compare metadata.yaml with the content of the files."""
    fields = metadata_of(log.path, Diagnostics(log.path))
    if not fields:
        return
    messages = sum(one.messages for one in seen.values())
    held = {
        "message_count": messages,
        "duration": log.end_ns - log.start_ns,
        "starting_time": log.start_ns,
    }
    for name, value in held.items():
        number = _metadata_number(fields.get(name))
        if number is not None and number != value and (messages or name == "message_count"):
            groups.say(name, f"{METADATA} says {name} {number}, the files hold {value}")
    listed = {name: (kind, count) for name, kind, count in _metadata_topic_counts(fields)}
    for topic in log.topics:
        kind, count = listed.pop(topic.name, (None, 0))
        if kind is None:
            groups.say("topic", f"{METADATA} does not name topic {topic.name}")
        elif count != seen[topic.id].messages:
            groups.say(
                "topic",
                f"{METADATA} says {count} messages on {topic.name}, it has "
                f"{seen[topic.id].messages}",
            )
    for name in listed:
        groups.say("topic", f"{METADATA} names topic {name}, which no file holds")


def _metadata_number(value: Any) -> int | None:
    """A number, bare or under the single key that rosbag2 uses."""
    if isinstance(value, dict):
        value = next(iter(value.values()), None)
    return value if isinstance(value, int) else None


def _metadata_topic_counts(fields: dict[str, Any]) -> Iterator[tuple[str, str, int]]:
    for entry in fields.get("topics_with_message_count") or ():
        about = entry.get("topic_metadata") if isinstance(entry, dict) else None
        if isinstance(about, dict):
            yield (
                str(about.get("name")),
                str(about.get("type")),
                _metadata_number(entry.get("message_count")) or 0,
            )


def _mcap_files_in(path: Path) -> list[Path]:
    try:
        files = (
            list_member_files(path, Diagnostics(path))
            if path.is_dir()
            else [path]
            if path.is_file()
            else []
        )
    except LogError:
        return []
    return [file for file in files if ".mcap" in file.suffixes]


def _check_mcap_file(file: Path, limits: Input) -> list[Finding]:
    def checked(source: Path) -> list[Finding]:
        groups = _GroupedFindings(file)
        if is_mcap(source):
            data = map_file(source)
            check_mcap(data, Diagnostics(file, limits=limits), groups.say)
            check_untruncated(data, file)
        return list(groups.findings())

    with file.open("rb") as stream:
        packed = is_packed(stream.read(4))
    return unpack_file(file, checked, limits) if packed else checked(file)
