"""Message paths: `/topic.field[0].x`, `/skin.data[:].prox[0]`,
`/tf.transforms[:]{child_frame_id=="hand"}.x`.
"""

import re
from collections.abc import Iterable
from typing import NamedTuple

from ...errors import ConfigError

_STEP = re.compile(
    r"\.(?P<name>[A-Za-z_]\w*)"
    r"|\[(?P<index>-?\d+)\]"
    r"|\[(?P<first>-?\d*):(?P<last>-?\d*)\]"
    r"|\{(?P<key>[A-Za-z_]\w*)==(?P<value>-?\d+|true|false|\"[^\"]*\"|'[^']*')\}"
)


class IndexRange(NamedTuple):
    """Elements first to last, both included, as in Foxglove; negative ones count from the end."""

    first: int
    last: int

    def of(self, count: int) -> range:
        """The indices this selects out of `count` elements."""
        first, last = (n + count if n < 0 else n for n in (self.first, self.last))
        return range(max(first, 0), min(last + 1, count))


class Only(NamedTuple):
    """Elements whose `field` equals `value`."""

    field: str
    value: int | str


Step = str | IndexRange | Only


class Path(NamedTuple):
    """A topic and the steps from its message down to values; no steps: the whole message."""

    topic: str
    steps: tuple[Step, ...]


def parse_message_path(text: str, topics: Iterable[str] = ()) -> Path:
    """Parse the path in `text`; a topic of `topics` at its
    start takes precedence over the first `.`, `[` or `{`.
    """
    known = [
        topic
        for topic in topics
        if text == topic or (text.startswith(topic) and text[len(topic)] in ".[{")
    ]
    topic = max(known, key=len) if known else re.split(r"[.\[{]", text, maxsplit=1)[0]
    return Path(topic, parse_steps(text[len(topic) :], text))


def parse_steps(text: str, whole: str | None = None) -> tuple[Step, ...]:
    """The steps in `text`, e.g. `.data[:].prox[0]` (a leading
    dot is optional); ConfigError names the invalid part.
    """
    rest = f".{text}" if text and text[0] not in ".[{" else text
    found: list[Step] = []
    while rest:
        match = _STEP.match(rest)
        if match is None:
            known = ".field, [0], [1:3], [:], {id==2}"
            raise ConfigError(
                f"message path {whole or text!r}: cannot read {rest!r}; the steps are {known}"
            )
        found.append(_parse_step(match))
        rest = rest[match.end() :]
    return tuple(found)


def is_index(step: Step) -> bool:
    """Whether a step selects one element by number."""
    return isinstance(step, IndexRange) and step.first == step.last


def _parse_step(match: re.Match[str]) -> Step:
    if match["name"]:
        return match["name"]
    if match["index"]:
        return IndexRange(int(match["index"]), int(match["index"]))
    if match["key"]:
        value = match["value"]
        if value in ("true", "false"):
            return Only(match["key"], int(value == "true"))
        return Only(match["key"], value[1:-1] if value[0] in "\"'" else int(value))
    return IndexRange(int(match["first"] or 0), int(match["last"] or -1))
