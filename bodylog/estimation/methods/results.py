"""From beliefs at instants to an Estimate: errors and predictions per sense, free energy per output, names, clocks."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ...body_model import BodyModel
from ...types import Array, Estimate, Fault, Finding, Series
from ..inference.leave_one_out import projected
from ..measurements.long_arrays import seen as seen_rows
from ..measurements.records import Evidence, Sighting
from ..measurements.timeline import Timeline

Place = tuple[Array, Array, Array]
"""Of a sighting's frames: mean (F,D), covariance (F,D,D) without their own noise, and the model's variance (F,D)."""


@dataclass(frozen=True, eq=False)
class Beliefs:
    """At every instant: z (E,K) · cov (E,M,M) · nats (E,); before the instant: x (E,M), cov, encoder errors (E,M).

    places: of each sighting's frames, if not predicted before the instant: mean (F,D), cov (F,D,D), model's var (F,D).
    """

    z: Array
    cov: Array
    nats: Array
    before: Array
    before_cov: Array
    encoder_errors: Array
    scale: Mapping[str, float]
    settings: Mapping[str, Any]
    faults: tuple[Fault, ...] = ()
    findings: tuple[Finding, ...] = ()
    places: tuple[Place, ...] = ()


def estimate(method: str, body: BodyModel, evidence: Evidence, line: Timeline, beliefs: Beliefs) -> Estimate:
    """The public record of one method's beliefs."""
    m, at = len(body.joints), line.outputs
    t, z = line.t[at], beliefs.z[at]

    def series(values: Array, unit: str) -> Series:
        return Series(t, values, body.joints, unit, line.source_ns)

    both = zip(evidence.sightings, line.sightings, strict=True)
    places = beliefs.places or tuple(predicted(s, beliefs.before[at], beliefs.before_cov[at]) for s, at in both)
    sights = {
        s.name: sight(s, place, beliefs.scale.get(s.name, 1.0))
        for s, place in zip(evidence.sightings, places, strict=True)
    }
    errors = {name: error for name, (error, _, _) in sights.items()}
    if evidence.encoders is not None and np.isfinite(evidence.encoders.values).any():
        rows = beliefs.encoder_errors[line.encoders]
        errors["encoders"] = Series(evidence.encoders.t, rows, body.joints, "std", evidence.encoders.source_ns)
    hypotheses = {"hypotheses": [asdict(one) for one in evidence.hypotheses]} if evidence.hypotheses else {}
    return Estimate(
        method, series(z[:, :m], "rad"), series(z[:, m : 2 * m], "rad/s"), beliefs.cov[at], errors,
        np.diff(np.cumsum(beliefs.nats)[at], prepend=0.0), evidence.used,
        {name: predicted for name, (_, predicted, _) in sights.items() if name != "touch"},
        {name: cov for name, (_, _, cov) in sights.items() if name != "touch"},
        {**beliefs.settings, **hypotheses},
        series(z[:, 2 * m :], "rad") if z.shape[1] > 2 * m else None,
        (*evidence.faults, *beliefs.faults), (*evidence.findings, *beliefs.findings),
    )  # fmt: skip


def predicted(sighting: Sighting, x: Array, cov: Array) -> tuple[Array, Array, Array]:
    """Mean (F,D), covariance (F,D,D) and the model's variance (F,D) of frames by angles x (F,M) of cov (F,M,M)."""
    mean, jac, var = sighting.model.predict(x)
    return mean, projected(jac, cov), var


def sight(sighting: Sighting, place: tuple[Array, Array, Array], scale: float) -> tuple[Series, Series, Array]:
    """Standardised errors where seen; the place predicted without the frame; its covariance (F,D,D) with noise."""
    (mean, cov, var), names = place, sighting.model.outputs
    cov = cov + scale * (sighting.var[..., None] * np.eye(len(names)) if sighting.cov is None else sighting.cov)
    np.einsum("fdd->fd", cov)[:] += var
    std = np.sqrt(np.einsum("fdd->fd", cov))
    seen = seen_rows(sighting.values)
    error = ((sighting.values - mean) / std)[seen]
    mean = mean if sighting.displaced is None else mean + sighting.displaced
    errors = Series(sighting.t[seen], error, names, "std", sighting.source_ns[seen])
    unit = getattr(sighting.model, "unit", "px")
    return errors, Series(sighting.t, mean, names, unit, sighting.source_ns, std), cov
