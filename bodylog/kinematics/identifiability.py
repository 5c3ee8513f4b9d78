"""Which joint zeros and scales the sightings identify,
and which other unknowns the rest are correlated with.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..types import Array
from .rig import Rig

LEAST = 1.0 / 3.0
"""A zero is identifiable if its standard deviation is at most this share of the prior's."""
TOLD = 0.7
"""The same for a compliance, of whose size little is known: sightings halve its prior variance."""
SHOWN = {
    "rad": (float(np.degrees(1.0)), "°"),
    "m": (1e3, " mm"),
    "1": (100.0, " %"),
    "rad/(N m)": (1e3, " mrad/(N m)"),
    "m/N": (1e3, " mm/N"),
}
"""Factor and symbol with which each unit is displayed."""
GIVEN = 1e-6
"""rad or m: a zero with a smaller prior std is given, not estimated."""
_TOGETHER = 0.5
_ALONG = 0.9


@dataclass(frozen=True)
class Offset:
    """One joint's zero: value ± std in `unit`, rad or m ·
    beforehand: prior std · confused: correlated unknowns.

    A scale has the unit "1": the joint moves by 1 + value times its reading.
    """

    joint: str
    value: float
    std: float
    beforehand: float
    unit: str = "rad"
    confused: tuple[str, ...] = ()

    @property
    def identifiable(self) -> bool:
        """Whether the sightings determine it."""
        most = TOLD if self.noun == "compliance" else LEAST
        return self.std <= most * self.beforehand

    @property
    def noun(self) -> str:
        """Which parameter of the joint it is: zero, scale or compliance."""
        nouns = {"1": "scale", "rad/(N m)": "compliance", "m/N": "compliance"}
        return nouns.get(self.unit, "zero")

    @property
    def shown(self) -> str:
        """Value and standard deviation in degrees or millimetres, of a scale in percent."""
        factor, unit = SHOWN[self.unit]
        return f"{factor * self.value:+.2f}{unit} ± {factor * self.std:.2f}{unit}"


def joint_zeros(rig: Rig, theta: Array, covariance: Array) -> tuple[Offset, ...]:
    """Each joint's zero for θ (P,) ± covariance (P,P)."""
    units = ["m" if rig.slides(m) else "rad" for m in range(len(rig.joints))]
    return tuple(
        _zero_or_scale(rig, theta, covariance, rig.of_joints.start + m, units[m])
        for m in range(len(rig.joints))
    )


def joint_scales(rig: Rig, theta: Array, covariance: Array) -> tuple[Offset, ...]:
    """Each joint's scale for θ (P,) ± covariance (P,P); empty where scales are fixed."""
    part = rig.of_scales
    return tuple(
        _zero_or_scale(rig, theta, covariance, index, "1") for index in range(part.start, part.stop)
    )


def joint_compliances(rig: Rig, theta: Array, covariance: Array) -> tuple[Offset, ...]:
    """Each joint's compliance for θ (P,) ± covariance (P,P); empty where there is no sag."""
    units = ["m/N" if rig.slides(m) else "rad/(N m)" for m in range(len(rig.joints))]
    part = range(rig.of_sag.start, rig.of_sag.stop)
    return tuple(
        _zero_or_scale(rig, theta, covariance, index, unit)
        for index, unit in zip(part, units, strict=False)
    )


def _zero_or_scale(rig: Rig, theta: Array, covariance: Array, index: int, unit: str) -> Offset:
    """The zero or scale at `index` of θ."""
    joint = rig.joints[(index - rig.of_joints.start) % len(rig.joints)]
    std = float(np.sqrt(covariance[index, index]))
    plain = Offset(joint, float(theta[index]), std, float(rig.prior[1][index]), unit)
    words = () if plain.identifiable else tuple(_correlated_unknowns(rig, covariance, index))[:2]
    return replace(plain, confused=words)


def describe_unidentified(found: Sequence[Offset]) -> Iterator[str]:
    """Yield a line for each joint whose zero or scale
    was estimated and is not identifiable, and why.
    """
    for one in found:
        if not one.identifiable and one.beforehand > GIVEN:
            others = " and ".join(one.confused)
            reason = f"cannot be separated from {others}" if others else "has no visible effect"
            yield f"{one.joint}: its {one.noun} {reason}"


def _correlated_unknowns(rig: Rig, covariance: Array, index: int) -> Iterator[str]:
    """Unknowns correlated with the one at `index`, largest correlation first."""
    std = np.sqrt(np.diag(covariance))
    together = covariance[index] / np.maximum(std * std[index], 1e-300)
    groups = []
    for start, stop, words in _groups_of_unknowns(rig):
        rows = [k for k in range(start, stop) if k != index]
        if rows:
            groups.append((float(np.abs(together[rows]).max()), words, rows))
    for size, words, rows in sorted(groups, key=lambda group: -group[0]):
        if size > _TOGETHER:
            yield words + (
                _rotation_axis(rig, rows, covariance[rows, index]) if words.endswith("turn") else ""
            )


def _groups_of_unknowns(rig: Rig) -> Iterator[tuple[int, int, str]]:
    for k, camera in enumerate(rig.cameras):
        begin = rig.of_camera(k).start
        yield begin, begin + 3, f"{camera.name}'s place"
        yield begin + 3, begin + 6, f"{camera.name}'s turn"
        if not camera.tracks_space:
            yield begin + 6, begin + 12, f"{camera.name}'s lens"
    for k, carrier in enumerate(rig.carriers):
        part = rig.of_carrier(k)
        yield part.start, part.start + 3, f"{carrier.name}'s place"
        if carrier.turns:
            yield part.start + 3, part.stop, f"{carrier.name}'s turn"
    for m, name in enumerate(rig.joints):
        yield rig.of_joints.start + m, rig.of_joints.start + m + 1, f"{name}'s zero"
    for name, index in zip(
        rig.joints, range(rig.of_scales.start, rig.of_scales.stop), strict=False
    ):
        yield index, index + 1, f"{name}'s scale"


def _rotation_axis(rig: Rig, rows: Sequence[int], lean: Array) -> str:
    """The axis of its link about which a rotation is
    correlated with another unknown, if it is one axis.
    """
    for k, camera in enumerate(rig.cameras):
        if rows[0] == rig.of_camera(k).start + 3:
            turn = camera.anchor[:3, :3].T @ lean
            link = camera.link
            break
    else:
        carriers = (
            one for k, one in enumerate(rig.carriers) if rows[0] == rig.of_carrier(k).start + 3
        )
        turn = lean
        link = next(carriers).link
    share = np.abs(turn) / max(float(np.linalg.norm(turn)), 1e-300)
    return f" about the {'xyz'[int(share.argmax())]} axis of {link}" if share.max() > _ALONG else ""
