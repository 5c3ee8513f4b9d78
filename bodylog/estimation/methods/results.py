"""From beliefs at instants to an Estimate: errors and predictions per sense, free energy per output, names, clocks."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ...body_model import BodyModel
from ...types import Array, Estimate, Fault, Finding, Series
from ..measurements.long_arrays import seen as seen_rows
from ..measurements.records import Evidence, Sighting
from ..measurements.timeline import Timeline


@dataclass(frozen=True, eq=False)
class Beliefs:
    """At every instant: z (E,K) · cov (E,M,M) · nats (E,); before the instant: x (E,M), cov, encoder errors (E,M)."""

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


def estimate(method: str, body: BodyModel, evidence: Evidence, line: Timeline, beliefs: Beliefs) -> Estimate:
    """The public record of one method's beliefs."""
    m, at = len(body.joints), line.outputs
    t, z = line.t[at], beliefs.z[at]

    def series(values: Array, unit: str) -> Series:
        return Series(t, values, body.joints, unit, line.source_ns)

    sights = {s.name: sight(s, events, beliefs) for s, events in zip(evidence.sightings, line.sightings, strict=True)}
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


def sight(sighting: Sighting, events: Array, beliefs: Beliefs) -> tuple[Series, Series, Array]:
    """Standardised errors where seen; the place predicted before the frame; its covariance (F,D,D) with noise."""
    mean, jac, var = sighting.model.predict(beliefs.before[events])
    cov = _projected(jac, beliefs.before_cov[events])
    scale, names = beliefs.scale.get(sighting.name, 1.0), sighting.model.outputs
    cov += scale * (sighting.var[..., None] * np.eye(len(names)) if sighting.cov is None else sighting.cov)
    np.einsum("fdd->fd", cov)[:] += var
    std = np.sqrt(np.einsum("fdd->fd", cov))
    seen = seen_rows(sighting.values)
    error = ((sighting.values - mean) / std)[seen]
    mean = mean if sighting.displaced is None else mean + sighting.displaced
    errors = Series(sighting.t[seen], error, names, "std", sighting.source_ns[seen])
    unit = getattr(sighting.model, "unit", "px")
    return errors, Series(sighting.t, mean, names, unit, sighting.source_ns, std), cov


def _projected(jac: Array, cov: Array) -> Array:
    """J P Jᵀ (F,D,D) of jac (F,D,M) and cov (F,M,M); with frames last, products of small matrices are fast."""
    jac, cov = (np.ascontiguousarray(np.moveaxis(part, 0, -1)) for part in (jac, cov))
    found = np.einsum("dkf,ekf->fde", np.einsum("dmf,mkf->dkf", jac, cov), jac)
    return np.ascontiguousarray(found)
