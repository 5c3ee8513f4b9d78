"""Body models with a changed header or arrays."""

import io
import json
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np

from .grammar import FLOATS, INTEGERS, TEXTS, Draw, deep

SHAPES = (
    "(-1, -2)",
    "(0, 4611686018427387904, 8)",
    "(True, 2)",
    "(2,)",
    "()",
    "(2, 2",
    "(1e3,)",
    "(9**9**9,)",
    "(" * 300,
    "(18446744073709551616,)",
    "None",
    "(0,)",
    "(-1,)",
    "((2,),)",
)


def spoilt(draw: Draw, source: Path, path: Path) -> None:
    """Write `source`, a body model, to `path` with hostile content."""
    with zipfile.ZipFile(source) as read:
        members = {name: read.read(name) for name in read.namelist()}
    for _ in range(draw.random.randint(1, 2)):
        name = "header.npy" if draw.random.random() < 0.6 else draw.of(sorted(members))
        members[name] = _header(draw, members[name]) if name == "header.npy" else _array(draw, members[name])
    if draw.hostile(0.2):
        members.pop(draw.of(sorted(members)))
    kind = zipfile.ZIP_DEFLATED if draw.hostile(0.2) else zipfile.ZIP_STORED
    with zipfile.ZipFile(path, "w", kind) as written:
        for name, data in members.items():
            written.writestr(name, data)


def _header(draw: Draw, data: bytes) -> bytes:
    text = str(np.load(io.BytesIO(data)))
    try:
        header = json.loads(text)
    except (RecursionError, json.JSONDecodeError):  # spoilt already
        return data
    for _ in range(draw.random.randint(1, 3)):
        _change(draw, header)
    text = json.dumps(header)
    if draw.hostile(0.3):
        text = text.replace("0.", draw.of(("1e999", "-0.", "9" * 401 + ".")), 1)
    out = io.BytesIO()
    np.save(out, np.array(text if draw.random.random() < 0.9 else "[" * 5000))
    return out.getvalue()


def _change(draw: Draw, value: Any) -> None:
    """Replace one value somewhere below."""
    while True:
        places = list(value) if isinstance(value, dict) else list(range(len(value)))
        if not places:
            return
        key = draw.of(places)
        if not isinstance(value[key], dict | list) or not value[key] or draw.random.random() < 0.3:
            break
        value = value[key]
    kinds: tuple[Callable[[], Any], ...] = (
        lambda: draw.of(FLOATS),
        lambda: draw.of(INTEGERS),
        lambda: draw.of((*TEXTS, "\ud800")),
        draw.json,
        lambda: deep(900),
        lambda: draw.of(([], {}, None, True, 5, -1, 0, "x")),
        lambda: [value[key]] * 3,
        lambda: draw.of((-1e-9, 1e300, 1e-300)),
    )
    value[key] = draw.of(kinds)()


def _array(draw: Draw, data: bytes) -> bytes:
    try:
        array = np.load(io.BytesIO(data))
    except (ValueError, OverflowError, TokenError):  # spoilt already
        return data
    kind = draw.random.randint(0, 4)
    if kind == 0:
        return _npy(draw.of(SHAPES), data[-array.nbytes :] if draw.random.random() < 0.5 else b"")
    if kind == 1 and array.size and array.dtype.kind in "fc":
        flat = array.reshape(-1)
        flat[draw.random.randrange(flat.size) if draw.random.random() < 0.5 else slice(None)] = draw.of(
            (*FLOATS, 0.0, -1.0)
        )
    elif kind == 2:
        array = array * draw.of((1e300, 1e-300, -1.0, 1e150)) if array.dtype.kind in "biufc" else array
    elif kind == 3:
        array = array[: draw.random.randint(0, len(array))] if array.ndim else array
    else:
        array = array.astype(draw.of(("<f4", ">f8", "<i8", "<c16", "U9")))
    out = io.BytesIO()
    np.save(out, array)
    return out.getvalue() if draw.random.random() < 0.9 else out.getvalue()[: draw.random.randint(0, 200)]


def _npy(shape: str, data: bytes) -> bytes:
    text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}"
    text += " " * (-(len(text) + 11) % 64) + "\n"
    return b"\x93NUMPY\x01\0" + struct.pack("<H", len(text)) + text.encode() + data
