"""Parse message definitions (ros2msg, ros1msg, ros2idl
text) to a flat table of types, down to the primitives.
"""

import re
from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

from ...errors import FormatError

PRIMITIVES: Mapping[str, str] = {
    "bool": "u1",
    "byte": "u1",
    "octet": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}
"""Primitive -> numpy dtype without byte order."""

TEXTS = frozenset({"string", "wstring"})
TIMES = frozenset(
    {"time", "duration", "builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"}
)
_DUMMY = "structure_needs_at_least_one_member"
_SEPARATOR = re.compile(r"^={3,}\s*$", re.MULTILINE)
_HEADING = re.compile(r"\s*(?:MSG|IDL):\s*(\S+)[^\n]*(?:\n|$)")
_DIRECTIVE = re.compile(r"^\s*#.*$", re.MULTILINE)
_LINE = re.compile(
    r"(?P<type>[A-Za-z][\w/]*)(?:<=\d+)?\s*(?P<array>\[(?:<=)?\d*\])?"
    r"\s+(?P<name>[A-Za-z]\w*)\s*(?P<rest>.*)$"
)
_LARGEST = 1 << 31
_LONGEST = 1 << 20
"""Bytes of a definition; the longest complete one of a common robot has 30 kB."""
_DEEPEST = 4
_MOST_SIZES = 300
_MOST_STRINGS = 300
"""Limits of IDL: nested brackets, sizes and operators, texts. Its
parser's time doubles with each nested sequence and is quadratic in the
others: about 0.1 s at these limits. rosidl's output has a tenth of that."""
_OPENS = frozenset("<([")
_VERBATIM = re.compile(r'@verbatim\s*\((?:[^()"]|"(?:[^"\\]|\\.)*")*\)')
_QUOTED = re.compile(r'"(?:[^"\\]|\\.)*"')
_COMMENTS = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)
_SIZES = re.compile(r"\[|<\s*\w*\d|,\s*\w*\d\w*\s*>|[-+*/%|^&~]")
_MOST_TYPES = 10_000


class Field(NamedTuple):
    """name · type: a primitive, string, time or package/msg/Name
    · size: None one value, -1 a sequence, n exactly n.
    """

    name: str
    type: str
    size: int | None


class Definition(NamedTuple):
    """The root type and the fields of every type it
    needs; bytes per wstring character, or 0 if unknown.
    """

    root: str
    types: Mapping[str, tuple[Field, ...]]
    wide: int = 0


@lru_cache(maxsize=256)
def parse_definition(text: bytes, root: str, encoding: str) -> Definition:
    """Parse the definition of `root` from `text`;
    FormatError for a line or type that cannot be parsed.
    """
    if len(text) > _LONGEST:
        raise FormatError(f"{root}: a definition of {len(text)} bytes; at most {_LONGEST} are read")
    ros1 = encoding == "ros1msg"
    sections = (
        _idl_sections(text, root) if encoding == "ros2idl" else _split_sections(text, root, ros1)
    )
    types: dict[str, tuple[Field, ...]] = {}
    _add_missing_types(root, sections, types, (), ros1)
    return Definition(root, types)


def normalise_type_name(name: str, package: str = "") -> str:
    """package/msg/Name of a type written package/Name, package/msg/Name, Name or Header."""
    parts = name.split("/")
    if len(parts) == 1:
        package = "std_msgs" if name == "Header" else package
        return f"{package}/msg/{name}" if package else name
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else name


def _split_sections(text: bytes, root: str, ros1: bool) -> dict[str, tuple[Field, ...]]:
    try:
        pieces = _SEPARATOR.split(text.decode())
    except UnicodeDecodeError as error:
        raise FormatError(
            f"{root}: the definition is not text: {error.reason} at byte {error.start}"
        ) from None
    headings = [_HEADING.match(piece) for piece in pieces[1:]]
    found = {
        normalise_type_name(h[1]): piece[h.end() :]
        for h, piece in zip(headings, pieces[1:], strict=True)
        if h
    }
    known = frozenset({root, *found})
    sections = {name: tuple(_parse_fields(body, name, known, ros1)) for name, body in found.items()}
    if pieces[0].strip() or found:
        sections[root] = tuple(_parse_fields(pieces[0], root, known, ros1))
    return sections


def _parse_fields(body: str, owner: str, known: frozenset[str], ros1: bool) -> Iterator[Field]:
    package = owner.split("/")[0]
    empty = True
    for line in body.splitlines():
        line = line.strip()
        if not line or line.startswith("#"):
            continue
        match = _LINE.match(line)
        if match is None:
            raise FormatError(
                f"{owner}: cannot read the definition line {line[:60]!r}; expected: type name"
            )
        if match["rest"].startswith("="):
            continue
        empty = False
        yield Field(
            match["name"],
            _resolve_type(match["type"], package, known, ros1),
            _parse_array_size(match["array"], owner, line),
        )
    if empty and not ros1:
        yield Field(_DUMMY, "uint8", None)


def _resolve_type(name: str, package: str, known: frozenset[str], ros1: bool) -> str:
    if name in PRIMITIVES:
        return "int8" if ros1 and name == "byte" else name
    if name in TEXTS or name in ("time", "duration"):
        return name
    full = normalise_type_name(name, package)
    if full in known or "/" in name:
        return full
    namesakes = [other for other in known if other.rsplit("/", 1)[-1] == name]
    return namesakes[0] if len(namesakes) == 1 else full


def _parse_array_size(array: str | None, owner: str, line: str) -> int | None:
    if array is None:
        return None
    inside = array[1:-1]
    if not inside or inside.startswith("<="):
        return -1
    if len(inside) > 10 or int(inside) >= _LARGEST:
        raise FormatError(
            f"{owner}: {line[:60]!r} asks for {inside[:20]} elements; at most {_LARGEST - 1}"
        )
    return int(inside)


def _add_missing_types(
    name: str,
    sections: Mapping[str, tuple[Field, ...]],
    types: dict[str, tuple[Field, ...]],
    above: tuple[str, ...],
    ros1: bool,
) -> None:
    if name in above or len(above) > 64:
        raise FormatError(
            f"{name}: the definition contains itself: {' > '.join([*above[-3:], name])}"
        )
    if name in types or name in PRIMITIVES or name in TEXTS or (above and name in TIMES):
        return
    if len(types) > _MOST_TYPES:
        raise FormatError(f"{above[0]}: the definition has more than {_MOST_TYPES} types")
    fields = sections[name] if name in sections else _standard_type_fields(name, above, ros1)
    for field in fields:
        _add_missing_types(field.type, sections, types, (*above, name), ros1)
    types[name] = fields


def _standard_type_fields(name: str, above: tuple[str, ...], ros1: bool) -> tuple[Field, ...]:
    described = _standard_typestore(ros1).get(name)
    if described is None:
        where = f"{above[0]}: " if above else ""
        raise FormatError(
            f"{where}the log holds no definition of {name}, and it is not a standard type"
        )
    fields = (_field_from_rosbags(label, node) for label, node in described[1])
    return (
        tuple(_as_ros1(field) for field in fields if field.name != _DUMMY)
        if ros1
        else tuple(fields)
    )


def _as_ros1(field: Field) -> Field:
    plain = {"builtin_interfaces/msg/Time": "time", "builtin_interfaces/msg/Duration": "duration"}
    return Field(field.name, plain.get(field.type, field.type), field.size)


@lru_cache(maxsize=2)
def _standard_typestore(ros1: bool) -> Mapping[str, Any]:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE).fielddefs


def _field_from_rosbags(label: str, node: Any) -> Field:
    """A field in rosbags' notation: (kind, argument), kind 1 base, 2 name, 3 array, 4 sequence."""
    kind = int(node[0])
    argument = node[1]
    if kind in (3, 4):
        element, length = argument
        return Field(label, _field_from_rosbags(label, element).type, length if kind == 3 else -1)
    return Field(label, argument[0] if kind == 1 else argument, None)


def _idl_sections(text: bytes, root: str) -> dict[str, tuple[Field, ...]]:
    from rosbags.typesys import get_types_from_idl

    sections: dict[str, tuple[Field, ...]] = {}
    for piece in _SEPARATOR.split(_DIRECTIVE.sub("", text.decode(errors="replace"))):
        heading = _HEADING.match(piece)
        body = piece[heading.end() :] if heading else piece
        if not body.strip():
            continue
        body = _VERBATIM.sub("", body)
        _check_idl(body, root)
        try:
            found = get_types_from_idl(body)
        except Exception as error:
            raise FormatError(
                f"{root}: cannot read the IDL definition: {str(error).splitlines()[0][:80]}"
            ) from None
        for name, (_, fields) in found.items():
            sections[name] = tuple(_field_from_rosbags(label, node) for label, node in fields)
    return sections


def _check_idl(body: str, root: str) -> None:
    """FormatError for text that the IDL parser takes
    long for: nested brackets, many sizes or texts.
    """
    bare = _COMMENTS.sub(" ", _QUOTED.sub(" ", body))
    depth = 0
    deepest = 0
    for sign in re.findall(r"[<(\[>)\]]", bare):
        depth = max(0, depth + (1 if sign in _OPENS else -1))
        deepest = max(deepest, depth)
    counts = (
        (deepest, _DEEPEST, "brackets in one another"),
        (len(_SIZES.findall(bare)), _MOST_SIZES, "array sizes and operators"),
        (body.count('"'), 2 * _MOST_STRINGS, "quotes"),
    )
    for count, most, what in counts:
        if count > most:
            raise FormatError(
                f"{root}: the IDL definition has {count} {what}; at most {most} are read"
            )
