"""Global parameters as columns of the border: what a
unit of each changes in links, images and readings.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ...kinematics.hand import Hand
from ...types import TRACK_AXES, Array
from ..measurements.track import camera_of_track
from .images import Images


@dataclass(frozen=True, eq=False)
class Path:
    """Where the joints are believed at K knots: angles,
    rates and links (K,M), and each play's state (K,M).

    links differ from angles by what bends between motor and link · slack (K,M): (link − motor) over
    half the play, in −1 … 1.
    """

    knots: Array
    angles: Array
    rates: Array
    links: Array
    slack: Array

    def at_images(self, images: Images) -> "Path":
        """The same at the images' times."""
        ahead = images.ahead[:, None]
        rows = images.knots
        rates = self.rates[rows]
        moved = ahead * rates
        return Path(
            self.knots[rows] + images.ahead,
            self.angles[rows] + moved,
            rates,
            self.links[rows] + moved,
            self.slack[rows],
        )

    def measure_levers(self, hand: Hand) -> Array:
        """The levers of a hand along the path, as of `Hand`: once for all columns of a load."""
        for known, levers in self._levers_of_hands:
            if known is hand:
                return levers
        levers = hand.measure_levers(self.angles)
        self._levers_of_hands.append((hand, levers))
        return levers

    @cached_property
    def _levers_of_hands(self) -> list[tuple[Hand, Array]]:
        return []


@dataclass(frozen=True)
class Column:
    """A global parameter that changes nothing: what a column may override.

    name · std, mean: of its size before the log · group: the one whose standard deviation, times
    std, is learned from the log; None for std alone · bends: whether it moves the links themselves,
    and not only what images show of them.
    """

    bends: ClassVar[bool] = False
    name: str
    std: float
    mean: float = 0.0
    group: int | None = None

    def moves_links(self, path: Path) -> Array:
        """What a unit moves the links by (K,M) rad."""
        return np.zeros(path.angles.shape)

    def moves_images(self, images: Images, seen: Path) -> Array:
        """What a unit moves the links by (F,M) rad, as images show them; seen: the path at their
        times.
        """
        return self.moves_links(seen)

    def displaces_images(self, images: Images, seen: Path) -> Array:
        """What a unit displaces images by beside moving links (F,D), in the unit of their sense."""
        return np.zeros(images.values.shape)

    def changes_readings(self, t: Array, path: Path) -> Array:
        """What a unit changes in readings (N,M) at t (N,) s, rad."""
        return np.zeros((len(t), path.angles.shape[1]))


@dataclass(frozen=True)
class Play(Column):
    """Half of the play between a joint's motor and its link, rad: the link trails by it."""

    bends: ClassVar[bool] = True
    joint: int = 0

    def moves_links(self, path: Path) -> Array:
        """The link's place within its play, for this joint."""
        own = np.zeros(path.angles.shape)
        own[:, self.joint] = path.slack[:, self.joint]
        return own


@dataclass(frozen=True)
class Delay(Column):
    """Delay (s) of a camera's images against the encoders: they show links as they were before."""

    camera: str = ""

    def moves_images(self, images: Images, seen: Path) -> Array:
        """Minus the rate, in this camera's images."""
        return -seen.rates * float(camera_of_track(images.sighting.name) == self.camera)


@dataclass(frozen=True)
class ImageShift(Column):
    """How far a camera's images are displaced along one axis from `since` to `until` s, in their
    unit.
    """

    camera: str = ""
    axis: int = 0
    since: float = -np.inf
    until: float = np.inf

    def displaces_images(self, images: Images, seen: Path) -> Array:
        """A unit along the axis, in this camera's images of that time."""
        own = np.zeros(images.values.shape)
        sighting = images.sighting
        if sighting.is_track and camera_of_track(sighting.name) == self.camera:
            own[:, self.axis] = (seen.knots >= self.since) & (seen.knots < self.until)
        return own


def describe_displacement(displaced: Mapping[str, Any]) -> str:
    """Displaced images in words: `camera`, `since` and `until` (s), None at an end of the log, and
    `size` along each axis, in their unit.
    """
    since = "the start" if displaced["since"] is None else f"{displaced['since']:.1f} s"
    until = "the end" if displaced["until"] is None else f"{displaced['until']:.1f} s"
    far = float(np.linalg.norm(displaced["size"]))
    unit = TRACK_AXES[len(displaced["size"])][1]
    return (
        f"{displaced['camera']}: images from {since} to {until} are displaced by {far:.2g} {unit}"
    )


@dataclass(frozen=True)
class EncoderShift(Column):
    """What an encoder reads too much from `since` to `until` s, rad."""

    joint: int = 0
    since: float = -np.inf
    until: float = np.inf

    def changes_readings(self, t: Array, path: Path) -> Array:
        """A step, or two."""
        own = np.zeros((len(t), path.angles.shape[1]))
        own[:, self.joint] = (t >= self.since) & (t < self.until)
        return own
