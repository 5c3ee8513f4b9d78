"""Merge joints of several topics into one signal at common times."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..errors import ConfigError, LogError
from ..settings import Settings
from ..types import Array, Series
from .clocks import seconds_since
from .dated_streams import Stream
from .joint_names import JOINTS, topic_name
from .joint_topics import common_unit, own_names, streams_of


def merge_joint_series(
    streams: Mapping[str, Stream], settings: Settings, start_ns: int, what: str
) -> Series | None:
    """The joints (N,M) rad of all topics at all of their times,
    NaN where a topic has no reading; None without joints.

    LogError when [body] joints names a missing joint.
    """
    found = streams_of(streams)
    _check_delay_topics(found, settings, what)
    if len(found) < 2:
        return None if not found else _series_of_single_topic(found[0], settings, start_ns)
    late = [round(1e9 * _delay_of_joints_s(stream, settings)) for stream in found]
    clocks = [stream.timing.t_ns - ns for stream, ns in zip(found, late, strict=True)]
    t_ns = np.unique(np.concatenate(clocks))
    every = [name for some in own_names(found) for name in some]
    values = np.full((len(t_ns), len(every)), np.nan)
    source_ns = np.zeros(len(t_ns), np.int64)
    column = 0
    for stream, clock in zip(reversed(found), reversed(clocks), strict=True):
        source_ns[np.searchsorted(t_ns, clock)] = stream.log_ns
    for stream, clock in zip(found, clocks, strict=True):
        width = stream.values.shape[1]
        values[np.searchsorted(t_ns, clock), column : column + width] = stream.values
        column += width
    whole = Series(
        seconds_since(t_ns, start_ns), values, tuple(every), common_unit(found), source_ns
    )
    return _select_joints_wanted(whole, settings.body.joints, what)


def _series_of_single_topic(stream: Stream, settings: Settings, start_ns: int) -> Series:
    """A single topic's joints; `delay` corrects the delay of this topic alone."""
    t_ns = stream.timing.t_ns - round(1e9 * _delay_of_joints_s(stream, settings))
    return Series(
        seconds_since(t_ns, start_ns), stream.values, stream.names, stream.unit, stream.log_ns
    )


def _check_delay_topics(found: Sequence[Stream], settings: Settings, what: str) -> None:
    """ConfigError for a delay of a missing joint topic."""
    given = settings.time.delay
    there = [f"{JOINTS}{topic_name(stream.role.topic)}" for stream in found]
    asked = [key for key in given if key.startswith(JOINTS)] if isinstance(given, Mapping) else []
    if unknown := [key for key in asked if key not in there]:
        raise ConfigError(
            f"{what}: [time] delay: {unknown[0]!r}; possible: {', '.join(there) or 'no joints'}"
        )


def _delay_of_joints_s(stream: Stream, settings: Settings) -> float:
    given = settings.time.delay
    return (
        given.get(f"{JOINTS}{topic_name(stream.role.topic)}", 0.0)
        if isinstance(given, Mapping)
        else 0.0
    )


def _select_joints_wanted(whole: Series, wanted: tuple[str, ...] | None, what: str) -> Series:
    if wanted is None:
        return whole
    if unknown := [name for name in wanted if name not in whole.names]:
        raise LogError(
            f"{what}: [body] joints names {unknown[0]!r}; the log has "
            f"{', '.join(sorted(whole.names))}"
        )
    columns: Array = np.array([whole.names.index(name) for name in wanted])
    return replace(whole, values=whole.values[:, columns], names=wanted)
