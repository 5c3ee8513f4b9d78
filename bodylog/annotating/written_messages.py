"""Messages of features and estimates that the pipeline writes into a log, and their provenance."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..settings import Settings, settings_as_values
from ..types import Estimate, Features, Outgoing, Recording
from ..version import __version__


def feature_messages(read: Recording, features: Features) -> list[Outgoing]:
    """The features of a recording, as messages."""
    from . import messages

    return messages.from_features(features, read.start_ns)


def estimate_messages(read: Recording, features: Features, found: Estimate) -> list[Outgoing]:
    """An estimate and its features, as messages."""
    from . import messages

    return [
        *feature_messages(read, features),
        *messages.from_estimate(found, features, read.start_ns),
    ]


def topic_of_role(read: Recording, role: str) -> str | None:
    """The topic of a role's message path: the longest
    of the log's topics that the path begins with.
    """
    path = read.facts.roles.get(role, "")
    return max(
        (t.name for t in read.facts.topics if path == t.name or path.startswith(t.name + ".")),
        key=len,
        default=None,
    )


def provenance_of_logs(logs: Sequence[tuple[Path, str]], settings: Settings) -> dict[str, str]:
    """Version, settings, and name and digest of every input log, as metadata."""
    inputs = [[log.name, digest] for log, digest in logs]
    return {
        "version": __version__,
        "settings": _sorted_json(settings_as_values(settings)),
        "inputs": _sorted_json(inputs),
    }


def _sorted_json(value: Any) -> str:
    return json.dumps(value, sort_keys=True, default=float)
