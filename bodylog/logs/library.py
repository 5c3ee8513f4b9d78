"""The Python interface to a recorded log: topics as tables, batches, messages or images."""

import difflib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np

from ..errors import ConfigError, FormatError, LogError
from ..io import remote
from .decode.columns import columns_of, definition_of, is_ros1, is_ros1_payload
from .decode.definitions import PRIMITIVES, TEXTS, Definition, Field
from .decode.dynamic import make_dynamic_reader
from .decode.ros1_to_cdr import ROSBAGS_ERRORS, make_cdr_converter
from .decode.table import Table, fill_table, leaf_paths, object_paths
from .formats import open_log, payload_views, without_images
from .images import messages as images
from .limits import LIMITS
from .mcap.records import MAGIC
from .protocol import Log
from .records import Batch, Finding, LazyImage, Topic

_OBJECTS = ("json", "protobuf")
_HEADS = ("header", "encoding", "format", "name", "names", "position")
"""Fields for which no image needs to be decoded."""
_TIMES = {"time": "builtin_interfaces/msg/Time", "duration": "builtin_interfaces/msg/Duration"}
Decode = Callable[[bytes], Any]


class Message(NamedTuple):
    """One decoded message: topic · log time int64 ns ·
    a rosbags message, or a dict for JSON and protobuf.
    """

    topic: str
    log_ns: int
    value: Any


class OpenLog:
    """A log of any container, path or URL; a context manager.

    topics · start_ns, end_ns: first and last log time, int64 ns · `log[topic]` is a Table.
    """

    def __init__(
        self,
        path: str | Path,
        strict: bool = False,
        episode: int | None = None,
        max_wait_s: float | None = None,
    ) -> None:
        """Open a log, or `episode` of a dataset; LogError when
        it is not a log, or when `strict` and part is lost.
        """
        path = path if episode is None else f"{path}#{episode}"
        self.path = str(path)
        self.rejected: Counter[str] = Counter()
        self._open = ExitStack()
        with ExitStack() as opening:
            self._here = opening.enter_context(local_path(path, max_wait_s or LIMITS.max_wait_s))
            self._log: Log = opening.enter_context(open_log(self._here, strict))
            self._open = opening.pop_all()
        self.topics = self._log.topics
        self.start_ns = self._log.start_ns
        self.end_ns = self._log.end_ns

    @property
    def format(self) -> str:
        """mcap, bag, rosbag2, db3, or the name of a dataset's format."""
        return self._log.format

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Problems found so far."""
        return findings_about(self._log.findings, self._here, self.path)

    def __getitem__(self, topic: str) -> Table:
        """The messages of a topic; fields are decoded on
        first use. ConfigError names the existing topics.
        """
        topics = self._topics(topic)
        return Table(topic, self._fields(topics), self.read)

    def read(self, fields: Mapping[str, Sequence[str]]) -> dict[str, Table]:
        """Read fields of several topics, {topic: [message path, …]}, in one pass over the file."""
        topics = {name: self._topics(name) for name in fields}
        wants = {
            one.id: (one, tuple(fields[name])) for name, some in topics.items() for one in some
        }
        light = all(path.split(".")[0] in _HEADS for some in fields.values() for path in some)
        with self._errors():
            columns = columns_of(without_images(self._log) if light else self._log, wants)
        tables = {}
        for name, some in topics.items():
            own = [columns[one.id] for one in some]
            log_ns = np.concatenate([np.empty(0, np.int64), *(c.log_ns for c in own)])
            tables[name] = fill_table(
                Table(name, self._fields(some), self.read, log_ns), some, own, fields[name]
            )
        return tables

    def batches(self, topics: Sequence[str] | None = None) -> Iterator[Batch]:
        """Undecoded messages in file order, in batches
        of one topic; each batch is valid until the next.
        """
        return self._batches(None if topics is None else self._ids(topics))

    def messages(self, topics: Sequence[str] | None = None) -> Iterator[Message]:
        """Decoded messages in file order; `rejected` counts by topic those that do not decode."""
        wanted = (
            self.topics
            if topics is None
            else [one for name in topics for one in self._topics(name)]
        )
        decoders = {one.id: (one.name, _make_message_decoder(one)) for one in wanted}
        for batch in self._batches(tuple(decoders)):
            name, decode = decoders[batch.topic_id]
            for log_ns, payload in zip(batch.log_ns.tolist(), payload_views(batch), strict=True):
                try:
                    yield Message(name, log_ns, decode(bytes(payload)))
                except FormatError:
                    self.rejected[name] += 1

    def frames(self, topic: str) -> Iterator[LazyImage]:
        """The images of a topic in file order: `image`
        (H,W,3) uint8 BGR, t in s since start_ns by log time.
        """
        decoders = {one.id: images.make_image_decoder(one) for one in self._topics(topic)}
        for batch in self._batches(tuple(decoders)):
            for log_ns, payload in zip(batch.log_ns.tolist(), payload_views(batch), strict=True):
                decode = partial(decoders[batch.topic_id], bytes(payload))
                yield LazyImage((log_ns - self.start_ns) / 1e9, log_ns, decode)

    def close(self) -> None:
        """Close the file."""
        self._open.close()

    def __enter__(self) -> Self:
        """Return the log."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        problem: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file."""
        self.close()

    def __repr__(self) -> str:
        """Path, format and topics."""
        return f"<{self.format} log {self.path}: {', '.join(topic.name for topic in self.topics)}>"

    def _errors(self) -> AbstractContextManager[None]:
        """Turns errors about the local copy of a URL into errors about the URL."""
        return (
            remote.errors_about(self._here, self.path)
            if remote.is_url(self.path)
            else nullcontext()
        )

    def _batches(self, ids: tuple[int, ...] | None) -> Iterator[Batch]:
        with self._errors():
            yield from self._log.batches(ids)

    def _topics(self, name: str) -> list[Topic]:
        found = [topic for topic in self.topics if topic.name == name]
        if not found:
            known = sorted({topic.name for topic in self.topics})
            near = difflib.get_close_matches(name, known, 1, 0.0)
            hint = f"; did you mean {near[0]}?" if near else ""
            raise ConfigError(
                f"{self.path}: no topic {name!r}{hint} The topics are {', '.join(known) or 'none'}"
            )
        return found

    def _ids(self, topics: Sequence[str]) -> tuple[int, ...]:
        return tuple(one.id for name in topics for one in self._topics(name))

    def _fields(self, topics: Sequence[Topic]) -> tuple[str, ...]:
        return tuple(dict.fromkeys(path for topic in topics for path in self._paths(topic)))

    def _paths(self, topic: Topic) -> Iterator[str]:
        if topic.encoding not in _OBJECTS:
            yield from leaf_paths(definition_of(topic))
            return
        first = next(
            (payload for batch in self._batches((topic.id,)) for payload in payload_views(batch)),
            None,
        )
        if first is not None:
            yield from object_paths(_make_message_decoder(topic)(bytes(first)))


def findings_about(
    findings: Sequence[Finding], here: Path, path: str | Path
) -> tuple[Finding, ...]:
    """Findings on the local copy of a URL as findings on the URL."""
    if not remote.is_url(str(path)):
        return tuple(findings)
    return tuple(replace(one, text=one.text.replace(str(here), str(path))) for one in findings)


@contextmanager
def local_path(path: str | Path, wait_s: float = LIMITS.max_wait_s) -> Iterator[Path]:
    """A local path for a log: its own; for an MCAP behind a
    URL, a map that fetches on access; for others, a copy.

    `wait_s`: s without an answer, after which a server is given up.
    """
    if not remote.is_url(str(path)):
        yield Path(path)
        return
    from tempfile import gettempdir

    from .storage import remote_map

    url = str(path)
    size = remote.remote_size_bytes(url, wait_s)
    first, in_parts = remote.read_first_bytes(url, min(size, 64), wait_s) if size else (b"", False)
    if first.startswith(MAGIC) and in_parts:
        opened = remote_map.mapped_remote(
            remote.name_of(url), size, partial(_read_range, url, wait_s)
        )
    else:
        opened = remote.local_copy(url, Path(gettempdir()), wait_s)
    with opened as here, remote.errors_about(here, url):
        yield here


def _read_range(url: str, wait_s: float, start: int, end: int) -> bytes:
    """The bytes from start to before end of a remote file; LogError for fewer."""
    found = remote.read_range(url, start, end, wait_s)
    if len(found) != end - start:
        raise LogError(
            f"{url}: {len(found)} bytes arrived where {end - start} were asked for; try again"
        )
    return found


def _make_message_decoder(topic: Topic) -> Callable[[bytes], Any]:
    """A function from payload to message; it raises
    FormatError when they contradict the definition.
    """
    if topic.encoding in _OBJECTS:
        return make_dynamic_reader(topic)
    return make_object_decoder(topic)


def make_object_decoder(topic: Topic) -> Decode:
    """decode(payload) -> message; FormatError for an unreadable definition or payload."""
    definition = definition_of(topic)
    known: dict[bool, Decode] = {}

    def decode(payload: bytes) -> Any:
        ros1 = is_ros1(topic) or (
            (True in known or not known) and is_ros1_payload(definition, payload)
        )
        if ros1 not in known:
            known[ros1] = (
                _make_ros1_decoder(topic) if ros1 else _make_cdr_decoder(topic, definition)
            )
        return known[ros1](payload)

    return decode


def _make_ros1_decoder(topic: Topic) -> Decode:
    convert, _ = make_cdr_converter(topic)
    read = _wrap_read_errors(topic, convert.store)
    return lambda payload: read(bytes(convert(memoryview(payload))))


def _make_cdr_decoder(topic: Topic, definition: Definition) -> Decode:
    from rosbags.typesys import Stores, TypesysError, get_typestore

    store = get_typestore(Stores.EMPTY)
    try:
        store.register(_rosbags_types(definition))
    except (TypesysError, *ROSBAGS_ERRORS) as problem:
        raise FormatError(
            f"{topic.name}: the definition of {topic.type} cannot be read: {problem}"
        ) from None
    return _wrap_read_errors(topic, store)


def _rosbags_types(definition: Definition) -> Any:
    """The definition in rosbags' notation, times included."""
    from rosbags.interfaces import Nodetype
    from rosbags.typesys import Stores, get_typestore

    def node(field: Field) -> Any:
        plain = field.type in PRIMITIVES or field.type in TEXTS
        kind = _TIMES.get(field.type, field.type)
        one: Any = (Nodetype.BASE, (kind, 0)) if plain else (Nodetype.NAME, kind)
        if field.size is None:
            return one
        return (
            (Nodetype.SEQUENCE, (one, 0)) if field.size < 0 else (Nodetype.ARRAY, (one, field.size))
        )

    standard = get_typestore(Stores.ROS2_HUMBLE).fielddefs
    times = {name: standard[name] for name in _TIMES.values()}
    return times | {
        name: ([], [(f.name, node(f)) for f in fields]) for name, fields in definition.types.items()
    }


def _wrap_read_errors(topic: Topic, store: Any) -> Decode:
    from rosbags.serde import SerdeError

    def read(payload: bytes) -> Any:
        try:
            return store.deserialize_cdr(payload, topic.type)
        except (SerdeError, *ROSBAGS_ERRORS) as problem:
            raise FormatError(f"{topic.name}: {problem}") from None

    return read
