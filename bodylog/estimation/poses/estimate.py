"""The estimate of a table of still poses, each a separate belief."""

from dataclasses import replace

import numpy as np

from ...body_model import BodyModel
from ...errors import EvidenceError, ModelError, UsageError
from ...settings import EstimationSettings
from ...types import TRACK_AXES, Array, Capabilities, Estimate, Features, Finding, Series
from ..faults.screening import screen_measurements
from ..measurements.long_arrays import find_finite_rows as seen_rows
from ..measurements.records import Evidence
from ..noise import typed
from .encoders import Encoding, learn_pose_encoders, list_pose_offset_faults
from .solve import SolvedPoses, StillPoses, collect_pose_readings, solve_poses

LEAST_LEFT = 1e-12
"""Least 1 − s at which the other readings predict one:
rounding of s, some 1e-16, stays below a thousandth of it.
"""


def estimate_still_poses(
    features: Features, body: BodyModel, settings: EstimationSettings, can: Capabilities
) -> Estimate:
    """Estimate every pose's angles (P,M) rad and covariance from its own encoders and positions.

    UsageError for a method that needs motion; EvidenceError without readings.
    """
    if can.from_paper:
        possible = "filter, smoother or ekf, which are the same for poses"
        raise UsageError(
            f"method: {settings.method!r} needs motion, but the log has still poses; type "
            f"{possible}"
        )
    evidence = screen_measurements(replace(features, touches=None), body, settings)
    sightings = [
        s for s in typed.with_typed_variances(evidence.sightings, settings) if s.name != "touch"
    ]
    poses = collect_pose_readings(evidence.encoders, sightings, body)
    if not len(poses.t):
        raise EvidenceError(
            "no pose has a joint reading or position known to the body; type: bodylog info LOG"
        )
    known = typed.typed_joint_variances(
        settings.sigma_encoders, body.joints, np.array(body.noise.encoder, float)
    )
    unknown = settings.precision == "auto" and settings.sigma_encoders is None
    found = learn_pose_encoders(poses, known, body.joints, unknown, settings.bias)
    poses = poses.encoded(found.variance, found.offset)
    return _build_pose_estimate(settings, body, evidence, poses, found, solve_poses(poses))


def _build_pose_estimate(
    settings: EstimationSettings,
    body: BodyModel,
    evidence: Evidence,
    poses: StillPoses,
    found: Encoding,
    at: SolvedPoses,
) -> Estimate:
    """The public record."""
    t = poses.t
    names = body.joints
    source = poses.source_ns
    errors = dict[str, Series]()
    predicted = dict[str, Series]()
    covs = dict[str, Array]()
    for one, rows in zip(poses.sightings, poses.rows(), strict=True):
        left, cov = _leave_out_rows(poses, at, rows)
        std = np.sqrt(np.einsum("pkk->pk", cov))
        outputs = one.model.outputs
        seen = seen_rows(left)
        errors[one.name] = Series(t[seen], (left / std)[seen], outputs, "std", source[seen])
        mean = np.where(seen[:, None], poses.y[:, rows] - left, poses.predict(at.x)[0][:, rows])
        unit = TRACK_AXES[len(outputs)][1]
        predicted[one.name], covs[one.name] = Series(t, mean, outputs, unit, source, std), cov
    if np.isfinite(poses.y[:, : len(names)]).any():
        each = [_leave_out_rows(poses, at, slice(j, j + 1)) for j in range(len(names))]
        encoders = np.column_stack([left / np.sqrt(cov[:, 0]) for left, cov in each])
        errors["encoders"] = Series(t, encoders, names, "std", source)
    used = {
        "encoder": found.variance.tolist(),
        "scale": {s.name: 1.0 for s in poses.sightings},
        "motion": "none",
    }
    offset = Series(t, np.tile(found.offset, (len(t), 1)), names, "rad", source)
    text = f"{len(t)} still poses, each estimated separately"
    return Estimate(
        settings.method,
        Series(t, at.x, names, "rad", source),
        Series(t, np.zeros(at.x.shape), names, "rad/s", source),
        _pose_covariance(found, at, body),
        errors,
        at.cost,
        evidence.used,
        predicted,
        covs,
        used,
        offset if found.offset_var.any() else None,
        (*evidence.faults, *list_pose_offset_faults(names, found, float(t[0]))),
        (*evidence.findings, *found.findings, Finding("info", text)),
    )


def _pose_covariance(found: Encoding, at: SolvedPoses, body: BodyModel) -> Array:
    """Covariance (P,M,M) of the angles, including the offsets' uncertainty: dx/db = −Λ⁻¹ Σ⁻¹.

    Errors in the poses that the tracks were learned from
    are common to all tracks, so they add to it, too.
    """
    m = at.x.shape[1]
    std = np.array(body.provenance.get("pose_std", [0.0] * m), float)
    if std.shape != (m,):
        raise ModelError(
            f"provenance.pose_std: {len(std)} numbers for {m} joints; fit the body again"
        )
    lean = at.cov * (at.weight / at.var)[:, None, :m]
    return np.asarray(
        at.cov + np.diag(np.square(std)) + (lean * found.offset_var) @ lean.swapaxes(1, 2)
    )


def _leave_out_rows(poses: StillPoses, at: SolvedPoses, rows: slice) -> tuple[Array, Array]:
    """Leave-one-out errors (P,D) of rows of readings, NaN
    where missing, and their predicted covariance (P,D,D).

    With H = J P Jᵀ, R the noise and r the residual, the one left out has the residual R (R − H)⁻¹
    r, of covariance R (R − H)⁻¹ R (Rasmussen & Williams 5.12 for one block). By the eigenvalues s
    of H in units of R, 1 − s is how well the others predict it: where it is below LEAST_LEFT, the
    error is NaN, and the covariance the prior's.
    """
    jac = at.jac[:, rows]
    eye = np.eye(rows.stop - rows.start)
    noise = at.var[:, None, rows] * eye
    std = np.sqrt(at.var[:, rows] / np.maximum(at.weight[:, rows], 1e-12))
    units = std[:, :, None] * std[:, None]
    inside = jac @ at.cov @ jac.swapaxes(1, 2)
    share, axes = np.linalg.eigh(inside / units)
    foretold = share[:, -1] <= 1.0 - LEAST_LEFT
    left = np.maximum(1.0 - share, LEAST_LEFT)[:, None]
    along = (at.r[:, rows] / std)[:, None] @ axes
    error = std * ((along / left) @ axes.swapaxes(1, 2))[:, 0]
    others = units * ((axes * (share[:, None] / left)) @ axes.swapaxes(1, 2))
    prior = (jac * poses.span**2) @ jac.swapaxes(1, 2)
    cov = np.where(foretold[:, None, None], others, prior)
    known = foretold & seen_rows(poses.y[:, rows])
    return np.where(known[:, None], error, np.nan), noise + cov
