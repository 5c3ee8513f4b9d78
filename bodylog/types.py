"""The records that flow between stages: frozen dataclasses of arrays, nothing else.

Times `t` are float64 seconds since the recording's `start_ns`. A NaN row means: looked, saw
nothing. `source_ns` is the int64 log time (ns) of the message that brought a row, so that what is
derived from it can be written back beside it.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Protocol, Self

from .fault_kinds import ALTERNATIVE_SEPARATOR as ALTERNATIVE_SEPARATOR
from .fault_kinds import Fault as Fault
from .fault_kinds import FaultKind as FaultKind
from .logs.records import Array as Array
from .logs.records import Batch as Batch
from .logs.records import Finding as Finding
from .logs.records import LazyImage as LazyImage
from .logs.records import Outgoing as Outgoing
from .logs.records import Topic as Topic
from .settings import Settings

TRACK_AXES: Mapping[int, tuple[tuple[str, ...], str]] = {
    2: (("u", "v"), "px"),
    3: (("x", "y", "z"), "mm"),
}
"""Names and unit of a track's columns, by their number: places in images, points in space."""
MM_PER_M = 1e3
"""Points in space are in m in files and in mm here: an arm moves them by as many mm as its images
by px, and their noise is as large, so that one search serves both.
"""

Board = tuple[tuple[str, ...], Array]
"""Names of K tracks that lie on one rigid thing, and where on it: (K,3) m."""


@dataclass(frozen=True, eq=False)
class Series:
    """One signal: t (N,) s · values (N,D) in `unit` · names
    (D,) · source_ns (N,) · std (N,D) in `unit`, or None.
    """

    t: Array
    values: Array
    names: tuple[str, ...]
    unit: str
    source_ns: Array
    std: Array | None = None


@dataclass(frozen=True, eq=False)
class Poses:
    """A frame's poses in another: t (N,) s · place (N,3)
    m · turn (N,4) quaternion x, y, z, w · source_ns (N,).

    cov (N,6,6) of place, m, and of a small turn about the
    other frame's axes, rad; None where it is not known.
    """

    t: Array
    place: Array
    turn: Array
    frame: str
    source_ns: Array
    cov: Array | None = None


@dataclass(frozen=True)
class Health:
    """What became of a topic's messages: counts, reasons for rejection, the largest gap in s."""

    seen: int
    used: int
    rejected: Mapping[str, int] = field(default_factory=dict)
    largest_gap_s: float = 0.0


class FrameConsumer(Protocol):
    """Gets each image of a log's first camera, within a `with` block, while the log is read."""

    def __call__(self, frame: LazyImage) -> None:
        """Take the next image in file order; its time is not known yet."""

    def __enter__(self) -> Self:
        """Return the consumer."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        problem: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End after the last image."""


@dataclass(frozen=True, eq=False)
class ConsumedFrames:
    """Frames that a consumer got during reading: t (n,) s
    · source_ns (n,) · number (n,) of each in file order.
    """

    t: Array
    source_ns: Array
    number: Array
    by: FrameConsumer


@dataclass(frozen=True)
class Touch:
    """One touch on the skin: onset, offset (s) · cell indices
    · peak in 0..1 · strongest cell · log time of onset.
    """

    onset: float
    offset: float
    cells: tuple[int, ...]
    peak: float
    strongest: int
    source_ns: int


@dataclass(frozen=True)
class Stroke:
    """One contact stroke of the other's hand: start,
    end (s) and where it began and ended (u, v px).
    """

    start: float
    end: float
    start_px: tuple[float, float]
    end_px: tuple[float, float]


@dataclass(frozen=True)
class Synchrony:
    """How well a touch agrees with a stroke: delay =
    seen − felt (s), weight 0..1; unpaired: None, NaN, 0.

    common_cause: probability that both are one event
    at one place; 1 where that is taken for granted.
    """

    touch: int
    stroke: int | None
    delay: float
    weight: float
    common_cause: float = 1.0

    @property
    def event_weight(self) -> float:
        """The weight of the pair as one event, in time and in place."""
        return self.weight * self.common_cause


@dataclass(frozen=True, eq=False)
class PostureReadings:
    """Postures that images of the robot's own surface tell:
    t (N,) s · values (N,M) rad and cov (N,M,M) of `names`.
    """

    t: Array
    values: Array
    cov: Array
    names: tuple[str, ...]
    source_ns: Array


@dataclass(frozen=True, eq=False)
class Features:
    """What perception found: tracks (name -> Series of u, v in px, or
    of x, y, z in mm, with std), touches, strokes, synchrony.

    `touches` is None when there was no skin to look at. `effector` and `hand` are the tracks of
    those names. `picture_size` is (width, height) in px where it is known; `reference` the true
    angles where a log to learn from has them; `cameras` {camera: topic} whose pictures the tracks
    are of, "" the first one; `boards` {feature: (track names (K,), (K,3) m)} the tracks that lie on
    one rigid thing, and where on it. `poses`: rows are still poses that say nothing of each other:
    no motion joins them. `beside`: joints of further topics that nobody named. `postures`: by the
    robot's own surface, of each camera.
    """

    joints: Series | None
    tracks: Mapping[str, Series]
    touches: tuple[Touch, ...] | None
    strokes: tuple[Stroke, ...]
    synchrony: tuple[Synchrony, ...]
    health: Mapping[str, Health]
    findings: tuple[Finding, ...] = ()
    picture_size: tuple[int, int] | None = None
    reference: Series | None = None
    cameras: Mapping[str, str] = field(default_factory=dict)
    boards: Mapping[str, Board] = field(default_factory=dict)
    poses: bool = False
    beside: tuple[str, ...] = ()
    postures: Mapping[str, PostureReadings] = field(default_factory=dict)

    @property
    def effector(self) -> Series | None:
        """The end effector's track (N,2) px."""
        return self.tracks.get("effector")

    @property
    def hand(self) -> Series | None:
        """The other's hand's track (N,2) px."""
        return self.tracks.get("hand")


@dataclass(frozen=True, eq=False)
class RecordedSignals:
    """Signals of one log; a missing one is None.

    `features`: those that the log already carries. `reference` is what robot.toml names
    as the true angles to learn from; `truth` and the effector's true poses `truth_pose`
    are for scores alone. `poses`: the joints are still poses, one independent of the
    other. `tracks` {feature: …} are those of [features] that topics or tables have.
    """

    joints: Series | None = None
    skin: Series | None = None
    truth: Series | None = None
    features: Features | None = None
    reference: Series | None = None
    poses: bool = False
    truth_pose: Poses | None = None
    tracks: Mapping[str, Series] = field(default_factory=dict)


Frames = Callable[[], Iterator[LazyImage]]
"""Images in time order, from the first one at each call."""


@dataclass(frozen=True, eq=False)
class RecordedCameras:
    """Images of one log: `frames` of the first camera, and `views` {name: frames} of
    those beside it; what they show is named name/feature. `consumed` are the first
    camera's frames, if a consumer got them during reading.
    """

    frames: Frames | None = None
    views: Mapping[str, Frames] = field(default_factory=dict)
    consumed: ConsumedFrames | None = None


@dataclass(frozen=True, eq=False)
class LogFacts:
    """What is known about one log beside its content: `settings` are those it was
    read with, `beside` joints of further topics that nobody named, `track_health`
    {feature: …} of the tracks that topics or tables have.
    """

    name: str
    format: str
    topics: tuple[Topic, ...] = ()
    roles: Mapping[str, str] = field(default_factory=dict)
    health: Mapping[str, Health] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    settings: Settings = field(default_factory=Settings)
    beside: tuple[str, ...] = ()
    track_health: Mapping[str, Health] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Recording:
    """One log: when it begins (ns since the epoch), how long
    it lasts (s), its signals, its cameras, and facts about it.
    """

    start_ns: int
    duration_s: float
    facts: LogFacts
    signals: RecordedSignals
    cameras: RecordedCameras


@dataclass(frozen=True)
class Hypothesis:
    """One explanation that was weighed: its name, what it is about, ln evidence gained over the
    simpler one (nats), the threshold it had to win (nats), and whether it was chosen."""

    name: str
    about: str
    nats: float
    threshold: float
    chosen: bool


@dataclass(frozen=True)
class Capabilities:
    """What the method of an estimate can do; the defaults are those of a filter.

    causal: it uses nothing from after the time of an estimate · moves: between measurements the
    belief moves on with its rate · density: its free energy is the negative logarithm of a
    normalised density of all measurements · repairs: it takes out what faulty encoders measured · from_paper: the paper has it.
    """

    causal: bool = True
    moves: bool = True
    density: bool = True
    repairs: bool = True
    from_paper: bool = False


HARDWARE_ERRORS = "hardware_errors"
"""Key of an estimate's settings for errors of joints and encoders that it allows for: nats over
white noise alone; play {joint: rad, std}; lasting: std (rad), seconds, nats, at encoder or link, or
None; load: weight, nats, rad {joint}, or None; late {camera: seconds, std, nats}: its rest of delay.
"""

SURFACE_VIEWS = "surface"
"""In an estimate's settings: what a report shows of each camera by the robot's own surface."""
SURFACE_CHANGES = "surface_changes"
"""In an estimate's settings: shift_px of the still scene, and every hypothesis on what changed
since the body was learned, by camera of a body of the robot's surface.
"""
LASTING_ERROR = "lasting_error"
"""Key of an estimate's settings for errors of encoders
that last: std (rad), seconds, nats, nees_if_white.
"""


@dataclass(frozen=True, eq=False)
class Estimate:
    """Where the body was: joints (N,M) rad, rate (N,M)
    rad/s, cov (N,M,M) rad², free energy (N,) nats.

    errors {sense: Series in standard deviations at its times} · used {sense: Health} ·
    predicted {track: Series px with std at the track's times} · predicted_cov {track:
    (K,2,2) px²} · bias (N,M) rad or None · faults · settings as resolved · can: what
    the method can do · effector: poses in the robot's base, where lengths are known in
    m · kinematic {track: px by kinematics alone}.
    """

    method: str
    joints: Series
    rate: Series
    cov: Array
    errors: Mapping[str, Series]
    free_energy: Array
    used: Mapping[str, Health]
    predicted: Mapping[str, Series]
    predicted_cov: Mapping[str, Array]
    settings: Mapping[str, Any]
    bias: Series | None = None
    faults: tuple[Fault, ...] = ()
    findings: tuple[Finding, ...] = ()
    can: Capabilities = Capabilities()
    effector: Poses | None = None
    kinematic: Mapping[str, Series] = field(default_factory=dict)


@dataclass(frozen=True)
class Score:
    """One figure of merit that knows its unit, and its standard error where it was measured."""

    name: str
    value: float
    unit: str
    std: float | None = None
