"""From beliefs at instants to an Estimate: errors and
predictions per sense, free energy per output, names, clocks.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from ...linear_algebra import project_covariance
from ...settings import EstimationSettings
from ...types import HARDWARE_ERRORS, LASTING_ERROR, Array, Estimate, Fault, Finding, Series
from ..inference.filter_problem import FilterProblem
from ..inference.reacquisition import find_joints_left_open
from ..measurements.arm_errors import LEAST_NEES
from ..measurements.long_arrays import find_finite_rows
from ..measurements.posture import PostureModel
from ..measurements.records import Evidence, Sighting
from ..measurements.timeline import Timeline
from ..noise.lasting_error import FrameBelief, LastingError, find_lasting_error


@dataclass(frozen=True, eq=False)
class Beliefs:
    """At every instant: z (E,K) · cov (E,M,M) · nats (E,);
    before the instant: x (E,M), cov, encoder errors (E,M).

    places: of each sighting's frames, if not predicted before
    the instant: mean (F,D), cov (F,D,D), model's var (F,D).
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
    places: tuple[tuple[Array, Array, Array], ...] = ()


def build_estimate(method: str, evidence: Evidence, line: Timeline, beliefs: Beliefs) -> Estimate:
    """The public record of one method's beliefs."""
    m = len(evidence.joints)
    at = line.outputs
    t = line.t[at]
    z = beliefs.z[at]

    def make_series(values: Array, unit: str) -> Series:
        return Series(t, values, evidence.joints, unit, line.source_ns)

    places = beliefs.places or tuple(
        predict_frames(sighting, beliefs.before[rows], beliefs.before_cov[rows])
        for sighting, rows in zip(evidence.sightings, line.sightings, strict=True)
    )
    errors = dict[str, Series]()
    predicted = dict[str, Series]()
    predicted_cov = dict[str, Array]()
    for sighting, place in zip(evidence.sightings, places, strict=True):
        name = sighting.name
        error, prediction, prediction_cov = standardise_sighting(
            sighting, place, beliefs.scale.get(name, 1.0)
        )
        errors[name] = error
        if name != "touch" and not isinstance(sighting.model, PostureModel):
            predicted[name] = prediction
            predicted_cov[name] = prediction_cov
    if evidence.encoders is not None and np.isfinite(evidence.encoders.values).any():
        rows = beliefs.encoder_errors[line.encoders]
        errors["encoders"] = Series(
            evidence.encoders.t, rows, evidence.joints, "std", evidence.encoders.source_ns
        )
    hypotheses = (
        {"hypotheses": [asdict(one) for one in evidence.hypotheses]} if evidence.hypotheses else {}
    )
    return Estimate(
        method,
        make_series(z[:, :m], "rad"),
        make_series(z[:, m : 2 * m], "rad/s"),
        beliefs.cov[at],
        errors,
        np.diff(np.cumsum(beliefs.nats)[at], prepend=0.0),
        evidence.used,
        predicted,
        predicted_cov,
        {**beliefs.settings, **hypotheses},
        make_series(z[:, 2 * m :], "rad") if z.shape[1] > 2 * m else None,
        (*evidence.faults, *beliefs.faults),
        (*evidence.findings, *beliefs.findings),
    )


def find_evident_error(
    found: Estimate,
    problem: FilterProblem,
    z: Array,
    settings: EstimationSettings,
    faults: Sequence[Fault],
) -> LastingError | None:
    """The error of encoders that lasts, where it makes error bars of white noise too small.

    z (E,K): beliefs at all instants. Any offset but that of `faults` may stand for such an error,
    so images are compared with the readings of that encoder, too.
    """
    evidence = problem.evidence
    if settings.precision != "auto" or evidence.encoders is None:
        return None
    m = len(problem.start)
    faulty = {name for one in faults if one.sense == "encoders" for name in one.names}
    named = np.array([name in faulty for name in problem.evidence.joints])
    offsets = z[:, 2 * m :] * named if z.shape[1] > 2 * m else np.zeros((len(z), m))
    is_determined = np.logical_not(find_joints_left_open(problem.timeline.t, evidence).any(axis=1))
    beliefs = [
        FrameBelief(z[at, :m], z[at, m : 2 * m], offsets[at], is_determined[at])
        for at in problem.timeline.sightings
    ]
    lasting = find_lasting_error(
        evidence.encoders, evidence.sightings, beliefs, problem.precision.encoder
    )
    if lasting is None or estimate_white_nees(found, lasting.std**2) < LEAST_NEES:
        return None
    return lasting


def estimate_white_nees(found: Estimate, more: Array | float) -> float:
    """Mean squared error over stated variance, with a variance more (M,) rad² beside it."""
    stated = np.einsum("nii->ni", found.cov)
    return float(np.median((stated + more) / stated))


def with_lasting_error(found: Estimate, lasting: LastingError, kept_for: str) -> Estimate:
    """The estimate with wider error bars and a warning; angles stay as they are.

    kept_for: why the error is not taken out of the angles.
    """
    nees = estimate_white_nees(found, lasting.std**2)
    own = {LASTING_ERROR: {**asdict(lasting), "nees_if_white": nees}}
    seen = (
        f"errors last about {lasting.seconds:.2g} s, {1e3 * lasting.std:.2g} mrad "
        f"({lasting.nats:.0f} nats, by images): play, load, a bent link or electronics"
        if lasting.nats
        else f"joints have play or errors that last, {1e3 * lasting.std:.2g} mrad in the "
        "exploration"
    )
    text = (
        f"encoders: {seen}; error bars of white noise are too small (NEES about {nees:.2g}) "
        'and are widened by it; see "What real arms do" in docs/validation.md; '
        f"angles stay as they are: {kept_for}"
    )
    return replace(
        found,
        cov=found.cov + lasting.std**2 * np.eye(found.cov.shape[1]),
        settings={**found.settings, **own},
        findings=(*found.findings, Finding("warning", text)),
    )


def with_hardware_errors(found: Estimate, errors: Mapping[str, Any], text: str) -> Estimate:
    """The estimate with the errors of the hardware that its angles allow for, and a warning."""
    warning = f'{text}; see "What real arms do" in docs/validation.md'
    return replace(
        found,
        settings={**found.settings, HARDWARE_ERRORS: errors},
        findings=(*found.findings, Finding("warning", warning)),
    )


def with_rough_motion(found: Estimate, rough: Array) -> Estimate:
    """The estimate with error bars that hold the variance (M,) rad² of a rough motion."""
    sizes = zip(found.joints.names, 1e3 * np.sqrt(rough), strict=True)
    each = ", ".join(f"{name} {size:.2g}" for name, size in sizes)
    text = (
        "joints: encoders and the images after them err alike, or a reading and the next, so "
        f"joints stick and slip, or shake, by about (mrad) {each}; error bars are widened "
        'by that; see "What real arms do" in docs/validation.md'
    )
    return replace(
        found, cov=found.cov + np.diag(rough), findings=(*found.findings, Finding("warning", text))
    )


def predict_frames(sighting: Sighting, x: Array, cov: Array) -> tuple[Array, Array, Array]:
    """Mean (F,D), covariance (F,D,D) and the model's variance
    (F,D) of frames by angles x (F,M) of cov (F,M,M).
    """
    mean, jac, var = sighting.model.predict(x)
    return mean, project_covariance(jac, cov), var


def standardise_sighting(
    sighting: Sighting, place: tuple[Array, Array, Array], scale: float
) -> tuple[Series, Series, Array]:
    """Standardised errors where seen; the place predicted
    without the frame; its covariance (F,D,D) with noise.
    """
    mean, cov, var = place
    names = sighting.model.outputs
    cov = cov + scale * (
        sighting.var[..., None] * np.eye(len(names)) if sighting.cov is None else sighting.cov
    )
    np.einsum("fdd->fd", cov)[:] += var
    std = np.sqrt(np.einsum("fdd->fd", cov))
    seen = find_finite_rows(sighting.values)
    error = ((sighting.values - mean) / std)[seen]
    mean = mean if sighting.displaced is None else mean + sighting.displaced
    errors = Series(sighting.t[seen], error, names, "std", sighting.source_ns[seen])
    unit = getattr(sighting.model, "unit", "px")
    return errors, Series(sighting.t, mean, names, unit, sighting.source_ns, std), cov
