"""BodyModel <-> .npz: plain arrays and one JSON header, never pickle; the same model gives the same bytes."""

import json
import zipfile
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np

from ..body_model import BodyModel, Noise, TouchConstants
from ..errors import ModelError
from ..io.atomic_files import replacing
from ..io.values import read_json, text
from ..types import Array
from .gp.model import GP
from .kinematic import storage
from .kinematic.model import KinematicGP
from .senses.encoder_function import Polynomial

VERSION = 1
_KIND = "bodylog body model"
_WIDEST = 1 << 20
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
}
_KINDS: dict[type, str] = {GP: "gp", Polynomial: "polynomial", KinematicGP: "kinematic"}
_WITH = "kinematic"
_SIZES = {digit: int(digit) for digit in "1346"}
_UNITS = {
    "joints": "rad",
    "encoder": "rad^2",
    "process": "rad^2/s^3",
    "b1": "1/px^2",
    "cells": "px",
}
_UNUSED = {"b2": "1/s^2"}
"""Older bodies have it, with a2 and b2 among their touch constants, which nothing used."""
_POSITIVE, _NOT_NEGATIVE = ("scales", "amplitude", "doubt"), ("noise", "spread", "drift")
_LEAST, _LARGEST = 1e-30, 1e30
"""Bounds of positive numbers and of any number: products of four of these are finite and not 0."""


def save(model: BodyModel, path: Path) -> None:
    """Write the model to `path` (.npz, whole or not at all); ModelError for an unknown kind of sense."""
    arrays: dict[str, Array] = {}
    for name, sense in model.senses.items():
        if type(sense) not in _KINDS:
            possible = ", ".join(kind.__name__ for kind in _KINDS)
            raise ModelError(f"{path}: sense {name!r}: a {type(sense).__name__} cannot be saved; possible: {possible}")
        own = storage.arrays(sense) if isinstance(sense, KinematicGP) else {}
        fields = (*_SHAPES[_KINDS[type(sense)]], *(field for field in own if field in storage.BASE))
        values = {field: own[field] if field in own else getattr(sense, field) for field in fields}
        arrays |= {f"{name}/{field}.npy": np.asarray(value, np.float64) for field, value in values.items()}
    arrays[_HEADER] = np.array(json.dumps(_header(model), sort_keys=True))
    with replacing(path) as beside, zipfile.ZipFile(beside, "w", zipfile.ZIP_STORED) as archive:
        for name in sorted(arrays):
            with archive.open(zipfile.ZipInfo(name, _EPOCH), "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, arrays[name], version=(1, 0), allow_pickle=False)


def load(path: Path) -> BodyModel:
    """Read a model; ModelError, naming the field, for a wrong, truncated, newer or non-finite file."""
    if not path.is_file():
        raise ModelError(f"{path}: there is no such body model; type: bodylog fit LOG -o {path}")
    try:
        with zipfile.ZipFile(path) as archive:
            return _read(path, archive)
    except (zipfile.BadZipFile, EOFError, NotImplementedError, RuntimeError, OSError) as error:
        if getattr(error, "filename", None) is not None:  # the file could not be opened
            raise
        raise ModelError(f"{path}: not a whole .npz file ({error}); type: bodylog fit LOG -o body.npz") from error


def _header(model: BodyModel) -> dict[str, Any]:
    senses = {
        name: {"kind": _KINDS[type(sense)], "outputs": sense.outputs, "unit": getattr(sense, "unit", "")}
        | ({"kinematics": storage.names(sense)} if isinstance(sense, KinematicGP) else {})
        for name, sense in model.senses.items()
    }
    return {
        "kind": _KIND,
        "version": VERSION,
        "joints": model.joints,
        "units": _UNITS,
        "senses": senses,
        "noise": asdict(model.noise),
        "touch": asdict(model.touch),
        "cells": {str(cell): place for cell, place in model.cells.items()},
        "provenance": dict(model.provenance),
    }


def _read(path: Path, archive: zipfile.ZipFile) -> BodyModel:
    header = _parse(path, archive)
    try:
        joints = _joints(header["joints"])
        noise, touch = _noise(header["noise"]), _touch(header["touch"])
        cells = {int(cell): _floats(f"cells.{cell}", place) for cell, place in header.get("cells", {}).items()}
        senses = {text(n): _about(n, sense) for n, sense in header["senses"].items()}
        linked = {text(n): s for n, s in header["senses"].items() if s.get("kind") == _WITH}
        links = {name: storage.checked(said.get("kinematics")) for name, said in linked.items()}
        provenance = _provenance(header["provenance"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ModelError(f"{path}: field header: {error}; fit the body again") from error
    _check_noise(path, joints, {name: len(about[1]) for name, about in senses.items()}, noise, touch)
    bad = {cell: place for cell, place in cells.items() if cell < 0 or len(place) != 3 or place[2] <= 0.0}
    if bad:
        raise ModelError(f"{path}: field cells: found {bad}, possible: cell from 0 on, u, v and a positive spread, px")
    learned = {name: _sense(path, archive, name, *about, joints, links.get(name)) for name, about in senses.items()}
    places = {cell: (u, v, spread) for cell, (u, v, spread) in cells.items()}
    return BodyModel(joints, learned, noise, touch, provenance, places)


def _touch(told: Mapping[str, Any]) -> TouchConstants:
    """Touch constants without those of `_UNUSED`."""
    return TouchConstants(**{name: value for name, value in told.items() if name not in ("a2", "b2")})


def _about(name: str, sense: Mapping[str, Any]) -> tuple[str, tuple[str, ...], str]:
    """Kind, outputs and unit of a sense."""
    return _kind(sense), _texts(f"senses.{name}.outputs", sense["outputs"]), text(str(sense["unit"]))


def _kind(sense: Mapping[str, Any]) -> str:
    kind = str(sense.get("kind", "gp"))
    if kind not in _SHAPES:
        raise ValueError(f"sense of kind {kind!r}, possible: {', '.join(_SHAPES)}")
    return kind


def _parse(path: Path, archive: zipfile.ZipFile) -> Mapping[str, Any]:
    said = _array(path, archive, _HEADER, "U")
    try:
        header = read_json(str(said))
    except ValueError as error:
        raise ModelError(f"{path}: field header: {error}; fit the body again") from error
    if not isinstance(header, dict) or header.get("kind") != _KIND:
        raise ModelError(f"{path}: field kind: not a {_KIND}; type: bodylog fit LOG -o {path}")
    if header.get("version") != VERSION:
        raise ModelError(f"{path}: field version: found {header.get('version')!r}, possible: {VERSION}; fit it again")
    units = header.get("units", _UNITS)
    if units not in (_UNITS, _UNITS | _UNUSED):
        raise ModelError(f"{path}: field units: found {str(units)[:200]}, possible: {json.dumps(_UNITS)}; fit it again")
    return header


def _joints(found: Any) -> tuple[str, ...]:
    names = _texts("joints", found)
    twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if twice is not None or not names:
        raise ValueError(f"joints: found {twice or found!r}, possible: a list that names each joint once")
    return names


def _texts(field: str, found: Any) -> tuple[str, ...]:
    if not isinstance(found, list) or not all(isinstance(name, str) for name in found):
        raise ValueError(f"{field}: found {str(found)[:200]}, possible: a list of texts")
    return tuple(text(name) for name in found)


def _provenance(found: Any) -> dict[str, Any]:
    provenance = dict(found)
    if "cameras" in provenance:
        provenance["cameras"] = list(_texts("provenance.cameras", provenance["cameras"]))
    if "pose_std" in provenance:
        std = _floats("provenance.pose_std", provenance["pose_std"])
        if any(value < 0.0 for value in std):
            raise ValueError(f"provenance.pose_std: found {min(std)!r}, possible: 0 rad and more")
        provenance["pose_std"] = list(std)
    width = provenance.get("image_width", 1)
    if isinstance(width, bool) or not isinstance(width, int | float) or not 1 <= width <= _WIDEST:
        raise ValueError(f"provenance.image_width: found {width!r}, possible: 1 to {_WIDEST} px")
    return provenance


def _noise(found: Mapping[str, Any]) -> Noise:
    parts = ("senses", "std_error")
    senses, errors = ({n: _floats(f"noise.{part}.{n}", v) for n, v in found[part].items()} for part in parts)
    return Noise(
        _floats("noise.encoder", found["encoder"]), senses, _floats("noise.process", found["process"]), errors
    )


def _floats(field: str, values: Any) -> tuple[float, ...]:
    if not isinstance(values, list) or not all(_is_number(v) for v in values):
        raise ValueError(f"{field}: found {str(values)[:200]}, possible: a list of finite numbers")
    return tuple(float(v) for v in values)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _LARGEST


def _check_noise(
    path: Path,
    joints: tuple[str, ...],
    senses: Mapping[str, int],
    noise: Noise,
    touch: TouchConstants,
) -> None:
    expected = {"encoder": (noise.encoder, len(joints)), "process": (noise.process, len(joints))}
    for name, count in senses.items():
        if name != "encoders":
            expected[f"senses.{name}"] = (noise.senses.get(name, ()), count)
    for field, (values, count) in expected.items():
        if len(values) != count or not all(v >= _LEAST for v in values):
            raise ModelError(f"{path}: field noise.{field}: found {values}, possible: {count} positive variances")
    counts = {"encoder": len(joints), "process": len(joints), **senses}
    for name, errors in noise.std_error.items():
        if name not in counts or len(errors) != counts[name] or min(errors, default=0.0) < 0.0:
            wanted = f"{counts[name]} numbers of at least 0" if name in counts else f"one of {', '.join(counts)}"
            raise ModelError(f"{path}: field noise.std_error.{name}: found {errors}, possible: {wanted}")
    bad = {k: v for k, v in asdict(touch).items() if not _is_number(v) or v < 0}
    if bad:
        raise ModelError(f"{path}: field touch: found {bad}, possible: finite numbers of at least 0")


def _sense(
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
    for field, letters in (_SHAPES[kind] if links is None else _LEARNED | storage.shapes(links)).items():
        value = _array(path, archive, f"{name}/{field}.npy", "f")
        found = dict(zip(letters, value.shape, strict=False))
        expected = tuple(sizes.setdefault(letter, found.get(letter, 0)) for letter in letters)
        if value.shape != expected or 0 in expected:
            raise ModelError(f"{path}: field {name}/{field}: found shape {value.shape}, possible: {expected}")
        least = _LEAST if field in _POSITIVE else 0.0 if field in _NOT_NEGATIVE else -_LARGEST
        bad = value[~((value >= least) & (value <= _LARGEST))]
        if len(bad):
            wanted = f"numbers from {least:g} to {_LARGEST:g}"
            raise ModelError(f"{path}: field {name}/{field}: found {bad[0]}, possible: {wanted}")
        arrays[field] = value
    if kind in ("gp", _WITH):
        plain = GP(outputs, unit, **{field: arrays[field] for field in _LEARNED})
        if links is None:
            return plain
        try:
            return storage.build(plain, joints, arrays, links)
        except ValueError as error:
            raise ModelError(f"{path}: field {name}/{error}; fit the body again") from error
    if len(outputs) != len(joints):
        raise ModelError(f"{path}: field senses.{name}.outputs: found {len(outputs)}, possible: one for each joint")
    return Polynomial(outputs, unit=unit, **arrays)


def _array(path: Path, archive: zipfile.ZipFile, member: str, kind: str) -> Array:
    """Read one array of dtype kind "f" (float64) or "U"; its declared size must match the archive's."""
    try:
        info = archive.getinfo(member)
    except KeyError as error:
        raise ModelError(f"{path}: field {member[:-4]}: missing; fit the body again") from error
    if info.compress_type != zipfile.ZIP_STORED or info.file_size > path.stat().st_size:
        raise ModelError(f"{path}: field {member[:-4]}: {info.file_size} bytes do not fit the file; fit it again")
    with archive.open(info) as stream:
        try:
            shape, _, dtype = _READERS[np.lib.format.read_magic(stream)](stream)
        except (ValueError, KeyError, SyntaxError, TokenError) as error:
            raise ModelError(f"{path}: field {member[:-4]}: not an array; fit the body again") from error
        size = info.file_size - stream.tell()
        whole = all(type(n) is int and 0 <= n <= info.file_size for n in shape)
        sound = whole and (dtype.kind == "U" if kind == "U" else dtype == np.dtype("<f8"))
        if not sound or size != int(np.prod(shape, dtype=object)) * dtype.itemsize:
            raise ModelError(f"{path}: field {member[:-4]}: found {dtype} {shape} in {size} bytes; fit the body again")
    with archive.open(info) as stream:
        return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))


_READERS: Any = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
