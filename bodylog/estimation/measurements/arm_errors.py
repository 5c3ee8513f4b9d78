"""What an arm and its cameras keep from log to log: play between motors and
links, errors of encoders that last, and rows of pictures that are exposed in turn.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from math import isfinite
from typing import Any

import numpy as np

from ...body_model import BodyModel
from ...errors import ModelError
from ...types import Array, Features, Finding, Series
from .long_arrays import estimate_noise_variance, find_finite_rows, measure_median_step
from .records import interpolate_values

ARM_ERRORS = "arm_errors"
"""In a body's provenance: the errors that it was learned with."""
SMOOTH_S = 0.05
"""s over which readings are averaged before links are derived from them: arms hardly turn back
within it. Links of 24 drawn logs with 8 mrad of play, smooth or reaches, with 0.2 or 1 mrad of
noise, are off by 0.37, 0.21, 0.16, 0.14 and 0.28 mrad with 0.01, 0.02, 0.05, 0.1 and 0.2 s; with
0.1 s those of reaches with 0.2 mrad of noise by 0.12 in place of 0.06.
"""
NOISE_SIGMAS = 2.0
"""Standard deviations of a motor's angle that a turn back must exceed. With 0, 1, 2, 3 and 4 the
same links are off by 0.36, 0.23, 0.16, 0.17 and 0.22 mrad.
"""
PLAY_STD = 0.01
"""rad: prior standard deviation of half a play, 1.1° of play."""
LEAST_PLAY = 5e-4
"""rad: half of a play that is assumed at least, so that noise of the angle does not turn the link.
"""
LEAST_NEES = 1.5
"""Mean squared error over the stated variance from which error bars are worth a warning: 2σ then
covers 90 %. Of held-out images of 40 drawn sound explorations (docs/learning.md) the most had 1.27;
where encoders' errors last and are taken for noise of images, it was 2.1 to 2.6.
"""
MOST_OF_STEP = 0.45
"""Largest shift of an image by its row, in steps of the
camera: rows of a picture are exposed before the next one.
"""


@dataclass(frozen=True)
class RowExposure:
    """When a camera exposes a row: `seconds` ± std a px
    later than the row above, on time at `row` px.

    span: px between the rows that the log showed it at.
    """

    seconds: float
    std: float
    row: float
    span: float


@dataclass(frozen=True)
class ArmErrors:
    """Play {joint: (rad, std)}, from one end to the
    other, and {camera: RowExposure} of its pictures.

    lasting {joint: (σ rad, τ s)}: an Ornstein–Uhlenbeck error of the encoder · held_out {track}:
    squared held-out errors over their stated variance, where these are more than LEAST_NEES.
    """

    play: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    rows: Mapping[str, RowExposure] = field(default_factory=dict)
    lasting: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    held_out: Mapping[str, float] = field(default_factory=dict)

    def has_all_of(self, other: "ArmErrors") -> bool:
        """Whether these have the same joints' play as others, and all of their row times."""
        return self.play.keys() == other.play.keys() and other.rows.keys() <= self.rows.keys()

    def __bool__(self) -> bool:
        """Whether there are any."""
        return bool(self.play or self.rows or self.lasting or self.held_out)

    def as_provenance(self) -> dict[str, Any]:
        """Plain numbers for a body's provenance."""
        numbers = {
            "play": {name: list(pair) for name, pair in self.play.items()},
            "rows": {name: asdict(one) for name, one in self.rows.items()},
            "lasting": {name: list(pair) for name, pair in self.lasting.items()},
            "held_out": dict(self.held_out),
        }
        return {ARM_ERRORS: numbers}

    def warn_of_narrow_bars(self) -> Iterator[Finding]:
        """Yield a warning for each track whose images
        were farther off in the exploration than is stated.
        """
        for name, ratio in self.held_out.items():
            yield Finding(
                "warning",
                f"{name}: in the exploration squared errors of held-out images were {ratio:.2g} "
                "times their stated variance, so error bars are too small: encoders or the marker "
                'err for long, or joints stick and slip; see "What real arms do" in '
                "docs/validation.md",
            )


def read_arm_errors(body: BodyModel | None) -> ArmErrors:
    """The errors that a body was learned with; ModelError for anything else in its provenance."""
    given = {} if body is None else body.provenance.get(ARM_ERRORS, {})
    try:
        play, lasting = (
            {str(k): (float(v[0]), float(v[1])) for k, v in given.get(part, {}).items()}
            for part in ("play", "lasting")
        )
        rows = {str(k): RowExposure(**v) for k, v in given.get("rows", {}).items()}
        held_out = {str(k): float(v) for k, v in given.get("held_out", {}).items()}
        numbers = [n for one in (play, lasting) for v in one.values() for n in v]
        if not all(v > 0.0 for pair in lasting.values() for v in pair):
            numbers.append(np.nan)
        numbers += [*held_out.values()]
        numbers += [float(n) for one in rows.values() for n in asdict(one).values()]
    except (AttributeError, IndexError, KeyError, TypeError, ValueError):
        numbers = [np.nan]
    if not all(map(isfinite, numbers)):
        raise ModelError(
            f"provenance.{ARM_ERRORS}: found {given!r}, possible: play, rows, lasting and held_out "
            "in numbers"
        )
    return ArmErrors(play, rows, lasting, held_out)


def shift_by_rows(track: Series, rows: RowExposure | None) -> Array:
    """Times (N,) s at which a camera exposed the rows where a track was seen."""
    seen = find_finite_rows(track.values)
    if rows is None or seen.sum() < 2:
        return track.t
    most = MOST_OF_STEP * measure_median_step(track.t)
    later = rows.seconds * (np.where(seen, track.values[:, -1], rows.row) - rows.row)
    return np.asarray(track.t + np.clip(later, -most, most))


def follow_slack(motors: Array, half: Array, noise: Array) -> Array:
    """Where links lie within their play (K,M), −1 … 1,
    while motors (K,M) rad turn; half (M,) rad of the play.

    The link stays until the motor has gone through the play, then trails it (the backlash
    operator). noise (M,) rad: how far the motors' angles are known. A turn back within it counts
    for none, as noise alone would drag the link along.
    """
    reach = half + noise
    links = np.empty(motors.shape)
    for j, motor in enumerate(motors.T):
        link = float(motor[0])
        path = []
        # numbers of Python's: a loop over rows of an array takes four times as long
        for low, high in zip((motor - reach[j]).tolist(), (motor + reach[j]).tolist(), strict=True):
            link = low if link < low else high if link > high else link
            path.append(link)
        links[:, j] = path
    return np.clip((links - motors) / half, -1.0, 1.0)


def read_slack(t: Array, readings: Array, half: Array) -> Array:
    """Where links lie within their play (N,M), −1 … 1, by the
    readings (N,M) rad at t (N,) s of their motors.
    """
    motors, noise = smooth_motors(t, readings)
    return follow_slack(motors, half, noise)


def smooth_motors(t: Array, readings: Array) -> tuple[Array, Array]:
    """Angles of motors (N,M) rad by readings (N,M) rad at t (N,) s,
    averaged, and how far these are known (M,) rad.
    """
    motors = np.nan_to_num(interpolate_values(t, readings, t))
    width = max(int(SMOOTH_S / measure_median_step(t)) | 1, 1)
    ends = ((width // 2, width // 2), (0, 0))
    sums = np.cumsum(np.pad(np.pad(motors, ends, "edge"), ((1, 0), (0, 0))), axis=0)
    noise = NOISE_SIGMAS * np.sqrt(estimate_noise_variance(motors) / width)
    return (sums[width:] - sums[:-width]) / width, noise


def with_links(features: Features, play: Mapping[str, tuple[float, float]]) -> Features:
    """The features with joints where the links are, in place of the motors that encoders read."""
    joints = features.joints
    if joints is None:
        return features
    values = follow_links(joints.t, joints.values, joints.names, play)
    return replace(features, joints=replace(joints, values=values))


def follow_links(
    t: Array, readings: Array, names: Sequence[str], play: Mapping[str, tuple[float, float]]
) -> Array:
    """Where the links of the named joints are (N,M) rad, by the readings
    (N,M) rad at t (N,) s of their motors, NaN where these are missing.
    """
    columns = [j for j, name in enumerate(names) if name in play]
    if not columns or len(t) < 2:
        return readings
    half = np.array([0.5 * play[names[j]][0] for j in columns])
    links = readings.copy()
    links[:, columns] += half * read_slack(t, readings[:, columns], half)
    return links
