"""Features and estimates as messages, each at the time of the message that caused it."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from .. import overlay_style
from ..logs.encode import cdr
from ..logs.encode.cdr import CdrField, Payloads
from ..logs.encode.schemas import ros2msg_definition
from ..logs.topics import POINT_NAMES, PREFIX, TRACK, TRACK_NAMES, escape_topic_name
from ..overlay_style import CORNERS, ellipse_corners, measurement_ink
from ..types import (
    MM_PER_M,
    Array,
    Estimate,
    Fault,
    Features,
    Outgoing,
    Poses,
    Series,
    Synchrony,
    Touch,
)

PREDICTED = PREFIX + "predicted/"
KINEMATIC = PREFIX + "kinematics/"
ERROR = PREFIX + "prediction_error/"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
ANNOTATIONS = PREFIX + "annotations"
NAMES_OF_TRACK = {2: TRACK_NAMES, 3: POINT_NAMES}
PREDICTED_NAMES = {2: (*TRACK_NAMES, "cov_uv"), 3: (*POINT_NAMES, "cov_xy", "cov_xz", "cov_yz")}
"""Names of a track's vectors by its number of columns: px, or m."""
SIZE_OF_UNIT = {2: 1.0, 3: 1.0 / MM_PER_M}
"""What a track's unit is in its messages: px stay px, mm become m."""
_PREDICTED = (*overlay_style.PREDICTED.image, 1.0)
_CLEAR = (0.0, 0.0, 0.0, 0.0)
_LINE_LOOP = 2
_Circle = tuple[tuple[float, ...], float, Array]
"""Colour, diameter (px), centre (n,2) px."""


def from_features(features: Features, start_ns: int) -> list[Outgoing]:
    """Tracks, sightings, strokes, touches and synchrony;
    the frame_id of image positions is the camera.
    """
    out = [
        from_track(name, track, start_ns, _frame_id_of_track(name, features))
        for name, track in features.tracks.items()
    ]
    for name in ("effector", "hand"):
        if name in features.tracks:
            out.append(
                _points_message(
                    PREFIX + name,
                    features.tracks[name],
                    start_ns,
                    _frame_id_of_track(name, features),
                )
            )
    if features.hand is not None:
        out.append(_strokes_message(features, features.hand, start_ns))
    if features.touches is not None:
        out.append(_touches_message(features.touches, start_ns))
        out.append(_synchrony_message(features.synchrony, features.touches, start_ns))
    return out


def from_estimate(estimate: Estimate, features: Features, start_ns: int) -> list[Outgoing]:
    """Belief, covariance, errors, predictions, faults, and
    each camera's overlay of seen and predicted positions.
    """
    joints = estimate.joints
    out = [
        from_joints(PREFIX + "joint_states", joints, start_ns, estimate.rate.values),
        _named_vector_message(
            PREFIX + "joint_covariance",
            "Covariance",
            joints,
            estimate.cov.reshape(len(joints.t), -1),
            start_ns,
        ),
        _scalar_message(PREFIX + "free_energy", joints, estimate.free_energy, start_ns),
    ]
    out += [
        _named_vector_message(ERROR + escape_topic_name(sense), "Vector", e, e.values, start_ns)
        for sense, e in estimate.errors.items()
    ]
    if estimate.bias is not None:
        out.append(
            _named_vector_message(
                PREFIX + "encoder_bias", "Vector", estimate.bias, estimate.bias.values, start_ns
            )
        )
    for name, series in estimate.predicted.items():
        out.append(
            _predicted_message(
                name,
                series,
                estimate.predicted_cov.get(name),
                start_ns,
                _frame_id_of_track(name, features),
            )
        )
    if (predicted := estimate.predicted.get("effector")) is not None:
        out.append(
            _points_message(
                PREFIX + "effector_predicted",
                predicted,
                start_ns,
                _frame_id_of_track("effector", features),
            )
        )
    for name, kinematic in estimate.kinematic.items():
        values = kinematic.values * SIZE_OF_UNIT[kinematic.values.shape[1]]
        topic = KINEMATIC + escape_topic_name(name)
        out.append(_named_vector_message(topic, "Vector", kinematic, values, start_ns))
    if estimate.effector is not None:
        out.append(_poses_message(PREFIX + "effector_pose", estimate.effector, start_ns))
    if estimate.faults:
        out.append(_faults_message(estimate.faults, joints, start_ns))
    return [*out, *_overlays_by_camera(estimate, features.tracks, start_ns)]


def _camera_of_track(name: str) -> str:
    """The camera of a track camera/feature; "" is the first one."""
    return name.rpartition("/")[0]


def _frame_id_of_track(name: str, features: Features) -> str:
    """The topic of a track's camera; "" if unknown."""
    return features.cameras.get(_camera_of_track(name), "")


def _overlays_by_camera(
    estimate: Estimate, tracks: Mapping[str, Series], start_ns: int
) -> Iterator[Outgoing]:
    for camera in sorted({_camera_of_track(name) for name in (*tracks, *estimate.predicted)}):
        seen, predicted = (
            {
                name: series
                for name, series in found.items()
                if _camera_of_track(name) == camera and series.unit == "px"
            }
            for found in (tracks, estimate.predicted)
        )
        if not seen and not predicted:
            continue  # a tracker of points in space has no images
        times, payloads = draw_image_annotations(seen, predicted, estimate.predicted_cov, start_ns)
        topic = "/".join(filter(None, (ANNOTATIONS, escape_topic_name(camera))))
        yield _make_outgoing(topic, "foxglove_msgs/msg/ImageAnnotations", times, payloads)


def from_joints(topic: str, joints: Series, start_ns: int, rate: Array | None = None) -> Outgoing:
    """Joint angles (N,M) as sensor_msgs/JointState, with velocity where `rate` (N,M) is given."""
    # NaN instead of an empty array: pybag cannot read a message that ends in an empty array.
    unknown = np.full(joints.values.shape, np.nan)
    fields: list[CdrField] = [
        *cdr.cdr_header_field(stamps_ns(joints.t, start_ns)),
        ("string[]", joints.names),
        ("float64[]", joints.values),
        ("float64[]", unknown if rate is None else rate),
        ("float64[]", unknown),
    ]
    return _serialise_rows(topic, "sensor_msgs/msg/JointState", joints.source_ns, fields)


def from_skin(topic: str, skin: Series, start_ns: int) -> Outgoing:
    """Proximity (N,cells) 0..1 as bodylog_msgs/SkinArray."""
    fields: list[CdrField] = [
        *cdr.cdr_header_field(stamps_ns(skin.t, start_ns)),
        ("float32[]", skin.values),
    ]
    return _serialise_rows(topic, "bodylog_msgs/msg/SkinArray", skin.source_ns, fields)


def stamps_ns(t: Array, start_ns: int) -> Array:
    """Times in s since start_ns as int64 ns since the epoch."""
    return start_ns + np.rint(np.asarray(t, float) * 1e9).astype(np.int64)


def from_track(name: str, track: Series, start_ns: int, frame: str) -> Outgoing:
    """Positions (N,2) px, or (N,3) mm, of a track with their
    standard deviations as bodylog_msgs/Vector, px or m.
    """
    std = np.full_like(track.values, np.nan) if track.std is None else track.std
    width = track.values.shape[1]
    data = np.hstack([track.values, std]) * SIZE_OF_UNIT[width]
    return _vector_message(
        TRACK + escape_topic_name(name), track, NAMES_OF_TRACK[width], data, start_ns, frame
    )


def _predicted_message(
    name: str, series: Series, cov: Array | None, start_ns: int, frame: str
) -> Outgoing:
    width = series.values.shape[1]
    size = SIZE_OF_UNIT[width]
    if cov is None:
        cov = np.full((len(series.t), width, width), np.nan)
    std = np.sqrt(np.einsum("ndd->nd", cov))
    between = cov[:, *np.triu_indices(width, 1)]
    data = np.hstack([series.values * size, std * size, between * size**2])
    return _vector_message(
        PREDICTED + escape_topic_name(name), series, PREDICTED_NAMES[width], data, start_ns, frame
    )


def _points_message(topic: str, track: Series, start_ns: int, frame: str) -> Outgoing:
    seen = np.isfinite(track.values).all(1)
    width = track.values.shape[1]
    point = np.zeros((seen.sum(), 3))
    point[:, :width] = track.values[seen] * SIZE_OF_UNIT[width]
    fields: list[CdrField] = [
        *cdr.cdr_header_field(stamps_ns(track.t[seen], start_ns), frame),
        ("float64*", point),
    ]
    return _serialise_rows(topic, "geometry_msgs/msg/PointStamped", track.source_ns[seen], fields)


def _named_vector_message(
    topic: str, kind: str, series: Series, data: Array, start_ns: int
) -> Outgoing:
    return _vector_message(topic, series, series.names, data, start_ns, "", kind)


def _vector_message(
    topic: str,
    series: Series,
    names: Sequence[str],
    data: Array,
    start_ns: int,
    frame: str,
    kind: str = "Vector",
) -> Outgoing:
    fields: list[CdrField] = [
        *cdr.cdr_header_field(stamps_ns(series.t, start_ns), frame),
        ("string[]", names),
        ("float64[]", data),
    ]
    return _serialise_rows(topic, f"bodylog_msgs/msg/{kind}", series.source_ns, fields)


def _scalar_message(topic: str, series: Series, data: Array, start_ns: int) -> Outgoing:
    fields: list[CdrField] = [
        *cdr.cdr_header_field(stamps_ns(series.t, start_ns)),
        ("float64", data),
    ]
    return _serialise_rows(topic, "bodylog_msgs/msg/Scalar", series.source_ns, fields)


def _poses_message(topic: str, poses: Poses, start_ns: int) -> Outgoing:
    """Poses with their covariance, rows and columns
    in ROS's order: x, y, z, rotations about x, y, z.
    """
    count = len(poses.t)
    cov = np.zeros((count, 36)) if poses.cov is None else poses.cov.reshape(count, 36)
    fields: list[CdrField] = [
        *cdr.cdr_header_field(stamps_ns(poses.t, start_ns), poses.frame),
        ("float64*", np.column_stack([poses.place, poses.turn, cov])),
    ]
    return _serialise_rows(topic, POSE, poses.source_ns, fields)


def _strokes_message(features: Features, hand: Series, start_ns: int) -> Outgoing:
    """Strokes with the delay of the paired touch, each logged at the image in which it began."""
    delays = {pair.stroke: pair.delay for pair in features.synchrony}
    start, end = (
        np.array([getattr(s, side) for s in features.strokes], float) for side in ("start", "end")
    )
    start_stamps = stamps_ns(start, start_ns)
    places = [(*s.start_px, 0.0, *s.end_px, 0.0) for s in features.strokes]
    fields: list[CdrField] = [
        *cdr.cdr_header_field(start_stamps, _frame_id_of_track("hand", features)),
        *cdr.cdr_time_field(stamps_ns(end, start_ns) - start_stamps),
        ("float64*", np.array(places).reshape(-1, 6)),
        ("float64", np.array([delays.get(number, np.nan) for number in range(len(start_stamps))])),
    ]
    pictures = np.maximum(np.searchsorted(hand.t, start, "right") - 1, 0)
    return _serialise_rows(
        PREFIX + "stroke", "bodylog_msgs/msg/Stroke", hand.source_ns[pictures], fields
    )


def _touches_message(touches: Sequence[Touch], start_ns: int) -> Outgoing:
    parts = []
    for i, touch in enumerate(touches):
        onset, offset = stamps_ns(np.array([[touch.onset], [touch.offset]]), start_ns)
        cells = [touch.strongest, *(cell for cell in touch.cells if cell != touch.strongest)]
        fields: list[CdrField] = [
            *cdr.cdr_header_field(onset),
            *cdr.cdr_time_field(offset - onset),
            ("int32[]", np.array([cells])),
            ("float32", touch.peak),
        ]
        parts.append((np.array([i]), cdr.serialise_messages(1, fields)))
    times = np.array([touch.source_ns for touch in touches], np.int64)
    return _make_outgoing(
        PREFIX + "touch", "bodylog_msgs/msg/Touch", times, cdr.merge_payloads(parts, len(touches))
    )


def _synchrony_message(
    synchrony: Sequence[Synchrony], touches: Sequence[Touch], start_ns: int
) -> Outgoing:
    caused = [touches[s.touch] for s in synchrony]
    fields: list[CdrField] = [
        *cdr.cdr_header_field(stamps_ns(np.array([touch.onset for touch in caused]), start_ns)),
        ("float64", np.array([s.delay for s in synchrony])),
        ("float64", np.array([s.weight for s in synchrony])),
    ]
    times = np.array([touch.source_ns for touch in caused], np.int64)
    return _serialise_rows(PREFIX + "synchrony", "bodylog_msgs/msg/Synchrony", times, fields)


def _faults_message(faults: Sequence[Fault], joints: Series, start_ns: int) -> Outgoing:
    parts = []
    for i, fault in enumerate(faults):
        fields: list[CdrField] = [
            *cdr.cdr_header_field(stamps_ns(np.array([fault.since]), start_ns)),
            ("string", fault.sense),
            ("string", fault.name),
            ("string", fault.kind),
            ("float64", fault.size),
            ("string", fault.unit),
            *(("float64", np.nan if v is None else v) for v in _optional_fault_fields(fault)),
        ]
        parts.append((np.array([i]), cdr.serialise_messages(1, fields)))
    last = np.searchsorted(joints.t, [fault.since for fault in faults], "right") - 1
    times = joints.source_ns[np.maximum(last, 0)]
    return _make_outgoing(
        PREFIX + "faults", "bodylog_msgs/msg/Fault", times, cdr.merge_payloads(parts, len(faults))
    )


def _optional_fault_fields(fault: Fault) -> tuple[float | None, ...]:
    """What may be unknown of a fault, in the order of its message."""
    return fault.std, fault.turn, fault.turn_std, fault.until


def _serialise_rows(topic: str, kind: str, log_ns: Array, fields: Sequence[CdrField]) -> Outgoing:
    return _make_outgoing(topic, kind, log_ns, cdr.serialise_messages(len(log_ns), fields))


def _make_outgoing(topic: str, kind: str, log_ns: Array, payloads: Payloads) -> Outgoing:
    log_ns = np.asarray(log_ns, np.int64)
    order = np.argsort(log_ns, kind="stable")
    return Outgoing(
        topic,
        kind,
        ros2msg_definition(kind),
        log_ns[order],
        payloads.data,
        payloads.offset[order],
        payloads.length[order],
    )


def draw_image_annotations(
    seen: Mapping[str, Series],
    predicted: Mapping[str, Series],
    cov: Mapping[str, Array],
    start_ns: int,
) -> tuple[Array, Payloads]:
    """Log times (n,) of all frames, and one ImageAnnotations for each: a circle per feature seen or
    predicted, and the prediction's 2-sigma ellipse."""
    tracks = [*seen.values(), *predicted.values()]
    times, first = np.unique(
        np.concatenate([track.source_ns for track in tracks]), return_index=True
    )
    stamp = start_ns + np.rint(np.concatenate([track.t for track in tracks])[first] * 1e9).astype(
        np.int64
    )
    circles: list[_Circle] = [
        ((*measurement_ink(name).image, 1.0), 16.0, _values_at_log_times(times, track))
        for name, track in seen.items()
    ]
    circles += [
        (_PREDICTED, 8.0, _values_at_log_times(times, track)) for track in predicted.values()
    ]
    loops = [
        _values_at_log_times(times, series, _ellipse_corners(series, cov[name]))
        for name, series in predicted.items()
        if name in cov
    ]
    return times, _serialise_by_layout(stamp, circles, loops)


def _values_at_log_times(times: Array, track: Series, values: Array | None = None) -> Array:
    """A track's values (n,D) at the common log times; NaN where it has none."""
    values = track.values if values is None else values
    out = np.full((len(times), values.shape[1]), np.nan)
    out[np.searchsorted(times, track.source_ns)] = values
    return out


def _ellipse_corners(series: Series, cov: Array) -> Array:
    """Corners (K,2*CORNERS) px of 2-sigma ellipses of cov (K,2,2) px² around predictions."""
    return ellipse_corners(series.values, cov).reshape(len(cov), -1)


def _serialise_by_layout(stamp: Array, circles: list[_Circle], loops: list[Array]) -> Payloads:
    """One serialisation per group of frames that show the same parts and so have one layout."""
    shown = np.column_stack(
        [np.isfinite(values).all(1) for values in [*(c[2] for c in circles), *loops]]
    )
    packed = np.packbits(shown, axis=1)
    # as one text each: sorting rows of bits is slow
    kind_of = packed.view(f"S{packed.shape[1]}")[:, 0]
    parts = []
    for rows in (np.flatnonzero(kind_of == number) for number in np.unique(kind_of)):
        kind = shown[rows[0]]
        round_parts = [c for c, there in zip(circles, kind, strict=False) if there]
        loop_parts = [
            loop for loop, there in zip(loops, kind[len(circles) :], strict=True) if there
        ]
        fields: list[CdrField] = [("uint32", len(round_parts))]
        for colour, diameter, centre in round_parts:
            fields += _circle_fields(stamp[rows], centre[rows], diameter, colour)
        fields.append(("uint32", len(loop_parts)))
        for loop in loop_parts:
            fields += _loop_fields(stamp[rows], loop[rows])
        fields.append(("uint32", 0))
        parts.append((rows, cdr.serialise_messages(len(rows), fields)))
    return cdr.merge_payloads(parts, len(stamp))


def _circle_fields(
    stamp: Array, centre: Array, diameter: float, colour: tuple[float, ...]
) -> list[CdrField]:
    shape = [diameter, 2.0, *_CLEAR, *colour]
    return [*cdr.cdr_time_field(stamp), ("float64*", centre), ("float64*", np.array([shape]))]


def _loop_fields(stamp: Array, corners: Array) -> list[CdrField]:
    return [
        *cdr.cdr_time_field(stamp),
        ("uint8", _LINE_LOOP),
        ("uint32", CORNERS),
        ("float64*", corners),
        ("float64*", np.array([_PREDICTED])),
        ("uint32", 0),
        ("float64*", np.array([[*_CLEAR, 1.5]])),
    ]
