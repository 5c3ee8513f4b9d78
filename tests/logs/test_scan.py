"""Damage: fixtures give exactly what is sound; random cuts and flips never crash, hang, or give wrong data."""

import json
import struct
import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bodylog.errors import BodylogError, LogError
from bodylog.logs.formats import open_log
from tests.logs.whole_logs import Read, read
from tests.work import at_most

FOLDER = Path(__file__).parents[2] / "fixtures" / "containers"
EXPECTED = json.loads((FOLDER / "expected.json").read_text())
READ = [name for name, content in EXPECTED.items() if "messages" in content]
REFUSED = [name for name, content in EXPECTED.items() if "error" in content]
LOST = [name for name in READ if EXPECTED[name]["worst"] == "lost"]
SEVERITIES = (None, "info", "warning", "lost")
START_NS, STEP_NS, MESSAGES = 1_700_000_000_000_000_000, 10_000_000, 60
MOST_CALLS, MOST_BYTES = 500_000, 200 << 20
DAMAGED = ("none.mcap", "zstd.mcap", "unchunked.mcap", "no_summary.mcap", "none.bag", "lz4.bag", "killed.bag.active",
           "humble.db3", "packed.mcap.zst", "packed_messages.db3")  # fmt: skip
CHECKED = ("none.mcap", "lz4.mcap", "zstd.mcap", "no_summary.mcap", "no_message_index.mcap")
"""Logs whose chunks carry CRCs: what is read from them must be what was written."""


def number_of(path: Path, message: tuple[str, int, bytes]) -> int:
    """The number in a message, after checking that its topic and time match the number."""
    topic, log_ns, payload = message
    number = int(struct.unpack("<d", payload[-8:])[0])
    assert log_ns == START_NS + number * STEP_NS, path
    assert topic == ("/b" if number % 3 == 2 else "/a"), path
    return number


@pytest.fixture(autouse=True, scope="module")
def _imported() -> None:
    """Exclude one-time imports from the first damaged log's measurement."""
    for name in READ:
        read(FOLDER / name)


@pytest.mark.parametrize("name", READ)
def test_open_reads_sound_parts_and_reports_damage(name: str) -> None:
    found, findings = read(FOLDER / name)
    numbers = [number_of(FOLDER / name, message) for message in found]
    assert len(set(numbers)) == len(numbers) == EXPECTED[name]["messages"]
    assert max((f.severity for f in findings), key=SEVERITIES.index, default=None) == EXPECTED[name]["worst"]
    assert all(str(FOLDER / name) in finding.text and "\n" not in finding.text for finding in findings)


@pytest.mark.parametrize("name", REFUSED)
def test_open_refuses_unreadable_logs(name: str) -> None:
    with pytest.raises(LogError, match=EXPECTED[name]["error"]) as caught:
        open_log(FOLDER / name)
    assert str(caught.value).startswith(str(FOLDER / name))


@pytest.mark.parametrize("name", LOST)
def test_open_strict_refuses_losses(name: str) -> None:
    with pytest.raises(LogError, match="lost"):
        read(FOLDER / name, strict=True)


@pytest.mark.parametrize("name", LOST)
def test_findings_give_bytes_messages_and_seconds(name: str) -> None:
    lost = [finding.text for finding in read(FOLDER / name)[1] if finding.severity == "lost"]
    assert all(" bytes, " in text and " messages, " in text for text in lost)
    assert all(" s lost: " in text or " an unknown time lost: " in text for text in lost)


def test_findings_count_a_lost_chunk_exactly() -> None:
    texts = [finding.text for finding in read(FOLDER / "flipped_bit.mcap")[1]]
    assert any("565 bytes, 12 messages, 0.110 s lost" in text for text in texts)


def test_findings_report_each_loss_once() -> None:
    with open_log(FOLDER / "flipped_bit.mcap") as log:
        for _ in range(2):
            assert sum(len(batch.log_ns) for batch in log.batches()) == MESSAGES - 12
        assert len(log.findings) == 1


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_open_reads_a_truncated_chunk_up_to_the_cut(tmp_path: Path, compression: str) -> None:
    from tests.logs import written

    whole = written.source(
        tmp_path / "whole.mcap", count=3000, padding=400, extras=False, chunk_size=1 << 22,
        compression=getattr(written.CompressionType, compression.upper()),
    ).read_bytes()  # fmt: skip
    messages, counts, path = read(tmp_path / "whole.mcap")[0], [], tmp_path / "cut.mcap"
    for share in (0.2, 0.4, 0.6):
        path.write_bytes(whole[: int(share * len(whole))])
        found, (finding,) = read(path)
        assert sorted(found, key=lambda m: m[2]) == sorted(set(found) & set(messages), key=lambda m: m[2])
        assert finding.severity == "lost" and "the file ends in this chunk" in finding.text
        counts.append(len(found))
    assert 0 < counts[0] < counts[1] < counts[2] < len(messages)


def _block(packed: bytes, last: int) -> int:
    """Start of the zstd block that contains a position (RFC 8878, 3.1.1.2); type 3, bits 1 and 2, is invalid."""
    import zstandard

    at, size = 0, zstandard.frame_header_size(packed)
    while at + size <= last:
        at += size
        header = int.from_bytes(packed[at : at + 3], "little")
        size = 3 + (1 if header >> 1 & 3 == 1 else header >> 3)
    return at


def test_open_reads_a_compressed_file_up_to_its_damage(tmp_path: Path) -> None:
    import zstandard

    from tests.logs import written

    noise = {"count": 3000, "padding": 400, "extras": False, "chunk_size": 1 << 14}
    whole = written.source(tmp_path / "x.mcap", **noise, compression=written.CompressionType.NONE).read_bytes()
    messages, path, counts = set(read(tmp_path / "x.mcap")[0]), tmp_path / "x.mcap.zst", []
    packed = zstandard.ZstdCompressor(level=1).compress(whole)
    for share in (0.3, 0.6, 0.9):
        damaged = bytearray(packed)
        damaged[_block(packed, int(share * len(packed)))] |= 0b110
        path.write_bytes(damaged)
        found, findings = read(path)
        assert set(found) <= messages and findings[-1].severity == "lost"
        counts.append(len(found) / len(messages))
    assert all(share - 0.2 < count < share + 0.1 for share, count in zip((0.3, 0.6, 0.9), counts, strict=True)), counts


def test_findings_sum_many_losses(tmp_path: Path) -> None:
    whole = (FOLDER / "none.mcap").read_bytes()
    path = tmp_path / "x.mcap"
    broken = bytearray(whole * 1)
    for at in _chunk_starts(whole):
        broken[at + 60] ^= 1
    path.write_bytes(broken)
    found, findings = read(path)
    assert found == []
    assert len([finding for finding in findings if finding.severity == "lost"]) == len(_chunk_starts(whole))


def _chunk_starts(data: bytes) -> list[int]:
    starts, at = [], 8
    while at < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        starts += [at] * (opcode == 6)
        at += 9 + length
    return starts


def damaged(content: bytes, cut: float | None, flips: list[tuple[float, int]]) -> bytes:
    broken = bytearray(content if cut is None else content[: int(cut * len(content))])
    for place, bit in flips:
        if broken:
            broken[int(place * len(broken)) % len(broken)] ^= 1 << bit
    return bytes(broken)


places = st.floats(0, 1, exclude_max=True)
damages = st.tuples(st.none() | places, st.lists(st.tuples(places, st.integers(0, 7)), max_size=4))


def survives(path: Path) -> Read:
    """The content of a damaged log, after asserting little work, little memory and no traceback."""
    tracemalloc.start()
    found: Read = []
    try:
        with at_most(MOST_CALLS):
            found = read(path)[0]
    except BodylogError as problem:
        assert "\n" not in str(problem)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < MOST_BYTES
    return found


def _holds(name: str, tmp: Path, damage: tuple[float | None, list[tuple[float, int]]]) -> None:
    path = tmp / name
    path.write_bytes(damaged((FOLDER / name).read_bytes(), *damage))
    found = survives(path)
    cut, flips = damage
    # a truncated chunk has no checksum
    if name in CHECKED and not (cut is not None and flips):
        assert {(log_ns, payload) for _, log_ns, payload in found} <= _written(name)
        assert len(found) <= MESSAGES


def _written(name: str) -> set[tuple[int, bytes]]:
    return {(log_ns, payload) for _, log_ns, payload in read(FOLDER / name)[0]}


relaxed = {"deadline": None, "suppress_health_check": [HealthCheck.function_scoped_fixture]}


@pytest.mark.parametrize("name", sorted({*DAMAGED, *CHECKED}))
@settings(max_examples=25, derandomize=True, **relaxed)
@given(damage=damages)
def test_open_survives_random_damage(
    name: str, tmp_path: Path, damage: tuple[float | None, list[tuple[float, int]]]
) -> None:
    _holds(name, tmp_path, damage)


@pytest.mark.soak
@pytest.mark.parametrize("name", sorted({*DAMAGED, *CHECKED}))
@settings(max_examples=1000, **relaxed)
@given(damage=damages)
def test_open_survives_much_random_damage(
    name: str, tmp_path: Path, damage: tuple[float | None, list[tuple[float, int]]]
) -> None:
    _holds(name, tmp_path, damage)


@pytest.mark.parametrize("name", ["none.mcap", "unchunked.mcap", "no_summary.mcap", "none.bag", "killed.bag.active"])
def test_open_reads_what_precedes_any_cut(name: str, tmp_path: Path) -> None:
    """Cut at every 37th byte: never fewer messages than at the cut before, and all correct."""
    content, before = (FOLDER / name).read_bytes(), 0
    for cut in range(4200 if "bag" in name else 100, len(content), 37):
        path = tmp_path / name
        path.write_bytes(content[:cut])
        found, findings = read(path)
        assert before <= len(found), cut
        assert any(finding.severity in ("lost", "warning") for finding in findings), cut
        assert [number_of(path, message) for message in sorted(found, key=lambda m: m[1])] == list(range(len(found)))
        before = len(found)


@pytest.mark.parametrize("name", ["none.mcap", "zstd.mcap", "bz2.bag", "lz4.bag"])
def test_open_reads_a_preallocated_file(name: str, tmp_path: Path) -> None:
    """A killed recorder, or a power loss, leaves a file that ends in zeros."""
    content, path = (FOLDER / name).read_bytes(), tmp_path / name
    path.write_bytes(content[: len(content) * 2 // 3])
    found = read(path)[0]
    with path.open("r+b") as stream:
        stream.truncate((4 << 20) + 12345)
    padded, findings = read(path)
    assert found and set(padded) <= set(found) and len(padded) >= len(found) - MESSAGES // 2
    assert [finding.severity for finding in findings].count("lost")


def _streams(path: Path) -> Iterator[bytes]:
    from mcap.reader import NonSeekingReader

    with path.open("rb") as stream:
        try:
            for _, _, message in NonSeekingReader(stream).iter_messages(log_time_order=False):
                yield message.data
        except Exception:  # where the streaming reader stops
            return


@pytest.mark.parametrize("name", ["none.mcap", "zstd.mcap", "unchunked.mcap"])
def test_open_reads_at_least_what_the_streaming_reader_does(name: str, tmp_path: Path) -> None:
    content = (FOLDER / name).read_bytes()
    for cut in range(100, len(content), 211):
        path = tmp_path / name
        path.write_bytes(content[:cut])
        assert set(_streams(path)) <= {payload for _, _, payload in read(path)[0]}, cut


def test_fixtures_are_reproducible(tmp_path: Path) -> None:
    """Byte for byte where no library of another version compresses."""
    from fixtures.make_containers import make

    make(tmp_path / "made")
    names = {file.relative_to(FOLDER) for file in FOLDER.rglob("*")}
    assert {file.relative_to(tmp_path / "made") for file in (tmp_path / "made").rglob("*")} == names
    for name in [name for name in EXPECTED if name.startswith(("none", "unchunked", "no_summary", "wrong", "cut."))]:
        assert (tmp_path / "made" / name).read_bytes() == (FOLDER / name).read_bytes()


def test_findings_time_a_gap_between_chunks() -> None:
    (lost,) = [finding.text for finding in read(FOLDER / "hole.mcap")[1] if finding.severity == "lost"]
    assert "465 bytes, 12 messages, 0.130 s lost" in lost
