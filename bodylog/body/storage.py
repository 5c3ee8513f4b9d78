"""BodyModel <-> .npz: plain arrays and one JSON header,
never pickle; the same model gives the same bytes.
"""

import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np

from ..body_model import BodyModel, ForwardModel, Surface
from ..errors import ModelError
from ..io.atomic_files import replace_atomically
from ..io.text_paths import with_text_paths
from ..types import Array
from . import header
from . import surface as surface_fields
from .gp.axis_gp import AxisGP
from .gp.model import GP
from .kinematic import axis_storage, storage
from .kinematic.model import KinematicGP
from .senses.encoder_function import Polynomial

_HEADER = "header.npy"
_EPOCH = (1980, 1, 1, 0, 0, 0)

# n centres, r rank, s samples, d outputs, g kernels, m joints
_LEARNED = {
    "centres": "nm",
    "scales": "gm",
    "amplitude": "g",
    "mean": "d",
    "weights": "dn",
    "factor": "grn",
    "noise": "d",
    "samples": "sm",
    "targets": "sd",
    "spread": "sd",
}
# of a polynomial: d = m encoders, k coefficients each
_SHAPES: dict[str, dict[str, str]] = {
    "gp": _LEARNED,
    "polynomial": {"coefficients": "mk"},
    "kinematic": _LEARNED | storage.SHAPES,
    "axes": _LEARNED | axis_storage.SHAPES,
}
_SIZES = {digit: int(digit) for digit in "12346"}
_POSITIVE = ("scales", "amplitude", "doubt")
_NOT_NEGATIVE = ("noise", "spread", "drift")


def save(model: BodyModel, path: Path) -> None:
    """Write the model to `path` (.npz, whole or not at all).

    ModelError for an unknown kind of sense, or a header that `load_body` would refuse.
    """
    arrays: dict[str, Array] = {}
    for name, sense in model.senses.items():
        if type(sense) not in header.KINDS:
            possible = ", ".join(kind.__name__ for kind in header.KINDS)
            raise ModelError(
                f"{path}: sense {name!r}: a {type(sense).__name__} cannot be saved; "
                f"possible: {possible}"
            )
        own = _arrays_of_mean(sense)
        fields = (*_LEARNED, *own) if own else tuple(_SHAPES[header.KINDS[type(sense)]])
        values = {field: own[field] if field in own else getattr(sense, field) for field in fields}
        arrays |= {
            f"{name}/{field}.npy": np.asarray(value, np.float64) for field, value in values.items()
        }
    if model.surface is not None:
        arrays |= surface_fields.surface_arrays(model.surface)
    text = json.dumps(header.compose_header(model), sort_keys=True)
    header.read_header(path, text)
    arrays[_HEADER] = np.array(text)
    with (
        replace_atomically(path) as beside,
        zipfile.ZipFile(beside, "w", zipfile.ZIP_STORED) as archive,
    ):
        for name in sorted(arrays):
            with archive.open(zipfile.ZipInfo(name, _EPOCH), "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, arrays[name], version=(1, 0), allow_pickle=False)


def _arrays_of_mean(sense: ForwardModel) -> dict[str, Array]:
    """The arrays of a mean beside those of a Gaussian process on its residuals."""
    if isinstance(sense, KinematicGP):
        return storage.kinematic_arrays(sense)
    return axis_storage.axis_arrays(sense) if isinstance(sense, AxisGP) else {}


@with_text_paths
def load_body(path: Path) -> BodyModel:
    """Read a model; ModelError, naming the field,
    for a wrong, truncated, newer or non-finite file.
    """
    if not path.is_file():
        raise ModelError(f"{path}: there is no such body model; type: bodylog fit LOG -o {path}")
    try:
        with zipfile.ZipFile(path) as archive:
            return _read_archive(path, archive)
    except (zipfile.BadZipFile, EOFError, NotImplementedError, RuntimeError, OSError) as error:
        if getattr(error, "filename", None) is not None:  # the file could not be opened
            raise
        raise ModelError(
            f"{path}: not a whole .npz file ({error}); type: bodylog fit LOG -o body.npz"
        ) from error


def _read_archive(path: Path, archive: zipfile.ZipFile) -> BodyModel:
    found = header.read_header(path, str(_read_member_array(path, archive, _HEADER, "U")))
    learned = {
        name: _read_sense(path, archive, name, *about, found.joints, found.links.get(name))
        for name, about in found.senses.items()
    }
    surface = None if found.surface is None else _read_surface(path, archive, found.surface)
    return BodyModel(
        found.joints, learned, found.noise, found.touch, found.provenance, found.cells, surface
    )


def _read_surface(path: Path, archive: zipfile.ZipFile, about: Mapping[str, Any]) -> Surface:
    cameras = []
    for number in range(len(about["cameras"])):
        sizes = dict(_SIZES)
        own = dict[str, Array]()
        shapes = surface_fields.shapes_of(about["cameras"][number])
        for field, letters in shapes.items():
            where = f"surface.{number}/{field}"
            own[field] = _checked_array(path, archive, where, letters, sizes, -header.LARGEST)
        cameras.append(own)
    try:
        return surface_fields.build_surface(about, cameras)
    except ValueError as error:
        raise ModelError(f"{path}: field {error}; fit the body again") from error


def _checked_array(
    path: Path,
    archive: zipfile.ZipFile,
    name: str,
    letters: str,
    sizes: dict[str, int],
    least: float,
) -> Array:
    """An array of the shape that letters name, with finite
    numbers from `least` on; new letters get their sizes.
    """
    kind = "u" if name.endswith("/patches") else "f"
    value = _read_member_array(path, archive, f"{name}.npy", kind)
    found = dict(zip(letters, value.shape, strict=False))
    expected = tuple(sizes.setdefault(letter, found.get(letter, 0)) for letter in letters)
    if value.shape != expected or 0 in expected:
        raise ModelError(f"{path}: field {name}: found shape {value.shape}, possible: {expected}")
    bad = value[~((value >= least) & (value <= header.LARGEST))]
    if len(bad):
        wanted = f"numbers from {least:g} to {header.LARGEST:g}"
        raise ModelError(f"{path}: field {name}: found {bad[0]}, possible: {wanted}")
    return value


def _read_sense(
    path: Path,
    archive: zipfile.ZipFile,
    name: str,
    kind: str,
    outputs: tuple[str, ...],
    unit: str,
    joints: tuple[str, ...],
    links: Mapping[str, str] | None,
) -> GP | Polynomial:
    sizes = {"d": len(outputs), "m": len(joints), **_SIZES}
    arrays: dict[str, Array] = {}
    for field, letters in _shapes_of_sense(kind, outputs, links).items():
        least = (
            header.LEAST
            if field in _POSITIVE
            else 0.0
            if field in _NOT_NEGATIVE
            else -header.LARGEST
        )
        arrays[field] = _checked_array(path, archive, f"{name}/{field}", letters, sizes, least)
    if kind != "polynomial":
        plain = GP(outputs, unit, **{field: arrays[field] for field in _LEARNED})
        try:
            if kind == "axes":
                return axis_storage.build_axis_gp(plain, arrays)
            if links is None:
                return plain
            return storage.build_kinematic_gp(plain, joints, arrays, links)
        except ValueError as error:
            raise ModelError(f"{path}: field {name}/{error}; fit the body again") from error
    if len(outputs) != len(joints):
        raise ModelError(
            f"{path}: field senses.{name}.outputs: found {len(outputs)}, possible: one for "
            "each joint"
        )
    return Polynomial(outputs, unit=unit, **arrays)


def _shapes_of_sense(
    kind: str, outputs: tuple[str, ...], links: Mapping[str, str] | None
) -> dict[str, str]:
    """The arrays of a sense and their shapes."""
    if links is not None:
        return _LEARNED | storage.kinematic_shapes(links, outputs)
    return _LEARNED | axis_storage.axis_shapes(outputs) if kind == "axes" else _SHAPES[kind]


def _read_member_array(path: Path, archive: zipfile.ZipFile, member: str, kind: str) -> Array:
    """Read one array of dtype kind "f" (float64), "u" (uint8)
    or "U"; its declared size must match the archive's.
    """
    try:
        info = archive.getinfo(member)
    except KeyError as error:
        raise ModelError(f"{path}: field {member[:-4]}: missing; fit the body again") from error
    if info.compress_type != zipfile.ZIP_STORED or info.file_size > path.stat().st_size:
        raise ModelError(
            f"{path}: field {member[:-4]}: {info.file_size} bytes do not fit the file; fit it again"
        )
    with archive.open(info) as stream:
        try:
            shape, _, dtype = _READERS[np.lib.format.read_magic(stream)](stream)
        except (ValueError, KeyError, SyntaxError, TokenError) as error:
            raise ModelError(
                f"{path}: field {member[:-4]}: not an array; fit the body again"
            ) from error
        size = info.file_size - stream.tell()
        whole = all(type(n) is int and 0 <= n <= info.file_size for n in shape)
        expected = {"f": np.dtype("<f8"), "u": np.dtype("u1")}
        sound = whole and (dtype.kind == "U" if kind == "U" else dtype == expected[kind])
        if not sound or size != int(np.prod(shape, dtype=object)) * dtype.itemsize:
            raise ModelError(
                f"{path}: field {member[:-4]}: found {dtype} {shape} in {size} bytes; fit "
                "the body again"
            )
    with archive.open(info) as stream:
        return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))


_READERS: Any = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}
