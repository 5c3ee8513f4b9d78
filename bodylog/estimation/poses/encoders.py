"""Encoder noise and constant encoder offsets, learned from still poses.

Linearised at the angles found, the positions of a pose give its encoders' errors e = z
− q the likelihood exp(eᵀl − ½ eᵀΛe). These errors have the encoders' variances about
their offsets b. Variances and offsets maximise the evidence of all poses. An angle
without a reading has its prior instead.

Few numbers per pose hardly tell encoders apart, so the ratios of their variances in the body count
as one reading: the logarithms have the variance 2. How large they all are is left to the poses. On
drawn tables of 1 to 40 poses, a prior on that, too, makes errors up to 6 % smaller where the body
is right; where its standard deviations are a fortieth of the true ones, up to 4 % larger, with an
NEES of 2.3 in place of 1.9 at three poses.
"""

from dataclasses import dataclass

import numpy as np

from ...types import Array, Fault, FaultKind, Finding
from ..faults.threshold import CERTAIN_SIGMA, EVIDENCE_THRESHOLD_NATS, PRIOR_STD_RAD
from ..inference.initial_path import OFFSET_STD
from .solve import StillPoses, solve_poses


@dataclass(frozen=True, eq=False)
class Encoding:
    """variance (M,) rad² · offset (M,) rad and its variance (M,) rad², 0 where fixed."""

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
) -> Encoding:
    """Learn variances from `known` (M,) rad² if `noise`,
    and offsets as `bias` (auto, on, off) allows.
    """
    m = len(known)
    found = Encoding(known, np.zeros(m), np.zeros(m))
    seen = np.isfinite(poses.y)
    some = np.flatnonzero(seen[:, :m].any(axis=1) & seen[:, m:].any(axis=1))
    if not len(some) or not (noise or bias != "off"):
        return found
    x: Array | None = None
    for turn in range(3):
        # at first, angles are where the images want them
        trusted = poses.encoded(
            np.maximum(found.variance, PRIOR_STD_RAD**2) if turn == 0 else found.variance,
            found.offset,
        )
        errors, x = _collect_encoder_errors(poses, trusted, some, x)
        found = _choose_pose_offsets(errors, known, names, noise, bias, np.log(found.variance))
    return found


def _collect_encoder_errors(
    poses: StillPoses, trusted: StillPoses, some: Array, x: Array | None
) -> tuple[EncoderErrors, Array]:
    """What the positions show of the encoder errors
    at some of the poses, and all angles x (P,M) rad.
    """
    at = solve_poses(trusted, x)
    m = len(poses.centre)
    jac = at.jac[some, m:]
    weight = (at.weight / at.var)[some, m:, None]
    information = (jac * weight).swapaxes(1, 2) @ jac
    z = poses.y[some, :m]
    apart = np.where(np.isfinite(z), z, poses.centre) - at.x[some]
    pull = (information @ apart[..., None])[..., 0] - (jac * weight * at.r[some, m:, None]).sum(
        axis=1
    )
    return EncoderErrors(information, pull, np.isfinite(z), poses.span), at.x


def _choose_pose_offsets(
    errors: EncoderErrors,
    known: Array,
    names: tuple[str, ...],
    noise: bool,
    bias: str,
    begin: Array,
) -> Encoding:
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
        now = position_evidence(log_var, errors, free)[0]
        more = {j: free | (joints == j) for j in joints[~free].tolist()}
        likely = {
            j: one for j, one in more.items() if position_evidence(log_var, errors, one)[0] > now
        }
        trials = {
            j: _maximise_evidence(errors, known, one, noise, log_var) for j, one in likely.items()
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
        free, (value, log_var) = more[best], trials[best]
    _, _, offset, cov = position_evidence(log_var, errors, free)
    return Encoding(np.exp(log_var), offset, np.diag(cov), tuple(findings))


def _maximise_evidence(
    errors: EncoderErrors, known: Array, free: Array, noise: bool, begin: Array
) -> tuple[float, Array]:
    """Greatest evidence (nats) with offsets `free` (M,), and
    the ln variances (M,) of encoders where it is reached.
    """
    from scipy.optimize import minimize

    first = np.log(known)
    if not noise:
        return position_evidence(first, errors, free)[0], first

    def loss(log_var: Array) -> tuple[float, Array]:
        value, slope, *_ = position_evidence(log_var, errors, free)
        away = log_var - first - (log_var - first).mean()
        return -value + 0.25 * float(away @ away), -slope + 0.5 * away

    bounds = [(2.0 * np.log(1e-6), 2.0 * np.log(10.0))] * len(first)  # rad
    best = minimize(loss, begin, jac=True, method="L-BFGS-B", bounds=bounds)
    return -float(best.fun), np.asarray(best.x)


def position_evidence(
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
    names: tuple[str, ...], found: Encoding, since: float
) -> tuple[Fault, ...]:
    """Encoders with a significant offset in all poses."""
    certain = np.abs(found.offset) > np.maximum(
        OFFSET_STD, CERTAIN_SIGMA * np.sqrt(found.offset_var)
    )
    return tuple(
        Fault("encoders", names[j], FaultKind.OFFSET, since, float(found.offset[j]), "rad")
        for j in np.flatnonzero(certain)
    )
