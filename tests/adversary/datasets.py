"""Hostile datasets and tables: HDF5 episodes, LeRobot folders, tables with images, videos, tables of poses."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from .bombs import SECRET, mp4
from .grammar import FLOATS, INTEGERS, TEXTS, Draw
from .messages import hostile_picture, packed

ROWS = 12


def _numbers(draw: Draw, rows: int = ROWS, width: int = 2) -> np.ndarray:
    """Readings (rows, width); some of them no angles."""
    values = np.linspace(0.0, 1.0, rows * width).reshape(rows, width)
    for _ in range(draw.random.randint(1, 4) if draw.hostile() and values.size else 0):
        values.flat[draw.random.randrange(values.size)] = draw.of(FLOATS)
    return values


def _name(draw: Draw, usual: str) -> str:
    """A name for a file or dataset: no slash, no zero byte, not too long."""
    return draw.text(usual).replace("/", "_").replace("\0", "_")[:40] or usual


def hdf5(draw: Draw, path: Path) -> None:
    """An episode as ALOHA or robomimic keep it, with odd types, shapes, chunks, filters, links and bytes."""
    import h5py

    with h5py.File(path, "w") as file:
        top = file if draw.random.random() < 0.6 else file.create_group(f"data/demo_{draw.of((0, 1, 7))}")
        places = ("observations/qpos", "action", "observations/qvel", "timestamps", "observations/images/cam")
        for place in places if top is file else ("obs/joint_pos", "actions", "obs/agentview_image", "timestamps"):
            if not draw.hostile(0.5):
                _dataset(draw, top, place)
        for _ in range(draw.random.randint(0, 3)):
            _link(draw, file, top)
        if draw.hostile():
            file.attrs["fps"] = draw.of((30, 0, -1, "x", float("nan"), [1, 2]))
    spoil(draw, path)


def _dataset(draw: Draw, top: Any, place: str) -> None:
    import h5py

    values: Any = _numbers(draw)
    if "timestamp" in place:
        values = np.arange(ROWS) / 30.0
    elif "image" in place:
        values = np.zeros((ROWS, 8, 8, 3), np.uint8)
    if not draw.hostile(2.0):
        top[place] = values
        return
    kinds = ("f2", "i1", "u8", "?", "S5", "c16", h5py.ref_dtype, h5py.string_dtype(), h5py.vlen_dtype(np.uint8))
    shapes = ((), (0,), (ROWS, 0), (ROWS, 3, 3), (1 << 20, 60), (1 << 40,), (ROWS, 70), (ROWS, 1 << 12, 1 << 12, 3))
    kind = draw.of((*kinds, values.dtype, "f8", "u1"))
    shape = draw.of((*shapes, values.shape, values.shape))
    options: dict[str, Any] = {}
    if shape and draw.random.random() < 0.6:
        options["chunks"] = tuple(max(1, min(side, draw.of((1, 7, 64)))) for side in shape)
        options["compression"] = draw.of((None, "gzip", "lzf"))
        options["shuffle"] = draw.random.random() < 0.3
        options["maxshape"] = tuple(None for _ in shape)
    try:
        made = top.create_dataset(place, shape, kind, **options)
        if options and made.size:
            made.id.write_direct_chunk((0,) * len(shape), draw.noise(500))
        elif made.size < 10**5 and np.dtype(made.dtype).kind in "fiu":
            made[...] = draw.of((0, 1, 100))
    except (TypeError, ValueError, OSError, RuntimeError):  # what HDF5 itself refuses to write
        return


def _link(draw: Draw, file: Any, top: Any) -> None:
    import h5py

    kinds: tuple[Callable[[], Any], ...] = (
        lambda: file["/"],
        lambda: top,
        lambda: h5py.SoftLink("/"),
        lambda: h5py.SoftLink("/nowhere"),
        lambda: h5py.ExternalLink("/etc/passwd", "/"),
        lambda: h5py.ExternalLink(file.filename, "/"),
    )
    for _ in range(draw.of((1, 3, 40))):
        place = f"{draw.of(('', 'a/', 'observations/'))}link{draw.random.randint(0, 10**6)}"
        try:
            top[place] = draw.of(kinds)()
        except (OSError, RuntimeError, ValueError):  # a name that is taken
            return


def spoil(draw: Draw, path: Path) -> None:
    """Change some bytes of a file, or cut it, one time in three."""
    if draw.random.random() < 0.66:
        return
    data = bytearray(path.read_bytes())
    for _ in range(draw.random.randint(1, 20) if data else 0):
        data[draw.random.randrange(len(data))] = draw.random.randrange(256)
    path.write_bytes(data[: draw.random.randint(0, len(data))] if draw.random.random() < 0.3 else data)


def lerobot(draw: Draw, path: Path) -> None:
    """A LeRobot dataset whose lists, shapes, names and columns lie."""
    data, meta = path / "data" / "chunk-000", path / "meta"
    data.mkdir(parents=True)
    meta.mkdir()
    columns = {"timestamp": np.arange(ROWS) / 30.0, "episode_index": np.zeros(ROWS, np.int64)}
    columns |= {name: _column(draw) for name in ("observation.state", "action", "observation.images.cam")}
    _parquet(draw, data / "episode_000000.parquet", columns)
    features: dict[str, Any] = {name: {"dtype": "float32", "shape": [2], "names": ["a", "b"]} for name in columns}
    features["observation.images.cam"] = {"dtype": draw.of(("image", "video")), "shape": [8, 8, 3]}
    paths = {"data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet", "chunks_size": 1000}
    paths["video_path"] = "videos/{video_key}.mp4"
    info: Any = {"codebase_version": draw.of(("v2.1", "v2.0", "v3.0")), "fps": 30, "features": features, **paths}
    for _ in range(draw.random.randint(1, 3) if draw.hostile(2.0) else 0):
        _change(draw, info)
    (meta / "info.json").write_text(_json(draw, info), encoding="utf-8", errors="replace")
    row: Any = {"episode_index": 0, "length": ROWS, "tasks": ["x"]}
    if draw.hostile():
        _change(draw, row)
    (meta / "episodes.jsonl").write_text(_json(draw, row) + "\n", encoding="utf-8", errors="replace")
    (path / "videos").mkdir()
    video(draw, path / "videos" / "observation.images.cam.mp4")
    _out_of(draw, path)


def _change(draw: Draw, value: Any) -> None:
    """Replace one value somewhere below."""
    while value:
        key = draw.of(list(value) if isinstance(value, dict) else list(range(len(value))))
        if not isinstance(value[key], dict | list) or not value[key] or draw.random.random() < 0.3:
            value[key] = draw.of((5, -1, None, True, "", [], {}, [5], "x" * 300, 1e300, draw.json()))
            return
        value = value[key]


def _json(draw: Draw, value: Any) -> str:
    text = json.dumps(value)
    return draw.of(("[" * 100_000, text[:-3], "null", "5", text * 2)) if draw.hostile(0.2) else text


def _column(draw: Draw) -> Any:
    """A column for Arrow: numbers, lists of any length, texts, bytes, or what all rows share."""
    import pyarrow as arrow

    whole = _numbers(draw).tolist()
    if not draw.hostile(2.0):
        return arrow.array(whole)
    kinds: tuple[Callable[[], Any], ...] = (
        lambda: arrow.array([row * draw.of((0, 1, 300)) for row in whole]),
        lambda: arrow.array([draw.of(TEXTS) for _ in range(ROWS)]),
        lambda: arrow.array([hostile_picture(draw, 1, ".png") for _ in range(ROWS)], arrow.binary()),
        lambda: arrow.array([{"bytes": packed(1, ".png"), "path": draw.of(TEXTS)} for _ in range(ROWS)]),
        lambda: arrow.array([None] * ROWS, arrow.list_(arrow.float64())),
        lambda: arrow.array([[[1.0], [2.0, 3.0]]] * ROWS),
        lambda: arrow.DictionaryArray.from_arrays(np.zeros(ROWS, np.int32), ["y" * 10_000]),
        lambda: arrow.array(np.arange(ROWS), arrow.timestamp("ns")),
        lambda: arrow.nulls(ROWS),
    )
    return draw.of(kinds)()


def _parquet(draw: Draw, path: Path, columns: dict[str, Any]) -> None:
    import pyarrow as arrow
    from pyarrow import parquet

    parquet.write_table(arrow.table(columns), path, compression=draw.of(("zstd", "snappy", "none")))
    spoil(draw, path)


def tables(draw: Draw, path: Path) -> None:
    """A folder of tables and images, some of them links out of it."""
    path.mkdir()
    images = [_name(draw, f"{k}.png") for k in range(ROWS)]
    (path / "cam.csv").write_text(_csv(draw, {"t": list(range(1, ROWS + 1)), "file": images}), errors="replace")
    for name in images:
        if draw.random.random() < 0.8:
            (path / name).write_bytes(hostile_picture(draw, 1, ".png") if draw.hostile() else packed(1, ".png"))
    if draw.random.random() < 0.7:
        csv(draw, path / f"{_name(draw, 'joints')}.csv")
    if draw.random.random() < 0.4:
        video(draw, path / "side.mp4")
    _out_of(draw, path)


def _out_of(draw: Draw, folder: Path) -> None:
    """Replace a file by a link to another file, or to a folder."""
    files = sorted(one for one in folder.rglob("*") if one.is_file())
    if not draw.hostile(2.0) or not files:
        return
    secret = folder.parent / "secret"
    secret.write_bytes(SECRET)
    one = draw.of(files)
    one.unlink()
    os.symlink(draw.of((secret, folder, "/dev/zero", "/nowhere", one)), one)


def video(draw: Draw, path: Path) -> None:
    """An MP4 whose tables declare any number, size and place of samples."""
    image = hostile_picture(draw, 1, ".jpg") if draw.hostile() else packed(1, ".jpg")
    samples = draw.of((0, 1, ROWS, 1 << 24, 2**32 - 1)) if draw.hostile() else ROWS
    size = draw.of((0, 1, 2**31, len(image))) if draw.hostile() else len(image)
    width = draw.of((0, 1, 16_384, 65_535)) if draw.hostile() else 64
    path.write_bytes(mp4(samples, size, width, data=image * ROWS))
    spoil(draw, path)


def csv(draw: Draw, path: Path) -> None:
    """A table of poses as CSV."""
    columns = {"t": list(range(1, ROWS + 1)), "elbow": _numbers(draw)[:, 0].tolist(), "tip_u": list(range(ROWS))}
    columns |= {"tip_v": list(range(ROWS)), "image": [draw.text("../secret") for _ in range(ROWS)]}
    path.write_text(_csv(draw, columns), encoding="utf-8", errors="replace")
    spoil(draw, path)


def _csv(draw: Draw, columns: dict[str, list[Any]]) -> str:
    names = [draw.text(name) for name in columns]
    rows = [",".join(names), *(",".join(map(str, row)) for row in zip(*columns.values(), strict=True))]
    if draw.hostile():
        rows[draw.random.randrange(len(rows))] = draw.of(
            (",", '"', '"' + "x" * 200_000, "a" * 10**6, "\0", "," * 10**5)
        )
    return draw.of(("\n", "\r\n", "\r")).join(rows) + draw.of(("", "\n"))


def yaml(draw: Draw, path: Path) -> None:
    """A table of poses as YAML."""
    odd = (
        "&a [*a]",
        "[*x, *x]",
        "{a: 1}",
        "!!python/object:os.system x",
        "[" * 300,
        "? [1]",
        "1e999",
        "2020-01-01",
        "~",
    )
    rows = []
    for k in range(ROWS):
        cells = {"t": str(k), "elbow": str(0.1 * k), "tip": "[3, 4]"}
        for name in cells:
            if draw.hostile():
                cells[name] = draw.of((*odd, str(draw.of(FLOATS)), str(draw.of(INTEGERS)), repr(draw.of(TEXTS))))
        rows.append("- {" + ", ".join(f"{name}: {text}" for name, text in cells.items()) + "}")
    if draw.hostile():
        rows.append(draw.of(("- ? {a: 1}\n  : 2", "- ? [a]\n  : 2", "x", "- 5", "...", "--- 3", "- &a b", "- *a")))
    path.write_text("\n".join(rows), encoding="utf-8", errors="replace")
    spoil(draw, path)


def parquet(draw: Draw, path: Path) -> None:
    """A table of poses as Parquet."""
    names = ("elbow", "tip_u", "tip_v", "image", draw.text("wrist"))
    columns = {name: _column(draw) if draw.hostile(2.0) else np.arange(float(ROWS)) for name in names}
    _parquet(draw, path, {"t": np.arange(1.0, ROWS + 1), **columns})


WRITERS: dict[str, Callable[[Draw, Path], None]] = {
    "episode.h5": hdf5,
    "set": lerobot,
    "tables": tables,
    "film.mp4": video,
    "poses.csv": csv,
    "poses.yaml": yaml,
    "poses.parquet": parquet,
}
"""Kinds of hostile datasets and tables."""
