"""Where a track comes from: one record per kind of source of `[features]`, read from TOML and checked here."""

import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields
from typing import Any

from .errors import ConfigError

Colour = str | Mapping[str, tuple[int, int, int]]
"""A name ("green"), or {"low": (h, s, v), "high": (h, s, v)} in OpenCV ranges; low h > high h wraps around red."""

NAMED_COLOURS = ("blue", "cyan", "green", "magenta", "orange", "red", "yellow")
RANGES = "{low = [h,s,v], high = [h,s,v]} with h 0..180, s and v 0..255"

DICTIONARIES: Mapping[str, int] = {
    **{f"{n}x{n}_{size}": size for n in (4, 5, 6, 7) for size in (50, 100, 250, 1000)},
    "aruco_original": 1024,
    "mip_36h12": 250,
    "apriltag_16h5": 30,
    "apriltag_25h9": 35,
    "apriltag_36h10": 2320,
    "apriltag_36h11": 587,
}
"""Tag dictionaries by name, and how many tags each has."""

RESERVED = ("encoders", "vision", "touch")
"""Names of other senses, which no feature may take."""


@dataclass(frozen=True)
class ColourSource:
    """The blob of a colour."""

    colour: Colour


@dataclass(frozen=True)
class TagSource:
    """An ArUco or AprilTag of a dictionary: its centre, or four tracks NAME.0 to NAME.3 where `corners`; size in m."""

    tag: int
    dictionary: str = "apriltag_36h11"
    size: float | None = None
    corners: bool = False


@dataclass(frozen=True)
class CharucoSource:
    """A ChArUco board "COLUMNSxROWS" of squares: each inner corner k is the track NAME.k; square and marker in m.

    `legacy`: whether it has the pattern of OpenCV before 4.6; None: whichever is seen.
    """

    charuco: str
    square: float
    marker: float
    dictionary: str = "4x4_50"
    legacy: bool | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Columns and rows of squares."""
        columns, rows = self.charuco.split("x")
        return int(columns), int(rows)


@dataclass(frozen=True)
class TopicSource:
    """Points that another detector published on a topic; `path` says where in a message, None: by its type."""

    topic: str
    path: str | None = None


@dataclass(frozen=True)
class TableSource:
    """Columns u, v of a table beside the log (CSV or Parquet); None: NAME_u and NAME_v."""

    table: str
    columns: tuple[str, ...] | None = None


@dataclass(frozen=True)
class PointSource:
    """The patch about `point` (u, v px) in the frame nearest `at` (s since the log's start)."""

    point: tuple[float, float]
    at: float = 0.0


Source = ColourSource | TagSource | CharucoSource | TopicSource | TableSource | PointSource

SOURCES: Mapping[str, type[Source]] = {
    "colour": ColourSource,
    "tag": TagSource,
    "charuco": CharucoSource,
    "topic": TopicSource,
    "table": TableSource,
    "point": PointSource,
}
"""The key that identifies a source, and its record; the record's other fields are its other keys."""


def parse(name: str, value: Any, where: str) -> Source:
    """The source that a value of `[features]` NAME describes; ConfigError names key, value and what is possible."""
    key = f"{where}: features.{name}"
    if not name or {"/", "."} & set(name):
        raise ConfigError(f"{where}: [features] names {name!r}; a feature's name is not empty and has no / and no .")
    if name in RESERVED:
        raise ConfigError(f"{where}: [features] names {name!r}, which is another sense; possible: any other name")
    if isinstance(value, str) or (isinstance(value, Mapping) and {"low", "high"} & set(value)):
        return ColourSource(check_colour(value, key))
    if not isinstance(value, Mapping):
        raise ConfigError(f"{key} is {value!r}; possible: a colour's name, or a table with one of {', '.join(SOURCES)}")
    kinds = [kind for kind in SOURCES if kind in value]
    if len(kinds) != 1:
        found = " and ".join(kinds) or f"only {', '.join(map(str, value)) or 'nothing'}"
        raise ConfigError(f"{key} has {found}; it must have exactly one of {', '.join(SOURCES)}")
    return _source(SOURCES[kinds[0]], value, key)


def check_colour(colour: Any, key: str) -> Colour:
    """The colour, its bounds as tuples; ConfigError where it is no colour's name and no HSV range."""
    if isinstance(colour, str):
        if colour not in NAMED_COLOURS:
            raise ConfigError(f"{key} is {colour!r}; possible: {', '.join(NAMED_COLOURS)}, or {RANGES}")
        return colour
    if not isinstance(colour, Mapping) or set(colour) != {"low", "high"} or not all(map(_hsv, colour.values())):
        raise ConfigError(f"{key} is {dict(colour) if isinstance(colour, Mapping) else colour!r}; it must be {RANGES}")
    return {bound: (int(h), int(s), int(v)) for bound, (h, s, v) in colour.items()}


def spelled(source: Source) -> Any:
    """The source as its value in TOML: a colour, or a table without what is left out."""
    if isinstance(source, ColourSource):
        return source.colour
    return {f.name: value for f in fields(source) if (value := getattr(source, f.name)) is not None}


def track_names(name: str, source: Source) -> tuple[str, ...]:
    """The tracks a feature gives: NAME, or NAME.0 and so on where it gives several."""
    if isinstance(source, CharucoSource):
        columns, rows = source.shape
        return tuple(f"{name}.{k}" for k in range((columns - 1) * (rows - 1)))
    if isinstance(source, TagSource) and source.corners:
        return tuple(f"{name}.{k}" for k in range(4))
    return (name,)


def feature_of(track: str) -> str:
    """The feature that a track belongs to: `wrist` of `wrist`, `wrist.2` and `side/wrist.2`."""
    return track.rpartition("/")[2].partition(".")[0]


def group_of(track: str) -> str:
    """The track without its number in a group: `side/wrist` of `side/wrist.2`."""
    camera, slash, name = track.rpartition("/")
    return camera + slash + name.partition(".")[0]


def board_points(source: Source) -> list[tuple[float, float, float]] | None:
    """Where a rigid thing's tracks lie on it, m, in the order of `track_names`; None where that is not known.

    Of a tag the origin is its centre, of a board its outer corner; x to the right and y down as printed, z into it.
    """
    if isinstance(source, CharucoSource):
        columns, rows = source.shape
        return [(x * source.square, y * source.square, 0.0) for y in range(1, rows) for x in range(1, columns)]
    if isinstance(source, TagSource) and source.corners and source.size is not None:
        half = source.size / 2
        return [(-half, -half, 0.0), (half, -half, 0.0), (half, half, 0.0), (-half, half, 0.0)]
    return None


def _source(kind: type[Source], value: Mapping[str, Any], key: str) -> Source:
    known = {f.name: f for f in fields(kind)}
    checked = {}
    for name, given in value.items():
        if name not in known:
            import difflib

            near = difflib.get_close_matches(str(name), known, 1, 0.0)[0]
            raise ConfigError(f"{key} has {name!r}; did you mean {near}? possible: {', '.join(known)}")
        if given is not None:
            checked[name] = _checked(name, given, f"{key}.{name}")
    missing = [name for name, field in known.items() if field.default is MISSING and name not in checked]
    if missing:
        raise ConfigError(f"{key} has no {missing[0]}; it must have {', '.join(n for n in known)[:200]}")
    return _consistent(kind(**checked), key)


def _consistent(source: Source, key: str) -> Source:
    if isinstance(source, TagSource) and source.tag >= DICTIONARIES[source.dictionary]:
        most = DICTIONARIES[source.dictionary] - 1
        raise ConfigError(f"{key}.tag is {source.tag}; {source.dictionary} has tags from 0 to {most}")
    if isinstance(source, CharucoSource) and source.marker >= source.square:
        raise ConfigError(f"{key}.marker is {source.marker:g} m; it must be less than square = {source.square:g} m")
    if isinstance(source, CharucoSource):
        columns, rows = source.shape
        if (markers := columns * rows // 2) > (most := DICTIONARIES[source.dictionary]):
            raise ConfigError(f"{key}.charuco needs {markers} markers; {source.dictionary} has {most}")
    return source


def _checked(name: str, value: Any, key: str) -> Any:
    if name == "colour":
        return check_colour(value, key)
    convert, possible = KEYS[name]
    converted = convert(value)
    if converted is None:
        raise ConfigError(f"{key} is {value!r}; possible: {possible}")
    return converted


def _hsv(values: Any) -> bool:
    whole = isinstance(values, list | tuple) and all(isinstance(v, int) and not isinstance(v, bool) for v in values)
    return whole and len(values) == 3 and 0 <= values[0] <= 180 and all(0 <= v <= 255 for v in values[1:])


def _whole(value: Any) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) and value >= 0 else None


def _number(value: Any) -> float | None:
    usable = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if usable else None


def _length(value: Any) -> float | None:
    metres = _number(value)
    return metres if metres is not None and 0 < metres <= 100 else None


def _text(value: Any) -> str | None:
    return value if isinstance(value, str) and value else None


def _flag(value: Any) -> bool | None:
    return value if isinstance(value, bool) else None


def _texts(value: Any) -> tuple[str, ...] | None:
    usable = isinstance(value, list | tuple) and len(value) >= 2 and all(map(_text, value))
    return tuple(value) if usable else None


def _pixel(value: Any) -> tuple[float, float] | None:
    if not isinstance(value, list | tuple) or len(value) != 2:
        return None
    u, v = (_number(one) for one in value)
    return None if u is None or v is None else (u, v)


def _dictionary(value: Any) -> str | None:
    """The name, also as OpenCV spells it (DICT_ARUCO_MIP_36H12)."""
    if not isinstance(value, str):
        return None
    name = value.lower().removeprefix("dict_")
    name = name.removeprefix("aruco_") if name.startswith("aruco_mip") else name
    return name if name in DICTIONARIES else None


def _board(value: Any) -> str | None:
    sides = value.lower().split("x") if isinstance(value, str) else ()
    if len(sides) != 2 or not all(s.isdecimal() and len(s) < 3 and 2 <= int(s) <= 64 for s in sides):
        return None
    return "x".join(str(int(side)) for side in sides)


KEYS: Mapping[str, tuple[Callable[[Any], Any], str]] = {
    "tag": (_whole, "a tag's number, from 0"),
    "dictionary": (_dictionary, ", ".join(DICTIONARIES)),
    "size": (_length, "a length in m, above 0: the tag's side"),
    "corners": (_flag, "true (four corners), false (the centre)"),
    "charuco": (_board, 'columns and rows of squares, "10x14", each from 2 to 64'),
    "square": (_length, "a length in m, above 0: a square's side"),
    "marker": (_length, "a length in m, above 0: a marker's side"),
    "legacy": (_flag, "true (pattern of OpenCV before 4.6), false, or left out (either)"),
    "topic": (_text, "a topic's name"),
    "path": (_text, "a message path below the topic, or left out (by its type)"),
    "table": (_text, "a file's name"),
    "columns": (_texts, "names of two or more columns: u, v; or left out (NAME_u, NAME_v)"),
    "point": (_pixel, "[u, v] in px"),
    "at": (_number, "seconds since the log's start"),
}
"""How each key's value is read (None: not possible), and the values that are possible."""
