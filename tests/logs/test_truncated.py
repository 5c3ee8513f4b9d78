"""The truncated chunk at the end of a bag is read as far as it decompresses."""

import random
from pathlib import Path

import pytest

from bodylog.logs.rosbag1 import truncated
from fixtures import by_hand
from tests.logs.whole_logs import read

SOME = [(f"/t{i % 3}", 10**9 * (100 + i), bytes([i % 7]) * 20 + i.to_bytes(4, "little") * 30) for i in range(1000)]


@pytest.fixture(autouse=True)
def _longer_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(by_hand, "_PER_CHUNK", 400)


def _bag(compression: str) -> bytes:
    return by_hand.bag(SOME, "pkg/Type", b"int32 x", compression)


@pytest.mark.parametrize("compression", ["lz4", "bz2", "none"])
@pytest.mark.parametrize("cuts", [60, pytest.param(1500, marks=pytest.mark.soak)])
def test_open_reads_a_truncated_chunk_up_to_the_cut(tmp_path: Path, compression: str, cuts: int) -> None:
    """bz2 gives only whole blocks, and each of these chunks is one block."""
    whole, path, counts = _bag(compression), tmp_path / "cut.bag", []
    for cut in range(4500, len(whole), len(whole) // cuts):
        path.write_bytes(whole[:cut])
        found, findings = read(path)
        assert sorted(found) == sorted(set(found) & set(SOME))
        assert any(finding.severity in ("lost", "warning") for finding in findings)
        counts.append(len(found))
    assert counts == sorted(counts) and counts[-1] == len(SOME)
    assert set(counts) <= {0, 400, 800, 1000} if compression == "bz2" else len(set(counts)) > 15


def test_open_counts_missing_bytes_of_an_uncompressed_chunk(tmp_path: Path) -> None:
    """The rest of the chunk declared its messages; whole ones are kept."""
    whole, path = _bag("none"), tmp_path / "cut.bag"
    start = whole.index(b"compression=none")
    size = int.from_bytes(whole[whole.index(b"size=", start) + 5 :][:4], "little")
    body = whole.index(b"size=", start) + 13
    path.write_bytes(whole[: body + size - 500])
    found, findings = read(path)
    assert len(found) == 397 and set(found) <= set(SOME)
    (chunk, message) = [finding.text for finding in findings if finding.severity == "lost"]
    assert "from byte 4117 500 bytes," in chunk and "the file ends in this chunk, after" in chunk
    assert message.endswith("no whole record can be read there")


def test_open_reads_an_unclosed_chunk(tmp_path: Path) -> None:
    """A recorder writes a chunk's two lengths when it closes it; if killed before, it leaves zeros."""
    whole, path, zero = _bag("lz4"), tmp_path / "killed.bag", bytes(4)
    at = whole.index(b"compression=lz4", whole.index(b"compression=lz4") + 1)
    size, start = whole.index(b"size=", at) + 5, whole.index(b"\x04\x22\x4d\x18", at)
    path.write_bytes(whole[:size] + zero + whole[size + 4 : start - 4] + zero + whole[start : start + 2000])
    found, findings = read(path)
    assert 400 < len(found) < 800 and set(found) <= set(SOME)
    assert "the file ends in this chunk" in findings[-1].text and findings[-1].severity == "lost"


@pytest.mark.parametrize("seed", range(5))
def test_decompress_truncated_lz4_equals_the_library(seed: int) -> None:
    import lz4.frame

    rng = random.Random(seed)
    pieces = [rng.choice([bytes([i]) * 900, rng.randbytes(700), b"abcde" * 80]) for i in range(200)]
    raw = b"".join(rng.choices(pieces, k=600))
    how = {name: bool(seed >> bit & 1) for bit, name in enumerate(("block_linked", "block_checksum", "store_size"))}
    packed = lz4.frame.compress(raw, block_size=4 + seed % 4, **how)
    assert truncated.decompress_truncated(truncated.Cut("lz4", memoryview(packed), 1 << 30)) == raw
    lengths = []
    for cut in sorted(rng.choices(range(len(packed)), k=20)):
        part = truncated.decompress_truncated(truncated.Cut("lz4", memoryview(packed)[:cut], 1 << 30))
        assert raw.startswith(part)
        lengths.append(len(part))
    assert lengths == sorted(lengths) and len(set(lengths)) > 15
    assert len(truncated.decompress_truncated(truncated.Cut("lz4", memoryview(packed), 1000))) == 1000


def test_cut_at_bounds_a_declared_size() -> None:
    whole, start = _bag("lz4"), 13 + 8 + 4096
    sound = truncated.cut_at(memoryview(whole[:6000]), start)
    size = whole.index(b"size=", start) + 5
    claims = truncated.cut_at(memoryview(whole[:size] + b"\xff" * 4 + whole[size + 4 : 6000]), start)
    assert sound is not None and claims is not None
    assert sound.most < 100_000 and claims.most == 64 << 20
