"""Variances of the senses and of the motion: learned from this log's evidence, the body's, or the paper's."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..settings import Estimation
from ..types import Array, BodyModel, Finding
from . import motion
from .alike import NEAR
from .senses import Evidence


@dataclass(frozen=True, eq=False)
class Precision:
    """encoder (M,) rad² · process (M,) rad²/s³ · drift (M,) rad²/s or None · scale {sighting: variance factor}.

    near {sighting: px} within which its errors are alike; other sightings' errors are white · stated: what share of
    the covariance under white acceleration is stated · fewer {tracks in view: process (M,)} where these are not all ·
    likeliest: process (M,) of a filter, where a smoother's is another.
    """

    encoder: Array
    process: Array
    drift: Array | None
    scale: Mapping[str, float]
    near: Mapping[str, float] = field(default_factory=dict)
    stated: float = 1.0
    fewer: Mapping[tuple[str, ...], Array] = field(default_factory=dict)
    likeliest: Array | None = None

    def plain(self) -> dict[str, Any]:
        """As plain numbers, to be written beside the estimate."""
        drift = None if self.drift is None else [float(v) for v in self.drift]
        encoder, process = [float(v) for v in self.encoder], [float(v) for v in self.process]
        plain = {"encoder": encoder, "process": process, "drift": drift, "scale": dict(self.scale)}
        fewer = {" ".join(view) or "none": [float(v) for v in process] for view, process in self.fewer.items()}
        return {**plain, "stated": self.stated, **({"process_in_view": fewer} if fewer else {})}


PAPER = (1.0, 5.0)
"""The paper's variances of encoders (rad²) and pixels (px²)."""


def resolve(evidence: Evidence, body: BodyModel, settings: Estimation) -> Precision:
    """By `settings.precision`: `auto` from this log, `model` from the body, `fixed` from the paper."""
    encoder, process = np.array(body.noise.encoder, float), np.array(body.noise.process, float)
    scale = {sighting.name: 1.0 for sighting in evidence.sightings}
    if settings.precision == "fixed":
        return Precision(np.full(len(encoder), PAPER[0]), process, None, _fixed(evidence))
    if settings.precision != "auto":
        return Precision(encoder, process, None, scale)
    if evidence.encoders is not None:
        encoder, process = motion.learn(evidence.encoders, encoder, process)
    return Precision(encoder, process, None, scale, {name: NEAR for name in scale if name != "touch"})


def warned(evidence: Evidence, body: BodyModel, settings: Estimation) -> Evidence:
    """The evidence, with a warning where it was to say an encoder's noise of which there are too few readings."""
    if settings.precision != "auto" or evidence.encoders is None:
        return evidence
    counts = np.isfinite(evidence.encoders.values).sum(axis=0)
    few = [f"{name} {count}" for name, count in zip(body.joints, counts, strict=True) if 0 < count <= motion.FEWEST]
    if not few:
        return evidence
    text = (
        f"encoders: {', '.join(few)} readings, too few to learn their noise from (more than {motion.FEWEST} needed); "
        "the body's is used, and error bars are true only if these encoders are as noisy"
    )
    return replace(evidence, findings=(*evidence.findings, Finding("warning", text)))


def _fixed(evidence: Evidence) -> dict[str, float]:
    """Factors that bring each track's median variance to the paper's σ_v; touch keeps its own."""
    visual = [sighting for sighting in evidence.sightings if sighting.name != "touch"]
    return {s.name: float(PAPER[1] / np.median(s.var)) for s in visual}
