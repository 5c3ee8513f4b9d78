"""Rerun as a program: convert an MCAP to a recording (.rrd), merge recordings, open a window."""

import json
import re
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

from ...errors import LogError, UsageError
from ...io.atomic_files import replace_atomically
from ...io.extras import describe_missing
from ...io.temporary import create_scratch_folder

APPLICATION = "bodylog"
PROGRAM = (
    sys.executable,
    "-c",
    "import sys; from rerun_cli.__main__ import main; sys.exit(main())",
)
"""Rerun with its exit code, which `python -m rerun_cli` drops."""
_PASSED = re.compile(
    r"(?:\(entity: `(/[^`]*)`.*?\)|decode message on channel (\S+)): (?:.*\], )?(.*)"
)
"""An error about one entity or topic: its path and the reason."""
_WHERE = re.compile(r"^.* ERROR [\w:]+: ")
"""The time, and a place in Rerun's source."""
Companion = Callable[[Path, str, Mapping[str, str]], None]
"""Writes a companion recording with an identity to a file;
gets the entities that Rerun cannot show, with reasons.
"""
SECONDS = 600.0
"""s: most time that Rerun may take for one file; damaged ones can keep it busy forever."""


def require_rerun() -> None:
    """UsageError, before any file is read, if Rerun is not installed."""
    if find_spec("rerun") is None or find_spec("rerun_cli") is None:
        raise UsageError(f"view: {describe_missing('rerun')}")


def merge_recording(
    source: Path, out: Path, identity: str, companion: Companion, done: Callable[[int], None]
) -> dict[str, str]:
    """Merge an MCAP and the recording that `companion`
    writes into one recording (.rrd) of that identity.

    `done` is called with 1 after each of the three steps. Returns {entity that Rerun cannot show:
    reason}, which `companion` gets too. LogError: Rerun refuses the log.
    """
    with create_scratch_folder() as folder, replace_atomically(out) as beside:
        names = ("log.mcap", "log.rrd", "companion.rrd", "merged.rrd")
        log, converted, drawn, merged = (folder / name for name in names)
        log.symlink_to(source.resolve())  # names that are not UTF-8 end Rerun
        merged.symlink_to(beside.resolve())
        identity = identity.encode(errors="backslashreplace").decode()
        named = ["--application-id", APPLICATION, "--recording-id", identity]
        unshown = _run_rerun(
            ["mcap", "convert", str(log), *named, "-o", str(converted)], folder, source
        )
        done(1)
        companion(drawn, identity, unshown)
        done(1)
        _run_rerun(["rrd", "merge", str(converted), str(drawn), "-o", str(merged)], folder, source)
        done(1)
    return unshown


def open_window(recorded: Path) -> None:
    """Open a window on a recording and wait until it
    is closed; UsageError where there is no display.
    """
    done = subprocess.run([*PROGRAM, str(recorded)], capture_output=True, text=True)
    if done.returncode:
        # the part before it is a place in Rerun's source
        text = _last_error_text(done.stderr).rpartition(": ")[2]
        raise UsageError(
            f"view: Rerun could not open a window ({text}); type: bodylog view LOG -o out.rrd"
        )


def disable_analytics(home: Path) -> None:
    """Turn off analytics in this home folder of Rerun."""
    settings = home / ".config" / "rerun" / "analytics.json"
    settings.parent.mkdir(parents=True, exist_ok=True)
    settings.write_text(
        json.dumps({"analytics_enabled": False, "analytics_id": "", "metadata": {}}),
        encoding="utf-8",
    )


def _run_rerun(arguments: Sequence[str], home: Path, source: Path) -> dict[str, str]:
    """Run one command of Rerun in a separate home folder; {entity it skipped: reason}."""
    disable_analytics(home)
    command = [*PROGRAM, *arguments]
    alone = {"HOME": str(home)}
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS, env=alone)
    except subprocess.TimeoutExpired:
        raise LogError(
            f"{source}: Rerun did not end in {SECONDS:g} s; type: bodylog doctor {source}"
        ) from None
    errors = [line for line in _without_colour_codes(done.stderr).splitlines() if " ERROR " in line]
    passed = [_PASSED.search(line) for line in errors]
    if done.returncode or None in passed:  # its exit code is 0 even if it could read nothing
        raise LogError(
            f"{source}: Rerun cannot read it ({_last_error_text(done.stderr)}); type: "
            f"bodylog doctor {source}"
        )
    return {found[1] or found[2]: found[3] for found in passed if found}


def _last_error_text(text: str) -> str:
    """Rerun's last error message, or else its last line."""
    lines = [line.strip() for line in _without_colour_codes(text).splitlines() if line.strip()]
    return (
        [_WHERE.sub("", line) for line in lines if " ERROR " in line]
        or lines
        or ["it said nothing"]
    )[-1]


def _without_colour_codes(text: str) -> str:
    """The text without colour codes."""
    return re.sub(r"\x1b\[[0-9;]*m", "", text)
