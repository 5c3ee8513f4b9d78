"""Write docs/settings.md from the declarations of settings,
sources of tracks and batch.toml; a test compares them.
"""

import inspect
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path

from bodylog.batch.manifest import GroupTable
from bodylog.io.toml_keys import declared_keys, default_text, describe_possible_values
from bodylog.settings import Settings
from bodylog.sources import SOURCES

PAGE = Path(__file__).with_name("settings.md")
BEGIN = """# Settings

Every setting has a default. A `robot.toml` replaces defaults, and options on the command line replace both:

```bash
bodylog config > robot.toml
```

writes every setting with its meaning, values and default. Keep only the keys that you change:

```toml
[topics]
joints = "/arm/joint_states"
camera = "/camera/image/compressed"

[features]
effector = { tag = 7, dictionary = "apriltag_36h11" }
```

Pass the file to any command with `--config robot.toml`; `bodylog config --config robot.toml` prints
the result. An unknown key or an impossible value ends the command with exit code 2 and one line: file, key, value,
possible values, and what to type.

In the tables, `[X, …]` is a list of X, and `{NAME = X}` is a table of names and X. A default in words stands for a key
that is left out.
"""
FEATURES = """## [features]

Each key names a track, and its value is the track's source. A name has no `/` and no `.`, and is not `encoders`,
`vision` or `touch`. A value is a colour, or a table with the keys of one of these sources. OpenCV's names of
dictionaries (`DICT_4X4_50`) are possible, too.
"""
BATCH = """## batch.toml

`bodylog batch batch.toml -o out` runs groups of logs. Each group is a `[[group]]` table with its own logs, body,
methods, settings and bounds. Paths are relative to `batch.toml`.

```toml
[[group]]
name = "left arm"
train = ["explore.bag"]
logs = ["runs/*.mcap"]
methods = ["filter", "smoother"]
fail_if = ["faults>0"]
settings = { skin = { threshold = 0.5 } }

[[group]]
logs = ["other"]
body = "body.npz"
```

A group needs either `body` or `train`.

"""


def page() -> str:
    """The reference of settings as Markdown."""
    parts = [BEGIN]
    for section in fields(Settings):
        table = type(getattr(Settings(), section.name))
        parts.append(
            _features()
            if section.name == "features"
            else f"## [{section.name}]\n\n{_about(table)}\n\n{_rows(table)}"
        )
    return "\n".join([*parts, BATCH + _rows(GroupTable)])


def _about(table: type) -> str:
    """The docstring without the section's name, as a sentence."""
    text = (inspect.getdoc(table) or "").partition(": ")[2]
    return text[:1].upper() + text[1:]


def _rows(table: type) -> str:
    lines = [
        _row(f"`{name}`", one.key.meaning, describe_possible_values(one), default_text(one))
        for name, one in declared_keys(table).items()
    ]
    return _table(("key", "meaning", "values", "default"), lines)


def _features() -> str:
    parts = [
        f"### {name}\n\n{inspect.getdoc(source)}\n\n{_rows(source)}"
        for name, source in SOURCES.items()
    ]
    return "\n".join([FEATURES, *parts])


def _row(*cells: str) -> str:
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def _table(head: Iterable[str], lines: list[str]) -> str:
    columns = tuple(head)
    return "\n".join([_row(*columns), "|" + "---|" * len(columns), *lines, ""])


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
