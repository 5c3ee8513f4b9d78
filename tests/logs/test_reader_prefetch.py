"""Prefetching with one processor or two gives the same messages and losses in the same order."""

from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from bodylog.logs.formats import open_log, payload_views
from bodylog.logs.mcap import reader


@pytest.mark.parametrize("seed", range(3))
def test_prefetch_is_independent_of_processors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    path, rng = tmp_path / "a.mcap", np.random.default_rng(seed)
    writer = Writer(str(path), chunk_size=60_000)
    writer.start()
    channel = writer.register_channel("/a", "cdr", writer.register_schema("std_msgs/msg/UInt8", "ros2msg", b"uint8 x"))
    for time in range(400):
        writer.add_message(channel, time, rng.integers(0, 256, 2000, np.uint8).tobytes(), time)
    writer.finish()
    raw = bytearray(path.read_bytes())
    for place in rng.integers(len(raw) // 4, len(raw) // 2, 3):
        raw[place] ^= 255
    path.write_bytes(raw)
    read = {}
    for processors in (1, 2):
        monkeypatch.setattr(reader, "_count_processors", lambda count=processors: count)
        with open_log(path) as log:
            found = [(b.log_ns.tolist(), [bytes(p) for p in payload_views(b)]) for b in log.batches()]
            read[processors] = found, log.findings
    assert read[1] == read[2]
    assert sum(len(times) for times, _ in read[1][0]) < 400 and read[1][1]
