"""Every setting with its meaning, values and default: one
record per section of robot.toml; config.py resolves them.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from .io.toml_keys import DeclaredKey, check_values, declare_key, declared_keys, spell_key
from .logs.joint_units import parse_count_unit
from .logs.limits import Input
from .sources import (
    Colour,
    ColourSource,
    Source,
    SurfaceSource,
    colour_key,
    is_colour,
    parse_source,
    source_as_value,
)

__all__ = [
    "BodySettings",
    "CameraSettings",
    "ClockSettings",
    "Colour",
    "ColourSettings",
    "EstimationSettings",
    "FitSettings",
    "KinematicsSettings",
    "Settings",
    "SkinSettings",
    "Source",
    "TimeSettings",
    "TopicSettings",
    "find_declaration",
    "list_configured_sources",
    "settings_as_values",
]

METHOD_MODULES = {
    "filter": "filtering",
    "smoother": "smoother",
    "ekf": "filtering",
    "kalman": "kalman",
    "predictive-coding": "predictive_coding",
}
"""Methods of estimation: the module of each in `estimation/methods/`; its METHODS describes it."""
METHODS = tuple(METHOD_MODULES)
PRESETS = ("default", "paper")
CLOCKS = ("auto", "header", "log")


def _are_markers(value: Mapping[str, Any]) -> bool:
    return all(name and "/" not in name and is_colour(one) for name, one in value.items())


def _is_joint_unit(value: str) -> bool:
    return value in ("rad", "deg") or parse_count_unit(value) is not None


@dataclass(frozen=True)
class TopicSettings:
    """[topics]: the topic of each role; a message path names a field in it, e.g. "/state.q"."""

    joints: str | tuple[str, ...] | None = declare_key(
        None,
        "Joint states; several topics keep a clock each.",
        noun="topic",
        distinct=True,
        unset="by message type",
    )
    camera: str | tuple[str, ...] | None = declare_key(
        None,
        "Images, or a video file; the first camera's tracks have no prefix.",
        noun="topic",
        distinct=True,
        unset="by message type",
    )
    skin: str | None = declare_key(
        None, "Values of the skin's cells.", noun="topic", unset="by message type and name"
    )
    truth: str | None = declare_key(
        None, "True joint angles for scores.", noun="topic", unset="by message type and name"
    )
    start: float | None = declare_key(
        None,
        "Time of a video file's first frame.",
        unit="s since 1970",
        low=-9e9,
        high=9e9,
        unset="first joint state",
    )
    rate: float | None = declare_key(
        None,
        "Frame rate of a video file.",
        unit="Hz",
        low=1e-3,
        high=1e6,
        unset="as the file declares",
    )
    reference: str | None = declare_key(
        None,
        "True angles to learn from, where encoders read a function of them.",
        noun="topic",
        unset="not used",
    )

    @property
    def cameras(self) -> tuple[str, ...]:
        """The configured cameras, the first one first;
        empty where roles are assigned by message type.
        """
        return (self.camera,) if isinstance(self.camera, str) else self.camera or ()


@dataclass(frozen=True)
class BodySettings:
    """[body]: the robot's joints."""

    joints: tuple[str, ...] | None = declare_key(
        None,
        "Joints, in the order of the estimate.",
        noun="joint",
        distinct=True,
        unset="the joints that move",
    )
    unit: str = declare_key(
        "rad",
        "Unit of joint readings whose topic declares none.",
        accepts=_is_joint_unit,
        choices=("rad", "deg", "4096 counts", "4096 counts from 2048"),
        form='rad, deg, or counts of one turn: "4096 counts", "4096 counts from 2048" (2048 is 0 '
        "rad)",
    )


@dataclass(frozen=True)
class ColourSettings:
    """[colours]: coloured markers to track in the images."""

    effector: Colour = colour_key("green", "Colour of the end effector.")
    hand: Colour = colour_key("red", "Colour of the hand that touches the skin.")
    markers: Mapping[str, Colour] = declare_key(
        {},
        "Further markers on the arm.",
        accepts=_are_markers,
        form="{NAME = COLOUR}, names without /",
        unset="no others",
    )
    fast: bool = declare_key(False, "Decode JPEG images at half scale: faster, less accurate.")


@dataclass(frozen=True)
class SkinSettings:
    """[skin]: how touches are found in the values of the skin's cells."""

    threshold: float = declare_key(0.7, "A touch begins above this value.", low=0, high=1)
    release: float = declare_key(0.6, "A touch ends below this value.", low=0, high=1)
    shortest: float = declare_key(0.02, "Shorter touches are noise.", unit="s", low=0, high=3600)
    columns: int | None = declare_key(
        None,
        "Cells per row of a grid.",
        low=1,
        high=10**6,
        unset="cells with consecutive numbers are neighbours",
    )


@dataclass(frozen=True)
class ClockSettings:
    """[synchrony]: the camera's clock against the skin's."""

    clock_offset: float | str = declare_key(
        0.0,
        "Lag of the camera's timestamps behind the skin's; auto estimates it.",
        unit="s",
        low=-9e9,
        high=9e9,
        choices=("auto",),
    )


@dataclass(frozen=True)
class TimeSettings:
    """[time]: the clock that timestamps each stream;
    auto takes message headers where these are sound.
    """

    joints: str = declare_key("auto", "Clock of the joint states.", choices=CLOCKS)
    camera: str = declare_key("auto", "Clock of the images.", choices=CLOCKS)
    skin: str = declare_key("auto", "Clock of the skin.", choices=CLOCKS)
    truth: str = declare_key("auto", "Clock of the true angles.", choices=CLOCKS)
    reference: str = declare_key("auto", "Clock of the reference.", choices=CLOCKS)
    delay: str | Mapping[str, float] = declare_key(
        "auto",
        "Delay of a camera or of joints; auto estimates it.",
        unit="s",
        low=-3600,
        high=3600,
        choices=("auto", "off"),
    )


@dataclass(frozen=True)
class FitSettings:
    """[fit]: how a body is learned."""

    preset: str = declare_key(
        "default",
        "Model constants: learned (default), or the paper's with 46 samples (paper).",
        choices=PRESETS,
    )
    samples: int = declare_key(2000, "Most samples that a model keeps.", low=8, high=10**9)
    every: int = declare_key(1, "Use every n-th frame.", low=1, high=10**9)
    seed: int = declare_key(0, "Seed of the optimiser's restarts.", low=0, high=2**63)
    without: tuple[str, ...] = declare_key(
        (), "Tracks or features that are not learned.", noun="track", unset="learn all"
    )


@dataclass(frozen=True)
class KinematicsSettings:
    """[kinematics]: the robot's URDF and what may differ from it."""

    urdf: str | None = declare_key(
        None,
        "URDF file of the robot; log requires the log's own.",
        noun="file",
        unset="the log's own, if any",
    )
    use: bool = declare_key(True, "Use the URDF.")
    offset_prior: float = declare_key(
        5.0,
        "Prior standard deviation of joint offsets; 0 estimates none.",
        unit="deg",
        low=0,
        high=180,
    )
    scale_prior: float = declare_key(  # beyond 0.3 the gear is another one
        0.0,
        "Prior standard deviation of joint scales, relative; 0 estimates none.",
        low=0,
        high=0.3,
    )


@dataclass(frozen=True)
class CameraSettings:
    """[camera]: what is known of the first camera beforehand, with its doubt."""

    info: str | None = declare_key(
        None, "CameraInfo (YAML) with its lens.", noun="file", unset="the log's own, if any"
    )
    focal: float | None = declare_key(
        None, "Its focal length.", unit="px", low=1, high=1e6, unset="estimated, or by info"
    )
    focal_std: float = declare_key(
        0.01, "Standard deviation of a given focal length, relative.", low=1e-6, high=1
    )
    link: str | None = declare_key(
        None, "Link that carries it.", noun="link", unset="by frame, tf or evidence"
    )
    place: tuple[float, ...] | None = declare_key(
        None,
        "Optical frame in that link: x, y, z, roll, pitch, yaw.",
        unit="m and rad",
        low=-100,
        high=100,
        unset="estimated",
    )
    place_std: float = declare_key(
        0.02, "Standard deviation of that place.", unit="m", low=1e-6, high=10
    )
    turn_std: float = declare_key(
        2.0, "Standard deviation of that orientation.", unit="deg", low=1e-4, high=180
    )


@dataclass(frozen=True)
class MarkerSettings:
    """[marker]: where a marker or board is, as far as it is known beforehand."""

    name: str | None = declare_key(
        None, "Marker that it is about.", noun="feature", unset="the only one"
    )
    link: str | None = declare_key(None, "Link that carries it.", noun="link", unset="by evidence")
    place: tuple[float, ...] | None = declare_key(
        None,
        "Its frame in that link: x, y, z, roll, pitch, yaw.",
        unit="m and rad",
        low=-100,
        high=100,
        unset="estimated",
    )
    place_std: float = declare_key(
        0.01, "Standard deviation of that place.", unit="m", low=1e-6, high=10
    )
    turn_std: float = declare_key(
        2.0, "Standard deviation of that orientation.", unit="deg", low=1e-4, high=180
    )


@dataclass(frozen=True)
class EstimationSettings:
    """[estimate]: how joint angles are estimated; variances here replace those of `precision`."""

    method: str = declare_key(
        "filter", "Estimation method; preset paper implies predictive-coding.", choices=METHODS
    )
    preset: str = declare_key(
        "default", "Constants: of bodylog (default) or of the paper (paper).", choices=PRESETS
    )
    senses: tuple[str, ...] | None = declare_key(
        None,
        "Senses to use: encoders, vision, touch, joints or tracks.",
        noun="sense",
        unset="all in the log",
    )
    without: tuple[str, ...] = declare_key(
        (), "Senses to leave out.", noun="sense", unset="leave out none"
    )
    rate: float | None = declare_key(  # up to that of the fastest joint controllers
        None,
        "Estimates per second.",
        unit="Hz",
        low=1e-3,
        high=1e4,
        unset="the encoders' rate, at most 100",
    )
    precision: str = declare_key(
        "auto",
        "Variances: from this log (auto), the body (model) or the paper (fixed).",
        choices=("auto", "model", "fixed"),
    )
    motion: str = declare_key(
        "auto",
        "Motion of joints: auto, white-acceleration, white-jerk, or another model's name.",
        noun="motion model",
    )
    bias: str = declare_key(
        "auto",
        "Encoder offset states; not for kalman, predictive-coding.",
        choices=("auto", "on", "off"),
    )
    hardware_errors: str = declare_key(
        "explain",
        "Errors that last: take them out where trusted, or widen error bars.",
        choices=("explain", "widen"),
    )
    touch: str = declare_key(
        "likelihood", "Reading of the paper's touch equation.", choices=("likelihood", "literal")
    )
    common_cause: float | None = declare_key(
        None,
        "Prior probability that a touch and its stroke are at one place.",
        low=0,
        high=1,
        unset="taken for granted",
    )
    step: str = declare_key(
        "implicit", "Euler step of predictive-coding.", choices=("implicit", "explicit")
    )
    start: tuple[float, ...] | None = declare_key(
        None,
        "Joint angles at the start.",
        unit="rad",
        low=-1e4,
        high=1e4,
        unset="from the measurements",
    )
    sigma_encoders: float | Mapping[str, float] | None = declare_key(
        None,
        "Variance of all encoders, or by joint.",
        unit="rad²",
        low=1e-18,
        high=1e6,
        unset="by precision",
    )
    sigma_vision: float | Mapping[str, float] | None = declare_key(
        None,
        "Variance of all tracks, or by track.",
        unit="px²",
        low=1e-12,
        high=1e12,
        unset="by precision",
    )
    sigma_touch: float | None = declare_key(
        None, "Variance of touch.", unit="px²", low=1e-12, high=1e12, unset="by precision"
    )
    process: float | Mapping[str, float] | None = declare_key(
        None,
        "Process noise of all joints, or by joint; rad²/s⁵ under white jerk.",
        unit="rad²/s³",
        low=1e-18,
        high=1e9,
        unset="by precision",
    )
    lambda_: float | None = declare_key(
        None,
        "Rate at which predictive-coding's prior follows its belief.",
        unit="1/s",
        low=0,
        high=1e3,
        unset="the paper's",
    )

    @property
    def typed(self) -> dict[str, float | Mapping[str, float]]:
        """The variances that are set, by key."""
        keys = ("sigma_encoders", "sigma_vision", "sigma_touch", "process", "lambda_")
        return {spell_key(key): value for key in keys if (value := getattr(self, key)) is not None}


@dataclass(frozen=True)
class Settings:
    """All sections; `features` {name: source} declares tracks beside those of [colours].

    A section may be given as a mapping of its keys;
    ConfigError for an unknown key or an impossible value.
    """

    input: Input = field(default_factory=Input)
    topics: TopicSettings = field(default_factory=TopicSettings)
    body: BodySettings = field(default_factory=BodySettings)
    features: Mapping[str, Source] = field(default_factory=dict)
    colours: ColourSettings = field(default_factory=ColourSettings)
    skin: SkinSettings = field(default_factory=SkinSettings)
    time: TimeSettings = field(default_factory=TimeSettings)
    fit: FitSettings = field(default_factory=FitSettings)
    kinematics: KinematicsSettings = field(default_factory=KinematicsSettings)
    camera: CameraSettings = field(default_factory=CameraSettings)
    marker: MarkerSettings = field(default_factory=MarkerSettings)
    estimate: EstimationSettings = field(default_factory=EstimationSettings)
    synchrony: ClockSettings = field(default_factory=ClockSettings)

    def __post_init__(self) -> None:
        """Build each section that is given as a mapping."""
        for one in fields(self):
            value = getattr(self, one.name)
            if one.name == "features":
                sources = {
                    n: s if isinstance(s, Source) else parse_source(n, s, "Settings")
                    for n, s in value.items()
                }
                object.__setattr__(self, one.name, sources)
            elif isinstance(value, Mapping):
                table = one.default_factory
                assert isinstance(table, type)
                object.__setattr__(
                    self, one.name, table(**check_values(table, value, "Settings", one.name))
                )


def find_declaration(section: str, name: str) -> DeclaredKey:
    """The declaration of a setting by its section and key in robot.toml."""
    return declared_keys(type(getattr(Settings(), section)))[name]


def settings_as_values(settings: Settings) -> dict[str, Any]:
    """The settings as nested plain values, to be written beside a result."""
    found = {
        section: {spell_key(k): v for k, v in values.items()}
        for section, values in asdict(settings).items()
    }
    return found | {
        "features": {name: source_as_value(source) for name, source in settings.features.items()}
    }


def list_sought_sources(settings: Settings, skin: bool) -> dict[str, Source]:
    """The features to track in a log with or without
    `skin`: the default hand is of use to touches alone.
    """
    found = list_configured_sources(settings)
    default = settings.colours.hand == ColourSettings().hand and "hand" not in settings.features
    return {name: source for name, source in found.items() if name != "hand" or skin or not default}


def hand_colour(settings: Settings, skin: bool) -> Colour | None:
    """The colour of the hand that touches the skin;
    None in a log without skin, unless it is configured.
    """
    return settings.colours.hand if skin or settings.colours.hand != ColourSettings().hand else None


def list_configured_sources(settings: Settings) -> dict[str, Source]:
    """Every feature to track and its source: [colours], then [features], which wins.

    Once [features] names anything, the effector's
    colour is tracked only where it is not the default.
    """
    colours = settings.colours
    found: dict[str, Source] = {
        "effector": ColourSource(colours.effector),
        "hand": ColourSource(colours.hand),
    }
    if settings.features and colours.effector == ColourSettings().effector:
        del found["effector"]
    found |= {name: ColourSource(one) for name, one in colours.markers.items()}
    return found | {
        name: one for name, one in settings.features.items() if not isinstance(one, SurfaceSource)
    }
