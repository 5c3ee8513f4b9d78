"""Readings given to a live filter: angles by joint,
positions by track; checked, counted and filtered.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np

from ...body_model import BodyModel, ForwardModel
from ...errors import ModelError, UsageError
from ...settings import EstimationSettings
from ...types import MM_PER_M, TRACK_AXES, Array, Health
from ..measurements.gather import choose_senses
from ..measurements.track import pixel_variance
from ..noise import typed

Angles = Sequence[float] | Array | Mapping[str, float]
"""rad, in the body's order, or by joint; NaN, or a joint left out, is a missing reading."""
Place = Sequence[float] | Array
"""(u, v) or (u, v, std_u, std_v) px; of a point in space
(x, y, z), or these and their std, m; NaN is not seen.
"""

ToAngles = Callable[[Array], Array]
"""Converts readings (M,) to angles (M,) rad."""


@dataclass(frozen=True, eq=False)
class Observation:
    """Angles (M,) rad, NaN where missing, or None ·
    places {track: (u, v) px and its variance (2,) px², or (x, y, z) mm and mm²}.
    """

    angles: Array | None
    places: Mapping[str, tuple[Array, Array]]


class Inputs:
    """The senses of a body, which of them are used, and counts of each one's readings."""

    def __init__(self, body: BodyModel, settings: EstimationSettings, to_angles: ToAngles) -> None:
        """UsageError for senses in the settings that the body lacks."""
        visual = {name: model for name, model in body.senses.items() if name != "encoders"}
        touch = {"touch": visual["effector"]} if "effector" in visual else {}
        wanted = choose_senses(visual, body, settings)
        self.models: dict[str, ForwardModel] = {**visual, **touch}
        self.wanted = {name: model for name, model in self.models.items() if name in wanted}
        self.silent = np.array([name not in wanted for name in body.joints])
        self._joints = body.joints
        self._noise = body.noise.senses
        self._to_angles = to_angles
        self._newest_angles = np.full(len(body.joints), -np.inf)
        self._newest: dict[str, float] = {}
        self._variance = {name: typed.typed_track_variance(settings, name) for name in self.models}
        self._counts: dict[str, dict[str, int]] = {}

    def read(self, joints: Angles | None, places: Mapping[str, Place | None]) -> Observation:
        """Convert readings to arrays; UsageError or ModelError where they do not fit the body."""
        angles = None if joints is None else self._angles(joints)
        return Observation(
            angles,
            {name: self._place(name, one) for name, one in places.items() if one is not None},
        )

    def _angles(self, given: Angles) -> Array:
        names = self._joints
        if isinstance(given, Mapping):
            if not any(name in given for name in names):
                raise ModelError(
                    f"joints: {', '.join(given) or 'none'} found, possible: {', '.join(names)}"
                )
            given = [given.get(name, np.nan) for name in names]
        possible = f"one angle in rad for each of {', '.join(names)}"
        x = self._to_angles(_parse_numbers("joints", given, (len(names),), possible))
        return np.where(np.isfinite(x), x, np.nan)

    def _place(self, name: str, given: Place) -> tuple[Array, Array]:
        if name not in self.models:
            raise UsageError(
                f"{name}: the body has no such sense; it has "
                f"{', '.join(self.models) or 'joints alone'}"
            )
        axes = self.models[name].outputs
        count = len(axes)
        alone, both = (count,), (2 * count,)
        words = f"({', '.join(axes)}, {', '.join(f'std_{axis}' for axis in axes)})"
        unit = "m" if TRACK_AXES[count][1] == "mm" else "px"
        sizes, possible = (
            (both, f"{words} in {unit}")
            if name == "touch"
            else ((*alone, *both), f"({', '.join(axes)}) or {words} in {unit}")
        )
        found = _parse_numbers(name, given, sizes, possible) * (MM_PER_M if unit == "m" else 1.0)
        place = found[:count]
        std = found[count:] if len(found) == 2 * count else None
        if (given_var := self._variance[name]) is not None:
            return place, np.full(count, given_var)
        if name == "touch" and std is not None:
            return place, np.square(std)
        return place, pixel_variance(
            std, self.models[name], np.array(self._noise.get(name, (1.0,) * count), float)
        )

    def accept(self, t: float, given: Observation, late: bool) -> Observation:
        """Keep the readings of time t (s) that may be used; count the others by reason."""
        places = {
            name: one for name, one in given.places.items() if self._accepted(name, t, one[0], late)
        }
        return Observation(
            None if given.angles is None else self._accepted_angles(t, given.angles, late), places
        )

    def _accepted(self, name: str, t: float, place: Array, late: bool) -> bool:
        after = t > self._newest.get(name, -np.inf)
        if after and not late:
            self._newest[name] = t
        rejected = {
            "too late": late,
            "time runs backwards": not after,
            "out of view": not np.isfinite(place).all(),
        }
        return self._count(name, {**rejected, "not asked for": name not in self.wanted})

    def _accepted_angles(self, t: float, x: Array, late: bool) -> Array:
        known = np.isfinite(x)
        fresh = t > self._newest_angles
        usable = known & fresh & ~self.silent
        if not late:
            self._newest_angles[known & fresh] = t
        rejected = {
            "too late": late,
            "not a number": not known.any(),
            "time runs backwards": not (known & fresh).any(),
        }
        accepted = self._count("encoders", {**rejected, "not asked for": not usable.any()})
        return np.where(usable & accepted, x, np.nan)

    def _count(self, sense: str, rejected: Mapping[str, bool]) -> bool:
        counts = self._counts.setdefault(sense, {})
        reason = next((reason for reason, holds in rejected.items() if holds), "")
        counts[reason] = counts.get(reason, 0) + 1
        return not reason

    @property
    def used(self) -> dict[str, Health]:
        """Counts of used and rejected readings, by sense."""
        return {
            sense: Health(
                sum(counts.values()),
                counts.get("", 0),
                {why: n for why, n in counts.items() if why},
            )
            for sense, counts in self._counts.items()
        }


def require_finite_time(t: float) -> float:
    """Return a time (s) as float; UsageError unless it is finite."""
    if not isinstance(t, int | float | np.number) or not isfinite(t):
        raise UsageError(f"t: {t!r} found, a finite time in s is possible")
    return float(t)


def _parse_numbers(
    what: str, given: Sequence[float] | Array, sizes: tuple[int, ...], possible: str
) -> Array:
    try:
        found = np.asarray(given, float)
    except (TypeError, ValueError):
        found = np.empty((0, 0))
    if found.ndim != 1 or len(found) not in sizes:
        raise UsageError(f"{what}: {' '.join(str(given).split())[:80]} found, possible: {possible}")
    return found
