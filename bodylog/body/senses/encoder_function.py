"""Encoders that read a function of the angle, given or learned, and its inverse."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...body_model import BodyModel
from ...errors import UsageError
from ...settings import EstimationSettings
from ...types import Array, Features, Series
from ..gp.model import GP

_GRID = 4097
# least slope over the largest: methods with one variance per joint err by its square
_STEEP = 0.25


@dataclass(frozen=True, eq=False)
class Polynomial:
    """Readings of M encoders: reading m = Σₖ coefficients[m,k]
    xₘᵏ, coefficients (M,K) of ascending powers.

    As body.senses["encoders"] it replaces s_p = x. An exploration alone
    cannot determine it: angles in any other unit explain the images as
    well. So it is given, or learned where a reference has the true angles.
    """

    outputs: tuple[str, ...]
    coefficients: Array
    unit: str = "rad"

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        """Predict at x (N,M) rad: reading (N,M) · Jacobian (N,M,M) · zero variance (N,M)."""
        x = np.atleast_2d(x)
        powers = x[:, :, None] ** np.arange(self.coefficients.shape[1])
        rising = self.coefficients[:, 1:] * np.arange(1, self.coefficients.shape[1])
        slope = (powers[:, :, :-1] * rising).sum(axis=2)
        return (
            (powers * self.coefficients).sum(axis=2),
            slope[:, :, None] * np.eye(x.shape[1]),
            np.zeros(x.shape),
        )


def with_true_angles(found: Features, known: BodyModel | None) -> Features:
    """Replace joints by true angles: the reference's,
    or those that a known body's encoders give.
    """
    if found.reference is not None:
        return replace(found, joints=found.reference)
    if known is None or found.joints is None:
        return found
    return convert_readings_to_angles(found, known, EstimationSettings())[0]


def convert_readings_to_angles(
    found: Features, body: BodyModel, settings: EstimationSettings, coding: bool = False
) -> tuple[Features, BodyModel, EstimationSettings]:
    """Convert features, body and settings for a method that expects angles.

    With `coding`, the method uses the encoders' model itself and only its start is converted.
    UsageError where a reading does not determine the angle over the explored range.
    """
    if "encoders" not in body.senses or found.joints is None or (coding and settings.start):
        return found, body, settings
    angles = _angles_from_readings(found.joints, body)
    if coding:
        return found, body, replace(settings, start=_first_finite_angles(angles, body.joints))
    return replace(found, joints=angles), body_for_angles(body), settings


def body_for_angles(body: BodyModel) -> BodyModel:
    """The body for angles instead of readings, with the encoder noise converted."""
    if "encoders" not in body.senses:
        return body
    senses = {name: model for name, model in body.senses.items() if name != "encoders"}
    slope = np.einsum("nmm->nm", body.senses["encoders"].predict(_explored_angles(body))[1])
    variance = np.array(body.noise.encoder) * (slope**-2.0).mean(axis=0)
    return replace(body, senses=senses, noise=replace(body.noise, encoder=tuple(variance.tolist())))


def angle_reader(body: BodyModel) -> Callable[[Array], Array]:
    """Return a function from readings (…,M) in the body's
    order to angles in rad, over the explored range.

    UsageError where different angles give (almost) the same reading.
    """
    if "encoders" not in body.senses:
        return lambda readings: readings
    x = _explored_angles(body)
    grid = np.linspace(x.min(axis=0), x.max(axis=0), _GRID)
    read = body.senses["encoders"].predict(grid)[0]
    step = np.diff(read, axis=0) * np.sign(read[-1] - read[0])
    if (step.min(axis=0) < _STEEP * step.max(axis=0)).any():
        raise UsageError(
            "encoders: readings turn or flatten over the explored angles; type: --method "
            "predictive-coding, and in robot.toml [estimate] start, the angles in rad of "
            f"{', '.join(body.joints)}"
        )
    columns = range(len(body.joints))
    return lambda readings: np.stack(
        [_invert_curve(readings[..., m], read[:, m], grid[:, m]) for m in columns], axis=-1
    )


def _angles_from_readings(joints: Series, body: BodyModel) -> Series:
    """The readings as angles."""
    values = joints.values.astype(float)
    known = [name for name in body.joints if name in joints.names]
    readings = np.full((len(values), len(body.joints)), np.nan)
    places = (
        [joints.names.index(name) for name in known],
        [body.joints.index(name) for name in known],
    )
    readings[:, places[1]] = values[:, places[0]]
    values[:, places[0]] = angle_reader(body)(readings)[:, places[1]]
    return replace(joints, values=values)


def _invert_curve(y: Array, read: Array, grid: Array) -> Array:
    """Invert the monotone curve read(grid) at values y (N,), linear beyond its ends."""
    way = 1 if read[-1] > read[0] else -1
    inside = np.interp(y, read[::way], grid[::way])
    beyond = y - np.clip(y, min(read[0], read[-1]), max(read[0], read[-1]))
    first = (grid[1] - grid[0]) / (read[1] - read[0])
    last = (grid[-1] - grid[-2]) / (read[-1] - read[-2])
    at_first = (beyond < 0) == (way > 0)
    return np.asarray(inside + beyond * np.where(at_first, first, last))


def _explored_angles(body: BodyModel) -> Array:
    """The angles (S,M) rad at which the body's tracks were learned."""
    return np.concatenate(
        [model.samples for model in body.senses.values() if isinstance(model, GP)]
    )


def _first_finite_angles(angles: Series, names: tuple[str, ...]) -> tuple[float, ...] | None:
    """The first finite angle of each joint; None where one has none."""
    columns = [angles.values[:, angles.names.index(name)] for name in names if name in angles.names]
    found = [column[np.isfinite(column)] for column in columns]
    return tuple(float(column[0]) for column in found) if all(map(len, found)) else None
