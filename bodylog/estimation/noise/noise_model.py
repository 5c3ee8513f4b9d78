"""Noise model of senses and motion: learned from this log, the body's, or the paper's.

Variances set by the user: they replace learned ones and stay fixed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...body_model import BodyModel
from ...errors import UsageError
from ...motion import MOTION_MODELS, PROCESS_UNITS, WHITE_ACCELERATION
from ...settings import EstimationSettings
from ...types import Array, Finding
from ..measurements.long_arrays import MIN_READINGS
from ..measurements.records import Encoders, Evidence, Sighting
from . import encoder_noise
from .correlated_noise import PIXEL_CORRELATION_PX
from .encoder_noise import LearnedEncoderNoise
from .quantisation import compute_relative_variances


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Variances of encoders, motion and images.

    encoder (M,) rad² of a reading · process (M,) of the motion, rad²/s³ or rad²/s⁵ · drift (M,)
    rad²/s or None · scale {sighting: factor on its variance} · correlation_px {sighting: px},
    correlation length of its errors; other sightings have white errors · stated: share of the
    covariance that is stated, () or (M,) · process_by_view {tracks in view: process (M,)} where
    these are not all · filter_process (M,): of a filter, where a smoother's differs ·
    evidence_process (M,): before `with_memory_bound` · learned: from encoders, for white
    acceleration and white jerk · motion: name of the joints' motion model · moments (O,M): mean
    squares of the angles, from their explored mean, and of their derivatives, if one is silent ·
    burst_factor (M,): process variance of a joint's fast motion over its usual one, then too.
    """

    encoder: Array
    process: Array
    drift: Array | None
    scale: Mapping[str, float]
    correlation_px: Mapping[str, float] = field(default_factory=dict)
    stated: Array | float = 1.0
    process_by_view: Mapping[tuple[str, ...], Array] = field(default_factory=dict)
    filter_process: Array | None = None
    evidence_process: Array | None = None
    learned: tuple[LearnedEncoderNoise, LearnedEncoderNoise] | None = None
    motion: str = WHITE_ACCELERATION
    moments: Array | None = None
    burst_factor: Array | float = 1.0

    @property
    def order(self) -> int:
        """Order of the motion model."""
        return MOTION_MODELS[self.motion].order

    def plain_numbers(self) -> dict[str, Any]:
        """The model as plain numbers, for the estimate's settings."""
        numbers: dict[str, Any] = {
            "motion": self.motion,
            "encoder": [float(v) for v in self.encoder],
            "process": [float(v) for v in self.process],
            "drift": None if self.drift is None else [float(v) for v in self.drift],
            "scale": dict(self.scale),
            "near": dict(self.correlation_px),
            "stated": np.broadcast_to(self.stated, self.process.shape).tolist(),
        }
        if self.filter_process is not None:
            numbers["likeliest"] = self.filter_process.tolist()
        if self.moments is not None:
            numbers["moments"] = self.moments.tolist()
            numbers["bursts"] = np.broadcast_to(self.burst_factor, self.process.shape).tolist()
        if self.process_by_view:
            numbers["process_in_view"] = {
                " ".join(view) or "none": [float(v) for v in process]
                for view, process in self.process_by_view.items()
            }
        return numbers

    def with_memory_bound(
        self, evident: Array, encoders: Encoders, white: Array | float = 1.0
    ) -> "NoiseModel":
        """The model with processes (M,) by evidence, but at least those that bound a filter's
        memory by MAX_MEMORY_S.

        Under white noise in derivative p, 1/2p of a steady variance is motion, which is stated only
        as far as there is any. white: share of the variance from encoders, whose errors are
        independent.
        """
        least = encoder_noise.compute_least_process(encoders.t, self.encoder, self.order)
        process = np.maximum(evident, least)
        stated = 1.0 - white / (2 * self.order) * (1.0 - np.minimum(evident / process, 1.0))
        return replace(self, process=process, stated=stated, evidence_process=evident)

    def stated_covariance(self, cov: Array, held: Array | None = None) -> Array:
        """Stated covariance (…,M,M) for the covariance `cov`
        of the filter or smoother, whole for joints held (…,M).
        """
        share = np.sqrt(np.where(False if held is None else held, 1.0, self.stated))
        share = np.broadcast_to(share, cov.shape[:-1])
        return np.asarray(share[..., None] * share[..., None, :] * cov)


PAPER_VARIANCES = (1.0, 1.0, 5.0)
"""The paper's variances σ_x of motion and σ_p of encoders
(rad²), and σ_v of pixels (px², or of image widths).
"""


def resolve_noise_model(
    evidence: Evidence, body: BodyModel, settings: EstimationSettings
) -> NoiseModel:
    """The noise model of `settings.precision`: `auto` from
    this log, `model` from the body, `fixed` from the paper.
    """
    encoder = np.array(body.noise.encoder, float)
    process = np.array(body.noise.process, float)
    scale = {sighting.name: 1.0 for sighting in evidence.sightings}
    if settings.precision == "fixed":
        fixed = {
            s.name: float(PAPER_VARIANCES[2] / np.median(s.var))
            for s in evidence.sightings
            if s.name != "touch"
        }
        return NoiseModel(np.full(len(encoder), PAPER_VARIANCES[1]), process, None, fixed)
    if settings.precision != "auto":
        return NoiseModel(encoder, process, None, scale)
    near = {
        s.name: PIXEL_CORRELATION_PX
        for s in evidence.sightings
        if s.name != "touch" and s.cov is None
    }
    if evidence.encoders is None:
        return NoiseModel(encoder, process, None, scale, near)
    # white acceleration may take noise for motion where an
    # arm stands and moves by turns, white jerk does not
    joints = encoder_noise.average_joint_readings(evidence.encoders)
    jerk = encoder_noise.learn_encoder_noise(joints, encoder, process, 3)
    white = encoder_noise.learn_encoder_noise(joints, encoder, process, 2, jerk.dithered)
    learned = NoiseModel(white.encoder, process, None, scale, near, learned=(white, jerk))
    return learned.with_memory_bound(white.process, evidence.encoders)


def weigh_repeated_readings(
    evidence: Evidence, precision: NoiseModel, settings: EstimationSettings
) -> Evidence:
    """The evidence with larger variances for repeated
    readings, as of an arm at rest, if noise is learned.
    """
    encoders = evidence.encoders
    if (
        settings.precision != "auto"
        or encoders is None
        or not (np.diff(encoders.values, axis=0) == 0.0).any()
    ):
        return evidence
    weighed = encoders.weigh_joints(
        lambda t, y, joint: compute_relative_variances(t, y, float(precision.encoder[joint]))
    )
    return replace(evidence, encoders=weighed)


def carry_noise_model(body: BodyModel, found: Mapping[str, Any] | None) -> NoiseModel:
    """A filter's noise model from the body, or from settings (`NoiseModel.plain_numbers`).

    UsageError if these are not of this body.
    """
    if found is None:
        encoder = np.array(body.noise.encoder, float)
        return NoiseModel(encoder, np.array(body.noise.process, float), None, {})
    motion = found.get("motion", WHITE_ACCELERATION)
    require_motion_model(motion, "learned")
    order = MOTION_MODELS[motion].order
    if "likeliest" in found:  # a smoother's process variances are not a filter's
        found = {**found, "process": found["likeliest"], "stated": [1.0] * len(body.joints)}
    shape = (len(body.joints),)
    encoder, process, stated = (
        _parse_positive_array(found, name, shape) for name in ("encoder", "process", "stated")
    )
    moments = None
    if "moments" in found:
        moments = _parse_positive_array(found, "moments", (order, *shape))
    bursts: Array | float = 1.0
    if "bursts" in found:
        bursts = _parse_positive_array(found, "bursts", shape)
    return NoiseModel(
        encoder,
        process,
        None,
        dict(found.get("scale", {})),
        dict(found.get("near", {})),
        stated,
        motion=motion,
        moments=moments,
        burst_factor=bursts,
    )


def require_motion_model(name: object, where: str, *others: str) -> None:
    """UsageError for a motion model that is not in the table, or of an order that the kernel lacks.

    others: names that are possible there beside the table's.
    """
    orders = {known: model.order for known, model in MOTION_MODELS.items()}
    if name not in orders:
        possible = ", ".join([*others, *orders])
        raise UsageError(f"{where}: motion is {name!r}; possible: {possible}")
    if orders[str(name)] not in PROCESS_UNITS:
        raise UsageError(
            f"{where}: motion {name!r} has {orders[str(name)]} states a joint, possible: 2 or 3"
        )


def _parse_positive_array(found: Mapping[str, Any], name: str, shape: tuple[int, ...]) -> Array:
    """Positive numbers of a shape from the settings; UsageError for others."""
    try:
        values = np.asarray(found.get(name), float)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape == shape and (values > 0).all() and np.isfinite(values).all():
        return values
    count = " × ".join(map(str, shape))
    text = (
        f"learned: {name} is {found.get(name)!r}, possible: {count} numbers above 0, as an "
        "estimate by this body has"
    )
    raise UsageError(text)


def warn_of_few_readings(
    evidence: Evidence, body: BodyModel, settings: EstimationSettings
) -> Evidence:
    """The evidence, with a warning if an encoder has too few readings to learn its noise well."""
    if settings.precision != "auto" or evidence.encoders is None:
        return evidence
    counts = np.isfinite(evidence.encoders.values).sum(axis=0)
    few = [
        f"{name} {count}"
        for name, count in zip(body.joints, counts, strict=True)
        if 0 < count <= MIN_READINGS
    ]
    if not few:
        return evidence
    text = (
        f"encoders: {', '.join(few)} readings, too few to learn their noise from reliably "
        f"(more than {MIN_READINGS} needed); "
        "error bars may be too small"
    )
    return replace(evidence, findings=(*evidence.findings, Finding("warning", text)))


def check_typed_variances(
    settings: EstimationSettings, joints: Sequence[str], tracks: Sequence[str]
) -> None:
    """UsageError for a table that names an unknown joint or track."""
    for key, names in (("sigma_encoders", joints), ("process", joints), ("sigma_vision", tracks)):
        given = getattr(settings, key)
        for name in given if isinstance(given, Mapping) else ():
            if name not in names:
                raise UsageError(
                    f"estimate.{key}: {name!r} is not one of {', '.join(names) or 'none'}"
                )


def fill_joint_variances(
    given: float | Mapping[str, float] | None, joints: Sequence[str], learned: Array
) -> Array:
    """Variances (M,): given for all joints or by joint, else the learned ones."""
    if given is None:
        return learned
    table = given if isinstance(given, Mapping) else dict.fromkeys(joints, given)
    return np.array(
        [table.get(name, value) for name, value in zip(joints, learned.tolist(), strict=True)]
    )


def find_typed_variance(settings: EstimationSettings, name: str) -> float | None:
    """The variance (px²) given for a track, or for touch."""
    if name == "touch":
        return settings.sigma_touch
    given = settings.sigma_vision
    return given.get(name) if isinstance(given, Mapping) else given


def with_typed_variances(
    found: Sequence[Sighting], settings: EstimationSettings
) -> tuple[Sighting, ...]:
    """The sightings with the variances set for them."""
    given = [(one, find_typed_variance(settings, one.name)) for one in found]
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

    def fill_process(learned: Array) -> Array:
        return fill_joint_variances(settings.process, joints, learned)

    return replace(
        found,
        encoder=fill_joint_variances(settings.sigma_encoders, joints, found.encoder),
        process=fill_process(found.process),
        filter_process=None if found.filter_process is None else fill_process(found.filter_process),
        process_by_view={view: fill_process(one) for view, one in found.process_by_view.items()},
        stated=np.where(np.isnan(fill_process(np.full(len(joints), np.nan))), found.stated, 1.0),
        scale={
            name: factor if find_typed_variance(settings, name) is None else 1.0
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
        f"process {_list_variances(found.process)} {PROCESS_UNITS[found.order]}",
        *(f"{name} {value:.3g} px²" for name, value in pixels.items()),
    ]
    typed = f" ({', '.join(settings.typed)} as typed)" if settings.typed else ""
    return (
        Finding(
            "info", f"precision {settings.precision}{typed}: variances used are {', '.join(used)}"
        ),
    )


def _list_variances(values: Array) -> str:
    """Variances (M,) in words: one for all where they are the same."""
    distinct = values[:1] if np.ptp(values) == 0.0 else values
    return " ".join(f"{value:.3g}" for value in distinct)
