"""BodyModel <-> .npz: plain arrays and one JSON header, never pickle; the same model gives the same bytes."""

import json
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ModelError
from ..files import replacing
from ..types import Array, BodyModel, Noise, TouchConstants
from .gp import GP

VERSION = 1
_KIND = "bodylog body model"
_HEADER = "header.npy"
_EPOCH = (1980, 1, 1, 0, 0, 0)

# n centres, s samples, d outputs, g kernels, m joints
_SHAPES: dict[str, str] = {
    "centres": "nm",
    "scales": "gm",
    "amplitude": "g",
    "mean": "d",
    "weights": "dn",
    "factor": "gnn",
    "noise": "d",
    "samples": "sm",
    "targets": "sd",
    "spread": "sd",
}
_POSITIVE = ("scales", "amplitude")


def save(model: BodyModel, path: Path) -> None:
    """Write the model to `path` (.npz, whole or not at all); ModelError for a sense that is not a GP."""
    arrays = {_HEADER: np.array(json.dumps(_header(model), sort_keys=True))}
    for name, gp in model.senses.items():
        if not isinstance(gp, GP):
            raise ModelError(f"{path}: sense {name!r}: a {type(gp).__name__} cannot be saved; possible: GP")
        arrays |= {f"{name}/{field}.npy": np.asarray(getattr(gp, field), np.float64) for field in _SHAPES}
    with replacing(path) as beside, zipfile.ZipFile(beside, "w", zipfile.ZIP_STORED) as archive:
        for name in sorted(arrays):
            with archive.open(zipfile.ZipInfo(name, _EPOCH), "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, arrays[name], version=(1, 0), allow_pickle=False)


def load(path: Path) -> BodyModel:
    """Read a model; ModelError, naming the field, if it is not one, truncated, of another version or not finite."""
    if not path.is_file():
        raise ModelError(f"{path}: there is no such body model; type: bodylog fit LOG -o {path}")
    try:
        with zipfile.ZipFile(path) as archive:
            return _read(path, archive)
    except (zipfile.BadZipFile, EOFError, NotImplementedError, RuntimeError) as error:
        raise ModelError(f"{path}: not a whole .npz file ({error}); type: bodylog fit LOG -o {path}") from error


def _header(model: BodyModel) -> dict[str, Any]:
    senses = {n: {"outputs": g.outputs, "unit": getattr(g, "unit", "")} for n, g in model.senses.items()}
    return {
        "kind": _KIND,
        "version": VERSION,
        "joints": model.joints,
        "units": {"joints": "rad", "encoder": "rad^2", "process": "rad^2/s^3", "b1": "1/px^2", "b2": "1/s^2"},
        "senses": senses,
        "noise": asdict(model.noise),
        "touch": asdict(model.touch),
        "provenance": dict(model.provenance),
    }


def _read(path: Path, archive: zipfile.ZipFile) -> BodyModel:
    header = _parse(path, archive)
    try:
        joints = tuple(str(name) for name in header["joints"])
        noise, touch = _noise(header["noise"]), TouchConstants(**header["touch"])
        senses = {str(n): (tuple(s["outputs"]), str(s["unit"])) for n, s in header["senses"].items()}
        provenance = dict(header["provenance"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ModelError(f"{path}: field header: {error}; fit the body again") from error
    _check_noise(path, joints, senses, noise, touch)
    learned = {name: _gp(path, archive, name, *about, joints) for name, about in senses.items()}
    return BodyModel(joints, learned, noise, touch, provenance)


def _parse(path: Path, archive: zipfile.ZipFile) -> Mapping[str, Any]:
    text = _array(path, archive, _HEADER, "U")
    try:
        header = json.loads(str(text), parse_constant=_refuse)
    except ValueError as error:
        raise ModelError(f"{path}: field header: {error}; fit the body again") from error
    if not isinstance(header, dict) or header.get("kind") != _KIND:
        raise ModelError(f"{path}: field kind: not a {_KIND}; type: bodylog fit LOG -o {path}")
    if header.get("version") != VERSION:
        raise ModelError(f"{path}: field version: found {header.get('version')!r}, possible: {VERSION}; fit it again")
    return header


def _refuse(name: str) -> None:
    raise ValueError(f"the number {name} is not finite")


def _noise(found: Mapping[str, Any]) -> Noise:
    senses, errors = ({k: _floats(v) for k, v in found[part].items()} for part in ("senses", "std_error"))
    return Noise(_floats(found["encoder"]), senses, _floats(found["process"]), errors)


def _floats(values: Any) -> tuple[float, ...]:
    return tuple(float(v) for v in values)


def _check_noise(
    path: Path,
    joints: tuple[str, ...],
    senses: Mapping[str, tuple[tuple[str, ...], str]],
    noise: Noise,
    touch: TouchConstants,
) -> None:
    expected = {"encoder": (noise.encoder, len(joints)), "process": (noise.process, len(joints))}
    for name, (outputs, _) in senses.items():
        expected[f"senses.{name}"] = (noise.senses.get(name, ()), len(outputs))
    for field, (values, count) in expected.items():
        if len(values) != count or not all(v > 0.0 for v in values):
            raise ModelError(f"{path}: field noise.{field}: found {values}, possible: {count} positive variances")
    bad = {k: v for k, v in asdict(touch).items() if not isinstance(v, int | float) or v < 0}
    if bad:
        raise ModelError(f"{path}: field touch: found {bad}, possible: numbers of at least 0")


def _gp(
    path: Path, archive: zipfile.ZipFile, name: str, outputs: tuple[str, ...], unit: str, joints: tuple[str, ...]
) -> GP:
    sizes = {"d": len(outputs), "m": len(joints)}
    arrays: dict[str, Array] = {}
    for field, letters in _SHAPES.items():
        value = _array(path, archive, f"{name}/{field}.npy", "f")
        found = dict(zip(letters, value.shape, strict=False))
        expected = tuple(sizes.setdefault(letter, found.get(letter, 0)) for letter in letters)
        if value.shape != expected or 0 in expected:
            raise ModelError(f"{path}: field {name}/{field}: found shape {value.shape}, possible: {expected}")
        if not np.isfinite(value).all() or (field in _POSITIVE and value.min() <= 0.0):
            kind = "finite positive" if field in _POSITIVE else "finite"
            raise ModelError(f"{path}: field {name}/{field}: found {_worst(value)}, possible: {kind} numbers")
        arrays[field] = value
    return GP(outputs, unit, **arrays)


def _worst(value: Array) -> float:
    bad = value[~np.isfinite(value)]
    return float(bad[0] if len(bad) else value.min())


def _array(path: Path, archive: zipfile.ZipFile, member: str, kind: str) -> Array:
    """One array of dtype kind "f" (float64) or "U"; its declared size must be what the archive holds."""
    try:
        info = archive.getinfo(member)
    except KeyError as error:
        raise ModelError(f"{path}: field {member[:-4]}: missing; fit the body again") from error
    if info.compress_type != zipfile.ZIP_STORED or info.file_size > path.stat().st_size:
        raise ModelError(f"{path}: field {member[:-4]}: {info.file_size} bytes do not fit the file; fit it again")
    with archive.open(info) as stream:
        try:
            shape, _, dtype = _READERS[np.lib.format.read_magic(stream)](stream)
        except (ValueError, KeyError) as error:
            raise ModelError(f"{path}: field {member[:-4]}: not an array; fit the body again") from error
        size = info.file_size - stream.tell()
        sound = dtype.kind == "U" if kind == "U" else dtype == np.dtype("<f8")
        if not sound or size != int(np.prod(shape, dtype=object)) * dtype.itemsize:
            raise ModelError(f"{path}: field {member[:-4]}: found {dtype} {shape} in {size} bytes; fit the body again")
    with archive.open(info) as stream:
        return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))


_READERS: dict[tuple[int, int], Callable[[Any], tuple[Any, ...]]] = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}
