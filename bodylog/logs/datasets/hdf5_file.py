"""Open HDF5 files with episodes, find one episode's datasets, and unpack their chunks."""

import math
import re
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FormatError, LogError
from ...io.extras import require_module
from ...io.values import read_json
from ..limits import LIMITS, Input
from ..records import Array, Finding

MAGIC = b"\x89HDF\r\n\x1a\n"
_DEEPEST = 6
_MOST_DEMOS = 1_000_000
_LINKS_A_SET = 10
"""Links that are looked at for each dataset that an episode may have."""
_DEMO = re.compile(r"demo_(\d{1,9})$")
_PIECE = 4 << 20
"""Bytes of rows that are read at once, or of one chunk if that is more."""
_MOST_AT_ONCE = 64 << 20
"""Bytes of rows that are read at once where a chunk
spans more rows: such a chunk is unpacked more than once.
"""
_MOST_CHUNKS = 1 << 18
"""Chunks of a dataset: HDF5 looks for 10 000 a second, stored or not."""
_CHUNKS_AT_ONCE = 1024
"""HDF5 keeps some hundred bytes for each chunk of a request, whether it is stored or not."""
_MOST_EXPANSION = 1032
"""Bytes of which deflate makes one: 258 bytes from two bits."""
_OVERHEAD = 1 << 16
"""Bytes that a filter may add to a chunk that it cannot compress."""
_DEFLATE = 1
_COMPRESSING: Mapping[int, str] = {_DEFLATE: "gzip", 4: "szip", 32000: "lzf"}
_REARRANGING: Mapping[int, str] = {2: "shuffle", 3: "fletcher32"}


@dataclass(frozen=True, eq=False)
class Sets:
    """The datasets of one group by their path in it, and the rate if the file declares it (Hz)."""

    group: str
    sets: Mapping[str, Any]
    rate: float | None
    format: str


def demonstration_numbers(file: Path) -> tuple[int, ...]:
    """The numbers of a file's demonstrations; empty if it holds a single episode."""
    with open_hdf5_file(file) as one:
        return _demonstration_groups(one)


@contextmanager
def open_hdf5_file(path: Path) -> Iterator[Any]:
    """Open an HDF5 file; FormatError when it is damaged or becomes unreadable."""
    h5py = require_module("h5py", path)
    try:
        with h5py.File(path, "r") as file:
            yield file
    except (OSError, RuntimeError, KeyError, ValueError) as problem:
        text = " ".join(str(problem).split())[:160]
        raise FormatError(f"{path}: the HDF5 file cannot be read: {text}") from None


def _demonstration_groups(file: Any) -> tuple[int, ...]:
    data = _unlinked_member(file, "data")
    names = (
        _limited_member_names(data, _MOST_DEMOS)
        if data is not None and hasattr(data, "keys")
        else []
    )
    return tuple(sorted(int(match[1]) for name in names if (match := _DEMO.fullmatch(name))))


def sets_of(
    file: Any, path: Path, number: int | None, findings: list[Finding], limits: Input = LIMITS
) -> Sets:
    """The datasets of the episode; LogError if that episode,
    or any, is missing, or it has too many datasets.
    """
    demos = _demonstration_groups(file)
    if not demos:
        if number:
            raise LogError(f"{path}: no episode {number}; the file holds one, number 0")
        rate = _sampling_rate(read_attribute(file, "fps")) or _sampling_rate(
            read_attribute(file, "hz")
        )
        return Sets("", _walk_datasets(file, limits), rate, "hdf5")
    asked = number
    number = demos[0] if number is None else number
    if number not in demos:
        some = ", ".join(map(str, demos[:12]))
        raise LogError(
            f"{path}: no episode {number}; possible: {some}{' …' if len(demos) > 12 else ''}"
        )
    if asked is None and len(demos) > 1:
        some = (
            f"episode {number}, the first of {len(demos)}; for another, type: --episode {demos[1]}"
        )
        findings.append(Finding("info", some))
    group = f"data/demo_{number}"
    demo = _unlinked_member(file["data"], f"demo_{number}")
    if demo is None or not hasattr(demo, "keys"):
        raise LogError(
            f"{path}: {group} is a link out of this file, or no group; give the file that holds it"
        )
    return Sets(group, _walk_datasets(demo, limits), _control_rate(file["data"]), "robomimic")


def _walk_datasets(top: Any, limits: Input) -> dict[str, Any]:
    """The datasets below a group that are in the file
    itself, each once: no links, no external data.

    Names of the file's own objects (hard links) may
    lead in a circle, or to one object in many ways.
    """
    found: dict[str, Any] = {}
    seen = {_object_identity(top)}
    left = [(top, "", 0)]
    budget = _LINKS_A_SET * limits.max_datasets
    while left:
        group, before, depth = left.pop()
        for name in _limited_member_names(group, budget + 1):
            budget -= 1
            one = _unlinked_member(group, name)
            if one is None or _object_identity(one) in seen:
                continue
            seen.add(_object_identity(one))
            if hasattr(one, "keys"):
                left += [(one, f"{before}{name}/", depth + 1)] if depth < _DEEPEST else []
            elif _is_own(one):
                found[f"{before}{name}"] = one
        if budget < 0 or len(found) > limits.max_datasets:
            asked = f"type in robot.toml: [input] max_datasets = {10 * limits.max_datasets}"
            raise LogError(
                f"{top.file.filename}: more than {limits.max_datasets} datasets in one "
                f"episode; {asked}"
            )
    return dict(sorted(found.items(), key=lambda one: one[0].split("/")))


def _limited_member_names(group: Any, most: int) -> list[str]:
    """The names in a group, `most` at most."""
    found: list[str] = []

    def keep(name: bytes) -> bool | None:
        found.append(name.decode("utf-8", "surrogateescape"))
        return True if len(found) >= most else None

    group.id.links.iterate(keep)
    return found


def _object_identity(one: Any) -> tuple[int, int]:
    """What identifies an object of a file, whatever it is called there."""
    about = require_module("h5py", Path(one.file.filename)).h5o.get_info(one.id)
    return int(about.fileno), int(about.addr)


def _is_own(one: Any) -> bool:
    """Whether this is a dataset of a NumPy type with its data in the file."""
    try:
        return (
            one.dtype is not None
            and one.shape is not None
            and not one.is_virtual
            and not one.external
        )
    except (AttributeError, TypeError):
        return False


def read_attribute(one: Any, name: str) -> Any:
    """An attribute, or None if NumPy does not know its type."""
    try:
        return one.attrs.get(name)
    except (TypeError, OSError, RuntimeError, ValueError):
        return None


def is_bytes_list(one: Any) -> bool:
    """Whether each row is a list of bytes, of a length of
    its own: not a text, and no reference to an object.
    """
    h5py = require_module("h5py", Path(one.file.filename))
    return bool(one.dtype == object and h5py.check_vlen_dtype(one.dtype) == np.uint8)


def _unlinked_member(group: Any, name: str) -> Any:
    """The object of that name, unless it is missing or a
    link, which may lead out of the file: none is followed.
    """
    h5py = require_module("h5py", Path(group.file.filename))
    links = group.id.links
    raw = name.encode("utf-8", "surrogateescape")
    if not links.exists(raw) or links.get_info(raw).type != h5py.h5l.TYPE_HARD:
        return None
    return group[raw]


def _sampling_rate(value: Any) -> float | None:
    try:
        found = float(value)
    except (TypeError, ValueError):
        return None
    return found if 0 < found < 1e6 else None


def _control_rate(data: Any) -> float | None:
    """The control frequency of robomimic's env_args."""
    stored = read_attribute(data, "env_args")
    try:
        args = read_json(stored) if isinstance(stored, str | bytes) else {}
        return _sampling_rate(args["env_kwargs"]["control_freq"])
    except (ValueError, KeyError, TypeError):
        return None


def explain_refused_dataset(one: Any, limits: Input) -> str | None:
    """Why a dataset may not be read: its chunks, its
    filters, or what is stored of them; None if it may.
    """
    if one.chunks is None:
        return None
    size = chunk_bytes(one)
    if size > limits.max_message_mb * 1e6:
        asked = f"type in robot.toml: [input] max_message_mb = {math.ceil(size / 1e6)}"
        return f"chunks of {size} bytes; to read them, {asked}"
    if (
        chunks := math.prod(math.ceil(a / b) for a, b in zip(one.shape, one.chunks, strict=True))
    ) > _MOST_CHUNKS:
        return f"{chunks} chunks; at most {_MOST_CHUNKS} are read"
    return _refused_filters(one) or _refused_storage(one, size)


def chunk_bytes(one: Any) -> int:
    """Bytes that HDF5 unpacks at once; 0 for a dataset without chunks."""
    values: int = math.prod(one.chunks) if one.chunks else 0
    return values * int(one.id.get_type().get_size())


def read_float_rows(one: Any, limits: Input = LIMITS) -> Array:
    """All rows as float64 (N,K), block by block; FormatError
    where a chunk unpacks to more than it declares.
    """
    values = np.empty((one.shape[0], math.prod(one.shape[1:])))
    for first, rows in row_blocks(one, one.shape[0], limits):
        values[first : first + len(rows)] = rows.reshape(len(rows), -1)
    return values


def row_blocks(
    one: Any, count: int, limits: Input = LIMITS, start: int = 0
) -> Iterator[tuple[int, Array]]:
    """Rows from `start` to before `count`: (number of the
    first, rows), some megabytes or a chunk at a time.

    FormatError where a chunk unpacks to more than it declares.
    """
    step = rows_at_once(one)
    large = _large_chunks(one, limits)
    for first in range(start, count, step):
        end = min(first + step, count)
        for offset in large:
            if first <= offset[0] < end:
                _check_stream(one, offset)
        yield first, one[first:end]


def rows_at_once(one: Any) -> int:
    """Rows that are read in one request: whole chunks, where that is not too much."""
    width = math.prod(one.shape[1:]) * one.dtype.itemsize
    rows = int(max(1, _PIECE // max(width, 1)))
    if not one.chunks:
        return rows
    across = math.prod(math.ceil(a / b) for a, b in zip(one.shape[1:], one.chunks[1:], strict=True))
    chunks = min(rows // one.chunks[0], _CHUNKS_AT_ONCE // max(across, 1))
    most = max(1, _MOST_AT_ONCE // max(width, 1))
    return int(min(one.chunks[0] * max(chunks, 1), most))


def _dataset_filter_codes(one: Any) -> list[int]:
    """The codes of a dataset's filters, in the order of writing."""
    plist = one.id.get_create_plist()
    return [int(plist.get_filter(number)[0]) for number in range(plist.get_nfilters())]


def _refused_filters(one: Any) -> str | None:
    """Why its filters are refused: two that compress would expand a million times."""
    codes = _dataset_filter_codes(one)
    known = {**_COMPRESSING, **_REARRANGING}
    if strange := [code for code in codes if code not in known]:
        return f"packed by HDF5's filter {strange[0]}; possible: {', '.join(known.values())}"
    if sum(code in _COMPRESSING for code in codes) > 1:
        return f"packed twice, by {' and '.join(known[code] for code in codes)}"
    return None


def _refused_storage(one: Any, size: int) -> str | None:
    """Why what is stored is refused: more bytes than a chunk of `size` bytes can take."""
    longest = 0

    def examine(about: Any) -> None:
        nonlocal longest
        longest = max(longest, about.size)

    if set(_dataset_filter_codes(one)) & set(_COMPRESSING):
        one.id.chunk_iter(examine)
    return (
        f"{longest} bytes are stored of a chunk of {size}"
        if longest > size + size // 8 + _OVERHEAD
        else None
    )


def _large_chunks(one: Any, limits: Input) -> list[tuple[int, ...]]:
    """The places of chunks that may unpack to more than
    a message may: HDF5 unpacks a stream to its end.
    """
    found: list[tuple[int, ...]] = []

    def examine(about: Any) -> None:
        if about.size * _MOST_EXPANSION > limits.max_message_mb * 1e6:
            found.append(about.chunk_offset)

    if one.chunks and _DEFLATE in _dataset_filter_codes(one):
        one.id.chunk_iter(examine)
    return found


def _check_stream(one: Any, offset: tuple[int, ...]) -> None:
    """FormatError if a chunk's stream does not end within it; it is unpacked piece by piece."""
    size = chunk_bytes(one)
    found = 0
    unpacker = zlib.decompressobj()
    packed = one.id.read_direct_chunk(offset)[1]
    while packed and not unpacker.eof and found <= size:
        try:
            found += len(unpacker.decompress(packed, _PIECE))
        except zlib.error:
            return  # HDF5 refuses it too
        packed = unpacker.unconsumed_tail
    if found > size:
        raise FormatError(f"{one.name}: a chunk of {size} bytes unpacks to more")
