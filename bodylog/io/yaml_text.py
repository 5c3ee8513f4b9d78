"""Read YAML texts as plain values: no names that repeat a value, no keys but plain ones."""

from typing import Any

DEEPEST = 64
"""Levels of lists and mappings."""


MOST_VALUES = 100_000
"""Values of a MB of text: the parser is Python, and takes up to 0.2 ms for each."""


def parse_yaml_text(text: str, most: int = MOST_VALUES) -> Any:
    """The value of a YAML text; ValueError if it is invalid,
    too deep, or has aliases or keys that are no scalars.

    `most`: values and keys that are read; ValueError where there are more.

    A few lines of aliases can expand without end: &a [x, x], &b [*a, *a], …
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.composer import Composer
    from ruamel.yaml.error import YAMLError
    from ruamel.yaml.events import AliasEvent, MappingStartEvent, SequenceStartEvent
    from ruamel.yaml.nodes import MappingNode

    class Plain(Composer):
        depth = 0
        count = 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.parser.check_event(AliasEvent):
                raise ValueError("it has aliases (*name); write the values out")
            is_key = isinstance(parent, MappingNode) and index is None
            if is_key and self.parser.check_event(MappingStartEvent, SequenceStartEvent):
                raise ValueError("a key is a list or a mapping; names are possible")
            self.count += 1
            if self.count > most:
                raise ValueError(
                    f"it has more than {most} values; to read them, raise [input] max_yaml_mb"
                )
            self.depth += 1
            if self.depth > DEEPEST:
                raise ValueError(f"lists and mappings are more than {DEEPEST} deep")
            found = super().compose_node(parent, index)
            self.depth -= 1
            return found

    yaml = YAML(typ="safe", pure=True)
    yaml.Composer = Plain
    try:
        return yaml.load(text)
    except (YAMLError, RecursionError) as problem:
        raise ValueError(" ".join(str(problem).split())[:200]) from None
