"""Sound containers with hostile content: .mcap, .bag, .db3, rosbag2 folders, and compressed ones."""

import bz2
import os
import sqlite3
import struct
import zlib
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import lz4.frame
import zstandard

from fixtures import by_hand

from .definitions import IDL, definition
from .grammar import STEP, T0, Draw
from .messages import KINDS, OBJECTS, sequence

SCHEMAS = {"/json/image": b'{"type":"object","properties":{"timestamp":{},"data":{}}}'}


@dataclass
class Channel:
    """One topic with its messages: (log time ns, payload)."""

    name: bytes
    type: bytes
    encoding: bytes
    definition: bytes
    dialect: bytes
    messages: list[tuple[int, bytes]]
    metadata: dict[str, str] = field(default_factory=dict)


def channels(
    draw: Draw, ros1: bool = False, objects: bool = False, low: int = 0, high: int = 2**64 - 1
) -> list[Channel]:
    """The topics of a robot's log, each of some tens of messages."""
    found = []
    chosen = [name for name in KINDS if draw.random.random() < 0.75] or ["/joint_states"]
    for name in [*chosen, *(n for n in OBJECTS if objects and draw.random.random() < 0.4)]:
        kind, make = (KINDS | OBJECTS)[name]
        text, dialect = definition(draw, kind) if name in KINDS else (SCHEMAS.get(name, b"{}"), "jsonschema")
        payloads = sequence(draw, make, draw.of((0, 1, 2, 30, 60)) if draw.hostile() else 40, ros1)
        times = [draw.time(T0 + number * STEP + 1_000_000, low, high) for number in range(len(payloads))]
        encoding = draw.raw(("ros1" if ros1 else "cdr") if name in KINDS else "json")
        fields = (draw.raw(name), draw.raw(kind), encoding, text, dialect.encode("utf-8", "replace"))
        found.append(Channel(*fields, list(zip(times, payloads, strict=True))))
    if draw.hostile(0.3):
        found.append(Channel(b"/cells", b"demo_msgs/msg/Cells", b"cdr", IDL.encode(), b"ros2idl", [(T0, b"\0\1\0\0")]))
    return found


def ordered(some: list[Channel]) -> list[tuple[int, int, bytes]]:
    """(time, number of the channel, payload) in order of time."""
    return sorted((t, number, p) for number, channel in enumerate(some) for t, p in channel.messages)


def _string(raw: bytes) -> bytes:
    return struct.pack("<I", len(raw)) + raw


def _record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


_PACKERS: dict[bytes, Callable[[bytes], bytes]] = {
    b"": bytes,
    b"lz4": lz4.frame.compress,
    b"zstd": zstandard.ZstdCompressor(level=1).compress,
}


def mcap(draw: Draw, path: Path) -> list[Channel]:
    """An MCAP, chunked or not, with a summary or without one, attachments and metadata."""
    some = channels(draw, objects=True)
    data = _mcap(draw, some)
    path.write_bytes(data)
    return some


def _mcap(draw: Draw, some: list[Channel]) -> bytes:
    out = bytearray(b"\x89MCAP0\r\n" + _record(1, _string(draw.raw("ros2")) + _string(draw.raw("adversary"))))
    declared = _declared(draw, some)
    out += b"".join(declared)
    rows, infos, step = ordered(some), b"", draw.of((7, 50, 10**6))
    if draw.random.random() < 0.8:
        for low in range(0, len(rows), step):
            chunk, info = _chunk(draw, rows[low : low + step], len(out))
            out += chunk
            infos += info
    else:
        out += b"".join(_message(*row) for row in rows)
    for name, content in _metadata(draw):
        out += _record(12, _string(name) + _string(content))
    if draw.hostile():
        out += _record(
            9,
            struct.pack("<QQ", draw.time(T0), 0)
            + _string(draw.raw("a.txt"))
            + _string(b"text/plain")
            + struct.pack("<Q", 3)
            + b"abc"
            + bytes(4),
        )
    out += _record(15, bytes(4))
    start = len(out)
    if draw.random.random() < 0.7:
        times = [row[0] for row in rows] or [0]
        counts = b"".join(struct.pack("<HQ", number, len(c.messages)) for number, c in enumerate(some))
        chunks = infos.count(_INFO)
        fields = struct.pack("<QHIIIIQQ", len(rows), len(some), len(some), 0, 0, chunks, min(times), max(times))
        out += (
            b"".join(declared)
            + infos.replace(_INFO, b"")
            + _record(11, fields + struct.pack("<I", len(counts)) + counts)
        )
    footer = struct.pack("<BQQQ", 2, 20, start if len(out) > start else 0, 0)
    crc = zlib.crc32(bytes(out[start:]) + footer) if len(out) > start else 0
    return bytes(out + footer + struct.pack("<I", crc) + b"\x89MCAP0\r\n")


_INFO = b"<one chunk index>"


def _declared(draw: Draw, some: list[Channel]) -> list[bytes]:
    out = []
    for number, c in enumerate(some):
        out.append(
            _record(3, struct.pack("<H", number + 1) + _string(c.type) + _string(c.dialect) + _string(c.definition))
        )
        pairs = b"".join(_string(draw.raw(k)) + _string(draw.raw(v)) for k, v in (("qos", "x"),) if draw.hostile())
        out.append(
            _record(4, struct.pack("<HH", number, number + 1) + _string(c.name) + _string(c.encoding) + _string(pairs))
        )
    return out


def _message(t: int, number: int, payload: bytes) -> bytes:
    return _record(5, struct.pack("<HIQQ", number, 0, t, t) + payload)


def _chunk(draw: Draw, rows: list[tuple[int, int, bytes]], at: int) -> tuple[bytes, bytes]:
    content, entries = b"".join(_message(*row) for row in rows), dict[int, bytes]()
    offset = 0
    for t, number, payload in rows:
        entries[number] = entries.get(number, b"") + struct.pack("<QQ", t, offset)
        offset += 31 + len(payload)
    name = draw.of(tuple(_PACKERS))
    packed = _PACKERS[name](content)
    times = [row[0] for row in rows]
    body = struct.pack("<QQQI", min(times), max(times), len(content), zlib.crc32(content)) + _string(name)
    chunk = _record(6, body + struct.pack("<Q", len(packed)) + packed)
    indexes, places = b"", b""
    for number, listed in entries.items():
        places += struct.pack("<HQ", number, at + len(chunk) + len(indexes))
        indexes += _record(7, struct.pack("<H", number) + struct.pack("<I", len(listed)) + listed)
    fields = struct.pack("<QQQQ", min(times), max(times), at, len(chunk)) + _string(places)
    fields += struct.pack("<Q", len(indexes)) + _string(name) + struct.pack("<QQ", len(packed), len(content))
    return chunk + indexes, _record(8, fields) + _INFO


def _metadata(draw: Draw) -> list[tuple[bytes, bytes]]:
    if not draw.hostile():
        return []
    keys = ("settings", "inputs", "version", "method", "used", "findings", "resolved", "x")
    values = (
        "[" * 100_000,
        '{"topics": {"joints": "/x.y[", "camera": 5}}',
        "[]",
        '{"body": {"joints": [""]}}',
        "1e999",
    )
    pairs = b"".join(_string(draw.raw(draw.of(keys))) + _string(draw.of(values).encode()) for _ in range(4))
    return [(draw.of((b"bodylog", b"other", b"\xff")), pairs)]


def bag(draw: Draw, path: Path) -> list[Channel]:
    """A ROS 1 bag."""
    some, rows = channels(draw, ros1=True, high=2**32 * 10**9 - 1), []
    rows = ordered(some)
    topics = {number: _connection(number, c) for number, c in enumerate(some)}
    start, body, infos, step = 13 + 8 + 4096, b"", b"", draw.of((7, 50, 10**6))
    for low in range(0, len(rows), step):
        chunk, info = _bag_chunk(draw, rows[low : low + step], topics, start + len(body))
        body += chunk
        infos += info
    fields = {"op": b"\x03", "index_pos": struct.pack("<Q", start + len(body)), "conn_count": _u32(len(some))}
    fields["chunk_count"] = _u32(-(-len(rows) // step))
    padding = start - 13 - len(by_hand.record(b"", **fields))
    head = b"#ROSBAG V2.0\n" + by_hand.record(b" " * padding, **fields)
    path.write_bytes(head + body + b"".join(topics.values()) + infos)
    return some


def _u32(number: int) -> bytes:
    return struct.pack("<I", number)


def _connection(number: int, c: Channel) -> bytes:
    fields = {
        "topic": c.name,
        "type": c.type.replace(b"/msg/", b"/"),
        "md5sum": b"*",
        "message_definition": c.definition,
    }
    data = b"".join(struct.pack("<I", len(k) + 1 + len(v)) + k.encode() + b"=" + v for k, v in fields.items())
    return by_hand.record(data, op=b"\x07", conn=_u32(number), topic=c.name)


def _bag_chunk(
    draw: Draw, rows: list[tuple[int, int, bytes]], topics: dict[int, bytes], at: int
) -> tuple[bytes, bytes]:
    content, entries, counts = b"", dict[int, bytes](), dict[int, int]()
    for t, number, payload in rows:
        if number not in entries:
            content += topics[number]
        time = struct.pack("<II", *divmod(t, 10**9))
        entries[number] = entries.get(number, b"") + time + _u32(len(content))
        counts[number] = counts.get(number, 0) + 1
        content += by_hand.record(payload, op=b"\x02", conn=_u32(number), time=time)
    packers: dict[bytes, Callable[[bytes], bytes]] = {b"none": bytes, b"bz2": bz2.compress, b"lz4": lz4.frame.compress}
    name = draw.of(tuple(packers))
    chunk = by_hand.record(packers[name](content), op=b"\x05", compression=name, size=_u32(len(content)))
    for number, listed in entries.items():
        chunk += by_hand.record(listed, op=b"\x04", ver=_u32(1), conn=_u32(number), count=_u32(counts[number]))
    first, last = (struct.pack("<II", *divmod(rows[i][0], 10**9)) for i in (0, -1))
    data = b"".join(_u32(number) + _u32(count) for number, count in counts.items())
    fields = {"ver": _u32(1), "chunk_pos": struct.pack("<Q", at), "start_time": first, "end_time": last}
    return chunk, by_hand.record(data, op=b"\x06", **fields, count=_u32(len(counts)))


_ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT {} FROM n"


def db3(draw: Draw, path: Path) -> list[Channel]:
    """A rosbag2 database; its tables may be views, and its values of any type."""
    some = channels(draw, low=-(2**63), high=2**63 - 1)
    with closing(sqlite3.connect(path)) as store, store:
        store.text_factory = bytes
        _topics(draw, store, some)
        _rows(draw, store, some)
        if draw.random.random() < 0.6:
            store.execute(
                "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type, encoding,"
                " encoded_message_definition, type_description_hash)"
            )
            fields = [(_sql(c.type), _sql(c.dialect), _sql(c.definition)) for c in some]
            store.executemany("INSERT INTO message_definitions VALUES (NULL, ?, ?, ?, '')", fields)
    return some


def _sql(raw: bytes) -> Any:
    try:
        return raw.decode()
    except UnicodeDecodeError:
        return raw


def _topics(draw: Draw, store: sqlite3.Connection, some: list[Channel]) -> None:
    if draw.hostile(0.1):
        store.execute(
            f"CREATE VIEW topics AS {_ENDLESS.format('i AS id, 1 AS name, 2 AS type, 3 AS serialization_format')}"
        )
        return
    store.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format, offered_qos_profiles)")
    for number, c in enumerate(some, 1):
        qos = draw.text("") if not draw.hostile(0.2) else draw.of((None, 5, 2.5, b"\xff"))
        row = [_sql(c.name), _sql(c.type), _sql(c.encoding), qos]
        if draw.hostile(0.3):
            row[draw.random.randrange(3)] = draw.of((None, 5, 1e300, b"\xff\0"))
        store.execute("INSERT INTO topics VALUES (?, ?, ?, ?, ?)", (number, *row))


def _rows(draw: Draw, store: sqlite3.Connection, some: list[Channel]) -> None:
    if draw.hostile(0.1):
        what = "i AS id, 1 AS topic_id, i AS timestamp, x'00010000' AS data"
        store.execute(f"CREATE VIEW messages AS {_ENDLESS.format(what)}")
        return
    store.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
    if draw.random.random() < 0.5:
        store.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
    each, packer = draw.hostile(0.5), zstandard.ZstdCompressor()
    for t, number, payload in ordered(some):
        data: Any = payload if not each else _packed(draw, packer, payload)
        row = [number + 1, t, data]
        if draw.hostile(0.02):
            row[draw.random.randrange(3)] = draw.of((None, "text", 2.5, -(2**63), b"", 2**62))
        store.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", row)


def _packed(draw: Draw, packer: zstandard.ZstdCompressor, payload: bytes) -> bytes:
    if draw.hostile(0.3):
        return packer.compress(payload + bytes(draw.of((1 << 20, 1 << 26, 1 << 27))))
    return packer.compress(payload)


def folder(draw: Draw, path: Path) -> list[Channel]:
    """A rosbag2 folder of one or two files with a metadata.yaml."""
    path.mkdir()
    suffix, writer = draw.of(((".db3", db3), (".mcap", mcap)))
    names = [f"{draw.of(('log', 'a b', 'é'))}_{number}{suffix}" for number in range(draw.of((1, 2)))]
    some = [channel for name in names for channel in writer(draw, path / name)]
    if draw.hostile(0.2):
        os.rename(os.fsencode(path / names[0]), os.fsencode(path) + b"/\xff\xfe" + suffix.encode())
    (path / "metadata.yaml").write_bytes(metadata_yaml(draw, names).encode("utf-8", "backslashreplace"))
    return some


def metadata_yaml(draw: Draw, names: list[str]) -> str:
    """A metadata.yaml with values of any type, and aliases."""
    listed = str(
        draw.of((names, 5, 2.5, None, [5, None, {}], [[names]], {"a": 1}, True, ["../../x", "\0"]))
        if draw.hostile()
        else names
    )
    text = f"rosbag2_bagfile_information:\n  version: {draw.json(3)}\n  relative_file_paths: {listed}\n".replace(
        "None", "~"
    )
    if draw.hostile():
        lines = ["a: &a [x,x,x,x,x,x,x,x,x]"] + [
            f"{b}: &{b} [*{a},*{a},*{a},*{a},*{a},*{a},*{a},*{a}]"
            for a, b in zip("abcdefghi", "bcdefghij", strict=True)
        ]
        text = "\n".join(lines) + "\n" + text.replace(listed, "*j")
    return (
        draw.of(("", "[" * 5000, "\t", "&a [*a]", "x: 1e999\n" * 50, draw.noise(200).decode("latin1")))
        if draw.hostile(0.3)
        else text
    )


def zipped(draw: Draw, path: Path) -> list[Channel]:
    """A log in zstd, possibly followed by gigabytes of zeros."""
    some = mcap(draw, path)
    data = path.read_bytes() if not draw.hostile(0.3) else draw.of((b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n", b""))
    extra = draw.of((0, 1 << 20, 1 << 28)) if draw.hostile(0.2) else 0
    packer = zstandard.ZstdCompressor(level=1).compressobj()
    with path.open("wb") as out:
        out.write(packer.compress(data))
        for _ in range(extra >> 20):
            out.write(packer.compress(bytes(1 << 20)))
        out.write(packer.flush())
    return some


Writer = Callable[[Draw, Path], list[Channel]]
WRITERS: dict[str, Writer] = {"log.mcap": mcap, "log.bag": bag, "log.db3": db3, "log": folder, "log.mcap.zst": zipped}
"""Name of the file -> who writes it."""
