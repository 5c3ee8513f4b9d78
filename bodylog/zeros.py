"""Joints' zeros as files that people use: a table in YAML or JSON, or a URDF that has them in it."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .body.offsets import plain
from .errors import ModelError, UsageError

if TYPE_CHECKING:
    from .kinematics.identifiability import Offset

__all__ = ["FORMS", "plain", "write", "zeros"]

FORMS = (".yaml", ".yml", ".json", ".urdf")


def zeros(body: Path) -> "tuple[Offset, ...]":
    """The joints' zeros of a body that was learned with a URDF."""
    from .body import model, offsets

    learned = model.load(body)
    try:
        return offsets.learned(learned)
    except ModelError as problem:
        raise ModelError(f"{body}: {problem}") from problem


def write(found: "tuple[Offset, ...]", out: Path, urdf: Path | None) -> None:
    """Write the zeros by the file's suffix; a URDF is `urdf` with the identifiable zeros in it. UsageError as typed."""
    from .files import replacing

    if out.suffix not in FORMS:
        raise UsageError(f"{out}: -o ends in {out.suffix!r}; possible: {', '.join(FORMS)}")
    if out.suffix == ".urdf" and urdf is None:
        raise UsageError(f"{out}: a URDF is written from one; type: --urdf ROBOT.urdf")
    values = plain(found)
    text = _corrected(found, urdf) if urdf is not None and out.suffix == ".urdf" else _table(values, out.suffix)
    with replacing(out) as beside:
        beside.write_text(text)


def _table(values: Mapping[str, Mapping[str, Any]], suffix: str) -> str:
    if suffix == ".json":
        return json.dumps({"offsets": values}, indent=2) + "\n"
    # JSON's scalars are YAML's
    rows = (f"  {json.dumps(name)}: {json.dumps(value)}\n" for name, value in values.items())
    return "".join(("offsets:\n", *rows))


def _corrected(found: "tuple[Offset, ...]", urdf: Path) -> str:
    from .kinematics import urdf as files
    from .kinematics.corrected import corrected

    return corrected(files.text(urdf), str(urdf), {one.joint: one.value for one in found if one.identifiable})
