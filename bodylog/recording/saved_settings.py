"""Settings of the bodylog run that wrote a log; explicit settings take precedence."""

from contextlib import suppress
from dataclasses import replace
from typing import Any, TypeVar, get_args, get_type_hints

from ..errors import ConfigError, LogError
from ..io.values import read_json
from ..logs.decode.message_path import parse_message_path
from ..logs.protocol import Log
from ..logs.topics import PREFIX
from ..settings import BodySettings, Settings, TimeSettings, TopicSettings
from ..sources import Source, parse_source

Text = str | tuple[str, ...]
Section = TypeVar("Section", TopicSettings, BodySettings, TimeSettings)


def is_ours(log: Log) -> bool:
    """Whether bodylog wrote topics into a log."""
    return any(topic.name.startswith(PREFIX) for topic in log.topics)


def restore_settings(log: Log, settings: Settings) -> Settings:
    """Fill defaults in [topics], [body] and [time] from the
    metadata record, if bodylog wrote topics into the log.

    [features] likewise if it is empty. Topics missing in the log stay unset.
    """
    if not is_ours(log):
        return settings
    from ..annotating.read_back import read_metadata

    saved: Any = {}
    with suppress(LogError, ValueError, KeyError):
        saved = read_json(read_metadata(log.path)["settings"])
    names = [topic.name for topic in log.topics]
    topics = {
        role: text
        for role, text in _saved_texts(saved, "topics").items()
        if _names_present_topics(text, names)
    }
    return replace(
        settings,
        topics=_fill_defaults(settings.topics, topics),
        body=_fill_defaults(settings.body, _saved_texts(saved, "body")),
        time=_fill_defaults(settings.time, _saved_texts(saved, "time")),
        features=settings.features or _saved_sources(saved),
    )


def _saved_sources(saved: Any) -> dict[str, Source]:
    """The sources of [features] in a metadata record; empty if one is damaged."""
    values = saved.get("features") if isinstance(saved, dict) else None
    with suppress(ConfigError):
        items = values.items() if isinstance(values, dict) else ()
        return {str(name): parse_source(str(name), value, "metadata") for name, value in items}
    return {}


def _saved_texts(saved: Any, section: str) -> dict[str, Text]:
    """The texts, and lists of texts, of a section."""
    values = saved.get(section) if isinstance(saved, dict) else None
    plain = (
        {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
        if isinstance(values, dict)
        else {}
    )
    return {
        k: v
        for k, v in plain.items()
        if v and isinstance(v, str | tuple) and all(isinstance(t, str) for t in v)
    }


def _names_present_topics(text: Text, names: list[str]) -> bool:
    return all(
        parse_message_path(path, names).topic in names
        for path in ((text,) if isinstance(text, str) else text)
    )


def _fill_defaults(section: Section, saved: dict[str, Text]) -> Section:
    """The section with its defaults replaced by saved values of the right type."""
    hints = get_type_hints(type(section))
    default = type(section)()
    at_default = [
        name for name in saved if name in hints and getattr(section, name) == getattr(default, name)
    ]
    known: Any = {name: saved[name] for name in at_default if _fits_hint(saved[name], hints[name])}
    return replace(section, **known)


def _fits_hint(text: Text, hint: Any) -> bool:
    kind: Any = str if isinstance(text, str) else tuple[str, ...]
    return kind in (hint, *get_args(hint))
