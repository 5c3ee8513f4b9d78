"""Recorded logs whose clocks are set back while they are recorded: stamps of some topics, and log
times if asked.
"""

import struct
from collections.abc import Collection
from pathlib import Path

import numpy as np

SECOND = 10**9
_STAMP = struct.Struct("<iI")
_HEADER = 4
"""Bytes before the header of a CDR message."""


def set_back(
    source: Path,
    out: Path,
    at: float,
    by: float,
    topics: Collection[str] | None = None,
    recorder: bool = False,
    jitter: float = 0.0,
    seed: int = 0,
    ends: float = np.inf,
) -> Path:
    """Write the log with clocks `by` s behind from `at` s until it ends: those of `topics` (None:
    all), or the
    recorder's too; with exponential transport delays of mean `jitter` s.
    """
    from mcap.reader import make_reader
    from mcap.writer import Writer

    rng, channels = np.random.default_rng(seed), {}
    with source.open("rb") as read:
        messages = list(make_reader(read).iter_messages())
    started = messages[0][2].log_time
    arrivals = [
        message.log_time + round(rng.exponential(jitter) * SECOND) for *_, message in messages
    ]
    with out.open("wb") as written:
        writer = Writer(written)
        writer.start("ros2", "stepped")
        for number in np.argsort(arrivals, kind="stable").tolist():
            schema, channel, message = messages[number]
            behind = round(by * SECOND) * (at < (message.log_time - started) / SECOND <= ends)
            logged = (
                round(by * SECOND) * (at < (arrivals[number] - started) / SECOND <= ends) * recorder
            )
            data = message.data
            if b"std_msgs/Header" in schema.data and (topics is None or channel.topic in topics):
                seconds, nanoseconds = _STAMP.unpack_from(data, _HEADER)
                stamp = _STAMP.pack(*divmod(seconds * SECOND + nanoseconds - behind, SECOND))
                data = data[:_HEADER] + stamp + data[_HEADER + _STAMP.size :]
            if channel.topic not in channels:
                known = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(
                    channel.topic, channel.message_encoding, known
                )
            time = arrivals[number] - logged
            writer.add_message(channels[channel.topic], time, data, time)
        writer.finish()
    return out
