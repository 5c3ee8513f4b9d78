"""One stream per role on a common clock: columns read in one pass, every message accounted for."""

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from itertools import islice
from typing import NamedTuple

import numpy as np

from ..errors import BodylogError, ConfigError, FormatError, LogError
from ..io.values import reject_impossible
from ..logs.decode.columns import Source, columns_of, read_topic_columns
from ..logs.decode.parts import TopicColumns
from ..logs.images import messages
from ..logs.joint_units import UNIT, joint_unit
from ..logs.joint_units import parse_count_unit as counted
from ..logs.limits import Input
from ..logs.protocol import Log
from ..logs.records import Array, Batch, Finding, Topic
from ..logs.tables.frame_columns import poses_of_quaternions, sound_poses
from ..logs.topics import has_independent_poses
from ..settings import Settings
from . import role_values
from .clock_steps import ClockStep, Mended, Times, mend_clocks
from .clocks import Timing, order_by_time, stamp_field
from .roles import Role, pose_field, topic_name

_MINUTE = 60_000_000_000
_JOINT_FIELDS = ("name", "position")
_CHILD = re.compile(r"child_frame_id==[\"']([^\"']+)[\"']")
_PLACES = ("position", "translation")
_TURNS = ("orientation", "rotation")


class Stream(NamedTuple):
    """One role's messages in time order: values (m,D),
    log_ns (m,), and the counts behind its health.

    steps: of its clocks, which are taken out of its times; log_ns is as recorded.
    """

    role: Role
    timing: Timing
    values: Array
    names: tuple[str, ...]
    log_ns: Array
    rows: Array
    counts: tuple[int, ...]
    rejected: Mapping[str, int]
    fallback: int
    beyond: int
    wraps: Mapping[str, int]
    sets: tuple[role_values.JointNameSet, ...]
    unit: str
    shifted_s: float = 0.0
    steps: tuple[ClockStep, ...] = ()


def read_streams(
    log: Source, found: Mapping[str, Role], settings: Settings, name: str
) -> tuple[dict[str, Stream], tuple[Finding, ...]]:
    """The roles of a log with usable messages, and findings on guessed roles without any.

    LogError when a role named in robot.toml has none.
    """
    alone = sum(role.role == "joints" for role in found.values()) < 2
    read = _read_role_columns(log, found, name)
    signals = {
        role: _signal_in_file_order(*source, settings, name, alone) for role, source in read.items()
    }
    mended = mend_clocks(
        {role: _times_of_signal(*read[role], signal) for role, signal in signals.items()}
    )
    timing = _reject_falling_streams(
        {
            role: _date_stream(*read[role], signals[role], mended[role], settings, name)
            for role in read
        }
    )
    usable = {role: stream for role, stream in timing.items() if len(stream.timing.t_ns)}
    empty = (
        _finding_on_empty_stream(stream, settings, name)
        for role, stream in timing.items()
        if role not in usable
    )
    return _one_epoch(usable), tuple(empty)


def joints_of(log: Log) -> Callable[[Topic], tuple[str, ...]]:
    """The joints in a JointState topic's first messages; "" for each position without a name."""

    def names(topic: Topic) -> tuple[str, ...]:
        try:
            found = read_topic_columns(_Beginning(log), topic, ("name", "position"))
        except BodylogError:
            return ()
        nameless = max((np.shape(part.values[1])[-1] for part in found.parts), default=0)
        named = [
            name
            for part in found.parts
            if isinstance(part.values[0], tuple)
            for name in part.values[0]
        ]
        return tuple(dict.fromkeys(named)) or ("",) * nameless

    return names


class _Beginning(NamedTuple):
    """The first batch of a log."""

    log: Log

    def batches(self, ids: Collection[int]) -> Iterator[Batch]:
        return islice(self.log.batches(ids), 1)


def _read_role_columns(
    log: Source, found: Mapping[str, Role], name: str
) -> dict[str, tuple[Role, tuple[TopicColumns, ...]]]:
    fields: dict[int, dict[str, None]] = {}
    topics = {topic.id: topic for role in found.values() for topic in role.topics}
    for role in found.values():
        for topic in role.topics:
            stamp = stamp_field(topic)
            wanted = dict.fromkeys([stamp] if stamp else []) | dict.fromkeys(_fields_of_role(role))
            fields.setdefault(topic.id, {}).update(wanted)
    try:
        read = columns_of(log, {id_: (topics[id_], tuple(names)) for id_, names in fields.items()})
    except ConfigError as problem:
        asked = ", ".join(f'{role.role} = "{role.path}"' for role in found.values() if role.field)
        raise ConfigError(f"{name}: [topics] {asked}: {problem}") from problem
    except FormatError as problem:
        raise FormatError(f"{name}: {problem}") from problem
    return {
        name: (role, tuple(read[topic.id] for topic in role.topics)) for name, role in found.items()
    }


def _fields_of_role(role: Role) -> tuple[str, ...]:
    if role.role == "camera":
        return (messages.text_field(role.topics[0]),)
    if paths := pose_paths(role):
        return paths
    return (role.field,) if role.field else _JOINT_FIELDS


def _signal_in_file_order(
    role: Role, read: tuple[TopicColumns, ...], settings: Settings, name: str, alone: bool
) -> role_values.RoleSignal:
    """A role's values and stamps in the file's order."""
    stamp = stamp_field(role.topics[0])
    found = list(role_values.read_blocks(read, stamp, _fields_of_role(role)))
    return _signal_of_blocks(role, found, settings, f"{name}: {role.topic}", alone)


def _times_of_signal(
    role: Role, read: tuple[TopicColumns, ...], signal: role_values.RoleSignal
) -> Times:
    """The times of a signal's messages; a table of still poses has no clock."""
    log_ns = np.concatenate([some.log_ns for some in read])[signal.rows]
    if has_independent_poses(role.topics):
        return Times(log_ns[:0], None)
    ends = np.cumsum([len(some.log_ns) for some in read])[:-1]
    return Times(log_ns, signal.stamp_ns, tuple(np.searchsorted(signal.rows, ends).tolist()))


def _date_stream(
    role: Role,
    read: tuple[TopicColumns, ...],
    signal: role_values.RoleSignal,
    mended: Mended,
    settings: Settings,
    name: str,
) -> Stream:
    """The messages of one role in time order, in the role's unit."""
    log_ns = np.concatenate([some.log_ns for some in read])
    choice = getattr(settings.time, role.role)
    if choice == "header" and signal.stamp_ns is None and len(signal.rows):
        raise LogError(
            f'{name}: [time] {role.role} = "header", but {role.topic} has no header; use '
            '"log" or "auto"'
        )
    by_name = role.role in ("joints", "truth", "reference")
    if has_independent_poses(role.topics):
        mended = Mended(log_ns[signal.rows], signal.stamp_ns)
    timing = order_by_time(mended.log_ns, mended.stamp_ns, choice, distinct=not by_name)
    values = signal.values[timing.rows]
    idle = 0
    beyond = 0
    wraps = dict[str, int]()
    # true angles are in rad or degrees, never in encoder counts
    unit_text = (
        settings.body.unit
        if role.role == "joints" or counted(settings.body.unit) is None
        else "rad"
    )
    # coordinates of a frame are in m and rad, whatever the unit of a robot's joints is
    about = {UNIT: "rad"} if pose_paths(role) else role.topics[0].metadata
    unit = joint_unit(about, unit_text)
    if by_name:
        converted = values if unit.factor == 1.0 else (values - unit.zero) * unit.factor
        keep, values, idle = role_values.merge_equal_stamps(timing.t_ns, converted)
        timing = timing._replace(t_ns=timing.t_ns[keep], rows=timing.rows[keep])
        values, beyond, turns = role_values.unwrap_angles(
            values[keep], None if has_independent_poses(role.topics) else unit.turn
        )
        wraps = {
            joint: int(count) for joint, count in zip(signal.names, turns, strict=True) if count
        }
    elif values.dtype.kind == "f":
        values, beyond = reject_impossible(values)
    rejected = sum(
        (Counter(some.rejected) for some in read),
        Counter(signal.rejected) + Counter(timing.rejected),
    )
    rejected.update({"same stamp again": idle} if idle else {})
    rows = signal.rows[timing.rows]
    counts = tuple(len(some.log_ns) for some in read)
    slow = sum(some.fallback for some in read)
    return Stream(
        role,
        timing,
        values,
        signal.names,
        log_ns[rows],
        rows,
        counts,
        dict(rejected),
        slow,
        beyond,
        wraps,
        signal.sets,
        unit.unit if by_name else "",
        steps=mended.steps,
    )


def _signal_of_blocks(
    role: Role, found: list[role_values.Block], settings: Settings, what: str, alone: bool
) -> role_values.RoleSignal:
    if role.role == "camera":
        seen = {str(text) for _, _, (names,) in found for text in names}
        return role_values.signal_of_texts(
            found, {text: messages.explain_refused_image(role.topics[0], text) for text in seen}
        )
    if not role.field:
        wanted = settings.body.joints if alone or role.role != "joints" else None
        return role_values.joints_by_name(
            found, wanted, what, role.role == "joints", settings.input
        )
    if pose_paths(role):
        wanted = settings.body.joints if alone else None
        return signal_of_poses(role, found, wanted, what, settings.input)
    signal = role_values.signal_of_arrays(found)
    if role.role == "skin" or not len(signal.rows):
        return role_values.reject_non_proximities(signal) if role.unsure else signal
    nameless = [(signal.rows, signal.stamp_ns, ((), signal.values))]
    return role_values.joints_by_name(nameless, settings.body.joints, what, limits=settings.input)


def _finding_on_empty_stream(stream: Stream, settings: Settings, name: str) -> Finding:
    why = rejection_reasons(stream) or "it is empty"
    role = stream.role
    if getattr(settings.topics, role.role) is not None:
        raise LogError(f"{name}: no usable message on {role.topic}: {why}")
    return Finding(
        "warning", f"{role.role}: {role.topic} was considered, but has no usable message: {why}"
    )


def _reject_falling_streams(found: dict[str, Stream]) -> dict[str, Stream]:
    """Reject streams whose times fall while others'
    rise; if all fall, the file is stored backwards.
    """
    falling = [role for role, stream in found.items() if stream.timing.falls]
    if len(falling) == len([stream for stream in found.values() if len(stream.rows)]):
        return found
    return found | {role: _reject_all_messages(found[role]) for role in falling}


def _reject_all_messages(stream: Stream) -> Stream:
    """The stream with all its messages rejected."""
    none = stream.timing._replace(t_ns=stream.timing.t_ns[:0], rows=stream.timing.rows[:0])
    rejected = Counter(stream.rejected) + Counter({"time runs backwards": len(stream.rows)})
    return stream._replace(
        timing=none,
        values=stream.values[:0],
        log_ns=stream.log_ns[:0],
        rows=stream.rows[:0],
        rejected=rejected,
    )


def _one_epoch(found: dict[str, Stream]) -> dict[str, Stream]:
    """Shift streams whose clocks are over a minute
    apart to the first one's, through their log times.
    """
    behind = {
        role: (s.timing.offset_ns or 0) if s.timing.clock == "header" else 0
        for role, s in found.items()
    }
    first = next(iter(behind.values()), 0)
    return {role: _shift_stream(stream, behind[role] - first) for role, stream in found.items()}


def _shift_stream(stream: Stream, by_ns: int) -> Stream:
    if abs(by_ns) < _MINUTE:
        return stream
    return stream._replace(
        timing=stream.timing._replace(t_ns=stream.timing.t_ns + by_ns), shifted_s=by_ns / 1e9
    )


def rejection_reasons(stream: Stream) -> str:
    """How many messages of a stream were rejected, by reason."""
    return ", ".join(f"{count} ({reason})" for reason, count in sorted(stream.rejected.items()))


def pose_paths(role: Role) -> tuple[str, ...]:
    """Paths to a pose's place x, y, z and quaternion x, y, z, w; empty for other joints."""
    if role.role != "joints" or not role.field or pose_field(role.topics[0]) is None:
        return ()
    which = int(role.field.endswith("transform"))
    place = (f"{role.field}.{_PLACES[which]}.{axis}" for axis in "xyz")
    return (*place, *(f"{role.field}.{_TURNS[which]}.{axis}" for axis in "xyzw"))


def frame_name(role: Role) -> str:
    """The frame whose poses a role holds: tf's child, or the topic's name."""
    child = _CHILD.search(role.field)
    return topic_name(role.topic) if child is None else child[1]


def signal_of_poses(
    role: Role,
    found: Sequence[role_values.Block],
    wanted: tuple[str, ...] | None,
    what: str,
    limits: Input,
) -> role_values.RoleSignal:
    """The six coordinates of a frame, m and rad; messages without a sound pose are counted."""
    rejected: Counter[str] = Counter()
    blocks = list[role_values.Block]()
    for rows, stamps, values in found:
        columns = [np.asarray(one).reshape(len(rows), -1) for one in values]
        if any(one.shape[1] != 1 or one.dtype.kind not in "fiu" for one in columns):
            rejected["not in the message, or several times"] += len(rows)
            continue
        blocks.append((rows, stamps, (np.hstack(columns),)))
    signal = role_values.signal_of_arrays(blocks)
    if not len(signal.rows):
        return signal._replace(rejected=Counter(signal.rejected) + rejected)
    place = signal.values[:, :3]
    turn = signal.values[:, 3:]
    sound = sound_poses(place, turn)
    rejected["a pose beyond 50 m, or a quaternion whose length is not 1"] += int((~sound).sum())
    stamps = None if signal.stamp_ns is None else signal.stamp_ns[sound]
    poses = poses_of_quaternions(frame_name(role), place[sound], turn[sound], what)
    coordinates = poses.coordinates
    block = (
        signal.rows[sound],
        stamps,
        (tuple(coordinates), np.column_stack(list(coordinates.values()))),
    )
    chosen = [block] if sound.any() else []
    named = role_values.joints_by_name(chosen, wanted, what, limits=limits)
    return named._replace(rejected=Counter(named.rejected) + Counter(signal.rejected) + rejected)
