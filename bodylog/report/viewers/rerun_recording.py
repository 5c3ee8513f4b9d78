"""What Rerun does not draw from a log: the overlay
on images, the belief with its band, errors, events.

The timeline is `message_log_time`, as of Rerun's messages from an MCAP.
"""

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FormatError
from ...overlay_style import BELIEF, PREDICTED, TRUTH, ellipse_corners, measurement_ink
from ...types import Array, Estimate, Features, Frames, LazyImage, Series

ROOT = "bodylog"
"""Root entity beside the log's own topics; joints are below /bodylog/belief and /bodylog/errors."""
TIME = "message_log_time"
_PLANE = "_image_plane"
"""Rerun puts an image of frame X into the frame
X_image_plane; only entities in that frame are drawn on it.
"""
CORNER = 0.5
"""px: Rerun counts from the first pixel's corner, tracks from its centre."""
Event = tuple[int, str, str]
"""Log time in ns, level, text."""


@dataclass(frozen=True)
class RerunCamera:
    """A camera's image topic, its frame_id, which puts
    the overlay into the image's plane, and its frames.

    `frames` is None where there is nothing to decode.
    """

    topic: str
    frame_id: str
    frames: Frames | None = None

    @property
    def entity(self) -> str:
        """Rerun's entity of the images."""
        return _entity_path(*_topic_parts(self.topic))


def write_companion(
    out: Path,
    identity: str,
    unshown: Container[str],
    cameras: Mapping[str, RerunCamera],
    features: Features | None,
    estimate: Estimate | None,
    truth: Series | None,
) -> None:
    """Write the companion of the recording `identity` to `out` (.rrd), with the layout of a window.

    `cameras` have the names before the last / of their tracks' names: "" is the first. Images of
    `unshown` entities are written too.
    """
    import rerun

    stream = rerun.RecordingStream(ROOT, recording_id=identity, send_properties=False)
    stream.save(out)
    for camera in cameras.values():
        if camera.entity in unshown and camera.frames is not None:
            _send_pictures(stream, camera, camera.frames())
    if features is not None:
        _send_measured_points(stream, cameras, features)
    if estimate is not None:
        _send_predicted_points(stream, cameras, estimate)
        _send_belief(stream, estimate, truth)
    _send_events(stream, features, estimate)
    stream.send_blueprint(_window_layout(tuple(cameras.values()), estimate))
    stream.flush()
    stream.disconnect()


def _entity_path(*parts: str) -> str:
    """An entity's path; names from a log are escaped."""
    import rerun

    return str(rerun.new_entity_path(list(parts)))


def _topic_parts(topic: str) -> tuple[str, ...]:
    return tuple(part for part in topic.split("/") if part)


def _send_pictures(stream: Any, camera: RerunCamera, frames: Iterable[LazyImage]) -> None:
    """Images that Rerun cannot read, as JPEG; undecodable ones are left out."""
    import cv2
    import rerun

    if camera.frame_id:
        stream.log(camera.entity, rerun.CoordinateFrame(f"{camera.frame_id}{_PLANE}"), static=True)
    for frame in frames:
        with suppress(FormatError):
            packed = cv2.imencode(".jpg", frame.decode(1))[1].tobytes()
            stream.set_time(TIME, timestamp=np.datetime64(frame.source_ns, "ns"))
            stream.log(camera.entity, rerun.EncodedImage(contents=packed, media_type="image/jpeg"))
    stream.reset_time()


def _send_measured_points(
    stream: Any, cameras: Mapping[str, RerunCamera], features: Features
) -> None:
    """Points at measured places, below the entity of their camera's image."""
    for name, track in features.tracks.items():
        if camera := cameras.get(name.rpartition("/")[0]):
            _send_points(stream, camera, f"{name} seen", track, measurement_ink(name).rgb)


def _send_predicted_points(
    stream: Any, cameras: Mapping[str, RerunCamera], estimate: Estimate
) -> None:
    """Points at predicted places, with their 2-sigma ellipses."""
    for name, track in estimate.predicted.items():
        if camera := cameras.get(name.rpartition("/")[0]):
            _send_points(stream, camera, f"{name} predicted", track, PREDICTED.rgb)
            if name in estimate.predicted_cov:
                _send_ellipses(
                    stream,
                    camera,
                    f"{name} predicted, 2 sigma",
                    track,
                    estimate.predicted_cov[name],
                )


def _send_points(
    stream: Any, camera: RerunCamera, name: str, track: Series, colour: tuple[int, int, int]
) -> None:
    """One point per row; an empty row where nothing was seen, so that no old point stays."""
    import rerun

    seen = np.isfinite(track.values).all(axis=1)
    columns = rerun.Points2D.columns(positions=track.values[seen] + CORNER)
    style = rerun.Points2D.from_fields(colors=[colour], radii=rerun.Radius.ui_points(4.0))
    path = _entity_in_image(stream, camera, name, style)
    stream.send_columns(
        path, [_time_column(track.source_ns)], columns.partition(seen.astype(np.int64))
    )


def _send_ellipses(stream: Any, camera: RerunCamera, name: str, track: Series, cov: Array) -> None:
    import rerun

    known = np.isfinite(track.values).all(axis=1) & np.isfinite(cov).all(axis=(1, 2))
    corners = ellipse_corners(track.values[known] + CORNER, cov[known])
    strips = list(np.concatenate([corners, corners[:, :1]], axis=1))
    columns = rerun.LineStrips2D.columns(strips=strips)
    path = _entity_in_image(
        stream, camera, name, rerun.LineStrips2D.from_fields(colors=[PREDICTED.rgb])
    )
    stream.send_columns(
        path, [_time_column(track.source_ns)], columns.partition(known.astype(np.int64))
    )


def _entity_in_image(stream: Any, camera: RerunCamera, name: str, style: Any) -> str:
    import rerun

    path = _entity_path(*_topic_parts(camera.topic), name)
    stream.log(path, style, static=True)
    if camera.frame_id:
        stream.log(path, rerun.CoordinateFrame(f"{camera.frame_id}{_PLANE}"), static=True)
    return path


def _send_belief(stream: Any, estimate: Estimate, truth: Series | None) -> None:
    ns = estimate.joints.source_ns
    spread = 2.0 * np.sqrt(np.maximum(np.diagonal(estimate.cov, 0, 1, 2), 0.0))
    for m, name in enumerate(estimate.joints.names):
        mean = estimate.joints.values[:, m]
        band = np.stack([mean, mean - spread[:, m], mean + spread[:, m]], axis=1)
        _send_lines(
            stream,
            _entity_path(ROOT, "belief", name),
            ns,
            band,
            (name, "-2 sigma", "+2 sigma"),
            BELIEF.rgb,
        )
        if truth is not None and name in truth.names:
            real = truth.values[:, [truth.names.index(name)]]
            _send_lines(
                stream,
                _entity_path(ROOT, "belief", name, "truth"),
                truth.source_ns,
                real,
                ("truth",),
                TRUTH.rgb,
            )
    for sense, errors in estimate.errors.items():
        _send_lines(
            stream,
            _entity_path(ROOT, "errors", sense),
            errors.source_ns,
            errors.values,
            errors.names,
            None,
        )
    energy = estimate.free_energy[:, None]
    _send_lines(
        stream, _entity_path(ROOT, "energy"), ns, energy, ("free energy, nats",), BELIEF.rgb
    )


def _send_lines(
    stream: Any,
    path: str,
    ns: Array,
    values: Array,
    names: tuple[str, ...],
    colour: tuple[int, int, int] | None,
) -> None:
    """Columns (N,D) as D lines of one entity; the second and later of a coloured one fainter."""
    import rerun

    faint = (
        None if colour is None else [(*colour, 255 if d == 0 else 110) for d in range(len(names))]
    )
    stream.log(path, rerun.SeriesLines(names=list(names), colors=faint), static=True)
    if len(ns):
        columns = rerun.Scalars.columns(scalars=np.asarray(values, float))
        stream.send_columns(path, [_time_column(ns)], columns)


def _send_events(stream: Any, features: Features | None, estimate: Estimate | None) -> None:
    """Touches with their synchrony, and faults, as lines of text."""
    import rerun

    for ns, level, text in list_events(features, estimate):
        stream.set_time(TIME, timestamp=np.datetime64(ns, "ns"))
        stream.log(_entity_path(ROOT, "events"), rerun.TextLog(text, level=level))
    stream.reset_time()


def list_events(features: Features | None, estimate: Estimate | None) -> list[Event]:
    """Every touch and fault, in order of time."""
    felt = () if features is None else _touch_events(features)
    return sorted([*felt, *(() if estimate is None else _fault_events(estimate))])


def _touch_events(features: Features) -> Iterator[Event]:
    pairs = {pair.touch: pair for pair in features.synchrony}
    for i, touch in enumerate(features.touches or ()):
        text = f"touch of cells {', '.join(map(str, touch.cells[:8]))}"
        if i in pairs:
            text += f", seen {pairs[i].delay:+.3f} s later, synchrony {pairs[i].weight:.2f}"
        yield touch.source_ns, "INFO", text


def _fault_events(estimate: Estimate) -> Iterator[Event]:
    rows = np.searchsorted(estimate.joints.t, [fault.since for fault in estimate.faults])
    for fault, row in zip(estimate.faults, rows.tolist(), strict=True):
        ns = int(estimate.joints.source_ns[min(row, len(estimate.joints.t) - 1)])
        yield ns, "WARN", f"{fault.sense} {fault.name}: {fault.kind}, {fault.size:.4g} {fault.unit}"


def _time_column(ns: Array) -> Any:
    import rerun

    return rerun.TimeColumn(TIME, timestamp=np.asarray(ns, np.int64).view("datetime64[ns]"))


def _window_layout(cameras: Sequence[RerunCamera], estimate: Estimate | None) -> Any:
    """The layout: images with overlay, beside belief, errors, free energy and events over time."""
    import rerun.blueprint as rrb

    pictures = [rrb.Spatial2DView(origin=camera.entity, name="picture") for camera in cameras]
    plots = [
        rrb.TimeSeriesView(origin=_entity_path(ROOT, "belief", name), name=f"{name}, rad")
        for name in (estimate.joints.names if estimate else ())
    ] or [rrb.TimeSeriesView(origin="/", name="signals")]
    if estimate is not None:
        plots.append(
            rrb.TimeSeriesView(
                origin=_entity_path(ROOT, "errors"), name="errors, standard deviations"
            )
        )
        plots.append(
            rrb.TimeSeriesView(origin=_entity_path(ROOT, "energy"), name="free energy, nats")
        )
    left = rrb.Vertical(
        *pictures, rrb.TextLogView(origin=_entity_path(ROOT, "events"), name="touches and faults")
    )
    columns = rrb.Horizontal(left, rrb.Vertical(*plots))
    return rrb.Blueprint(columns, rrb.TimePanel(timeline=TIME), collapse_panels=True)
