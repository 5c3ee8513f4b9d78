"""Variances set by the user: they replace learned ones and stay fixed."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...errors import UsageError
from ...settings import EstimationSettings
from ...types import Array, Finding
from ..measurements.records import Sighting
from .noise_model import NoiseModel


def check_typed_variances(
    settings: EstimationSettings, joints: Sequence[str], tracks: Sequence[str]
) -> None:
    """UsageError for a table that names an unknown joint or track."""
    for key, names in (("sigma_encoders", joints), ("process", joints), ("sigma_vision", tracks)):
        given = getattr(settings, key)
        unknown = (
            [name for name in given if name not in names] if isinstance(given, Mapping) else []
        )
        if unknown:
            raise UsageError(
                f"estimate.{key}: {unknown[0]!r} is not one of {', '.join(names) or 'none'}"
            )


def typed_joint_variances(
    given: float | Mapping[str, float] | None, joints: Sequence[str], learned: Array
) -> Array:
    """Variances (M,): given for all joints or by joint, else the learned ones."""
    if given is None:
        return learned
    table = given if isinstance(given, Mapping) else dict.fromkeys(joints, given)
    return np.array(
        [table.get(name, value) for name, value in zip(joints, learned.tolist(), strict=True)]
    )


def typed_track_variance(settings: EstimationSettings, name: str) -> float | None:
    """The variance (px²) given for a track, or for touch."""
    if name == "touch":
        return settings.sigma_touch
    given = settings.sigma_vision
    return given.get(name) if isinstance(given, Mapping) else given


def with_typed_variances(
    found: Sequence[Sighting], settings: EstimationSettings
) -> tuple[Sighting, ...]:
    """The sightings with the variances set for them."""
    given = [(one, typed_track_variance(settings, one.name)) for one in found]
    return tuple(
        one if v is None else replace(one, var=np.full_like(one.var, v), cov=None)
        for one, v in given
    )


def with_typed_noise(
    found: NoiseModel, settings: EstimationSettings, joints: Sequence[str]
) -> NoiseModel:
    """The noise model with the variances that are set;
    with a process set, the full covariance is stated.
    """

    def given(learned: Array) -> Array:
        return typed_joint_variances(settings.process, joints, learned)

    return replace(
        found,
        encoder=typed_joint_variances(settings.sigma_encoders, joints, found.encoder),
        process=given(found.process),
        likeliest=None if found.likeliest is None else given(found.likeliest),
        fewer={view: given(one) for view, one in found.fewer.items()},
        stated=np.where(np.isnan(given(np.full(len(joints), np.nan))), found.stated, 1.0),
        scale={
            name: factor if typed_track_variance(settings, name) is None else 1.0
            for name, factor in found.scale.items()
        },
    )


def remark_on_precision(
    settings: EstimationSettings, found: NoiseModel, sightings: Sequence[Sighting]
) -> tuple[Finding, ...]:
    """Finding on the variances that `--precision fixed` used, and on those that were set."""
    if settings.precision != "fixed" and not settings.typed:
        return ()
    pixels = {s.name: float(np.median(s.var)) * found.scale.get(s.name, 1.0) for s in sightings}
    used = [
        f"encoders {_list_variances(found.encoder)} rad²",
        f"process {_list_variances(found.process)} rad²/s³",
        *(f"{name} {value:.3g} px²" for name, value in pixels.items()),
    ]
    typed = f" ({', '.join(settings.typed)} as typed)" if settings.typed else ""
    return (
        Finding(
            "info", f"precision {settings.precision}{typed}: variances used are {', '.join(used)}"
        ),
    )


def _list_variances(values: Array) -> str:
    return (
        f"{values[0]:.3g}"
        if np.ptp(values) == 0.0
        else " ".join(f"{value:.3g}" for value in values)
    )
