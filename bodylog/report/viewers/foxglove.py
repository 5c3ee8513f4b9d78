"""A layout for Foxglove and Lichtblick: images with
the overlay, belief, errors and free energy over time.
"""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ...io.atomic_files import write_text_atomically
from ...logs.topics import PREFIX
from ...types import Estimate


def write_foxglove_layout(
    out: Path, camera: str | None, estimate: Estimate, views: Mapping[str, str]
) -> None:
    """Write the layout as JSON to `out`, for the camera
    topics and the joints and senses of `estimate`.
    """
    layout = build_layout(camera, estimate, views)
    write_text_atomically(out, json.dumps(layout, indent=2) + "\n")


def build_layout(
    camera: str | None, estimate: Estimate, views: Mapping[str, str]
) -> dict[str, Any]:
    """The layout's tree: panels by id, and their shares of
    the window; `views`: topics of further cameras by name.
    """
    joints = enumerate(estimate.joints.names)
    senses = {name: errors.names for name, errors in estimate.errors.items()}
    panels: dict[str, Any] = {
        "Plot!belief": _plot_panel(
            [(_message_path("joint_states", "position", k), name) for k, name in joints]
        ),
        "Plot!errors": _plot_panel(_error_lines(senses)),
        "Plot!free_energy": _plot_panel([(f"{PREFIX}free_energy.data", "free energy, nats")]),
        "Image!camera": _image_panel(camera, f"{PREFIX}annotations"),
        "RawMessages!faults": {"topicPath": f"{PREFIX}faults"},
    }
    plots = _split_window(
        "column", "Plot!belief", _split_window("column", "Plot!errors", "Plot!free_energy", 60), 45
    )
    picture = _split_window("column", "Image!camera", "RawMessages!faults", 75)
    for name, topic in views.items():
        panels[f"Image!{name}"] = _image_panel(topic, f"{PREFIX}annotations/{name}")
        picture = _split_window("column", f"Image!{name}", picture, 40)
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _split_window("row", picture, plots, 45),
    }


def _error_lines(senses: Mapping[str, Sequence[str]]) -> list[tuple[str, str]]:
    return [
        (_message_path(f"prediction_error/{sense}", "data", k), f"{sense} {name}, σ")
        for sense, names in senses.items()
        for k, name in enumerate(names)
    ]


def _message_path(topic: str, field: str, index: int) -> str:
    return f"{_quote_topic(f'{PREFIX}{topic}')}.{field}[{index}]"


def _quote_topic(topic: str) -> str:
    """A topic in a message path, quoted unless it has
    only letters, digits, underscores and slashes.
    """
    if re.fullmatch("[A-Za-z0-9_/]+", topic):
        return topic
    escaped = topic.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def _plot_panel(lines: Sequence[tuple[str, str]]) -> dict[str, Any]:
    paths = [
        {"value": value, "label": label, "enabled": True, "timestampMethod": "headerStamp"}
        for value, label in lines
    ]
    return {"paths": paths, "showLegend": True, "isSynced": True, "xAxisVal": "timestamp"}


def _image_panel(camera: str | None, annotations: str) -> dict[str, Any]:
    return {
        "imageMode": {"imageTopic": camera or "", "annotations": {annotations: {"visible": True}}}
    }


def _split_window(direction: str, first: Any, second: Any, share: int) -> dict[str, Any]:
    return {"direction": direction, "first": first, "second": second, "splitPercentage": share}
