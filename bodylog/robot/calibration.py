"""The calibration of a body learned with a URDF: as
plain values, as text, and in the files that people use.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..body import storage
from ..body.kinematic.model import KinematicGP
from ..body.kinematic.offsets import offsets_as_values
from ..body.kinematic.placements import Calibration, Lens, Placement, calibration_of_body
from ..body_model import BodyModel
from ..errors import ModelError, UsageError
from ..io.atomic_files import ensure_dir, write_text_atomically
from ..kinematics import urdf as files
from ..kinematics.corrected import CameraFrame, correct_urdf
from ..kinematics.identifiability import Offset
from ..kinematics.rotations import quaternions_from_rotations, rpy_from_rotation

FORMS = (".yaml", ".yml", ".json", ".urdf")


def load_calibration(body: Path) -> Calibration:
    """The calibration of a body file; ModelError where it was learned without a URDF."""
    learned = storage.load_body(body)
    try:
        return calibration_of_body(learned)
    except ModelError as problem:
        raise ModelError(f"{body}: {problem}") from problem


def calibration_as_values(found: Calibration) -> dict[str, Any]:
    """As plain values, in m, rad and px: {"cameras", "trackers", "markers", "zeros",
    "scales", "compliances", "sag", "earlier"}; None: not identifiable.

    compliances: by how much joints give way to gravity, rad/(N m) or m/N · sag: a sentence about
    it · earlier: where cameras and markers were before they moved between logs.
    """
    cameras = zip(found.cameras, found.lenses, strict=True)
    return {
        "cameras": {
            camera_name_in_scores(one.name): _placement_as_values(one) | _lens_as_values(lens)
            for one, lens in cameras
        },
        "trackers": {one.name: _placement_as_values(one) for one in found.trackers},
        "markers": {one.name: _placement_as_values(one) for one in found.markers},
        "zeros": offsets_as_values(found.zeros),
        "scales": offsets_as_values(found.scales),
        "compliances": offsets_as_values(found.compliances),
        "sag": found.sag,
        "earlier": {one.name: _placement_as_values(one) for one in found.earlier},
    }


def camera_name_in_scores(name: str) -> str:
    """A camera's name as in the scores: that of its tracks, "camera" where they have no prefix."""
    return name.removeprefix("camera ")


def _placement_as_values(one: Placement) -> dict[str, Any]:
    sure = one.identifiable
    turned = one.identifiable and one.turns
    return {
        "link": one.link,
        "xyz_m": one.pose[:3, 3].tolist() if sure else None,
        "xyz_std_m": one.place_std.tolist(),
        "quaternion_xyzw": quaternions_from_rotations(one.pose[None, :3, :3])[0].tolist()
        if turned
        else None,
        "rotation_std_rad": one.turn_std.tolist() if one.turns else None,
    }


def _lens_as_values(lens: Lens) -> dict[str, Any]:
    return {
        "focal_px": lens.focal.tolist(),
        "focal_std_px": lens.focal_std.tolist(),
        "centre_px": lens.centre.tolist(),
        "centre_std_px": lens.centre_std.tolist(),
        "distortion": lens.distortion.tolist(),
        "distortion_std": lens.distortion_std.tolist(),
        "row_time_s": lens.row_time,
        "row_time_std_s": lens.row_time_std,
    }


def summarise_placements(model: BodyModel) -> tuple[str, ...]:
    """Where each camera and marker of a body is, a line
    each; empty where it was learned without a URDF.
    """
    if model.surface is None and not any(
        isinstance(sense, KinematicGP) for sense in model.senses.values()
    ):
        return ()
    found = calibration_of_body(model)
    texts = []
    for camera, lens in zip(found.cameras, found.lenses, strict=True):
        texts.append(
            f"{next(placement_lines(camera))}, focal "
            f"{_values_with_std(lens.focal, lens.focal_std, 1)} px"
        )
    rest = (*found.trackers, *found.markers)
    return (*texts, *(next(placement_lines(one)) for one in rest))


def calibration_lines(found: Calibration) -> Iterator[str]:
    """Yield the calibration in mm, degrees and px, with the transforms to type."""
    for camera, lens in zip(found.cameras, found.lenses, strict=True):
        yield from placement_lines(camera)
        yield f"  {lens_line(lens)}"
        if camera.identifiable:
            yield f"  {transform_command(camera, optical_frame(camera))}"
    for tracker in found.trackers:
        yield from placement_lines(tracker)
        if tracker.identifiable:
            yield f"  {transform_command(tracker, tracker.name)}"
    for marker in (*found.markers, *found.earlier):
        yield from placement_lines(marker)
    yield from zero_lines((*found.zeros, *found.scales, *found.compliances))
    if found.sag:
        yield found.sag


def placement_lines(one: Placement) -> Iterator[str]:
    """Yield where a camera or marker is in its link, in mm and degrees (roll, pitch, yaw)."""
    if not one.identifiable:
        yield f"{one.name} in {one.link}: not identifiable"
        return
    yield (
        f"{one.name} in {one.link}: "
        f"{_values_with_std(1e3 * one.pose[:3, 3], 1e3 * one.place_std, 1)} mm"
    )
    if one.turns:
        angles = np.degrees(rpy_from_rotation(one.pose[:3, :3]))
        std = np.degrees(one.turn_std)
        texts = ", ".join(f"{value:.2f}" for value in angles)
        yield (
            f"  roll, pitch, yaw {texts}°, ± {', '.join(f'{value:.2f}' for value in std)}° about "
            "x, y, z"
        )


def lens_line(lens: Lens) -> str:
    """A lens in px."""
    focal = _values_with_std(lens.focal, lens.focal_std, 1)
    centre = _values_with_std(lens.centre, lens.centre_std, 1)
    text = (
        f"focal {focal} px, centre {centre} px, k1, k2 "
        f"{_values_with_std(lens.distortion, lens.distortion_std, 3)}"
    )
    if lens.row_time is None or lens.row_time_std is None:
        return text
    return f"{text}, rows {1e3 * lens.row_time:.0f} ± {1e3 * lens.row_time_std:.0f} ms"


def _values_with_std(values: Any, stds: Any, digits: int) -> str:
    pairs = zip(values.tolist(), stds.tolist(), strict=True)
    return ", ".join(f"{value:.{digits}f} ± {std:.{digits}f}" for value, std in pairs)


def zero_lines(found: Sequence[Offset]) -> Iterator[str]:
    """Yield each joint's zero in degrees or mm, each scale in percent, each
    compliance in mrad/(N m), or what it cannot be separated from.
    """
    width = max((len(one.joint) for one in found), default=0)
    for one in found:
        why = " and ".join(one.confused) or "not seen"
        shown = one.shown if one.identifiable else f"not identifiable: {why}"
        yield f"{one.joint:<{width}}  {'' if one.noun == 'zero' else f'{one.noun} '}{shown}"


def transform_command(camera: Placement, frame: str) -> str:
    """The command that publishes the pose of a camera's or tracker's frame to tf (ROS 2)."""
    values = _placement_as_values(camera)
    place = zip("xyz", values["xyz_m"], strict=True)
    turn = zip(("qx", "qy", "qz", "qw"), values["quaternion_xyzw"], strict=True)
    numbers = " ".join(f"--{name} {value:.6f}" for name, value in (*place, *turn))
    frames = f"--frame-id {camera.link} --child-frame-id {frame}"
    return f"ros2 run tf2_ros static_transform_publisher {numbers} {frames}"


def optical_frame(camera: Placement) -> str:
    """The name of a camera's optical frame beside its link."""
    return f"{camera_name_in_scores(camera.name).replace('/', '_')}_optical_frame"


def write_calibration(
    found: Calibration, out: Path, urdf: Path | None, values: Mapping[str, Any]
) -> None:
    """Write plain values as YAML or JSON, or a URDF
    with cameras and zeros moved, by the file's suffix.

    UsageError for other suffixes.
    """
    if out.suffix not in FORMS:
        raise UsageError(f"{out}: -o ends in {out.suffix!r}; possible: {', '.join(FORMS)}")
    if out.suffix == ".urdf" and urdf is None:
        raise UsageError(f"{out}: a URDF is written from one; type: --urdf ROBOT.urdf")
    text = (
        _corrected_urdf(found, urdf)
        if urdf is not None and out.suffix == ".urdf"
        else _values_as_text(values, out.suffix)
    )
    write_text_atomically(out, text)


def _values_as_text(values: Mapping[str, Any], suffix: str) -> str:
    if suffix == ".json":
        return json.dumps(values, indent=2) + "\n"
    return "".join(f"{line}\n" for line in _yaml_lines(values))


def _yaml_lines(values: Mapping[str, Any], depth: int = 0, deepest: int = 1) -> Iterator[str]:
    """Yield lines of YAML: mappings to a depth, beyond it JSON, which is valid YAML."""
    for key, value in values.items():
        name = "  " * depth + (key if depth == 0 else json.dumps(key))
        if isinstance(value, Mapping) and value and depth < deepest:
            yield f"{name}:"
            yield from _yaml_lines(value, depth + 1, deepest)
        else:
            yield f"{name}: {json.dumps(value)}"


def _corrected_urdf(found: Calibration, urdf: Path) -> str:
    cameras = [
        CameraFrame(one.link, frame, one.pose)
        for one, frame in (
            *((one, optical_frame(one)) for one in found.cameras),
            *((one, one.name) for one in found.trackers),
        )
        if one.identifiable
    ]
    zeros = {one.joint: one.value for one in found.zeros if one.identifiable}
    return correct_urdf(files.read_urdf_text(urdf), str(urdf), zeros, cameras)


def without_cameras(found: Calibration) -> Calibration:
    """The joints alone."""
    return replace(found, cameras=(), lenses=(), markers=(), trackers=())


def write_lenses(body: Path, found: Calibration, folder: Path) -> tuple[Path, ...]:
    """Write each camera's lens as folder/CAMERA.yaml; UsageError
    where a body does not know the size of its images.
    """
    texts = {}
    for camera, lens in zip(found.cameras, found.lenses, strict=True):
        name = camera_name_in_scores(camera.name).replace("/", "_")
        size = found.image_sizes.get(camera.name)
        if size is None:
            known = (
                "tables of positions alone do not tell it; learn from images, or from a log with "
                "a CameraInfo"
            )
            missing = "the size of its images is not known, and a CameraInfo needs it"
            raise UsageError(f"{body}: {camera.name}: {missing}; {known}")
        texts[folder / f"{name}.yaml"] = camera_info_yaml(name, lens, size)
    ensure_dir(folder)
    for path, text in texts.items():
        write_text_atomically(path, text)
    return tuple(texts)


def camera_info_yaml(name: str, lens: Lens, size: Sequence[int]) -> str:
    """A lens as ROS's camera_calibration_parsers read it:
    a CameraInfo in YAML, for images of (width, height) px.
    """
    fu, fv = lens.focal.tolist()
    cu, cv = lens.centre.tolist()
    matrix = [fu, 0.0, cu, 0.0, fv, cv, 0.0, 0.0, 1.0]
    projection = [fu, 0.0, cu, 0.0, 0.0, fv, cv, 0.0, 0.0, 0.0, 1.0, 0.0]
    arrays = {
        "camera_matrix": (3, 3, matrix),
        "distortion_coefficients": (1, 5, [*lens.distortion.tolist(), 0.0, 0.0, 0.0]),
        "rectification_matrix": (3, 3, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        "projection_matrix": (3, 4, projection),
    }
    named = {
        key: {"rows": rows, "cols": cols, "data": data}
        for key, (rows, cols, data) in arrays.items()
    }
    width, height = size
    whole = {
        "image_width": width,
        "image_height": height,
        "camera_name": name,
        "distortion_model": "plumb_bob",
    }
    return "".join(f"{line}\n" for line in _yaml_lines({**whole, **named}))
