"""Read annotations back: tracks and touches for a new run, the estimate for scores and reports."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ConfigError, FormatError, LogError
from ..fault_kinds import FORMS, Fault, FaultKind
from ..io.values import reject_impossible
from ..logs.decode.columns import columns_of
from ..logs.formats import open_log
from ..logs.mcap import opcodes as op
from ..logs.mcap.prefix import NAME
from ..logs.mcap.record_file import RecordFile
from ..logs.mcap.records import HEAD, parse_record
from ..logs.protocol import Log
from ..logs.topics import PREFIX, TRACK, unescape_topic_name
from ..types import (
    TRACK_AXES,
    Array,
    Estimate,
    Features,
    Health,
    Poses,
    Series,
    Stroke,
    Synchrony,
    Topic,
    Touch,
)
from .estimate_metadata import read_declared_estimate, type_again
from .messages import (
    ERROR,
    KINEMATIC,
    NAMES_OF_TRACK,
    POSE,
    PREDICTED,
    PREDICTED_NAMES,
    SIZE_OF_UNIT,
)
from .pose_topics import POSED, poses_from_columns

_VECTOR = ("header.stamp", "names", "data")
_FIELDS: Mapping[str, tuple[str, ...]] = {
    "bodylog_msgs/msg/Vector": (*_VECTOR, "header.frame_id"),
    "bodylog_msgs/msg/Covariance": _VECTOR,
    "bodylog_msgs/msg/Scalar": ("header.stamp", "data"),
    "bodylog_msgs/msg/Touch": ("header.stamp", "duration", "cells", "peak"),
    "bodylog_msgs/msg/Stroke": (
        "header.stamp",
        "duration",
        "start.x",
        "start.y",
        "end.x",
        "end.y",
        "delay",
    ),
    "bodylog_msgs/msg/Synchrony": ("header.stamp", "delay", "weight"),
    "bodylog_msgs/msg/Fault": ("header.stamp", "sense", "name", "kind", "size", "unit"),
    POSE: POSED,
    "sensor_msgs/msg/JointState": ("header.stamp", "name", "position", "velocity"),
}
"""Type -> the fields to read back."""


FAULT_DOUBTS = ("std", "turn", "turn_std", "until")
"""Fields of a fault that are NaN where they are not known; the oldest files have none of them."""


def _fields_of_annotation(topic: Topic) -> tuple[str, ...]:
    """The fields of a topic; older faults lack some."""
    fields = _FIELDS[topic.type]
    if topic.type.endswith("/Fault"):
        fields = (
            *fields,
            *(name for name in FAULT_DOUBTS if f"float64 {name}\n".encode() in topic.definition),
        )
    return fields


def read_metadata(path: Path) -> dict[str, str]:
    """The metadata record `bodylog` of an annotated MCAP; LogError without one."""
    try:
        with RecordFile(path) as file:
            _, summary = file.summary()
            listed = [
                r.fields
                for r, _ in summary
                if r.opcode == op.METADATA_INDEX and r.fields["name"] == NAME
            ]
            if listed:
                record = memoryview(file.read(listed[-1]["offset"], listed[-1]["length"]))
                return dict(parse_record(op.METADATA, record[HEAD.size :]).fields["metadata"])
    except (FormatError, OSError):
        pass  # not a whole MCAP, so not one that bodylog wrote
    raise LogError(f"{path}: no estimate in it, unless its end was cut off; {type_again(path)}")


def read_estimate(path: Path, start_ns: int | None = None) -> Estimate:
    """The estimate in an annotated MCAP, t in s since
    `start_ns` (None: the log's own); LogError without one.
    """
    with open_log(path) as log:
        stored = read_declared_estimate(path, read_metadata(path))
        table = _Table(log, log.start_ns if start_ns is None else start_ns, path)
    joints, rate = table.joints()
    size = len(joints.names)
    predicted, predicted_cov = table.predicted()
    return Estimate(
        method=stored.method,
        joints=joints,
        rate=rate,
        cov=table.aligned("joint_covariance", joints, size**2).reshape(-1, size, size),
        errors=table.under(ERROR, "std"),
        free_energy=table.aligned("free_energy", joints, 1).reshape(-1),
        used=stored.used,
        predicted=predicted,
        predicted_cov=predicted_cov,
        settings=stored.settings,
        bias=table.series(PREFIX + "encoder_bias", "rad"),
        faults=table.faults(),
        findings=stored.findings,
        effector=table.effector(),
        kinematic=table.kinematic_predictions(),
        can=stored.can,
    )


def read_features(log: Log, start_ns: int) -> Features | None:
    """Tracks, strokes, touches and synchrony of an earlier
    run in a log, without joints; None without any.
    """
    names = {topic.name for topic in log.topics}
    if not any(name.startswith(TRACK) or name == PREFIX + "touch" for name in names):
        return None
    table = _Table(log, start_ns, log.path)
    tracks = {
        name: _track_from_vector(series, len(series.names) // 2)
        for name, series in table.tracks().items()
    }
    touches = table.touches() if PREFIX + "touch" in names else None
    strokes, paired = table.strokes()
    pairs = table.synchrony(touches or (), paired)
    health = {name: Health(len(c.log_ns), len(c.sound)) for name, c in table.columns.items()}
    return Features(None, tracks, touches, strokes, pairs, health, cameras=table.cameras())


class _Table:
    """Columns of every topic that bodylog wrote into a log."""

    def __init__(self, log: Log, start_ns: int, path: Path) -> None:
        topics = {t.id: t for t in log.topics if t.name.startswith(PREFIX) and t.type in _FIELDS}
        try:
            found = columns_of(
                log,
                {number: (topic, _fields_of_annotation(topic)) for number, topic in topics.items()},
            )
        except (ConfigError, FormatError) as problem:
            raise FormatError(f"{path}: {problem}") from None
        self.columns = {topics[number].name: columns for number, columns in found.items()}
        self.start_ns = start_ns
        self.path = path

    def joints(self) -> tuple[Series, Series]:
        """The belief (N,M) rad and its rate (N,M) rad/s."""
        t, source_ns, (names, position, velocity) = self._rows(PREFIX + "joint_states")
        if position.shape != velocity.shape or position.shape != (len(t), len(names)):
            raise self._unfit(
                PREFIX + "joint_states",
                f"{len(names)} names, arrays {position.shape}, {velocity.shape}",
            )
        return Series(t, position, names, "rad", source_ns), Series(
            t, velocity, names, "rad/s", source_ns
        )

    def series(self, topic: str, unit: str) -> Series | None:
        """A vector topic (N,D), or None if it is missing."""
        if topic not in self.columns:
            return None
        t, source_ns, (names, data, *_) = self._rows(topic)
        if data.shape != (len(t), len(names)):
            raise self._unfit(topic, f"{len(names)} names, {data.shape[1]} values")
        return Series(t, data, names, unit, source_ns)

    def under(self, prefix: str, unit: str) -> dict[str, Series]:
        """All vector topics under a prefix, by the rest of their names."""
        names = [topic for topic in self.columns if topic.startswith(prefix)]
        return {
            unescape_topic_name(name[len(prefix) :]): s
            for name in names
            if (s := self.series(name, unit)) is not None
        }

    def tracks(self) -> dict[str, Series]:
        """Tracks: u, v and their standard deviations (N,4) px, or x, y, z and theirs (N,6) m."""
        found = self.under(TRACK, "")
        for name, series in found.items():
            self._require_names(TRACK + name, series, NAMES_OF_TRACK)
        return {
            name: replace(series, values=reject_impossible(series.values)[0])
            for name, series in found.items()
        }

    def aligned(self, name: str, joints: Series, width: int) -> Array:
        """Values (N,width) for each row of `joints`; LogError when they do not match."""
        t, _, values = self._rows(PREFIX + name)
        data: Array = values[-1].reshape(len(t), values[-1].size // max(1, len(t)))
        if data.shape != (len(joints.t), width) or not np.array_equal(t, joints.t):
            raise LogError(
                f"{self.path}: {PREFIX}{name} does not go with {PREFIX}joint_states; "
                f"{type_again(self.path)}"
            )
        return data

    def predicted(self) -> tuple[dict[str, Series], dict[str, Array]]:
        """Predictions (K,2) px or (K,3) mm with their standard
        deviations, and covariances (K,2,2) px² or (K,3,3) mm².
        """
        series = {}
        cov = {}
        for name, found in self.under(PREDICTED, "").items():
            width = self._require_names(PREDICTED + name, found, PREDICTED_NAMES)
            series[name] = _track_from_vector(found, width)
            std = found.values[:, width : 2 * width] / SIZE_OF_UNIT[width]
            above, right = np.triu_indices(width, 1)
            cov[name] = np.empty((len(found.t), width, width))
            with np.errstate(over="ignore"):  # an absurd error bar of a spoilt log is infinite
                cov[name][:, range(width), range(width)] = std**2
                between = found.values[:, 2 * width :] / SIZE_OF_UNIT[width] ** 2
            cov[name][:, above, right] = between
            cov[name][:, right, above] = between
        return series, cov

    def kinematic_predictions(self) -> dict[str, Series]:
        """Predictions of kinematics alone (K,2) px or (K,3) mm."""
        found = self.under(KINEMATIC, "")
        for name, series in found.items():
            self._require_names(
                KINEMATIC + name, series, {width: axes for width, (axes, _) in TRACK_AXES.items()}
            )
        return {name: _in_track_unit(series) for name, series in found.items()}

    def _require_names(
        self, topic: str, found: Series, names: Mapping[int, tuple[str, ...]]
    ) -> int:
        """The number of a track's columns, by the number of a vector's names."""
        for width, wanted in names.items():
            if len(found.names) == len(wanted):
                return width
        possible = " or ".join(str(len(wanted)) for wanted in names.values())
        raise self._unfit(topic, f"{len(found.names)} names, not {possible}")

    def touches(self) -> tuple[Touch, ...]:
        """Touches in order of onset."""
        found = []
        for part, log_ns in self._parts(PREFIX + "touch"):
            for stamp, lasting, cells, peak, source in zip(*part, log_ns, strict=True):
                if not len(cells):
                    raise self._unfit(PREFIX + "touch", "a touch of no cell")
                onset = (int(stamp) - self.start_ns) / 1e9
                offset = (int(stamp) + int(lasting) - self.start_ns) / 1e9
                numbers = tuple(sorted(int(cell) for cell in cells))
                found.append(Touch(onset, offset, numbers, float(peak), int(cells[0]), int(source)))
        return tuple(sorted(found, key=lambda touch: (touch.onset, touch.strongest)))

    def cameras(self) -> dict[str, str]:
        """The image topics of the tracks, by camera name."""
        named = (
            (topic, part)
            for topic in self.columns
            if topic.startswith(TRACK)
            for part, _ in self._parts(topic)
        )
        found = {
            unescape_topic_name(topic[len(TRACK) :]).rpartition("/")[0]: part[-1][0]
            for topic, part in named
        }
        return {name: camera for name, camera in sorted(found.items()) if camera}

    def strokes(self) -> tuple[tuple[Stroke, ...], Iterator[int]]:
        """Strokes in order, and the numbers of those paired with a touch."""
        found = []
        for part, _ in self._parts(PREFIX + "stroke"):
            for stamp, lasting, u, v, to_u, to_v, delay in zip(
                *(column.tolist() for column in part), strict=True
            ):
                start, end = ((ns - self.start_ns) / 1e9 for ns in (stamp, stamp + lasting))
                found.append((Stroke(start, end, (u, v), (to_u, to_v)), delay))
        found.sort(key=lambda stroke: (stroke[0].start, stroke[0].end))
        paired = (number for number, (_, delay) in enumerate(found) if np.isfinite(delay))
        return tuple(stroke for stroke, _ in found), paired

    def synchrony(self, touches: tuple[Touch, ...], paired: Iterator[int]) -> tuple[Synchrony, ...]:
        """One per touch of the same onset; the `paired` strokes of touches are in their order."""
        waiting: dict[int, list[int]] = {}
        for i, touch in reversed(list(enumerate(touches))):
            waiting.setdefault(round(touch.onset * 1e9), []).append(i)
        found = []
        for (stamp, delay, weight), _ in self._parts(PREFIX + "synchrony"):
            for s, d, w in zip(stamp.tolist(), delay.tolist(), weight.tolist(), strict=True):
                if numbers := waiting.get(s - self.start_ns):
                    found.append(Synchrony(numbers.pop(), None, d, w))
        found.sort(key=lambda pair: pair.touch)
        return tuple(
            replace(p, stroke=next(paired, None)) if np.isfinite(p.delay) else p for p in found
        )

    def faults(self) -> tuple[Fault, ...]:
        """Faults in order of onset."""
        found = []
        for (stamp, sense, name, kind, size, unit, *more), _ in self._parts(PREFIX + "faults"):
            fault_scores = np.stack(
                [*more, *(np.full(len(size), np.nan) for _ in FAULT_DOUBTS[len(more) :])], axis=1
            )
            for since, amount, row in zip(
                (stamp - self.start_ns) / 1e9, size, fault_scores.tolist(), strict=True
            ):
                if (sense[0], kind[0]) not in FORMS:
                    possible = ", ".join(" ".join(form) for form in FORMS)
                    raise self._unfit(
                        PREFIX + "faults",
                        f"sense and kind {sense[0]} {kind[0]}; possible: {possible}",
                    )
                known = (None if value != value else value for value in row)
                sized = float(since), float(amount), unit[0]
                found.append(Fault(sense[0], name[0], FaultKind(kind[0]), *sized, *known))
        return tuple(sorted(found, key=lambda fault: (fault.since, fault.sense, fault.name)))

    def effector(self) -> Poses | None:
        """The effector's poses in the base, or None without any."""
        columns = self.columns.get(PREFIX + "effector_pose")
        return None if columns is None else poses_from_columns(columns, self.start_ns)

    def _unfit(self, topic: str, found: str) -> LogError:
        return LogError(f"{self.path}: {topic}: {found}; {type_again(self.path)}")

    def _parts(self, topic: str) -> list[tuple[tuple[Any, ...], Array]]:
        columns = self.columns.get(topic)
        return (
            [(part.values, columns.log_ns[part.rows]) for part in columns.parts] if columns else []
        )

    def _rows(self, topic: str) -> tuple[Array, Array, tuple[Any, ...]]:
        """t (N,), log times (N,) and the other fields
        of a topic with constant names, in order of t.
        """
        if topic not in self.columns:
            raise _no_estimate_error(self.path)
        parts = self._parts(topic)
        if len(parts) != 1:
            raise LogError(
                f"{self.path}: {topic} has {len(parts)} sets of names, not 1; "
                f"{type_again(self.path)}"
            )
        (stamp, *values), log_ns = parts[0]
        order = np.argsort(stamp, kind="stable")
        sorted_values = tuple(v if isinstance(v, tuple) else v[order] for v in values)
        return (stamp[order] - self.start_ns) / 1e9, log_ns[order], sorted_values


def _track_from_vector(found: Series, width: int) -> Series:
    """u, v (N,2) px, or x, y, z (N,3) mm, and their standard
    deviations from a vector topic; unknown ones are None.
    """
    std = found.values[:, width : 2 * width]
    place = replace(found, values=found.values[:, :width])
    known = replace(found, values=std) if np.isfinite(std).any() else None
    own = _in_track_unit(place)
    return own if known is None else replace(own, std=_in_track_unit(known).values)


def _in_track_unit(found: Series) -> Series:
    """A vector of u, v, or of x, y, z in m, with its names and in px or mm."""
    width = found.values.shape[1]
    names, unit = TRACK_AXES[width]
    return replace(found, names=names, unit=unit, values=found.values / SIZE_OF_UNIT[width])


def _no_estimate_error(path: Path) -> LogError:
    return LogError(f"{path}: no {PREFIX} topics of an estimate; {type_again(path)}")
