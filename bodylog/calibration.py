"""Write joint zeros and scales as a table in YAML or JSON, or into a URDF."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .body.kinematic.offsets import tables
from .errors import ModelError, UsageError

if TYPE_CHECKING:
    from .kinematics.identifiability import Offset

__all__ = ["FORMS", "tables", "write", "zeros"]

FORMS = (".yaml", ".yml", ".json", ".urdf")


def zeros(body: Path) -> "tuple[tuple[Offset, ...], tuple[Offset, ...]]":
    """The joint zeros of a body learned with a URDF, and the scales if they are unknowns."""
    from .body import storage
    from .body.kinematic import offsets

    learned = storage.load(body)
    try:
        return offsets.learned(learned), offsets.scaled(learned)
    except ModelError as problem:
        raise ModelError(f"{body}: {problem}") from problem


def write(found: "tuple[Offset, ...]", scales: "tuple[Offset, ...]", out: Path, urdf: Path | None) -> None:
    """Write by the file's suffix; a URDF is `urdf` with the identifiable zeros added. UsageError for other suffixes."""
    from .io.atomic_files import replacing

    if out.suffix not in FORMS:
        raise UsageError(f"{out}: -o ends in {out.suffix!r}; possible: {', '.join(FORMS)}")
    if out.suffix == ".urdf" and urdf is None:
        raise UsageError(f"{out}: a URDF is written from one; type: --urdf ROBOT.urdf")
    values = tables(found, scales)
    text = _corrected(found, urdf) if urdf is not None and out.suffix == ".urdf" else _table(values, out.suffix)
    with replacing(out) as beside:
        beside.write_text(text)


def _table(values: Mapping[str, Mapping[str, Any]], suffix: str) -> str:
    if suffix == ".json":
        return json.dumps(values, indent=2) + "\n"
    # JSON's scalars are valid YAML
    lines = []
    for key, of in values.items():
        lines += [f"{key}:\n", *(f"  {json.dumps(name)}: {json.dumps(one)}\n" for name, one in of.items())]
    return "".join(lines)


def _corrected(found: "tuple[Offset, ...]", urdf: Path) -> str:
    from .kinematics import urdf as files
    from .kinematics.corrected import corrected

    return corrected(files.text(urdf), str(urdf), {one.joint: one.value for one in found if one.identifiable})
