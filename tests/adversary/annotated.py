"""Annotated logs whose /bodylog topics and metadata are changed field by field, by other libraries."""

import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from .grammar import FLOATS, Draw, deep


def spoilt(draw: Draw, source: Path, path: Path) -> None:
    """Write `source`, an annotated log, to `path` with hostile content."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    dropped, doubled = draw.hostile(0.3), draw.hostile(0.3)
    with source.open("rb") as read, path.open("wb") as written:
        reader, writer = make_reader(read), Writer(written, compression=CompressionType.NONE)
        writer.start("ros2", "adversary")
        known: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages():
            if channel.id not in known:
                _register(store, schema)
                name = draw.text(channel.topic) if draw.hostile(0.1) else channel.topic
                id_ = writer.register_schema(schema.name, schema.encoding, schema.data)
                known[channel.id] = writer.register_channel(name, channel.message_encoding, id_)
            if dropped and draw.random.random() < 0.1:
                continue
            data = (
                _changed(draw, store, schema.name, message.data)
                if channel.topic.startswith("/bodylog/")
                else message.data
            )
            for _ in range(1 + (doubled and draw.random.random() < 0.1)):
                writer.add_message(known[channel.id], message.log_time, data, message.publish_time)
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, _metadata(draw, record.metadata))
        writer.finish()


def _register(store: Any, schema: Any) -> None:
    found = get_types_from_msg(schema.data.decode(), schema.name)
    store.register({name: what for name, what in found.items() if name not in store.fielddefs})


def _changed(draw: Draw, store: Any, kind: str, data: bytes) -> bytes:
    if not draw.hostile(0.1):
        return data
    message = store.deserialize_cdr(data, kind)
    for _ in range(draw.random.randint(1, 3)):
        _change(draw, message)
    try:
        return bytes(store.serialize_cdr(message, kind))
    except Exception:  # a value of the wrong type for the field
        return data


def _change(draw: Draw, message: Any) -> None:
    field = draw.of([f.name for f in fields(message) if not f.name.startswith("_")])
    value = getattr(message, field)
    if is_dataclass(value):
        _change(draw, value)
    elif isinstance(value, np.ndarray):
        changed = np.array(value[: draw.random.randint(0, len(value))] if draw.random.random() < 0.5 else value)
        if len(changed) and changed.dtype.kind == "f":
            changed[draw.random.randrange(len(changed))] = draw.of(FLOATS)
        setattr(message, field, changed)
    elif isinstance(value, list):
        setattr(message, field, draw.of([[], value[:1], value * 2, ["" for _ in value], [*value, "\0"]]))
    elif isinstance(value, str):
        setattr(message, field, draw.of(("", "x", "\0", "é" * 2000, "/")))
    else:
        setattr(message, field, draw.of((0, -1, 2**31 - 1, -(2**31), 1e308, float("nan"), 5)))


def _metadata(draw: Draw, known: Mapping[str, str]) -> dict[str, str]:
    out = dict(known)
    for key in known:
        if draw.hostile(0.5):
            text = known[key]
            kind = draw.random.randint(0, 4)
            if kind == 0:
                text = "[" * draw.of((10, 2000, 200_000))
            elif kind == 1:
                text = json.dumps(draw.json())
            elif kind == 2:
                text = json.dumps({"encoders": draw.json(), "topics": draw.json(), "body": deep(400)})
            elif kind == 3:
                text = text[: draw.random.randint(0, len(text))]
            else:
                text = text.replace("0", draw.of(("1e999", "-", "9" * 401)))
            out[key] = text
    return out
