"""The images of recorded logs against rosbags-image."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bodylog.errors import BodylogError, FormatError
from bodylog.logs.formats import open_log, payload_views
from bodylog.logs.images import messages
from bodylog.logs.protocol import Log
from bodylog.types import Array, Topic

SHARED = Path(__file__).parents[2].parent / "shared" / "logs"
FOUND = {"mono8", "rgb8", "bgr8", "jpg", "jpeg", "png", "bgr8; jpeg compressed bgr8", "rgb8; jpeg compressed bgr8"}
"""How the recorded logs that rosbags can decode store their pictures."""


def test_decoder_equals_rosbags_image() -> None:
    peer = pytest.importorskip("rosbags.image")
    if not SHARED.is_dir():
        pytest.skip(f"{SHARED} is not here")
    met = set()
    for path in sorted(p for p in SHARED.rglob("*") if p.suffix in (".mcap", ".bag", ".db3") and p.is_file()):
        try:
            log = open_log(path)
        except BodylogError:
            continue
        with log:
            for topic in log.topics:
                if topic.type in messages.COMPRESSED + messages.RAW and (message := _first(log, topic)) is not None:
                    met |= _compared(peer, topic, *message)
    assert met >= FOUND


def _first(log: Log, topic: Topic) -> tuple[bytes, Any] | None:
    """A topic's first payload, and rosbags' reading of it; None if rosbags does not know the encoding."""
    from rosbags.typesys import Stores, get_typestore

    batch = next(iter(log.batches([topic.id])), None)
    if batch is None or topic.encoding not in ("cdr", "ros1"):
        return None
    payload = bytes(next(iter(payload_views(batch))))
    if topic.encoding == "ros1":
        return payload, get_typestore(Stores.ROS1_NOETIC).deserialize_ros1(payload, topic.type)
    return payload, get_typestore(Stores.ROS2_HUMBLE).deserialize_cdr(payload, topic.type)


def _compared(peer: Any, topic: Topic, payload: bytes, message: Any) -> set[str]:
    """The encoding, if both give the same image; empty if both refuse it."""
    try:
        ours: Array = messages.make_image_decoder(topic)(payload, 1)
    except FormatError:
        with pytest.raises((AssertionError, TypeError)):
            peer.message_to_cvimage(message, "bgr8")
        return set()
    assert np.array_equal(ours, peer.message_to_cvimage(message, "bgr8"))
    return {getattr(message, "encoding", None) or message.format}
