"""One episode examined: its scores and findings, and the evidence by which it is judged beside its
siblings."""

import base64
import hashlib
from collections.abc import Mapping
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from ..delays.findings import ExaminedDelays
from ..delays.flow_delay import FlowDelay
from ..errors import ModelError
from ..findings.result import Result, Scores
from ..settings import Settings
from ..types import Array, Fault, Finding, Recording, Score
from .checks import CHECKS, figure_name
from .reading import EpisodeReading, StoredNumbers, read_episode
from .views import encode_view, picture_at_rest

CURVE_POINTS = 60
"""Points of a joint's curve that a page draws."""
THUMBNAIL_WIDTH_PX = 160
_QUALITY = 75


def examine_episode(
    log: Path, settings: Settings, name: str, body: Path | None = None
) -> tuple[Result, dict[str, Any]]:
    """All checks of one episode: the result for people, and the evidence as plain values (see
    `episode_evidence`).

    `name`: what texts call the log · body: one of the robot's surface, by which the episode is
    judged, in place of a URDF. InputError where it cannot be used.
    """
    reading = read_episode(log, settings)
    scores = list[Score]()
    findings = [one for one in reading.findings if not _is_role_advice(one)]
    figures: dict[str, list[float | None]] = {}
    for check in CHECKS:
        for one in check.measure(reading) if check.measure is not None else ():
            figure = figure_name(check, one.part)
            if one.text:
                findings.append(Finding(one.severity, f"{log}: {one.text}"))
            if not isfinite(one.value):
                continue
            at = one.at if isfinite(one.at) else None
            figures[figure] = [one.value, one.std, one.shared_std, at]
            if check.public:
                scores.append(Score(figure, one.value, check.unit, one.std))
                if one.std is not None:
                    scores.append(Score(f"std/{figure}", one.std, check.unit))
    surface = dict[str, Any]()
    faults: tuple[Fault, ...] = ()
    if settings.time.delay != "off":
        found = _examine_surface(log, settings, body)
        surface = _add_surface(found, log, reading.read, scores, findings, figures)
        faults = found.faults
    findings = [replace(one, text=one.text.replace(str(log), name)) for one in findings]
    about = episode_evidence(reading, figures) | surface
    about["row_shares"] = _row_shares(reading, about)
    unique = tuple(dict.fromkeys(findings))
    return Result(None, Scores(scores), reading.read.facts.health, unique, faults=faults), about


def _examine_surface(log: Path, settings: Settings, body: Path | None) -> ExaminedDelays:
    """What the robot's own surface tells, by a body or else by a URDF; nothing without either."""
    from ..body import storage
    from ..surface.findings import examine_by_body, examine_by_surface

    if body is not None:
        try:
            return examine_by_body(log, storage.load_body(body), settings)
        except ModelError as problem:
            return ExaminedDelays((), (Finding("warning", str(problem)),))
    if settings.kinematics.urdf is not None:
        return examine_by_surface(log, settings)
    return ExaminedDelays()


def _add_surface(
    found: ExaminedDelays,
    log: Path,
    read: Recording,
    scores: list[Score],
    findings: list[Finding],
    figures: dict[str, list[float | None]],
) -> dict[str, Any]:
    """Add what the robot's own surface tells of cameras and joint zeros, and return the evidence of
    it; what flow tells of the same stands beside, as flow/NAME."""
    from ..recording.cameras import camera_name_of_source

    first = (
        camera_name_of_source(read.facts.roles["camera"])
        if "camera" in read.facts.roles
        else "camera"
    )
    known = [replace(one, name=_name_first_camera(one.name, first)) for one in found.scores]
    stated = {f"std/{one.name}": one for one in known if one.std is not None}
    for name in sorted(set(stated).difference(one.name for one in known)):
        known.append(Score(name, float(stated[name].std or 0.0), stated[name].unit))
    values = {one.name: one.value for one in known}
    figures_of_surface = [
        name for name in values if name.partition("/")[0] in ("delay", "row_time")
    ]
    row_shares = {
        _name_first_camera(name, first): known for name, known in found.row_shares.items()
    }
    for name in figures_of_surface:
        if name in figures:
            figures[f"flow/{name}"] = figures[name]
        share, _, row_std = row_shares.get(name, (0.0, 0.0, 0.0))
        figures[name] = [values[name], values.get(f"std/{name}"), abs(share) * row_std, None]
    beside = {*figures_of_surface, *(f"std/{name}" for name in figures_of_surface)}
    scores[:] = [
        replace(one, name=_name_beside_surface(one.name)) if one.name in beside else one
        for one in scores
    ]
    scores += known
    prefix = f"{log}: camera: "
    findings += [
        replace(one, text=f"{log}: {first}: {one.text.removeprefix(prefix)}")
        if one.text.startswith(prefix)
        else one
        for one in found.findings
    ]
    faults = [
        [one.kind, one.name, one.size if isfinite(one.size) else None, one.std, one.unit]
        for one in found.faults
    ]
    return {
        "by_surface": figures_of_surface,
        "faults": faults,
        "row_shares": {name: [share, at] for name, (share, at, _) in row_shares.items()},
        "changes": dict(found.changes),
    }


def _row_shares(reading: EpisodeReading, about: Mapping[str, Any]) -> dict[str, list[float]]:
    """How each camera's delay follows the row time, {figure: [s per s, row time (s) of the delay]},
    by the surface and by flow: rows above the middle are read earlier, and show joints of an
    earlier time."""
    found = dict(about.get("row_shares", {}))
    for name, film in reading.films.items():
        figure = f"delay/{name}"
        if film.delay is not None:
            by_flow = f"flow/{figure}" if figure in about.get("by_surface", ()) else figure
            found[by_flow] = [film.delay.mean_row, 0.0]
    return {figure: share for figure, share in found.items() if figure in about["figures"]}


def _name_first_camera(name: str, first: str) -> str:
    """A score of the first camera by the name that other checks give it."""
    return f"{name.removesuffix('/camera')}/{first}" if name.endswith("/camera") else name


def _name_beside_surface(name: str) -> str:
    """What flow's score is called beside the surface's."""
    return name.replace("std/", "std/flow/", 1) if name.startswith("std/") else f"flow/{name}"


def _is_role_advice(finding: Finding) -> bool:
    """Whether a finding is advice for robot.toml, which every episode of a dataset would repeat."""
    return finding.severity == "info" and finding.text.startswith("roles, ready for robot.toml")


def episode_evidence(
    reading: EpisodeReading, figures: Mapping[str, list[float | None]]
) -> dict[str, Any]:
    """What the comparison with siblings and the page need, as plain values.

    figures {name: [value, standard error or null, the part of it that siblings share, the joint
    reading that it is about or null]} · joints: names, unit, low and high, t and curves of few
    points · action: the same · cameras {name: thumbnails and the view at rest (JPEG, base64), size,
    stored_hz, arm: whose joints move its picture, of several, delay_profile: log likelihood (nats)
    of the delays by flow, flow_per_motion: how much the picture moves with the joints} ·
    robot: its type, "" if it is not known ·
    statistics {feature: count, min, max, mean, std} · digest: SHA-256 of the numbers as stored.
    `examine_episode` adds by_surface, the figures that are by the robot's surface, faults
    [kind, sensor, size, standard error, unit], what differs from a body, changes {camera: what it
    weighed about that}, and row_shares, how delays follow the row time.
    """
    return {
        "figures": dict(sorted(figures.items())),
        "joints": None if reading.joints is None else _sample_curves(reading.joints),
        "action": None if reading.action is None else _sample_curves(reading.action),
        "cameras": {
            name: _camera_evidence(film.seen) | {"arm": film.arm} | _flow_evidence(film.delay)
            for name, film in reading.films.items()
        },
        "statistics": {
            name: _column_statistics(values) for name, values in reading.features.items()
        },
        "digest": _digest_episode(reading),
        "duration_s": reading.read.duration_s,
        "rows": reading.rows,
        "robot": reading.robot,
    }


def _sample_curves(stored: StoredNumbers) -> dict[str, Any]:
    if not np.isfinite(stored.values).any(axis=0).all() or not len(stored.t):
        return {"names": [], "unit": stored.unit, "low": [], "high": [], "t": [], "curves": []}
    rows = np.unique(np.linspace(0, len(stored.t) - 1, CURVE_POINTS).round().astype(int))
    return {
        "names": list(stored.names),
        "unit": stored.unit,
        "low": _numbers_as_json(np.nanmin(stored.values, axis=0)),
        "high": _numbers_as_json(np.nanmax(stored.values, axis=0)),
        "t": _numbers_as_json(stored.t[rows]),
        "curves": [_numbers_as_json(column) for column in stored.values[rows].T],
    }


def _numbers_as_json(values: Array) -> list[float | None]:
    """Numbers as JSON holds them, to six figures."""
    return [float(f"{value:.6g}") if isfinite(value) else None for value in values.tolist()]


def _camera_evidence(seen: Any) -> dict[str, Any]:
    if seen is None:
        return {"thumbnails": [], "view": None, "size": None, "stored_hz": None}
    return {
        "view": encode_view(picture_at_rest(seen.pictures)),
        "thumbnails": [_thumbnail_as_jpeg(picture) for picture in seen.pictures],
        "size": list(seen.size),
        "stored_hz": seen.repeats.stored_hz,
    }


def _flow_evidence(delay: FlowDelay | None) -> dict[str, Any]:
    if delay is None or not isfinite(delay.flow_per_motion):
        return {"delay_profile": [], "flow_per_motion": None}
    return {
        "delay_profile": [round(nats, 1) for nats in delay.profile],
        "flow_per_motion": float(f"{delay.flow_per_motion:.4g}"),
    }


def _thumbnail_as_jpeg(picture: Array) -> str:
    import cv2

    height, width = picture.shape
    if width > THUMBNAIL_WIDTH_PX:
        size = (THUMBNAIL_WIDTH_PX, max(round(height * THUMBNAIL_WIDTH_PX / width), 1))
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
    done = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
    return base64.b64encode(done.tobytes()).decode()


def _column_statistics(values: Array) -> dict[str, Any]:
    from ..logs.datasets.statistics import of_numbers

    return of_numbers(values)


def _digest_episode(reading: EpisodeReading) -> str | None:
    """The digest of joints and actions as stored; None without joints that move."""
    if reading.joints is None or not np.ptp(np.nan_to_num(reading.joints.values), axis=0).any():
        return None
    found = hashlib.sha256()
    for stored in (reading.joints, reading.action):
        if stored is not None:
            found.update(np.ascontiguousarray(stored.values, "<f8").tobytes())
    return found.hexdigest()
