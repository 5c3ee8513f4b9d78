"""The 154 MCAP conformance files: records equal the .json beside each, and every message is read."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from isal.isal_zlib import crc32

from bodylog.logs.formats import open_log, payload_views
from bodylog.logs.mcap import opcodes as op
from bodylog.logs.mcap.chunks import chunk_head
from bodylog.logs.mcap.records import FIELDS, HEAD, MAGIC, Record, iter_records, parse_record
from bodylog.logs.storage.compression import Buffer

FOLDER = Path(__file__).parents[2].parent / "shared" / "logs" / "foxglove__mcap"
FILES = sorted(FOLDER.rglob("*.mcap"))
pytestmark = pytest.mark.skipif(not FILES, reason=f"the conformance files are not at {FOLDER}")


def plain(value: Any) -> Any:
    """A field as in the .json files: numbers as text, bytes as lists."""
    if isinstance(value, str):
        return value
    if isinstance(value, dict):
        return {plain(key): plain(item) for key, item in value.items()}
    return str(value) if isinstance(value, int) else [str(byte) for byte in bytes(value)]


def as_json(record: Record) -> dict[str, Any]:
    return {"type": record.name, "fields": sorted([name, plain(value)] for name, value in record.fields.items())}


def expected(path: Path) -> list[dict[str, Any]]:
    records = json.loads(path.with_suffix(".json").read_text())["records"]
    return [{"type": record["type"], "fields": sorted(record["fields"])} for record in records]


def every_record(data: memoryview) -> Iterator[Record]:
    """All records of a file, those of chunks in place of the chunk."""
    buffer = Buffer()
    for opcode, at, length in iter_records(data, len(MAGIC), len(data) - len(MAGIC)):
        if opcode == op.CHUNK:
            _, _, size, crc, compression, packed = chunk_head(data, at - HEAD.size)
            content = buffer.load(compression, packed, size).data
            assert not crc or crc32(content) == crc
            for inner, start, length in iter_records(content, 0, len(content)):
                yield parse_record(inner, content[start : start + length], start - HEAD.size)
        elif opcode in FIELDS:
            yield parse_record(opcode, data[at : at + length], at - HEAD.size)


def test_conformance_files_are_complete() -> None:
    assert len(FILES) == 154


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_records_equal_the_conformance_json(path: Path) -> None:
    records = every_record(memoryview(path.read_bytes()))
    found = [as_json(r) for r in records if r.opcode not in (op.CHUNK, op.MESSAGE_INDEX)]
    assert found == expected(path)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_open_reads_conformance_files_without_findings(path: Path) -> None:
    declared = [dict(record["fields"]) for record in expected(path) if record["type"] == "Message"]
    with open_log(path, strict=True) as log:
        batches = [(batch.log_ns.tolist(), [bytes(part) for part in payload_views(batch)]) for batch in log.batches()]
        assert log.findings == ()
        assert sum(topic.messages for topic in log.topics) == len(declared)
        times = sorted(int(message["log_time"]) for message in declared)
        assert (log.start_ns, log.end_ns) == (times[0], times[-1])
    found = sorted((time, payload) for batch in batches for time, payload in zip(*batch, strict=True))
    assert found == sorted((int(m["log_time"]), bytes(map(int, m["data"]))) for m in declared)
