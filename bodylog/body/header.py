"""The JSON header of a body's .npz: joints, senses,
noise, touch, provenance; written, and checked when read.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

from ..body_model import HELD, UNUSED_URDF, BodyModel, Noise, TouchConstants
from ..errors import ModelError
from ..io.values import encodable_text, read_json
from . import surface
from .gp.axis_gp import AxisGP
from .gp.model import GP
from .kinematic import storage
from .kinematic.model import KinematicGP
from .senses.encoder_function import Polynomial

VERSION = 1
_KIND = "bodylog body model"
_WIDEST = 1 << 20
KINDS: dict[type, str] = {
    GP: "gp",
    Polynomial: "polynomial",
    KinematicGP: "kinematic",
    AxisGP: "axes",
}
"""Names of the classes of senses that can be saved."""
_UNITS = {
    "joints": "rad",
    "encoder": "rad^2",
    "process": "rad^2/s^3",
    "b1": "1/px^2",
    "cells": "px",
}
_UNUSED = {"b2": "1/s^2"}
"""Older bodies have it, with a2 and b2 among their touch constants, which nothing used."""
LEAST = 1e-30
LARGEST = 1e30
"""Bounds of positive numbers and of any number: products of four of these are finite and not 0."""


class Header(NamedTuple):
    """The checked header; senses: {name: (kind, outputs,
    unit)}, links: names of kinematic senses by name.

    surface: names of the surface's part, or None.
    """

    joints: tuple[str, ...]
    noise: Noise
    touch: TouchConstants
    cells: dict[int, tuple[float, float, float]]
    senses: dict[str, tuple[str, tuple[str, ...], str]]
    links: dict[str, dict[str, str]]
    provenance: dict[str, Any]
    surface: dict[str, Any] | None = None


def compose_header(model: BodyModel) -> dict[str, Any]:
    """The header of a model."""
    senses = {
        name: {
            "kind": KINDS[type(sense)],
            "outputs": sense.outputs,
            "unit": getattr(sense, "unit", ""),
        }
        | ({"kinematics": storage.kinematic_names(sense)} if isinstance(sense, KinematicGP) else {})
        for name, sense in model.senses.items()
    }
    seen = {} if model.surface is None else {"surface": surface.surface_names(model.surface)}
    return seen | {
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


def read_header(path: Path, header_text: str) -> Header:
    """Parse and check a header; ModelError, naming the field, where it is invalid."""
    header = _parse_header_json(path, header_text)
    try:
        joints = _check_joint_names(header["joints"])
        noise = _parse_noise(header["noise"])
        touch = _parse_touch_constants(header["touch"])
        cells = {
            int(cell): _check_floats(f"cells.{cell}", place)
            for cell, place in header.get("cells", {}).items()
        }
        senses = {
            encodable_text(n): _parse_sense(n, sense) for n, sense in header["senses"].items()
        }
        linked = {
            encodable_text(n): s
            for n, s in header["senses"].items()
            if s.get("kind") == KINDS[KinematicGP]
        }
        links = {
            name: storage.check_kinematic_names(sense.get("kinematics"))
            for name, sense in linked.items()
        }
        provenance = _check_provenance(header["provenance"])
        seen = surface.check_surface(header["surface"], joints) if "surface" in header else None
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ModelError(f"{path}: field header: {error}; fit the body again") from error
    _check_noise(
        path, joints, {name: len(about[1]) for name, about in senses.items()}, noise, touch
    )
    bad = {
        cell: place
        for cell, place in cells.items()
        if cell < 0 or len(place) != 3 or place[2] <= 0.0
    }
    if bad:
        raise ModelError(
            f"{path}: field cells: found {bad}, possible: cell from 0 on, u, v and a "
            "positive spread, px"
        )
    places = {cell: (u, v, spread) for cell, (u, v, spread) in cells.items()}
    return Header(joints, noise, touch, places, senses, links, provenance, seen)


def _parse_header_json(path: Path, header_text: str) -> Mapping[str, Any]:
    try:
        header = read_json(header_text)
    except ValueError as error:
        raise ModelError(f"{path}: field header: {error}; fit the body again") from error
    if not isinstance(header, dict) or header.get("kind") != _KIND:
        raise ModelError(f"{path}: field kind: not a {_KIND}; type: bodylog fit LOG -o {path}")
    if header.get("version") != VERSION:
        raise ModelError(
            f"{path}: field version: found {header.get('version')!r}, possible: {VERSION}; "
            "fit it again"
        )
    units = header.get("units", _UNITS)
    if units not in (_UNITS, _UNITS | _UNUSED):
        raise ModelError(
            f"{path}: field units: found {str(units)[:200]}, possible: {json.dumps(_UNITS)}; "
            "fit it again"
        )
    return header


def _parse_touch_constants(fields: Mapping[str, Any]) -> TouchConstants:
    """Touch constants without those of `_UNUSED`."""
    return TouchConstants(
        **{name: value for name, value in fields.items() if name not in ("a2", "b2")}
    )


def _parse_sense(name: str, sense: Mapping[str, Any]) -> tuple[str, tuple[str, ...], str]:
    """Kind, outputs and unit of a sense."""
    return (
        _check_sense_kind(sense),
        _check_texts(f"senses.{name}.outputs", sense["outputs"]),
        encodable_text(str(sense["unit"])),
    )


def _check_sense_kind(sense: Mapping[str, Any]) -> str:
    kind = str(sense.get("kind", "gp"))
    if kind not in KINDS.values():
        raise ValueError(f"sense of kind {kind!r}, possible: {', '.join(KINDS.values())}")
    return kind


def _check_joint_names(found: Any) -> tuple[str, ...]:
    names = _check_texts("joints", found)
    twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if twice is not None or not names:
        raise ValueError(
            f"joints: found {twice or found!r}, possible: a list that names each joint once"
        )
    return names


def _check_texts(field: str, found: Any) -> tuple[str, ...]:
    if not isinstance(found, list) or not all(isinstance(name, str) for name in found):
        raise ValueError(f"{field}: found {str(found)[:200]}, possible: a list of texts")
    return tuple(encodable_text(name) for name in found)


def _check_provenance(found: Any) -> dict[str, Any]:
    provenance = dict(found)
    if "cameras" in provenance:
        provenance["cameras"] = list(_check_texts("provenance.cameras", provenance["cameras"]))
    if not isinstance(provenance.get(UNUSED_URDF, ""), str):
        raise ValueError(
            f"provenance.{UNUSED_URDF}: found {provenance[UNUSED_URDF]!r:.200}, possible: a text"
        )
    if "pose_std" in provenance:
        std = _check_floats("provenance.pose_std", provenance["pose_std"])
        if any(value < 0.0 for value in std):
            raise ValueError(f"provenance.pose_std: found {min(std)!r}, possible: 0 rad and more")
        provenance["pose_std"] = list(std)
    width = provenance.get("image_width", 1)
    if isinstance(width, bool) or not isinstance(width, int | float) or not 1 <= width <= _WIDEST:
        raise ValueError(f"provenance.image_width: found {width!r}, possible: 1 to {_WIDEST} px")
    if "image_sizes" in provenance and not _are_sizes(provenance["image_sizes"]):
        given = str(provenance["image_sizes"])[:200]
        raise ValueError(
            f"provenance.image_sizes: found {given}, possible: {{camera: [width, height]}} in px"
        )
    held = provenance.get(HELD, {})
    spans = held.values() if isinstance(held, dict) else [None]
    if not all(
        isinstance(span, list) and len(span) == 2 and all(map(_is_number, span)) for span in spans
    ):
        raise ValueError(
            f"provenance.{HELD}: found {str(held)[:200]}, possible: {{joint: [low, high]}}"
        )
    if not isinstance(provenance.get("sag", ""), str):
        raise ValueError(f"provenance.sag: found {provenance['sag']!r:.200}, possible: a text")
    if "calibration" in provenance:
        _check_calibration(provenance["calibration"])
    return provenance


def _check_calibration(found: Any) -> None:
    """ValueError, naming the part, unless a value is a calibration as plain values
    (`placements.kept_calibration`).
    """
    placements = "a list of name, link, pose (4 × 4), place_std (3), turn_std (3), turns"
    offsets = "a list of joint, value, std, beforehand, unit, confused"
    parts = {
        "cameras": (_are_placements, placements),
        "markers": (_are_placements, placements),
        "earlier": (_are_placements, placements),
        "trackers": (_are_placements, placements),
        "lenses": (_are_lenses, f"a list of {', '.join(_LENS)}, 2 numbers each"),
        "zeros": (_are_offsets, offsets),
        "scales": (_are_offsets, offsets),
        "compliances": (_are_offsets, offsets),
    }
    # bodies without masses, and of images alone
    needed = set(parts) - {"compliances", "trackers"}
    if not isinstance(found, dict) or not needed <= set(found) <= set(parts):
        raise ValueError(
            f"provenance.calibration: found {str(found)[:200]}, possible: {', '.join(parts)}"
        )
    for name in found:
        is_sound, wanted = parts[name]
        if not is_sound(found[name]):
            raise ValueError(
                f"provenance.calibration.{name}: found {str(found[name])[:200]}, possible: {wanted}"
            )
    if len(found["lenses"]) != len(found["cameras"]):
        lenses = len(found["lenses"])
        cameras = len(found["cameras"])
        raise ValueError(
            f"provenance.calibration.lenses: found {lenses}, possible: one for each of "
            f"{cameras} cameras"
        )


_LENS = ("focal", "focal_std", "centre", "centre_std", "distortion", "distortion_std")
_OFFSET = {"joint", "value", "std", "beforehand", "unit", "confused"}


def _are_lenses(found: Any) -> bool:
    """Whether a value is a list of lenses as plain values."""
    if not isinstance(found, list) or not all(
        isinstance(one, dict) and set(one) == set(_LENS) for one in found
    ):
        return False
    pairs = [pair for one in found for pair in one.values()]
    return all(
        isinstance(pair, list) and len(pair) == 2 and all(map(_is_number, pair)) for pair in pairs
    )


def _are_offsets(found: Any) -> bool:
    """Whether a value is a list of joints' zeros or scales as plain values."""
    if not isinstance(found, list) or not all(
        isinstance(one, dict) and set(one) == _OFFSET for one in found
    ):
        return False
    numbers = [one[name] for one in found for name in ("value", "std", "beforehand")]
    texts = [one[name] for one in found for name in ("joint", "unit")]
    lists = [one["confused"] for one in found]
    sound = all(map(_is_number, numbers)) and all(isinstance(text, str) for text in texts)
    return sound and all(
        isinstance(one, list) and all(isinstance(text, str) for text in one) for one in lists
    )


def _are_placements(found: Any) -> bool:
    """Whether a value is a list of placements as plain values (Placement.plain)."""
    if not isinstance(found, list):
        return False
    for one in found:
        if not isinstance(one, dict) or set(one) != {
            "name",
            "link",
            "pose",
            "place_std",
            "turn_std",
            "turns",
        }:
            return False
        rows = one["pose"]
        lists = [one["place_std"], one["turn_std"], *(rows if isinstance(rows, list) else [])]
        if len(lists) != 6 or not all(isinstance(row, list) for row in lists):
            return False
        if [len(row) for row in lists] != [3, 3, 4, 4, 4, 4] or not all(
            _is_number(v) for row in lists for v in row
        ):
            return False
        if not isinstance(one["turns"], bool) or not all(
            isinstance(one[key], str) for key in ("name", "link")
        ):
            return False
    return True


def _are_sizes(found: Any) -> bool:
    """Whether a value is {camera: [width, height]} in px."""
    if not isinstance(found, dict):
        return False
    pairs = [one if isinstance(one, list) and len(one) == 2 else [0, 0] for one in found.values()]
    sides = [side for pair in pairs for side in pair]
    return all(
        isinstance(side, int) and not isinstance(side, bool) and 1 <= side <= _WIDEST
        for side in sides
    )


def _parse_noise(found: Mapping[str, Any]) -> Noise:
    parts = ("senses", "std_error")
    senses, errors = (
        {n: _check_floats(f"noise.{part}.{n}", v) for n, v in found[part].items()} for part in parts
    )
    return Noise(
        _check_floats("noise.encoder", found["encoder"]),
        senses,
        _check_floats("noise.process", found["process"]),
        errors,
    )


def _check_floats(field: str, values: Any) -> tuple[float, ...]:
    if not isinstance(values, list) or not all(_is_number(v) for v in values):
        raise ValueError(f"{field}: found {str(values)[:200]}, possible: a list of finite numbers")
    return tuple(float(v) for v in values)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST


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
        if len(values) != count or not all(v >= LEAST for v in values):
            raise ModelError(
                f"{path}: field noise.{field}: found {values}, possible: {count} positive variances"
            )
    counts = {"encoder": len(joints), "process": len(joints), **senses}
    for name, errors in noise.std_error.items():
        if name not in counts or len(errors) != counts[name] or min(errors, default=0.0) < 0.0:
            wanted = (
                f"{counts[name]} numbers of at least 0"
                if name in counts
                else f"one of {', '.join(counts)}"
            )
            raise ModelError(
                f"{path}: field noise.std_error.{name}: found {errors}, possible: {wanted}"
            )
    bad = {k: v for k, v in asdict(touch).items() if not _is_number(v) or v < 0}
    if bad:
        raise ModelError(
            f"{path}: field touch: found {bad}, possible: finite numbers of at least 0"
        )
