"""Variances of the senses and of the motion: learned from this log's evidence, the body's, or the paper's."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...body_model import BodyModel
from ...errors import UsageError
from ...settings import Estimation
from ...types import Array, Finding
from ..measurements.records import Encoders, Evidence
from . import encoder_noise
from .correlated_noise import NEAR
from .encoder_noise import Learned
from .quantisation import relative


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """encoder (M,) rad² · process (M,) rad²/s³ · drift (M,) rad²/s or None · scale {sighting: variance factor}.

    near {sighting: px} within which its errors are alike; other sightings' errors are white · stated: what share of
    the covariance under white acceleration is stated, () or (M,) · fewer {tracks in view: process (M,)} where these are
    not all · likeliest: process (M,) of a filter, where a smoother's is another · evident: process (M,) before `held` ·
    white: what was learned for white acceleration.
    """

    encoder: Array
    process: Array
    drift: Array | None
    scale: Mapping[str, float]
    near: Mapping[str, float] = field(default_factory=dict)
    stated: Array | float = 1.0
    fewer: Mapping[tuple[str, ...], Array] = field(default_factory=dict)
    likeliest: Array | None = None
    evident: Array | None = None
    white: Learned | None = None

    def plain(self) -> dict[str, Any]:
        """As plain numbers, to be written beside the estimate."""
        drift = None if self.drift is None else [float(v) for v in self.drift]
        encoder, process = [float(v) for v in self.encoder], [float(v) for v in self.process]
        plain = {"encoder": encoder, "process": process, "drift": drift, "scale": dict(self.scale)}
        fewer = {" ".join(view) or "none": [float(v) for v in process] for view, process in self.fewer.items()}
        plain["near"], plain["stated"] = dict(self.near), np.broadcast_to(self.stated, self.process.shape).tolist()
        likeliest = {} if self.likeliest is None else {"likeliest": self.likeliest.tolist()}
        return {**plain, **likeliest, **({"process_in_view": fewer} if fewer else {})}

    def held(self, evident: Array, encoders: Encoders, white: Array | float = 1.0) -> "NoiseModel":
        """With processes (M,) by evidence alone, but no joint trusted to hold still for longer than MEMORY.

        Under white acceleration a quarter of a steady variance is motion: it is stated as far as there is any. `white`:
        share of the variance that is the encoders', whose readings err each by itself.
        """
        process = np.maximum(evident, encoder_noise.floor(encoders, self.encoder))
        stated = 1.0 - MOTION * white * (1.0 - np.minimum(evident / process, 1.0))
        return replace(self, process=process, stated=stated, evident=evident)

    def of(self, cov: Array) -> Array:
        """The covariance (E,M,M) that is stated where white acceleration gives `cov`."""
        share = np.sqrt(np.broadcast_to(self.stated, self.process.shape))
        return np.asarray(share[:, None] * share * cov)


MOTION = 0.25
"""Share of a filter's steady variance under white acceleration that is motion smoothed away."""
PAPER = (1.0, 5.0)
"""The paper's variances of encoders (rad²) and pixels (px²)."""


def resolve(evidence: Evidence, body: BodyModel, settings: Estimation) -> NoiseModel:
    """By `settings.precision`: `auto` from this log, `model` from the body, `fixed` from the paper."""
    encoder, process = np.array(body.noise.encoder, float), np.array(body.noise.process, float)
    scale = {sighting.name: 1.0 for sighting in evidence.sightings}
    if settings.precision == "fixed":
        return NoiseModel(np.full(len(encoder), PAPER[0]), process, None, _fixed(evidence))
    if settings.precision != "auto":
        return NoiseModel(encoder, process, None, scale)
    near = {name: NEAR for name in scale if name != "touch"}
    if evidence.encoders is None:
        return NoiseModel(encoder, process, None, scale, near)
    found = encoder_noise.learn(evidence.encoders, encoder, process)
    held = NoiseModel(found.encoder, process, None, scale, near).held(found.process, evidence.encoders)
    return replace(held, white=found)


def weighed(evidence: Evidence, precision: NoiseModel, settings: Estimation) -> Evidence:
    """The evidence with readings that repeat, as an arm at rest has them, worth less each; if noise is from the log."""
    encoders = evidence.encoders
    if settings.precision != "auto" or encoders is None or not (np.diff(encoders.values, axis=0) == 0.0).any():
        return evidence
    found = np.ones(encoders.values.shape)
    for joint, (column, variance) in enumerate(zip(encoders.values.T, precision.encoder, strict=True)):
        known = np.isfinite(column)
        if known.any():
            found[known, joint] = relative(encoders.t[known], column[known], variance)
    return replace(evidence, encoders=replace(encoders, relative=found))


def carried(body: BodyModel, found: Mapping[str, Any] | None) -> NoiseModel:
    """A filter's, as the body has them, or as an estimate's settings do (`Precision.plain`).

    UsageError where these are not of this body.
    """
    if found is None:
        return NoiseModel(np.array(body.noise.encoder, float), np.array(body.noise.process, float), None, {})
    found = found.get("live", found)
    if "likeliest" in found:  # a smoother's process variances are not a filter's
        found = {**found, "process": found["likeliest"], "stated": [1.0] * len(body.joints)}
    encoder, process, stated = (_positive(found, name, len(body.joints)) for name in ("encoder", "process", "stated"))
    return NoiseModel(encoder, process, None, dict(found.get("scale", {})), dict(found.get("near", {})), stated)


def _positive(found: Mapping[str, Any], name: str, count: int) -> Array:
    """Numbers (M,) above 0 that settings have; UsageError where they have not."""
    try:
        values = np.asarray(found.get(name), float)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape == (count,) and (values > 0).all() and np.isfinite(values).all():
        return values
    text = f"learned: {name} is {found.get(name)!r}, possible: {count} numbers above 0, as an estimate by this body has"
    raise UsageError(text)


def warned(evidence: Evidence, body: BodyModel, settings: Estimation) -> Evidence:
    """The evidence, with a warning where it was to say an encoder's noise of which there are too few readings."""
    if settings.precision != "auto" or evidence.encoders is None:
        return evidence
    counts = np.isfinite(evidence.encoders.values).sum(axis=0)
    least = encoder_noise.FEWEST
    few = [f"{name} {count}" for name, count in zip(body.joints, counts, strict=True) if 0 < count <= least]
    if not few:
        return evidence
    text = (
        f"encoders: {', '.join(few)} readings, too few to learn their noise from (more than {least} needed); "
        "the body's is used, and error bars are true only if these encoders are as noisy"
    )
    return replace(evidence, findings=(*evidence.findings, Finding("warning", text)))


def _fixed(evidence: Evidence) -> dict[str, float]:
    """Factors that bring each track's median variance to the paper's σ_v; touch keeps its own."""
    visual = [sighting for sighting in evidence.sightings if sighting.name != "touch"]
    return {s.name: float(PAPER[1] / np.median(s.var)) for s in visual}
