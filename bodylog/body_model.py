"""The records of a learned body."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from .logs.records import Array

UNUSED_URDF = "unused_urdf"
"""In a body's provenance: why the URDF that it was given is not used."""
HELD = "held"
"""In the provenance: {joint: [low, high]} between which readings each stood that is not learned."""
PATCH_PX = 25
"""Side of the pictures of landmarks."""
WITHOUT_URDF = "or type --no-urdf"
"""What else to do where a URDF does not fit: the end of the remark that it is not used."""


class ForwardModel(Protocol):
    """What one sense is expected to read, given joint angles."""

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the D outputs."""

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        """At x (N,M) rad: mean (N,D) · Jacobian (N,D,M) per
        rad · model variance (N,D), sensor noise excluded.
        """


@dataclass(frozen=True)
class Noise:
    """Learned variances: encoders (M,) rad² · senses {name:
    (D,) unit²} · process (M,) rad²/s³ (white acceleration).

    Of each joint one encoder variance is kept, pooled over
    all the logs learned from, though logs may differ in it.
    """

    encoder: tuple[float, ...]
    senses: Mapping[str, tuple[float, ...]]
    process: tuple[float, ...]
    std_error: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class TouchConstants:
    """g_t = a1 exp(−b1 |g_v − o_v|²) · f_t: b1 in 1/px²
    (paper eq. touch); f_t is a pair's `Synchrony.weight`.
    """

    a1: float
    b1: float


@dataclass(frozen=True, eq=False)
class LandmarkMap:
    """Landmarks with their views.

    body (K,): numbers of the model's bodies · places (K,3) m on them, at the shared unknowns of the
    logs learned from · precision (K,3,3) 1/m² and slopes (K,3,P) m: of places, given those unknowns
    · view_of (V,): the landmark of each view, ascending · patches (V,S,S) uint8 · view_slopes
    (V,2,3) px/m: how the landmark moved in the image by its place there.
    """

    body: Array
    places: Array
    precision: Array
    slopes: Array
    view_of: Array
    patches: Array
    view_slopes: Array

    @property
    def count(self) -> int:
        """The number of landmarks."""
        return len(self.body)

    def take(self, landmarks: Array) -> "LandmarkMap":
        """The landmarks with these numbers (k,), ascending, with numbers from 0."""
        import numpy as np

        number = np.full(self.count, -1)
        number[landmarks] = np.arange(len(landmarks))
        views = number[self.view_of] >= 0
        return LandmarkMap(
            self.body[landmarks],
            self.places[landmarks],
            self.precision[landmarks],
            self.slopes[landmarks],
            number[self.view_of[views]],
            self.patches[views],
            self.view_slopes[views],
        )


@dataclass(frozen=True, eq=False)
class SurfaceCamera:
    """A camera that was calibrated by the robot's own surface.

    size (width, height) px · anchor (4,4): its link in the camera before calibration, m · lens (6,)
    and doubt (12,): prior mean, and prior std of pose and lens · unknowns (P,) ± covariance (P,P):
    pose (6), lens (6), each joint's zero, row time (s) · delays (L,) s ± delay_std of the logs
    learned from · picture (h,w): their first log's median image, shrunken, grey levels · landmarks:
    places on the links that are found again; None where too few are.
    """

    name: str
    topic: str
    link: str
    size: tuple[int, int]
    anchor: Array
    lens: Array
    doubt: Array
    unknowns: Array
    covariance: Array
    delays: Array
    delay_std: Array
    picture: Array
    landmarks: LandmarkMap | None = None

    @property
    def sense(self) -> str:
        """The name of the sense that its images of the surface are."""
        return name_surface_sense(self.name)


def name_surface_sense(camera: str) -> str:
    """The sense that a camera's images of the surface are; "camera" is the first."""
    return "surface" if camera == "camera" else f"{camera}/surface"


@dataclass(frozen=True, eq=False)
class Surface:
    """The robot's own surface as a sense: its URDF (text), and cameras calibrated on it.

    joint_of {joint of the body: joint of the URDF} · still: angles, rad or m, of the URDF's joints
    at rest · zero_std: prior std of joint zeros, rad.
    """

    urdf: str
    joint_of: Mapping[str, str]
    still: Mapping[str, float]
    zero_std: float
    cameras: tuple[SurfaceCamera, ...]


@dataclass(frozen=True, eq=False)
class BodyModel:
    """A learned body: joint names in the order of x, one
    ForwardModel per sense, noise, touch constants, provenance.

    cells {skin cell: (u, v, spread) px}: where a touched cell was seen beside the effector, and how
    far about there; of a cell not in it nothing is known but what `touch` says of all · surface:
    where no marker was learned.
    """

    joints: tuple[str, ...]
    senses: Mapping[str, ForwardModel]
    noise: Noise
    touch: TouchConstants
    provenance: Mapping[str, Any]
    cells: Mapping[int, tuple[float, float, float]] = field(default_factory=dict)
    surface: Surface | None = None
