"""Metadata that an MCAP keeps from a dataset: names, units, and topics without a role."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from ..logs.formats import is_episode_file, open_log
from ..logs.joint_units import SOURCE_UNIT, UNIT
from ..logs.topics import INDEPENDENT, escape_topic_name
from ..settings import Settings
from ..types import Batch, Outgoing, Recording, Topic

JOINTS = "/joint_states"
_OURS = "bodylog."
Beside = tuple[Outgoing, Mapping[str, str]]
"""Messages of a topic, and its metadata."""


def settings_of_episode(path: Path, settings: Settings) -> tuple[Settings, list[Beside]]:
    """The settings with all cameras of a dataset's episode,
    and its topics that are neither joints nor images.

    Other logs give only the settings; cameras named in the settings stay the only ones.
    """
    from ..logs.datasets.episode_log import EpisodeLog

    if path.is_file() and not is_episode_file(path):
        return settings, []
    with open_log(path, settings.input.strict, settings.input) as log:
        if not isinstance(log, EpisodeLog):
            return settings, []
        cameras = tuple(topic.name for topic in log.topics if topic.id in log.cameras)
        beside = [
            topic for topic in log.topics if topic.name != JOINTS and topic.id not in log.cameras
        ]
        kept = [
            _topic_beside_signals(topic, batch)
            for topic in beside
            for batch in log.batches((topic.id,))
        ]
    if settings.topics.camera is None and cameras:
        settings = replace(settings, topics=replace(settings.topics, camera=cameras))
    return settings, kept


def _topic_beside_signals(topic: Topic, batch: Batch) -> Beside:
    fields = (
        topic.name,
        topic.type,
        topic.definition,
        batch.log_ns,
        batch.data,
        batch.offset,
        batch.length,
    )
    return Outgoing(*fields), topic.metadata


def kept_metadata(recording: Recording) -> dict[str, dict[str, str]]:
    """Metadata of the topics that a recording is written
    as, by /joint_states, and /camera or /NAME of cameras.
    """
    found = {
        JOINTS: {**joints_metadata(recording), **(INDEPENDENT if recording.signals.poses else {})}
    }
    for role in recording.facts.roles:
        if role.partition("/")[0] == "camera":
            under = f"/{escape_topic_name(role.partition('/')[2])}" if "/" in role else "/camera"
            found[under] = role_metadata(recording, role)
    return {topic: about for topic, about in found.items() if about}


def joints_metadata(recording: Recording) -> dict[str, str]:
    """The metadata of the joints' topic, with the unit after conversion."""
    about = role_metadata(recording, "joints")
    if recording.signals.joints is None or UNIT not in about:
        return about
    return {
        **about,
        UNIT: recording.signals.joints.unit,
        SOURCE_UNIT: about.get(SOURCE_UNIT, about[UNIT]),
    }


def role_metadata(recording: Recording, role: str) -> dict[str, str]:
    """Metadata from the dataset on the topic of a role."""
    topic = next(
        (
            topic
            for topic in recording.facts.topics
            if topic.name == recording.facts.roles.get(role)
        ),
        None,
    )
    return {} if topic is None else {k: v for k, v in topic.metadata.items() if k.startswith(_OURS)}
