"""The estimate of a table of still poses: each a separate belief, by robust Gauss–Newton from its
own encoders and positions, with noise and constant offsets of encoders learned from all.

The cost of a pose is ½ Σ ρ(d) over its readings, d in standard deviations: ρ = d² within
GATE_SIGMA, GATE² (1 + 2 ln(d/GATE)) beyond, so that outliers lose influence with distance: the
weight of a row is 1, then GATE²/d².

Linearised at the angles found, the positions of a pose give its encoders' errors e = z − q the
likelihood exp(eᵀl − ½ eᵀΛe). These errors have the encoders' variances about their offsets b.
Variances and offsets maximise the evidence of all poses. An angle without a reading has its prior
instead.

Few numbers per pose hardly tell encoders apart, so the ratios of their variances in the body count
as one reading: the logarithms have the variance 2. How large they all are is left to the poses. On
drawn tables of 1 to 40 poses, a prior on that, too, makes errors up to 6 % smaller where the body
is right; where its standard deviations are a fortieth of the true ones, up to 4 % larger, with an
NEES of 2.3 in place of 1.9 at three poses.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ..body_model import BodyModel
from ..errors import EvidenceError, ModelError, UsageError
from ..settings import EstimationSettings
from ..types import (
    TRACK_AXES,
    Array,
    Capabilities,
    Estimate,
    Fault,
    FaultKind,
    Features,
    Finding,
    Series,
)
from .faults.screening import screen_measurements
from .faults.threshold import CERTAIN_SIGMA, EVIDENCE_THRESHOLD_NATS, PRIOR_STD_RAD
from .inference.filter_pass import GATE_SIGMA
from .inference.tangents import OFFSET_STD
from .measurements.long_arrays import find_finite_rows
from .measurements.posture import PostureModel
from .measurements.records import Encoders, Evidence, Sighting
from .noise import noise_model


@dataclass(frozen=True, eq=False)
class StillPoses:
    """P poses: t (P,) s · source_ns · readings y (P,R), NaN if missing, with variances var (P,R).

    The first M rows are encoders, rad, which read as a sighting of the angles themselves; those of
    the other senses follow, px or mm; rows: each sense's. The prior of an angle is `centre` (M,)
    with std `span` (M,) rad: the range in which the body's tracks were learned, or else the range
    of encoder readings.
    """

    t: Array
    source_ns: Array
    y: Array
    var: Array
    senses: tuple[Sighting, ...]
    rows: tuple[slice, ...]
    centre: Array
    span: Array

    def with_encoders(self, variance: Array, offset: Array) -> "StillPoses":
        """The same with encoders of `variance` (M,) rad², their `offset` (M,) rad subtracted."""
        m = len(offset)
        y = self.y.copy()
        var = self.var.copy()
        y[:, :m] -= offset
        var[:, :m] = variance
        return replace(self, y=y, var=var)

    def select_poses(self, chosen: Array) -> "StillPoses":
        """Some of the poses."""
        return replace(
            self,
            t=self.t[chosen],
            source_ns=self.source_ns[chosen],
            y=self.y[chosen],
            var=self.var[chosen],
        )

    def predict_readings(self, x: Array) -> tuple[Array, Array, Array]:
        """Predict at x (P,M) rad: readings (P,R) ·
        Jacobian (P,R,M) · the model's variance (P,R).
        """
        parts = zip(*(sense.model.predict(x) for sense in self.senses), strict=True)
        g, jac, var = (np.concatenate(part, axis=1) for part in parts)
        return g, jac, var


@dataclass(frozen=True, eq=False)
class SolvedPoses:
    """At each pose: x (P,M) rad · cov (P,M,M) · of the readings,
    residuals r (P,R), Jacobian (P,R,M), variance (P,R) and weights
    0..1 · cost (P,), nats: minus the log density of the readings.
    """

    x: Array
    cov: Array
    r: Array
    jac: Array
    var: Array
    weight: Array
    cost: Array


def collect_pose_readings(
    encoders: Encoders | None, sightings: Sequence[Sighting], body: BodyModel
) -> StillPoses:
    """Collect the readings of every pose, by time."""
    none = np.empty((0, len(body.joints)))
    read = encoders or Encoders(none[:, 0], none, none[:, 0].astype(np.int64))
    angles = PostureModel(body.joints)
    own = Sighting(
        "encoders", angles, read.t, read.values, np.ones_like(read.values), read.source_ns
    )
    senses = (own, *sightings)
    ends = np.cumsum([0, *(sense.values.shape[1] for sense in senses)]).tolist()
    rows = tuple(slice(*each) for each in pairwise(ends))
    t = np.unique(np.concatenate([sense.t for sense in senses]))
    y = np.full((len(t), ends[-1]), np.nan)
    var = np.ones(y.shape)
    sources = np.zeros(len(t), np.int64)
    # where both saw a pose, the log time is that of the encoders
    for sense, columns in zip((*sightings, own), (*rows[1:], rows[0]), strict=True):
        at = np.searchsorted(t, sense.t)
        y[at, columns] = sense.values
        var[at, columns] = sense.var
        sources[at] = sense.source_ns
    known = [model.samples for model in body.senses.values() if hasattr(model, "samples")]
    explored = np.concatenate(known) if known else y[:, : len(body.joints)]
    low, high = (
        np.nan_to_num(end.reduce(explored, axis=0, initial=np.nan)) for end in (np.fmin, np.fmax)
    )
    # a joint that was hardly explored may still be anywhere near
    return StillPoses(
        t, sources, y, var, senses, rows, (low + high) / 2.0, np.maximum(high - low, 0.1)
    )


def solve_poses(poses: StillPoses, start: Array | None = None) -> SolvedPoses:
    """Most likely angles of every pose, from x (P,M) rad if given."""
    if start is not None:
        return descend_poses(poses, start)
    z = poses.y[:, : len(poses.centre)]
    best = descend_poses(poses, np.where(np.isfinite(z), z, poses.centre))
    loose = np.flatnonzero(
        ~np.isfinite(z).all(axis=1) & np.isfinite(poses.y[:, z.shape[1] :]).any(axis=1)
    )
    if not len(loose):
        return best
    some = poses.select_poses(loose)
    tried = descend_poses(some, _guess_postures(some))
    better = tried.cost < best.cost[loose] - 1e-9
    return _replace_solved_poses(best, tried, loose[better], better)


def _replace_solved_poses(
    whole: SolvedPoses, some: SolvedPoses, rows: Array, chosen: Array
) -> SolvedPoses:
    """The solution with `rows` replaced by those chosen (bool) of another."""
    columns = {name: values.copy() for name, values in vars(whole).items()}
    for name, values in columns.items():
        values[rows] = getattr(some, name)[chosen]
    return SolvedPoses(**columns)


def _guess_postures(poses: StillPoses) -> Array:
    """Angles (P,M) rad from which to search: those of
    least cost after one step from each explored posture.
    """
    z = poses.y[:, : len(poses.centre)]
    least = np.full(len(poses.t), np.inf)
    guess = np.where(np.isfinite(z), z, poses.centre)
    undamped = np.zeros(len(poses.t))
    explored = [sense.model.samples for sense in poses.senses if hasattr(sense.model, "samples")]
    for posture in np.unique(np.concatenate([poses.centre[None], *explored]), axis=0):
        near = _evaluate_poses(poses, np.where(np.isfinite(z), z, posture))
        near = _evaluate_poses(poses, near.x + _compute_damped_step(poses, near, undamped))
        better = near.cost < least
        guess[better] = near.x[better]
        least[better] = near.cost[better]
    return guess


def descend_poses(poses: StillPoses, x: Array) -> SolvedPoses:
    """Gauss–Newton with damping for each pose, raised where
    a step does not lower the cost at fixed variances.
    """
    now = _evaluate_poses(poses, x)
    damp = np.full(len(x), 1e-6)
    for _ in range(60):
        step = _compute_damped_step(poses, now, damp)
        tried = _evaluate_poses(poses, now.x + step)
        misfit = _compute_robust_misfit(poses, tried, now.var)
        better = misfit <= _compute_robust_misfit(poses, now, now.var) + 1e-12
        size = np.abs(step) / np.sqrt(np.einsum("pmm->pm", now.cov))
        damp = np.where(better, np.maximum(damp * 0.1, 1e-9), damp * 10.0)
        now = _replace_solved_poses(now, tried, np.flatnonzero(better), better)
        if size.max() < 1e-7:  # standard deviations
            break
    return now


def _compute_damped_step(poses: StillPoses, now: SolvedPoses, damp: Array) -> Array:
    """The Gauss–Newton step (P,M), damped along the posterior's axes (Levenberg–Marquardt)."""
    pull = (
        np.einsum("prm,pr->pm", now.jac, now.weight * now.r / now.var)
        + (poses.centre - now.x) / poses.span**2
    )
    information = np.linalg.inv(now.cov)
    information += (
        damp[:, None, None] * np.eye(now.x.shape[1]) * np.einsum("pmm->pm", information)[:, None]
    )
    return np.asarray(np.linalg.solve(information, pull[..., None])[..., 0])


def _evaluate_poses(poses: StillPoses, x: Array) -> SolvedPoses:
    """Residuals, weights, covariance and cost at x (P,M)."""
    g, jac, model = poses.predict_readings(x)
    var = model + poses.var
    seen = np.isfinite(poses.y)
    r = np.where(seen, poses.y - g, 0.0)
    weight = seen / np.maximum(np.square(r) / (GATE_SIGMA**2 * var), 1.0)
    information = (jac * (weight / var)[..., None]).swapaxes(1, 2) @ jac + np.diag(poses.span**-2.0)
    solved = SolvedPoses(x, np.linalg.inv(information), r, jac, var, weight, np.empty(len(x)))
    logs = (np.log(2.0 * np.pi * var) * seen).sum(axis=1) + 2.0 * np.log(poses.span).sum()
    logs += np.linalg.slogdet(information)[1]
    return replace(solved, cost=_compute_robust_misfit(poses, solved, var) + 0.5 * logs)


def _compute_robust_misfit(poses: StillPoses, solved: SolvedPoses, var: Array) -> Array:
    """Half the robust squares (P,) of all readings, with
    variances `var` (P,R), and of the prior, in nats.
    """
    over = np.square(solved.r) / (GATE_SIGMA**2 * var)
    robust = GATE_SIGMA**2 * (np.minimum(over, 1.0) + np.log(np.maximum(over, 1.0)))
    return np.asarray(
        0.5 * (robust.sum(axis=1) + np.square((solved.x - poses.centre) / poses.span).sum(axis=1))
    )


@dataclass(frozen=True, eq=False)
class PoseEncoders:
    """Encoders: variance (M,) rad² · offset (M,) rad and its variance (M,) rad², 0 where fixed."""

    variance: Array
    offset: Array
    offset_var: Array
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True, eq=False)
class EncoderErrors:
    """What positions show of encoder errors at P poses:
    information Λ (P,M,M) rad⁻² and l (P,M) rad⁻¹.

    read (P,M) bool: which encoders were read · span (M,) rad: prior std of the other angles.
    """

    information: Array
    pull: Array
    read: Array
    span: Array


def learn_pose_encoders(
    poses: StillPoses, known: Array, names: tuple[str, ...], noise: bool, bias: str
) -> PoseEncoders:
    """Learn variances from `known` (M,) rad² if `noise`,
    and offsets as `bias` (auto, on, off) allows.
    """
    m = len(known)
    encoders = PoseEncoders(known, np.zeros(m), np.zeros(m))
    seen = np.isfinite(poses.y)
    some = np.flatnonzero(seen[:, :m].any(axis=1) & seen[:, m:].any(axis=1))
    if not len(some) or not (noise or bias != "off"):
        return encoders
    x: Array | None = None
    for turn in range(3):
        # at first, angles are where the images want them
        variance = np.maximum(known, PRIOR_STD_RAD**2) if turn == 0 else encoders.variance
        trusted = poses.with_encoders(variance, encoders.offset)
        errors, x = _collect_encoder_errors(poses, trusted, some, x)
        encoders = _choose_pose_offsets(
            errors, known, names, noise, bias, np.log(encoders.variance)
        )
    return encoders


def _collect_encoder_errors(
    poses: StillPoses, trusted: StillPoses, some: Array, x: Array | None
) -> tuple[EncoderErrors, Array]:
    """What the positions show of the encoder errors
    at some of the poses, and all angles x (P,M) rad.
    """
    solved = solve_poses(trusted, x)
    m = len(poses.centre)
    jac = solved.jac[some, m:]
    weight = (solved.weight / solved.var)[some, m:, None]
    information = (jac * weight).swapaxes(1, 2) @ jac
    z = poses.y[some, :m]
    apart = np.where(np.isfinite(z), z, poses.centre) - solved.x[some]
    pull = (information @ apart[..., None])[..., 0]
    pull -= (jac * weight * solved.r[some, m:, None]).sum(axis=1)
    return EncoderErrors(information, pull, np.isfinite(z), poses.span), solved.x


def _choose_pose_offsets(
    errors: EncoderErrors,
    known: Array,
    names: tuple[str, ...],
    noise: bool,
    bias: str,
    begin: Array,
) -> PoseEncoders:
    """Noise and offsets of greatest evidence; with `auto`, one offset after the other while each
    wins EVIDENCE_THRESHOLD_NATS.

    The search for the noise starts at `begin`, the ln variances (M,). Offsets are tried that win at
    the present noise. Where another joint's offset explains nearly as much, none is chosen.
    """
    joints = np.arange(len(known))
    findings = list[Finding]()
    free = np.full(len(known), bias == "on")
    value, log_var = _maximise_evidence(errors, known, free, noise, begin)
    while bias == "auto":
        now = compute_position_evidence(log_var, errors, free)[0]
        wider = {j: free | (joints == j) for j in joints[~free].tolist()}
        trials = {
            j: _maximise_evidence(errors, known, offsets, noise, log_var)
            for j, offsets in wider.items()
            if compute_position_evidence(log_var, errors, offsets)[0] > now
        }
        best = max(trials, key=lambda j: trials[j][0], default=-1)
        if best < 0 or trials[best][0] - value < EVIDENCE_THRESHOLD_NATS:
            break
        near = [
            names[j] for j in trials if trials[best][0] - trials[j][0] < EVIDENCE_THRESHOLD_NATS
        ]
        if len(near) > 1:
            text = (
                f"an offset of {', '.join(near)} explains these poses equally well; another "
                "track would decide"
            )
            findings.append(Finding("warning", f"encoders: {text}"))
            break
        free = wider[best]
        value, log_var = trials[best]
    _, _, offset, cov = compute_position_evidence(log_var, errors, free)
    return PoseEncoders(np.exp(log_var), offset, np.diag(cov), tuple(findings))


def _maximise_evidence(
    errors: EncoderErrors, known: Array, free: Array, noise: bool, begin: Array
) -> tuple[float, Array]:
    """Greatest evidence (nats) with offsets `free` (M,), and
    the ln variances (M,) of encoders where it is reached.
    """
    from scipy.optimize import minimize

    first = np.log(known)
    if not noise:
        return compute_position_evidence(first, errors, free)[0], first

    def evaluate_loss(log_var: Array) -> tuple[float, Array]:
        value, slope, *_ = compute_position_evidence(log_var, errors, free)
        away = log_var - first - (log_var - first).mean()
        return -value + 0.25 * float(away @ away), -slope + 0.5 * away

    bounds = [(2.0 * np.log(1e-6), 2.0 * np.log(10.0))] * len(first)  # rad
    best = minimize(evaluate_loss, begin, jac=True, method="L-BFGS-B", bounds=bounds)
    return -float(best.fun), np.asarray(best.x)


def compute_position_evidence(
    log_var: Array, errors: EncoderErrors, free: Array
) -> tuple[float, Array, Array, Array]:
    """ln density (nats, but for a constant) of all positions,
    and its gradient in the ln of encoder variances (M,).

    Then the offsets (M,) rad and their covariance (M,M),
    0 except for `free` ones, over which it is integrated.
    """
    read = errors.read
    variance = np.where(read, np.exp(log_var), errors.span**2)
    eye = np.eye(len(log_var))
    cov = np.linalg.inv(errors.information + eye / variance[:, None])
    mean = (cov @ errors.pull[..., None])[..., 0]  # of errors, for offsets of 0
    share = cov * (read / variance)[:, None]  # its derivative in them
    prior = np.diag(PRIOR_STD_RAD**2 * free)
    ratio = eye + prior @ (read[..., None] * (errors.information @ share)).sum(axis=0)
    spread = np.linalg.solve(ratio, prior)
    score = (read * mean / variance).sum(axis=0)
    offset = spread @ score
    logs = np.linalg.slogdet(cov)[1].sum() - (read * log_var).sum() - np.linalg.slogdet(ratio)[1]
    value = 0.5 * float((errors.pull * mean).sum() + offset @ score + logs)
    slopes = share - eye
    square = (
        np.square(mean + slopes @ offset)
        + np.einsum("pii->pi", cov)
        + ((slopes @ spread) * slopes).sum(axis=2)
    )
    return value, 0.5 * (read * (square / variance - 1.0)).sum(axis=0), offset, spread


def list_pose_offset_faults(
    names: tuple[str, ...], encoders: PoseEncoders, since: float
) -> tuple[Fault, ...]:
    """Encoders with a significant offset in all poses."""
    certain = np.abs(encoders.offset) > np.maximum(
        OFFSET_STD, CERTAIN_SIGMA * np.sqrt(encoders.offset_var)
    )
    return tuple(
        Fault("encoders", names[j], FaultKind.OFFSET, since, float(encoders.offset[j]), "rad")
        for j in np.flatnonzero(certain)
    )


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
        raise UsageError(
            f"method: {settings.method!r} needs motion, but the log has still poses; type "
            "filter, smoother or ekf, which are the same for poses"
        )
    evidence = screen_measurements(replace(features, touches=None), body, settings)
    sightings = [
        sighting
        for sighting in noise_model.with_typed_variances(evidence.sightings, settings)
        if sighting.name != "touch"
    ]
    poses = collect_pose_readings(evidence.encoders, sightings, body)
    if not len(poses.t):
        raise EvidenceError(
            "no pose has a joint reading or position known to the body; type: bodylog info LOG"
        )
    known = noise_model.fill_joint_variances(
        settings.sigma_encoders, body.joints, np.array(body.noise.encoder, float)
    )
    unknown = settings.precision == "auto" and settings.sigma_encoders is None
    encoders = learn_pose_encoders(poses, known, body.joints, unknown, settings.bias)
    poses = poses.with_encoders(encoders.variance, encoders.offset)
    return _build_pose_estimate(settings, body, evidence, poses, encoders, solve_poses(poses))


def _build_pose_estimate(
    settings: EstimationSettings,
    body: BodyModel,
    evidence: Evidence,
    poses: StillPoses,
    encoders: PoseEncoders,
    solved: SolvedPoses,
) -> Estimate:
    """The public record of solved poses."""
    t = poses.t
    names = body.joints
    source = poses.source_ns
    errors = dict[str, Series]()
    predicted = dict[str, Series]()
    covs = dict[str, Array]()
    readings = poses.predict_readings(solved.x)[0]
    for sense, rows in zip(poses.senses[1:], poses.rows[1:], strict=True):
        left, cov = _leave_out_rows(poses, solved, rows)
        std = np.sqrt(np.einsum("pkk->pk", cov))
        outputs = sense.model.outputs
        seen = find_finite_rows(left)
        errors[sense.name] = Series(t[seen], (left / std)[seen], outputs, "std", source[seen])
        mean = np.where(seen[:, None], poses.y[:, rows] - left, readings[:, rows])
        unit = TRACK_AXES[len(outputs)][1]
        predicted[sense.name] = Series(t, mean, outputs, unit, source, std)
        covs[sense.name] = cov
    if np.isfinite(poses.y[:, : len(names)]).any():
        each = [_leave_out_rows(poses, solved, slice(j, j + 1)) for j in range(len(names))]
        encoder_errors = np.column_stack([left / np.sqrt(cov[:, 0]) for left, cov in each])
        errors["encoders"] = Series(t, encoder_errors, names, "std", source)
    used = {
        "encoder": encoders.variance.tolist(),
        "scale": {name: 1.0 for name in predicted},
        "motion": "none",
    }
    offset = Series(t, np.tile(encoders.offset, (len(t), 1)), names, "rad", source)
    text = f"{len(t)} still poses, each estimated separately"
    return Estimate(
        settings.method,
        Series(t, solved.x, names, "rad", source),
        Series(t, np.zeros(solved.x.shape), names, "rad/s", source),
        _compute_pose_covariance(encoders, solved, body),
        errors,
        solved.cost,
        evidence.used,
        predicted,
        covs,
        used,
        offset if encoders.offset_var.any() else None,
        (*evidence.faults, *list_pose_offset_faults(names, encoders, float(t[0]))),
        (*evidence.findings, *encoders.findings, Finding("info", text)),
    )


def _compute_pose_covariance(encoders: PoseEncoders, solved: SolvedPoses, body: BodyModel) -> Array:
    """Covariance (P,M,M) of the angles, including the offsets' uncertainty: dx/db = −Λ⁻¹ Σ⁻¹.

    Errors in the poses that the tracks were learned from
    are common to all tracks, so they add to it, too.
    """
    m = solved.x.shape[1]
    std = np.array(body.provenance.get("pose_std", [0.0] * m), float)
    if std.shape != (m,):
        raise ModelError(
            f"provenance.pose_std: {len(std)} numbers for {m} joints; fit the body again"
        )
    lean = solved.cov * (solved.weight / solved.var)[:, None, :m]
    return np.asarray(
        solved.cov + np.diag(np.square(std)) + (lean * encoders.offset_var) @ lean.swapaxes(1, 2)
    )


def _leave_out_rows(poses: StillPoses, solved: SolvedPoses, rows: slice) -> tuple[Array, Array]:
    """Leave-one-out errors (P,D) of rows of readings, NaN
    where missing, and their predicted covariance (P,D,D).

    With H = J P Jᵀ, R the noise and r the residual, the one left out has the residual R (R − H)⁻¹
    r, of covariance R (R − H)⁻¹ R (Rasmussen & Williams 5.12 for one block). By the eigenvalues s
    of H in units of R, 1 − s is how well the others predict it: where it is below LEAST_LEFT, the
    error is NaN, and the covariance the prior's.
    """
    jac = solved.jac[:, rows]
    eye = np.eye(rows.stop - rows.start)
    noise = solved.var[:, None, rows] * eye
    std = np.sqrt(solved.var[:, rows] / np.maximum(solved.weight[:, rows], 1e-12))
    units = std[:, :, None] * std[:, None]
    inside = jac @ solved.cov @ jac.swapaxes(1, 2)
    share, axes = np.linalg.eigh(inside / units)
    foretold = share[:, -1] <= 1.0 - LEAST_LEFT
    left = np.maximum(1.0 - share, LEAST_LEFT)[:, None]
    along = (solved.r[:, rows] / std)[:, None] @ axes
    error = std * ((along / left) @ axes.swapaxes(1, 2))[:, 0]
    others = units * ((axes * (share[:, None] / left)) @ axes.swapaxes(1, 2))
    prior = (jac * poses.span**2) @ jac.swapaxes(1, 2)
    cov = np.where(foretold[:, None, None], others, prior)
    known = foretold & find_finite_rows(poses.y[:, rows])
    return np.where(known[:, None], error, np.nan), noise + cov
