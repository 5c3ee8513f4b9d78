"""Small files that ask for much: links that never end, sizes that lie, rows that expand, texts that nest."""

import json
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tests.logs import writing

from .grammar import STEP, T0

Written = tuple[str, ...]
"""The words of a command that reads what was written."""
SECRET = b"the-secret-of-another-file"
"""What must never reach an output: it stands in a file that no command was given."""


@dataclass(frozen=True)
class Bomb:
    """One hostile input: a function that writes it and returns the command that reads it.

    `code`: the command's exit code · `says`: part of what it prints.
    """

    write: Callable[[Path], Written]
    code: int
    says: str = ""


def _ingest(folder: Path, name: str) -> Written:
    return ("ingest", str(folder / name), "-o", str(folder / "out.mcap"))


def _episode(folder: Path):
    """An open HDF5 file with ten rows of two joints."""
    import h5py

    file = h5py.File(folder / "x.h5", "w")
    file["observations/qpos"] = np.linspace(0.0, 1.0, 20).reshape(10, 2)
    return file


def hdf5_cycle(folder: Path) -> Written:
    """Groups that hold themselves under 300 names: 300⁶ ways of six steps."""
    with _episode(folder) as file:
        group = file.create_group("g")
        for k in range(300):
            group[f"{k}"] = group
    return _ingest(folder, "x.h5")


def hdf5_chain(folder: Path) -> Written:
    """Six groups, each in the one before under 60 names."""
    with _episode(folder) as file:
        group = file.create_group("g")
        for _ in range(7):
            inner = group.create_group("0")
            for k in range(1, 60):
                group[f"{k}"] = inner
            group = inner
        group["d"] = np.zeros(3)
    return _ingest(folder, "x.h5")


def hdf5_external(folder: Path) -> Written:
    """A demonstration that is a link into another file."""
    import h5py

    (folder / "other").mkdir()
    with h5py.File(folder / "other" / "private.h5", "w") as file:
        file["demo/obs/joint_pos"] = np.linspace(0.0, 1.0, 20).reshape(10, 2)
        text = np.frombuffer(SECRET * 4, np.uint8)
        file["demo/obs/secret_image"] = np.tile(text, (10, 1))
    with h5py.File(folder / "x.h5", "w") as file:
        file.create_group("data")["demo_0"] = h5py.ExternalLink("other/private.h5", "/demo")
    return _ingest(folder, "x.h5")


def hdf5_sum(folder: Path) -> Written:
    """Three datasets without a stored byte, each of half a gigabyte once read."""
    with _episode(folder) as file:
        del file["observations/qpos"]
        for name in ("qpos", "qvel", "effort"):
            file.create_dataset(f"observations/{name}", shape=(1 << 20, 60), dtype="f8")
    return _ingest(folder, "x.h5")


def hdf5_chunk(folder: Path) -> Written:
    """Times in one chunk of 2 GB, of which ten are asked for."""
    with _episode(folder) as file:
        shape, chunk = (10,), (1 << 28,)
        made = file.create_dataset("timestamps", shape, "f8", chunks=chunk, maxshape=(None,), compression="gzip")
        made.id.write_direct_chunk((0,), _zeros(8 << 28))
    return _ingest(folder, "x.h5")


def hdf5_stream(folder: Path) -> Written:
    """A chunk of 2 MB whose stored stream, as long as that, unpacks to 2 GB."""
    with _episode(folder) as file:
        chunk = (1 << 18,)
        made = file.create_dataset("timestamps", (10,), "f8", chunks=chunk, maxshape=(None,), compression="gzip")
        made.id.write_direct_chunk((0,), _zeros(1 << 31))
    return _ingest(folder, "x.h5")


def hdf5_references(folder: Path) -> Written:
    """Images that are references to objects."""
    import h5py

    with _episode(folder) as file:
        made = file.create_dataset("observations/images/cam", (10,), dtype=h5py.ref_dtype)
        made[:] = [file["observations"].ref] * 10
    return _ingest(folder, "x.h5")


def hdf5_heap(folder: Path) -> Written:
    """A million images that are all the same megabyte."""
    import h5py

    with _episode(folder) as file:
        del file["observations/qpos"]
        rows, kind = (400_000,), h5py.vlen_dtype(np.uint8)
        made = file.create_dataset("observations/images/cam", rows, kind, chunks=rows, compression="gzip")
        made[0] = np.ones(1 << 20, np.uint8)
        stored = made.id.read_direct_chunk((0,))[1]
        one = zlib.decompress(stored)[:16]
        made.id.write_direct_chunk((0,), zlib.compress(one * 400_000, 9))
    return _ingest(folder, "x.h5")


def _zeros(size: int) -> bytes:
    """A zlib stream of that many zeros."""
    packer, piece = zlib.compressobj(9), bytes(1 << 20)
    packed = [packer.compress(piece) for _ in range(size >> 20)]
    return b"".join(packed) + packer.flush()


def parquet_dictionary(folder: Path) -> Written:
    """Rows that all name one text of a megabyte."""
    import pyarrow as arrow
    from pyarrow import parquet

    text = arrow.DictionaryArray.from_arrays(np.zeros(3000, np.int32), ["x" * (1 << 20)])
    table = arrow.table({"t": np.arange(3000.0), "elbow": np.zeros(3000), "text": text})
    parquet.write_table(table, folder / "x.parquet", compression="zstd")
    return _ingest(folder, "x.parquet")


def parquet_padding(folder: Path) -> Written:
    """A LeRobot table with one long list among many short ones."""
    import pyarrow as arrow

    lists = [[0.0] * 100_000] + [[0.0]] * 100_000
    _lerobot(folder, {"observation.state": arrow.array(lists, arrow.list_(arrow.float32()))})
    return _ingest(folder, "set")


def parquet_lists(folder: Path) -> Written:
    """A table of poses whose cell is a list of 34 million numbers."""
    import pyarrow as arrow
    from pyarrow import parquet

    flat = arrow.array(np.zeros(1 << 25, np.int8))
    lists = arrow.ListArray.from_arrays(arrow.array([0, 1 << 25], arrow.int32()), flat)
    table = arrow.table({"t": [0.0], "elbow": [0.0], "list": lists})
    parquet.write_table(table, folder / "x.parquet", compression="zstd")
    return _ingest(folder, "x.parquet")


def parquet_images(folder: Path) -> Written:
    """Images of a LeRobot table that are all one text of 20 MB."""
    import pyarrow as arrow

    one = arrow.array([bytes(20 << 20)], arrow.binary())
    image = arrow.DictionaryArray.from_arrays(np.zeros(2000, np.int32), one)
    state = arrow.array([[0.1 * k, 0.2] for k in range(2000)])
    _lerobot(folder, {"observation.state": state, "observation.images.cam": image})
    return _ingest(folder, "set")


def info_shape(folder: Path) -> Written:
    """A feature whose shape is a number."""
    import pyarrow as arrow

    state = arrow.array([[0.1 * k, 0.2] for k in range(20)])
    _lerobot(folder, {"observation.state": state}, shape=5)
    return _ingest(folder, "set")


def _lerobot(folder: Path, columns: dict, shape: object = (2,)) -> None:
    """A LeRobot dataset v2.1 of one episode in folder/set."""
    import pyarrow as arrow
    from pyarrow import parquet

    meta, data = folder / "set" / "meta", folder / "set" / "data" / "chunk-000"
    meta.mkdir(parents=True)
    data.mkdir(parents=True)
    count = len(next(iter(columns.values())))
    rows = {"timestamp": np.arange(count) / 30.0, "episode_index": np.zeros(count, np.int64), **columns}
    parquet.write_table(arrow.table(rows), data / "episode_000000.parquet", compression="zstd", row_group_size=1 << 20)
    kinds = {"timestamp": ("float32", (1,)), "episode_index": ("int64", (1,))}
    kinds |= {name: ("image" if "image" in name else "float32", shape) for name in columns}
    features = {name: {"dtype": dtype, "shape": size} for name, (dtype, size) in kinds.items()}
    paths = {"data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet", "chunks_size": 1000}
    info = {"codebase_version": "v2.1", "fps": 30, "features": features, **paths}
    (meta / "info.json").write_text(json.dumps(info))
    (meta / "episodes.jsonl").write_text(json.dumps({"episode_index": 0, "length": count}) + "\n")


def csv_cells(folder: Path) -> Written:
    """A table of as many cells as bytes allow, none of them a number."""
    width = 1000
    header = ",".join(f"c{k}" for k in range(width))
    row = ",".join("a" for _ in range(width))
    (folder / "x.csv").write_text(f"t,elbow,{header}\n" + "".join(f"{k},{k},{row}\n" for k in range(12_000)))
    return _ingest(folder, "x.csv")


def csv_commas(folder: Path) -> Written:
    """Rows of empty cells."""
    commas = "," * 9000
    (folder / "x.csv").write_text(f"t,elbow,{','.join(f'c{k}' for k in range(8999))}\n" + f"1{commas}\n" * 4000)
    return _ingest(folder, "x.csv")


def yaml_aliases(folder: Path) -> Written:
    """Lists of lists of one list, by names inside brackets."""
    lines = ["- {t: 0, elbow: 1, a0: &a0 [x,x,x,x,x,x,x,x,x]}"]
    lines += [f"- {{t: {k}, elbow: 1, a{k}: &a{k} [{','.join(9 * [f'*a{k - 1}'])}]}}" for k in range(1, 12)]
    (folder / "x.yaml").write_text("\n".join(lines))
    return _ingest(folder, "x.yaml")


def yaml_key(folder: Path) -> Written:
    """A mapping whose key is a mapping."""
    (folder / "x.yaml").write_text("- t: 0\n  elbow: 1\n  ? {a: [1, 2]}\n  : 3\n")
    return _ingest(folder, "x.yaml")


def yaml_large(folder: Path) -> Written:
    """Eight megabytes of brackets and commas."""
    (folder / "x.yaml").write_text("- t: 0\n  elbow: 1\n  x: [" + "[]," * (2_600_000) + "]\n")
    return _ingest(folder, "x.yaml")


def yaml_values(folder: Path) -> Written:
    """A megabyte of brackets and commas, which is as long as a file may be."""
    (folder / "x.yaml").write_text("- t: 0\n  elbow: 1\n  x: [" + "[]," * 330_000 + "]\n")
    return _ingest(folder, "x.yaml")


def csv_full(folder: Path) -> Written:
    """As many cells as may be read, of a byte each."""
    header = ",".join(f"j{k}" for k in range(100))
    row = ",".join("1" * 100)
    (folder / "x.csv").write_text(f"{header}\n" + f"{row}\n" * 79_000)
    return _ingest(folder, "x.csv")


def hdf5_full(folder: Path) -> Written:
    """As many numbers as may be read, none of them stored."""
    import h5py

    with h5py.File(folder / "x.h5", "w") as file:
        file.create_dataset("observations/qpos", shape=(1 << 16, 117), dtype="f8")
    return _ingest(folder, "x.h5")


def yaml_deep(folder: Path) -> Written:
    """A hundred thousand lists in one another."""
    (folder / "x.yaml").write_text("- t: 0\n  x: " + "[" * 100_000 + "]" * 100_000 + "\n")
    return _ingest(folder, "x.yaml")


def urdf_mimics(folder: Path) -> Written:
    """Ten thousand joints, each of which mimics the one before."""
    joints = [
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
        + (f'<mimic joint="j{k - 1}"/>' if k else "")
        + "</joint>"
        for k in range(10_000)
    ]
    return _urdf(folder, "".join(f'<link name="l{k}"/>' for k in range(10_001)) + "".join(joints))


def urdf_links(folder: Path) -> Written:
    """A hundred thousand links, the last one twice."""
    return _urdf(folder, "".join(f'<link name="l{min(k, 99_998)}"/>' for k in range(100_000)))


def urdf_chain(folder: Path) -> Written:
    """Ten thousand joints in a row, from the last one to the first."""
    joints = [
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/></joint>'
        for k in range(10_000)
    ]
    links = [f'<link name="l{k}"/>' for k in reversed(range(10_001))]
    return _urdf(folder, "".join(links) + "".join(joints))


def _urdf(folder: Path, inner: str) -> Written:
    (folder / "x.urdf").write_text(f'<robot name="r">{inner}</robot>')
    _joints(folder / "x.mcap", 30, lambda k: ["j0", "j1"])
    return ("fit", str(folder / "x.mcap"), "--urdf", str(folder / "x.urdf"), "-o", str(folder / "out.npz"))


def _joints(path: Path, count: int, names: Callable[[int], list[str]]) -> Path:
    kind, rows = "sensor_msgs/msg/JointState", []
    for k in range(count):
        t, named = T0 + k * STEP, names(k)
        rows.append((t, writing.joint_state(t, named, [0.01 * k] * len(named))))
    return writing.write(path, [writing.Stream("/joint_states", kind, writing.define(kind), rows)])


def joint_names(folder: Path) -> Written:
    """Two thousand messages that name ten joints each, none of them twice."""
    _joints(folder / "x.mcap", 2000, lambda k: [f"{k}_{n}" for n in range(10)])
    return ("fit", str(folder / "x.mcap"), "-o", str(folder / "out.npz"))


def image_link(folder: Path) -> Written:
    """A table whose image is a link to another file."""
    _table_of(folder, "a.png")
    (folder / "secret").write_bytes(SECRET)
    (folder / "set" / "a.png").symlink_to(folder / "secret")
    return _ingest(folder, "set")


def image_parent(folder: Path) -> Written:
    """A table of poses whose image stands outside its folder."""
    (folder / "in").mkdir()
    (folder / "secret.png").write_bytes(SECRET)
    (folder / "in" / "x.csv").write_text("elbow,image\n" + "".join(f"{k},../secret.png\n" for k in range(5)))
    return _ingest(folder, "in/x.csv")


def table_link(folder: Path) -> Written:
    """A folder whose folder of images is a link out of it."""
    _table_of(folder, "images/a.png")
    (folder / "out").mkdir()
    (folder / "out" / "a.png").write_bytes(SECRET)
    (folder / "set" / "images").symlink_to(folder / "out")
    return _ingest(folder, "set")


def _table_of(folder: Path, image: str) -> None:
    (folder / "set").mkdir()
    (folder / "set" / "cam.csv").write_text("t,file\n" + "".join(f"{k + 1},{image}\n" for k in range(5)))
    (folder / "set" / "joints.csv").write_text("t,elbow\n" + "".join(f"{k + 1},{0.1 * k}\n" for k in range(5)))


def _box(kind: bytes, *content: bytes) -> bytes:
    data = b"".join(content)
    return struct.pack(">I4s", 8 + len(data), kind) + data


def mp4(samples: int, size: int, width: int = 64, height: int = 48, data: bytes = b"\0" * 64) -> bytes:
    """An MP4 of one MJPEG track: `samples` samples of `size` bytes each, all of them declared and none listed."""
    matrix = struct.pack(">9I", 0x10000, 0, 0, 0, 0x10000, 0, 0, 0, 0x40000000)
    entry = (
        bytes(6) + struct.pack(">H", 1) + bytes(16) + struct.pack(">HHIIIH", width, height, 72 << 16, 72 << 16, 0, 1)
    )
    entry += bytes(32) + struct.pack(">Hh", 24, -1)
    place = _box(b"dinf", _box(b"dref", struct.pack(">II", 0, 1), _box(b"url ", struct.pack(">I", 1))))
    shown = struct.pack(">II", width << 16, height << 16)
    head = _box(b"ftyp", b"isom", bytes(4), b"isom")
    at = len(head) + 8
    tables = _box(
        b"stbl",
        _box(b"stsd", struct.pack(">II", 0, 1), _box(b"jpeg", entry)),
        _box(b"stts", struct.pack(">IIII", 0, 1, samples, 1)),
        _box(b"stsc", struct.pack(">IIIII", 0, 1, 1, samples, 1)),
        _box(b"stsz", struct.pack(">III", 0, size, samples)),
        _box(b"stco", struct.pack(">III", 0, 1, at)),
    )
    media = _box(
        b"mdia",
        _box(b"mdhd", struct.pack(">IIIIIHH", 0, 0, 0, 30, samples, 0, 0)),
        _box(b"hdlr", bytes(8), b"vide", bytes(13)),
        _box(b"minf", _box(b"vmhd", struct.pack(">IIH", 1, 0, 0) + bytes(2)), place, tables),
    )
    track = _box(b"tkhd", struct.pack(">IIIIII", 3, 0, 0, 1, 0, samples), bytes(16), matrix, shown)
    length = struct.pack(">IIIIII", 0, 0, 0, 30, samples, 0x10000)
    movie = _box(b"mvhd", length, bytes(10), matrix, bytes(24), struct.pack(">I", 2))
    return head + _box(b"mdat", data) + _box(b"moov", movie, _box(b"trak", track, media))


def mp4_samples(folder: Path) -> Written:
    """A video of sixteen million samples of one byte."""
    (folder / "x.mp4").write_bytes(mp4(1 << 24, 1))
    return _ingest(folder, "x.mp4")


def side_samples(folder: Path) -> Written:
    """The same beside a log."""
    (folder / "x.mp4").write_bytes(mp4(1 << 24, 1))
    _joints(folder / "x.mcap", 30, lambda k: ["a", "b"])
    (folder / "robot.toml").write_text('[topics]\ncamera = "x.mp4"\n')
    return ("fit", str(folder / "x.mcap"), "--config", str(folder / "robot.toml"), "-o", str(folder / "out.npz"))


def side_size(folder: Path) -> Written:
    """A video that declares 64 x 48 beside a log, and holds images of 12000 x 12000."""
    from .messages import large

    image = large(".jpg", 12_000)
    (folder / "x.mp4").write_bytes(mp4(30, len(image), data=image))
    _joints(folder / "x.mcap", 30, lambda k: ["a", "b"])
    (folder / "robot.toml").write_text('[topics]\ncamera = "x.mp4"\n')
    return ("fit", str(folder / "x.mcap"), "--config", str(folder / "robot.toml"), "-o", str(folder / "out.npz"))


def video_size(folder: Path) -> Written:
    """The same as a log of its own."""
    side_size(folder)
    return _ingest(folder, "x.mp4")


def side_frame(folder: Path) -> Written:
    """A video of 64 x 48 beside a log, with images of 16000 x 15000 in its midst: 0.7 GB each."""
    from fractions import Fraction

    import av

    from .messages import large

    small = cv2.imencode(".jpg", np.zeros((48, 64, 3), np.uint8))[1].tobytes()
    huge = large(".jpg", 16_000)
    with av.open(str(folder / "x.avi"), "w") as container:
        stream = container.add_stream("mjpeg", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuvj420p"
        for number in range(30):
            packet = av.Packet(huge if 10 <= number < 16 else small)
            packet.stream, packet.time_base = stream, Fraction(1, 30)
            packet.pts = packet.dts = number
            container.mux(packet)
    _joints(folder / "x.mcap", 30, lambda k: ["a", "b"])
    (folder / "robot.toml").write_text('[topics]\ncamera = "x.avi"\n')
    asked = ("--config", str(folder / "robot.toml"), "-o", str(folder / "out.mcap"))
    return ("ingest", str(folder / "x.mcap"), *asked)


def video_frame(folder: Path) -> Written:
    """The same as a log of its own."""
    side_frame(folder)
    return ("doctor", str(folder / "x.avi"))


BOMBS = {
    "hdf5 cycle": Bomb(hdf5_cycle, 0),
    "hdf5 chain": Bomb(hdf5_chain, 0),
    "hdf5 external link": Bomb(hdf5_external, 65, "data/demo_0 is a link out of this file"),
    "hdf5 sum of datasets": Bomb(hdf5_sum, 65, "max_table_mb = 537"),
    "hdf5 giant chunk": Bomb(hdf5_chunk, 3, "timestamps: chunks of 2147483648 bytes"),
    "hdf5 endless stream": Bomb(hdf5_stream, 3, "/timestamps: a chunk of 2097152 bytes unpacks to more"),
    "hdf5 references": Bomb(hdf5_references, 0),
    "hdf5 one heap": Bomb(hdf5_heap, 65, "max_unpacked_gb"),
    "parquet dictionary": Bomb(parquet_dictionary, 65, "max_table_mb"),
    "parquet padding": Bomb(parquet_padding, 65, "max_table_mb"),
    "parquet lists": Bomb(parquet_lists, 65, "max_table_mb"),
    "parquet images": Bomb(parquet_images, 65, "max_unpacked_gb"),
    "info.json shape": Bomb(info_shape, 0, "info.json declares 5 numbers"),
    "csv cells": Bomb(csv_cells, 65, "max_table_mb"),
    "csv commas": Bomb(csv_commas, 65, "max_table_mb"),
    "yaml aliases": Bomb(yaml_aliases, 65, "it has aliases (*name)"),
    "yaml key": Bomb(yaml_key, 65, "a key is a list or a mapping"),
    "yaml large": Bomb(yaml_large, 65, "max_yaml_mb = 8"),
    "yaml values": Bomb(yaml_values, 65, "it has more than 100000 values"),
    "csv full": Bomb(csv_full, 0),
    "hdf5 full": Bomb(hdf5_full, 0),
    "yaml deep": Bomb(yaml_deep, 65, "64 deep"),
    "urdf mimics": Bomb(urdf_mimics, 65, "max_joints = 10000"),
    "urdf links": Bomb(urdf_links, 65, "link 'l99998' is declared twice"),
    "urdf chain": Bomb(urdf_chain, 65, "max_joints = 10000"),
    "joint names": Bomb(joint_names, 65, "its messages name 20000 joints"),
    "image link": Bomb(image_link, 3, "5 of 5 images cannot be read"),
    "image outside": Bomb(image_parent, 3, "only those in the table's folder are"),
    "folder link": Bomb(table_link, 3, "5 of 5 images cannot be read"),
    "mp4 samples": Bomb(mp4_samples, 65, "its tables declare 16777216 samples"),
    "side video samples": Bomb(side_samples, 65, "its tables declare 16777216 samples"),
    "side video size": Bomb(side_size, 65, "images of 12000 x 12000; set [input] max_image_mpx"),
    "video size": Bomb(video_size, 65, "max_image_mpx"),
    "side video frame": Bomb(side_frame, 3, "x.avi: 6 images cannot be read and are left out"),
    "video frame": Bomb(video_frame, 3, "6 of 30 images cannot be read"),
}
"""Every bomb, and what becomes of the command that reads it."""
