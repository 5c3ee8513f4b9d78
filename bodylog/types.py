"""The records that flow between stages: frozen dataclasses of arrays, nothing else.

Times `t` are float64 seconds since the recording's `start_ns`. A NaN row means: looked, saw
nothing. `source_ns` is the int64 log time (ns) of the message that brought a row, so that what is
derived from it can be written back beside it.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Protocol, Self

from .logs.records import Array as Array
from .logs.records import Batch as Batch
from .logs.records import Finding as Finding
from .logs.records import LazyImage as LazyImage
from .logs.records import Outgoing as Outgoing
from .logs.records import Topic as Topic
from .settings import Settings

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
    """What became of one topic's messages: counts,
    the reasons for rejection, the largest gap in s.
    """

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
    """What perception found: tracks (name -> Series of
    u, v in px with std), touches, strokes, synchrony.

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
class Recording:
    """One log: signals, and frames() as a lazy iterator in
    time order; `features` if the log already carries them.

    `views` {name: frames} are the cameras beside the first; what they show is named
    name/feature. `reference` is what robot.toml names as the true angles to learn from;
    `truth` is for scores alone. `settings` are those it was read with. `consumed` are
    the first camera's frames, if a consumer got them during reading. `poses`: the
    joints are still poses, one independent of the other. `beside`: joints of further
    topics that nobody named. `truth_pose`: the effector's true poses, for scores alone.
    `tracks` and `track_health` {feature: …} are those of [features] that topics or
    tables have.
    """

    name: str
    format: str
    start_ns: int
    duration_s: float
    topics: tuple[Topic, ...]
    roles: Mapping[str, str]
    joints: Series | None
    skin: Series | None
    truth: Series | None
    frames: Callable[[], Iterator[LazyImage]] | None
    features: Features | None
    health: Mapping[str, Health]
    findings: tuple[Finding, ...] = ()
    reference: Series | None = None
    views: Mapping[str, Callable[[], Iterator[LazyImage]]] = field(default_factory=dict)
    settings: Settings = field(default_factory=Settings)
    consumed: ConsumedFrames | None = None
    poses: bool = False
    beside: tuple[str, ...] = ()
    truth_pose: Poses | None = None
    tracks: Mapping[str, Series] = field(default_factory=dict)
    track_health: Mapping[str, Health] = field(default_factory=dict)


ALTERNATIVE_SEPARATOR = " or "
"""Between the names of joints one of which is faulty."""


@dataclass(frozen=True)
class Fault:
    """One sensor that lied: which joint or sense, what kind,
    since when (s), how much ± std (`unit`, None: unknown).

    until: when it ended (s); None where it lasts to the end of the log,
    or has no end, as a jump. turn ± turn_std: rad by which a board also
    turned, whose size is the displacement of its centre; None otherwise.
    """

    sense: str
    name: str
    kind: str
    since: float
    size: float
    unit: str
    std: float | None = None
    turn: float | None = None
    turn_std: float | None = None
    until: float | None = None

    @property
    def alternatives(self) -> tuple[str, ...]:
        """Names, after the first, of those that explain the log alike."""
        return tuple(self.name.split(ALTERNATIVE_SEPARATOR)[1:])


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
    normalised density of all measurements · learns_noise: from the log · repairs: it takes out what
    faulty encoders measured · from_paper: the paper has it.
    """

    causal: bool = True
    moves: bool = True
    density: bool = True
    learns_noise: bool = True
    repairs: bool = True
    from_paper: bool = False


HARDWARE_ERRORS = "hardware_errors"
"""Key of an estimate's settings for errors of joints and encoders that it allows for: nats over
white noise alone; play {joint: rad, std}; lasting: std (rad), seconds, nats, at encoder or link, or
None; load: weight, nats, rad {joint}, or None; late {camera: seconds, std, nats}: its rest of delay.
"""

SURFACE_VIEWS = "surface"
"""In an estimate's settings: what a report shows of each camera by the robot's own surface."""
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
