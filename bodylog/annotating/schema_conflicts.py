"""Rename message types that a log defines differently:
readers that look up types by name accept only one.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from ..errors import FormatError
from ..logs.decode.definitions import parse_definition
from ..logs.mcap import opcodes as op
from ..logs.mcap.records import HEAD, parse_record
from ..types import Finding, Outgoing

_BORROWED = "foxglove_msgs/"
_OWN = "bodylog_msgs/"
_READ = ("ros1msg", "ros2msg", "ros2idl")


def rename_conflicting(
    outgoing: Sequence[Outgoing], schemas: Iterable[bytes]
) -> tuple[list[Outgoing], tuple[Finding, ...]]:
    """The messages, renamed where the file's Schema
    records define their type differently; and findings.
    """
    theirs = _types_in_schemas(schemas)
    conflicting = {
        o.topic for o in outgoing if o.type.startswith(_BORROWED) and _differs_from_log(o, theirs)
    }
    found = [_rename_borrowed_type(o) if o.topic in conflicting else o for o in outgoing]
    text = (
        "{}: the log has another {}; written as {}, which every reader reads but viewers do not "
        "draw"
    )
    lines = [
        text.format(o.topic, o.type, f.type)
        for o, f in zip(outgoing, found, strict=True)
        if o.topic in conflicting
    ]
    return found, tuple(Finding("warning", line) for line in lines)


def _types_in_schemas(schemas: Iterable[bytes]) -> dict[str, object]:
    types: dict[str, object] = {}
    for raw in schemas:
        fields = parse_record(op.SCHEMA, memoryview(raw)[HEAD.size :]).fields
        if fields["encoding"] in _READ and _BORROWED.encode() in raw:
            try:
                types |= parse_definition(fields["data"], fields["name"], fields["encoding"]).types
            except FormatError:
                continue  # no reader can parse it
    return types


def _differs_from_log(outgoing: Outgoing, theirs: dict[str, object]) -> bool:
    ours = parse_definition(outgoing.definition, outgoing.type, outgoing.definition_encoding).types
    return any(
        theirs.get(name, fields) != fields
        for name, fields in ours.items()
        if name.startswith(_BORROWED)
    )


def _rename_borrowed_type(outgoing: Outgoing) -> Outgoing:
    definition = outgoing.definition.replace(_BORROWED.encode(), _OWN.encode())
    return replace(outgoing, type=outgoing.type.replace(_BORROWED, _OWN), definition=definition)
