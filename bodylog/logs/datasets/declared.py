"""What a LeRobot dataset's info.json declares, against what the dataset's files hold."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ..records import Array, Finding
from .video import Video

NUMBERS = (
    "float16",
    "float32",
    "float64",
    "int8",
    "int16",
    "int32",
    "int64",
    "uint8",
    "uint16",
    "uint32",
    "bool",
)
"""Types of features that are read as numbers."""
BOOKKEEPING = ("timestamp", "frame_index", "episode_index", "index", "task_index")
"""Columns by which the dataset finds its rows."""
_OTHER_TYPES = ("video", "image", "string")
RATE_SHARE = 0.1
"""Share by which a rate may differ from the declared one: recorders jitter, and LeRobot's loader
rejects stamps that are 0.1 ms off."""


def compare_columns(
    features: Mapping[str, Mapping[str, Any]], columns: Mapping[str, str], needed: tuple[str, ...]
) -> Iterator[Finding]:
    """Features whose type is unknown or another one than the table's, those that the table lacks,
    and columns that are not declared.

    columns: {name: type of its values} of the table · needed: features without which an episode
    loses a part.
    """
    for name, about in features.items():
        declared = about.get("dtype")
        severity = "lost" if name in needed else "warning"
        if declared not in (*NUMBERS, *_OTHER_TYPES):
            possible = ", ".join((*NUMBERS, *_OTHER_TYPES))
            text = f"info.json says dtype {declared!r:.40}, which is not read; possible: {possible}"
            yield Finding(severity, f"{name}: {text}")
        elif declared == "string" and name in needed:
            text = "info.json says dtype 'string', and no numbers are read"
            yield Finding(severity, f"{name}: {text}; possible: {', '.join(NUMBERS)}")
        elif name in BOOKKEEPING and name not in columns:
            text = f"{name}: info.json declares it, the table has no such column"
            yield Finding("warning", text)
        elif _kind_of_number(declared) and name in columns:
            stored = columns[name].replace("double", "float64")
            if _kind_of_number(stored) not in ("", _kind_of_number(declared)):
                text = f"{name}: info.json says dtype {declared}, the table holds {stored}"
                yield Finding("warning", text)
    undeclared = [
        name
        for name in columns
        if name not in (*features, *BOOKKEEPING) and not name.startswith("next.")
    ]
    if undeclared:
        text = f"info.json does not declare {', '.join(undeclared):.200}, which the table holds"
        yield Finding("warning", f"{text}; it is not read")


def _kind_of_number(kind: Any) -> str:
    """What type of number a type's name is of; empty for others."""
    name = str(kind)
    return next((one for one in ("float", "int", "bool") if name.lstrip("u").startswith(one)), "")


def compare_row_rate(t: Array, fps: float) -> Iterator[Finding]:
    """Rows at t (N,) s that are further apart, or less, than the declared rate says."""
    step_s = _find_other_step(t, fps)
    if step_s is not None:
        text = f"timestamp: rows are {step_s:.4g} s apart ({1.0 / step_s:.3g} Hz)"
        yield Finding("warning", f"{text}, info.json says fps {fps:g}")


def compare_video(
    name: str, about: Mapping[str, Any], film: Video, fps: float
) -> Iterator[Finding]:
    """A camera's video of another size or rate than declared."""
    declared = _declared_size(about)
    if declared is not None and declared != (film.width, film.height):
        text = f"{name}: info.json declares images of {declared[0]} x {declared[1]}"
        yield Finding("warning", f"{text}, the video has {film.width} x {film.height}")
    step_s = _find_other_step(film.t, fps)
    if step_s is not None:
        text = f"{name}: the video has {1.0 / step_s:.3g} frames a second"
        yield Finding("warning", f"{text}, info.json says fps {fps:g}")


def _find_other_step(t: Array, fps: float) -> float | None:
    """Median step (s) of t (N,) s; None where it is that of the rate fps, or zero."""
    step_s = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    return step_s if step_s > 0.0 and abs(step_s * fps - 1.0) > RATE_SHARE else None


def _declared_size(about: Mapping[str, Any]) -> tuple[int, int] | None:
    """Width and height (px) by a camera's shape: (height, width, channels), or channels first; None
    where it has no such shape."""
    shape = about.get("shape")
    if not isinstance(shape, list) or len(shape) != 3:
        return None
    if not all(isinstance(side, int) for side in shape):
        return None
    names = about.get("names")
    if isinstance(names, list) and {"height", "width"} <= {str(one) for one in names}:
        return shape[names.index("width")], shape[names.index("height")]
    channels_first = shape[0] in (1, 3) and shape[2] not in (1, 3)
    return (shape[2], shape[1]) if channels_first else (shape[1], shape[0])
