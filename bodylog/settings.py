"""Every setting with its default, one record per section of robot.toml; config.py resolves them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from .logs.limits import Input
from .sources import Colour, ColourSource, Source, spelled

__all__ = [
    "Body", "Clocks", "Colour", "Colours", "Estimation", "Fit", "Kinematics", "Settings", "Skin", "Source",
    "Time", "Topics", "plain", "wanted",
]  # fmt: skip


@dataclass(frozen=True)
class Topics:
    """[topics]: which topic plays which role, with a message path where a field must be named; None is guessed.

    `joints` may be several topics, each with its own clock. `camera` may be several, the first of which names its
    tracks plainly. One may be a video file beside the log: then `start` is the time of its first frame (s since epoch;
    None: the first joint) and `rate` its frames per second (None: as the file says). `reference` has the true angles
    of a log to learn from, where encoders read another function of them; it is never guessed.
    """

    joints: str | tuple[str, ...] | None = None
    camera: str | tuple[str, ...] | None = None
    skin: str | None = None
    truth: str | None = None
    start: float | None = None
    rate: float | None = None
    reference: str | None = None

    @property
    def cameras(self) -> tuple[str, ...]:
        """The cameras named, the first one first; none when they are to be guessed."""
        return (self.camera,) if isinstance(self.camera, str) else self.camera or ()


@dataclass(frozen=True)
class Body:
    """[body]: joint names in the order wanted (None: those that move), and the unit the log speaks.

    That is rad, deg, or encoder counts: "4096 counts" of one turn, "4096 counts from 2048" where 2048 is 0 rad.
    """

    joints: tuple[str, ...] | None = None
    unit: str = "rad"


@dataclass(frozen=True)
class Colours:
    """[colours]: what to look for in the pictures; `markers` names further features on the arm.

    `fast` looks at JPEG pictures at half scale: less exact, in less time.
    """

    effector: Colour = "green"
    hand: Colour = "red"
    markers: Mapping[str, Colour] = field(default_factory=dict)
    fast: bool = False


@dataclass(frozen=True)
class Skin:
    """[skin]: a cell is touched above `threshold` until below `release`; shorter than `shortest` s is noise.

    Cells neighbour by number, or by row and column where `columns` says how many cells make a row.
    """

    threshold: float = 0.7
    release: float = 0.6
    shortest: float = 0.02
    columns: int | None = None


@dataclass(frozen=True)
class Clocks:
    """[synchrony]: how much later (s) the camera's clock dates what the skin feels; "auto": the log's own median."""

    clock_offset: float | str = 0.0


@dataclass(frozen=True)
class Time:
    """[time]: which clock dates each stream, "header", "log" or "auto" (header where there is a sound one).

    `delay`: how much later (s) than the encoders each camera dates what it shows, {name: s}, or the joints what they
    read, as those know that ask where the body is; "auto": as the log has it, where it is sure; "off": not at all.
    """

    joints: str = "auto"
    camera: str = "auto"
    skin: str = "auto"
    truth: str = "auto"
    reference: str = "auto"
    delay: str | Mapping[str, float] = "auto"


@dataclass(frozen=True)
class Fit:
    """[fit]: preset default or paper · most samples kept · use every n-th frame · seed of restarts.

    without: tracks, or features with all their tracks, that are not learned.
    """

    preset: str = "default"
    samples: int = 2000
    every: int = 1
    seed: int = 0
    without: tuple[str, ...] = ()


@dataclass(frozen=True)
class Kinematics:
    """[kinematics]: the URDF (None: the log's own, if any; "log": insist on it), whether to use it, σ of offsets, °.

    scale_prior: σ of the joints' scales, in shares of one; 0: a joint turns by what it reads.
    """

    urdf: str | None = None
    use: bool = True
    offset_prior: float = 5.0
    scale_prior: float = 0.0


@dataclass(frozen=True)
class Estimation:
    """[estimate]: method, senses (None: all that are there), output rate in Hz (None: as the encoders, at most 100).

    Where robot.toml or the command line sets the preset paper and names no method, that is predictive-coding.
    Variances that are typed are used as they are, others are found as `precision` says: sigma_encoders (rad²) and
    process (rad²/s³) for all joints or {joint: …}, sigma_vision (px²) for all tracks or {track: …}, sigma_touch (px²).
    `lambda` (written lambda_ in Python): how fast the prior of predictive coding follows its belief, 1/s.
    """

    method: str = "laplace"
    preset: str = "default"
    senses: tuple[str, ...] | None = None
    without: tuple[str, ...] = ()
    rate: float | None = None
    precision: str = "auto"
    bias: str = "auto"
    touch: str = "likelihood"
    step: str = "implicit"
    start: tuple[float, ...] | None = None
    sigma_encoders: float | Mapping[str, float] | None = None
    sigma_vision: float | Mapping[str, float] | None = None
    sigma_touch: float | None = None
    process: float | Mapping[str, float] | None = None
    lambda_: float | None = None

    @property
    def typed(self) -> dict[str, float | Mapping[str, float]]:
        """The variances that are typed, by key."""
        keys = ("sigma_encoders", "sigma_vision", "sigma_touch", "process", "lambda_")
        return {spell(key): value for key in keys if (value := getattr(self, key)) is not None}


@dataclass(frozen=True)
class Settings:
    """All sections; `features` {name: source} says where each track comes from, beside [colours]."""

    input: Input = field(default_factory=Input)
    topics: Topics = field(default_factory=Topics)
    body: Body = field(default_factory=Body)
    features: Mapping[str, Source] = field(default_factory=dict)
    colours: Colours = field(default_factory=Colours)
    skin: Skin = field(default_factory=Skin)
    time: Time = field(default_factory=Time)
    fit: Fit = field(default_factory=Fit)
    kinematics: Kinematics = field(default_factory=Kinematics)
    estimate: Estimation = field(default_factory=Estimation)
    synchrony: Clocks = field(default_factory=Clocks)


def spell(field: str) -> str:
    """A setting's key in robot.toml: Python's own words end in _ as names of fields."""
    return field.rstrip("_")


def _spelled(values: Mapping[str, Any]) -> dict[str, Any]:
    return {spell(key): value for key, value in values.items()}


def plain(settings: Settings) -> dict[str, Any]:
    """The settings as nested plain values, to be written beside a result."""
    from dataclasses import asdict

    found = {section: _spelled(values) for section, values in asdict(settings).items()}
    return found | {"features": {name: spelled(source) for name, source in settings.features.items()}}


def wanted(settings: Settings) -> dict[str, Source]:
    """Every feature to look for and its source: [colours], then [features], which wins.

    Once [features] names anything, the effector's colour is looked for only where it is not the default.
    """
    colours = settings.colours
    found: dict[str, Source] = {"effector": ColourSource(colours.effector), "hand": ColourSource(colours.hand)}
    if settings.features and colours.effector == Colours().effector:
        del found["effector"]
    found |= {name: ColourSource(colour) for name, colour in colours.markers.items()}
    return found | dict(settings.features)
