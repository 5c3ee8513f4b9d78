"""Sources of tracks: one record per kind of source of `[features]`, read from TOML and checked."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import MISSING, dataclass, fields
from typing import Any

from .errors import ConfigError
from .io.toml_keys import check_values, declare_key

Colour = str | Mapping[str, tuple[int, int, int]]
"""A name ("green"), or {"low": (h, s, v), "high": (h, s,
v)} in OpenCV ranges; low h > high h wraps around red.
"""

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


_LENGTH: Any = {"unit": "m", "low": 1e-6, "high": 100}


def is_colour(value: Any) -> bool:
    """Whether a value is the name or the HSV range of a colour."""
    with suppress(ConfigError):
        return check_colour(value, "") is not None
    return False


def _is_board(value: str) -> bool:
    sides = value.split("x")
    return len(sides) == 2 and all(
        s.isdecimal() and s.isascii() and len(s) < 3 and 2 <= int(s) <= 64 for s in sides
    )


def colour_key(default: Any, meaning: str) -> Any:
    """Declare a key that is a colour."""
    form = f"{', '.join(NAMED_COLOURS)}, or {RANGES}"
    return declare_key(default, meaning, choices=NAMED_COLOURS, accepts=is_colour, form=form)


@dataclass(frozen=True)
class ColourSource:
    """The blob of a colour."""

    colour: Colour = colour_key(MISSING, "Colour of the blob.")


@dataclass(frozen=True)
class TagSource:
    """An ArUco tag or AprilTag: its centre, or its corners as the tracks NAME.0 to NAME.3."""

    tag: int = declare_key(MISSING, "Number of the tag.", low=0, high=10**6)
    dictionary: str = declare_key(
        "apriltag_36h11", "Dictionary of the tag.", choices=tuple(DICTIONARIES)
    )
    size: float | None = declare_key(None, "Side of the tag.", unset="unknown", **_LENGTH)
    corners: bool = declare_key(False, "Track the four corners.")


@dataclass(frozen=True)
class CharucoSource:
    """A ChArUco board: each inner corner k is the track NAME.k."""

    charuco: str = declare_key(
        MISSING,
        "Squares of the board.",
        accepts=_is_board,
        form='columns and rows, "10x14", each from 2 to 64',
    )
    square: float = declare_key(MISSING, "Side of a square.", **_LENGTH)
    marker: float = declare_key(MISSING, "Side of a marker.", **_LENGTH)
    dictionary: str = declare_key(
        "4x4_50", "Dictionary of the markers.", choices=tuple(DICTIONARIES)
    )
    legacy: bool | None = declare_key(None, "Pattern of OpenCV before 4.6.", unset="either pattern")

    @property
    def shape(self) -> tuple[int, int]:
        """Columns and rows of squares."""
        columns, rows = self.charuco.split("x")
        return int(columns), int(rows)


@dataclass(frozen=True)
class TopicSource:
    """Points that another detector published on a topic."""

    topic: str = declare_key(MISSING, "Topic of the points.", noun="topic")
    path: str | None = declare_key(
        None, "Message path of a point.", noun="message path", unset="by message type"
    )
    frame: str | None = declare_key(
        None, "Frame in which points are in space, in m.", noun="frame", unset="in images, px"
    )


@dataclass(frozen=True)
class TableSource:
    """Columns of a table beside the log (CSV or Parquet)."""

    table: str = declare_key(MISSING, "File of the table.", noun="file")
    columns: tuple[str, ...] | None = declare_key(
        None,
        "Columns of u and v, or of x, y and z.",
        accepts=lambda names: len(names) > 1 and all(names),
        unset="NAME_u, NAME_v",
        form="names of two or more columns",
    )
    frame: str | None = declare_key(
        None, "Frame in which points are in space, in m.", noun="frame", unset="in images, px"
    )


@dataclass(frozen=True)
class PointSource:
    """The patch around a point of one frame."""

    point: tuple[float, float] = declare_key(
        MISSING, "Place of the point.", unit="px", form="[u, v] in px"
    )
    at: float = declare_key(
        0.0, "Time of the frame after the start of the log.", form="number of seconds"
    )


@dataclass(frozen=True)
class SurfaceSource:
    """The robot's own surface: corners on its links, explained by a URDF; no track of its own."""

    surface: bool = declare_key(
        MISSING, "Learn by the robot's own surface.", accepts=lambda on: on is True, form="true"
    )


Source = (
    ColourSource
    | TagSource
    | CharucoSource
    | TopicSource
    | TableSource
    | PointSource
    | SurfaceSource
)

SOURCES: Mapping[str, type[Source]] = {
    "colour": ColourSource,
    "tag": TagSource,
    "charuco": CharucoSource,
    "topic": TopicSource,
    "table": TableSource,
    "point": PointSource,
    "surface": SurfaceSource,
}
"""The key that identifies a source, and its record;
the record's other fields are its other keys.
"""


def parse_source(name: str, value: Any, where: str) -> Source:
    """The source that a value of `[features]` NAME describes;
    ConfigError names key, value and what is possible.
    """
    label = f"{where}: features.{name}"
    if not name or {"/", "."} & set(name):
        raise ConfigError(
            f"{where}: [features] names {name!r}; a feature's name is not empty and has no / "
            "and no ."
        )
    if name in RESERVED:
        raise ConfigError(
            f"{where}: [features] names {name!r}, which is another sense; possible: any other name"
        )
    if isinstance(value, str) or (isinstance(value, Mapping) and {"low", "high"} & set(value)):
        return ColourSource(check_colour(value, label))
    if not isinstance(value, Mapping):
        raise ConfigError(
            f"{label} is {value!r}; possible: a colour's name, or a table with one of "
            f"{', '.join(SOURCES)}"
        )
    kinds = [kind for kind in SOURCES if kind in value]
    if len(kinds) != 1:
        found = " and ".join(kinds) or f"only {', '.join(map(str, value)) or 'nothing'}"
        raise ConfigError(f"{label} has {found}; it must have exactly one of {', '.join(SOURCES)}")
    return _build_source(SOURCES[kinds[0]], value, where, f"features.{name}")


def check_colour(colour: Any, key: str) -> Colour:
    """The colour, its bounds as tuples; ConfigError for an unknown name or an invalid HSV range."""
    if isinstance(colour, str):
        if colour not in NAMED_COLOURS:
            raise ConfigError(
                f"{key} is {colour!r}; possible: {', '.join(NAMED_COLOURS)}, or {RANGES}"
            )
        return colour
    if (
        not isinstance(colour, Mapping)
        or set(colour) != {"low", "high"}
        or not all(map(_is_hsv_bound, colour.values()))
    ):
        raise ConfigError(
            f"{key} is {dict(colour) if isinstance(colour, Mapping) else colour!r}; it must "
            f"be {RANGES}"
        )
    return {bound: (int(h), int(s), int(v)) for bound, (h, s, v) in colour.items()}


def source_as_value(source: Source) -> Any:
    """The source as its value in TOML: a colour, or a table without the defaults."""
    if isinstance(source, ColourSource):
        return source.colour
    return {f.name: value for f in fields(source) if (value := getattr(source, f.name)) is not None}


def track_names(name: str, source: Source) -> tuple[str, ...]:
    """The tracks a feature gives: NAME, or NAME.0 and so on where it gives several."""
    if isinstance(source, SurfaceSource):
        return ()
    if isinstance(source, CharucoSource):
        columns, rows = source.shape
        return tuple(f"{name}.{k}" for k in range((columns - 1) * (rows - 1)))
    if isinstance(source, TagSource) and source.corners:
        return tuple(f"{name}.{k}" for k in range(4))
    if isinstance(source, TopicSource | TableSource) and source.frame is not None:
        return (f"{source.frame}/{name}",)
    return (name,)


def describe_source(source: Source) -> str:
    """What a source looks for, for people: "tag 7 of apriltag_36h11"."""
    match source:
        case TagSource():
            return f"tag {source.tag} of {source.dictionary}"
        case CharucoSource():
            return f"a {source.charuco} ChArUco board of {source.dictionary}"
        case ColourSource(colour=str()):
            return f"something {source.colour}"
        case ColourSource():
            return "its colour"
        case PointSource():
            return f"the patch around ({source.point[0]:g}, {source.point[1]:g}) px"
        case SurfaceSource():
            return "the robot's own surface"
        case TopicSource():
            return f"points on {source.topic}"
        case TableSource():
            return f"places in {source.table}"


def feature_of(track: str) -> str:
    """The feature that a track belongs to: `wrist` of `wrist`, `wrist.2` and `side/wrist.2`."""
    return track.rpartition("/")[2].partition(".")[0]


def group_of(track: str) -> str:
    """The track without its number in a group: `side/wrist` of `side/wrist.2`."""
    camera, slash, name = track.rpartition("/")
    return camera + slash + name.partition(".")[0]


def board_points(source: Source) -> list[tuple[float, float, float]] | None:
    """The places of a rigid thing's tracks on it, m,
    in the order of `track_names`; None where unknown.

    The origin is a tag's centre or a board's outer corner;
    x to the right and y down as printed, z into it.
    """
    if isinstance(source, CharucoSource):
        columns, rows = source.shape
        return [
            (x * source.square, y * source.square, 0.0)
            for y in range(1, rows)
            for x in range(1, columns)
        ]
    if isinstance(source, TagSource) and source.corners and source.size is not None:
        half = source.size / 2
        return [(-half, -half, 0.0), (half, -half, 0.0), (half, half, 0.0), (-half, half, 0.0)]
    return None


def _build_source(kind: type[Source], value: Mapping[str, Any], where: str, label: str) -> Source:
    spelled_out = {"dictionary": _canonical_dictionary, "charuco": _canonical_board}
    given = {k: spelled_out.get(k, lambda one: one)(v) for k, v in value.items() if v is not None}
    return _require_consistent(kind(**check_values(kind, given, where, label)), f"{where}: {label}")


def _require_consistent(source: Source, key: str) -> Source:
    if isinstance(source, TagSource) and source.tag >= DICTIONARIES[source.dictionary]:
        most = DICTIONARIES[source.dictionary] - 1
        raise ConfigError(
            f"{key}.tag is {source.tag}; {source.dictionary} has tags from 0 to {most}"
        )
    if isinstance(source, CharucoSource) and source.marker >= source.square:
        raise ConfigError(
            f"{key}.marker is {source.marker:g} m; it must be less than square = "
            f"{source.square:g} m"
        )
    if isinstance(source, CharucoSource):
        columns, rows = source.shape
        if (markers := columns * rows // 2) > (most := DICTIONARIES[source.dictionary]):
            raise ConfigError(
                f"{key}.charuco needs {markers} markers; {source.dictionary} has {most}"
            )
    return source


def _is_hsv_bound(values: Any) -> bool:
    whole = isinstance(values, list | tuple) and all(
        isinstance(v, int) and not isinstance(v, bool) for v in values
    )
    return (
        whole
        and len(values) == 3
        and 0 <= values[0] <= 180
        and all(0 <= v <= 255 for v in values[1:])
    )


def _canonical_dictionary(value: Any) -> Any:
    """The name of a dictionary that OpenCV spells otherwise (DICT_ARUCO_MIP_36H12)."""
    if not isinstance(value, str):
        return value
    name = value.lower().removeprefix("dict_")
    return name.removeprefix("aruco_") if name.startswith("aruco_mip") else name


def _canonical_board(value: Any) -> Any:
    """Columns and rows of a board without leading zeros."""
    lower = value.lower() if isinstance(value, str) else value
    return (
        "x".join(str(int(side)) for side in lower.split("x"))
        if isinstance(lower, str) and _is_board(lower)
        else lower
    )
