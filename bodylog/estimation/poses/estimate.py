"""The estimate of a table of still poses, each a separate belief."""

from dataclasses import replace

import numpy as np

from ...body_model import BodyModel
from ...errors import EvidenceError, ModelError, UsageError
from ...settings import Estimation
from ...types import Array, Capabilities, Estimate, Features, Finding, Series
from ..faults.screening import POSES, screened
from ..measurements.records import Evidence, Sighting
from ..noise import typed
from .encoders import Encoding, faults, learned
from .solve import Poses, Solved, gathered, solved


def estimate(features: Features, body: BodyModel, settings: Estimation, can: Capabilities) -> Estimate:
    """Estimate every pose's angles (P,M) rad and covariance from its own encoders and positions.

    UsageError for a method that needs motion; EvidenceError without readings.
    """
    if can.from_paper:
        possible = "laplace, smoother or ekf, which are the same for poses"
        raise UsageError(f"method: {settings.method!r} needs motion, but the log has still poses; type {possible}")
    evidence = screened(replace(features, touches=None), body, settings, detectors=POSES)
    sightings = [s for s in typed.sightings(evidence.sightings, settings) if s.name != "touch"]
    poses = gathered(evidence.encoders, sightings, body)
    if not len(poses.t):
        raise EvidenceError("no pose has a joint reading or position known to the body; type: bodylog info LOG")
    known = typed.of_joints(settings.sigma_encoders, body.joints, np.array(body.noise.encoder, float))
    unknown = settings.precision == "auto" and settings.sigma_encoders is None
    found = learned(poses, known, body.joints, unknown, settings.bias)
    at = solved(poses, found.variance, found.offset)
    return _written(settings, body, evidence, poses, found, at)


def _written(
    settings: Estimation, body: BodyModel, evidence: Evidence, poses: Poses, found: Encoding, at: Solved
) -> Estimate:
    """The public record."""
    t, names = poses.t, body.joints
    errors, predicted, covs = dict[str, Series](), dict[str, Series](), dict[str, Array]()
    for sighting, columns in zip(poses.sightings, poses.rows, strict=True):
        error, prediction, cov = _predictions(poses, at, sighting, columns)
        errors[sighting.name], predicted[sighting.name], covs[sighting.name] = error, prediction, cov
    if np.isfinite(poses.z).any():
        errors["encoders"] = Series(t, _encoder_errors(poses, found, at), names, "std", poses.source_ns)
    offset = np.broadcast_to(found.offset, poses.z.shape).copy()
    used = {"encoder": found.variance.tolist(), "scale": {s.name: 1.0 for s in poses.sightings}, "motion": "none"}
    text = f"{len(t)} still poses, each estimated separately"
    return Estimate(
        settings.method,
        Series(t, at.x, names, "rad", poses.source_ns),
        Series(t, np.zeros(at.x.shape), names, "rad/s", poses.source_ns),
        _covariance(found, at, body),
        errors, at.cost, evidence.used, predicted, covs, used,
        Series(t, offset, names, "rad", poses.source_ns) if found.free.any() else None,
        (*evidence.faults, *faults(names, found, float(t[0]))),
        (*evidence.findings, *found.findings, Finding("info", text)),
    )  # fmt: skip


def _covariance(found: Encoding, at: Solved, body: BodyModel) -> Array:
    """Covariance (P,M,M) of the angles, including the offsets' uncertainty: dx/db = −Λ⁻¹ Σ⁻¹.

    Errors in the poses that the tracks were learned from are common to all tracks, so they add to it, too.
    """
    std = np.array(body.provenance.get("pose_std", [0.0] * at.x.shape[1]), float)
    if std.shape != at.x.shape[1:]:
        raise ModelError(f"provenance.pose_std: {len(std)} numbers for {at.x.shape[1]} joints; fit the body again")
    common = np.square(std)
    lean = at.cov * (at.encoder_weight / found.variance)[:, None, :]
    return np.asarray(at.cov + np.diag(common) + np.einsum("pij,j,pkj->pik", lean, found.offset_var, lean))


def _predictions(poses: Poses, at: Solved, sighting: Sighting, columns: slice) -> tuple[Series, Series, Array]:
    """A track's leave-one-out errors, predicted positions and their covariance (P,2,2) at each pose.

    With H = J P Jᵀ, R the noise and r the residual, the one left out has the residual R (R − H)⁻¹ r, of covariance R (R
    − H)⁻¹ R (Rasmussen & Williams 5.12 for one block).
    """
    jac, r = at.jac[:, columns], at.r[:, columns]
    noise = np.einsum("pk,kl->pkl", at.var[:, columns], np.eye(r.shape[1]))
    seen: Array = np.asarray(np.isfinite(poses.y[:, columns]).all(axis=1))
    weighed = noise / np.maximum(at.weight[:, columns], 1e-12)[:, None, :]
    inside = jac @ at.cov @ jac.swapaxes(1, 2)
    gain = np.linalg.inv(np.where(seen[:, None, None], weighed - inside, np.eye(r.shape[1])))
    left = np.where(seen[:, None], np.einsum("pij,pjk,pk->pi", weighed, gain, r), 0.0)
    cov = np.where(seen[:, None, None], weighed @ gain @ weighed - weighed + noise, inside + noise)
    std = np.sqrt(np.einsum("pkk->pk", cov))
    mean = np.where(seen[:, None], poses.y[:, columns] - left, poses.predict(at.x)[0][:, columns])
    names, t, source = sighting.model.outputs, poses.t, poses.source_ns
    errors = Series(t[seen], (left / std)[seen], names, "std", source[seen])
    return errors, Series(t, mean, names, "px", source, std), cov


def _encoder_errors(poses: Poses, found: Encoding, at: Solved) -> Array:
    """Leave-one-out error (P,M) of each reading, in standard deviations; NaN where missing."""
    known = np.isfinite(poses.z)
    weighed = found.variance / np.maximum(at.encoder_weight, 1e-12)
    inside = np.einsum("pmm->pm", at.cov)
    left = np.where(known, poses.z - found.offset - at.x, np.nan) * weighed / np.maximum(weighed - inside, 1e-18)
    spread = weighed * inside / np.maximum(weighed - inside, 1e-18) + found.variance
    return np.asarray(left / np.sqrt(spread))
