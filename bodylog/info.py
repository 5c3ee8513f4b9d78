"""What is in a file: a log here or behind a URL, or a body model."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .io import remote
from .io.atomic_files import is_archive
from .io.values import read_json
from .settings import Settings

if TYPE_CHECKING:
    from .body.kinematic.model import KinematicGP
    from .body_model import BodyModel, ForwardModel


def describe_file(log: Path | str, settings: Settings) -> dict[str, Any]:
    """What is in a log: topics, rates, roles, clocks; or in
    a body model (.npz): joints, senses, noise, provenance.

    Of an MCAP behind a URL only what this needs is read.
    """
    from .recording import facts

    if remote.is_url(str(log)):
        return _info_remote(str(log), settings)
    log = Path(log)
    if is_archive(log):
        return _info_body(log)
    return facts.describe_log(log, settings, settings.input.strict)


def dataset_images(log: Path, settings: Settings) -> int:
    """Images in a dataset of a log: one of each camera
    for each of the first one's; 0 without an image topic.
    """
    from .recording import dataset_rows

    return dataset_rows.count_row_images(log, settings)


def _info_remote(url: str, settings: Settings) -> dict[str, Any]:
    from .logs.library import local_path
    from .recording import facts

    with local_path(url, settings.input.max_wait_s) as path:
        found = facts.describe_log(path, settings, settings.input.strict)
    findings = [{**one, "text": one["text"].replace(str(path), url)} for one in found["findings"]]
    return found | {"path": url, "findings": findings}


def _info_body(path: Path) -> dict[str, Any]:
    from .body import storage

    learned = storage.load_body(path)
    return {
        "path": str(path),
        "format": "body",
        "joints": list(learned.joints),
        "senses": {
            name: _describe_sense(sense, learned.joints) for name, sense in learned.senses.items()
        },
        **_list_zeros_and_scales(learned),
        "noise": asdict(learned.noise),
        "touch": asdict(learned.touch),
        "cells": {str(cell): list(place) for cell, place in learned.cells.items()},
        "provenance": {key: _parse_if_json(value) for key, value in learned.provenance.items()},
        "findings": [],
    }


def _list_zeros_and_scales(learned: "BodyModel") -> dict[str, Any]:
    """The joints' zeros and scales of a body that was learned with a URDF."""
    from .body.kinematic import model as kinematic_gp
    from .body.kinematic import offsets

    if not any(isinstance(sense, kinematic_gp.KinematicGP) for sense in learned.senses.values()):
        return {}
    return dict(
        offsets.offset_tables(offsets.learned_zeros(learned), offsets.learned_scales(learned))
    )


def _describe_sense(sense: "ForwardModel", joints: Sequence[str]) -> dict[str, Any]:
    """What a sense's model is made of: samples and a length scale (rad) for each
    joint, and joints in the order of the axes found; or coefficients.
    """
    from .body.gp.axis_gp import AxisGP
    from .body.gp.model import GP
    from .body.kinematic.model import KinematicGP
    from .body.senses.encoder_function import Polynomial

    facts: dict[str, Any] = {"outputs": list(sense.outputs), "unit": getattr(sense, "unit", "")}
    if isinstance(sense, GP):
        scales = [dict(zip(joints, group, strict=True)) for group in sense.scales.tolist()]
        facts |= {"samples": len(sense.samples), "length_scales": scales}
        if isinstance(sense, AxisGP):
            facts["axes"] = [joints[m] for m in sense.chain.order]
        return facts | (
            {"kinematics": _list_links(sense)} if isinstance(sense, KinematicGP) else {}
        )
    return facts | (
        {"coefficients": sense.coefficients.tolist()} if isinstance(sense, Polynomial) else {}
    )


def _list_links(sense: "KinematicGP") -> dict[str, str | None]:
    """What hangs on which link, and the robot's root."""
    camera = sense.rig.cameras[0]
    marker = sense.rig.carriers[0]
    base = sense.base
    links = {
        "camera": camera.name,
        "camera_link": camera.link,
        "marker": marker.name,
        "marker_link": marker.link,
    }
    return links | {"base": None if base is None else base.chain.start}


def _parse_if_json(value: Any) -> Any:
    """A text that holds JSON as what it holds."""
    try:
        return read_json(value) if isinstance(value, str) else value
    except ValueError:
        return value
