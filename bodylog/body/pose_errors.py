"""Errors of still poses against their encoders, learned from residuals that several tracks share.

Held-out residuals of all tracks in one pose are r = J e + own: e, common to them, is normal with
variance Q (M,) rad² of each joint (encoders, and whatever of the arm does not repeat); their own
part is a share of the variance expected.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..types import Array
from .data.angles import STILL
from .senses.track import TrackSense

WIDTH = 2.0
"""Prior std of the logarithm of a standard deviation, about STILL."""
FEWEST = 10
"""Fewest poses."""
SURE = 2.0
"""Largest model std of a held-out sighting over its
noise; beyond it, errors are the models', not the joints'.
"""
FARTHEST = 0.02
"""rad: largest plausible error; larger shared residuals come from models of too few poses."""
_LEAST = 1e-6
_STEP = 0.1


@dataclass(frozen=True, eq=False)
class _PoseResiduals:
    """P poses: residuals r (P,K) px, Jacobians (P,K,M)
    px/rad, variances (P,K) px², infinite where not seen.
    """

    r: Array
    jac: Array
    var: Array


def learn_pose_errors(senses: Mapping[str, TrackSense], joints: int) -> tuple[Array, Array] | None:
    """Variance Q (M,) rad² and its standard error (M,); None
    if poses are too few to separate it from model error.
    """
    from scipy.optimize import minimize

    rows = _collect_pose_residuals(list(senses.values()), joints)
    if len(rows.r) < FEWEST:
        return None
    first = np.append(np.full(joints, 2.0 * np.log(STILL)), 0.0)
    bounds = [(2.0 * np.log(_LEAST), 0.0)] * joints + [(-3.0, 3.0)]
    found = np.asarray(
        minimize(lambda p: _pose_error_loss(p, rows), first, method="L-BFGS-B", bounds=bounds).x
    )
    if np.exp(0.5 * found[:joints]).max() > FARTHEST:
        return None
    best = _pose_error_loss(found, rows)
    bend = np.array(
        [
            _pose_error_loss(found + s, rows) + _pose_error_loss(found - s, rows) - 2.0 * best
            for s in _STEP * np.eye(joints + 1)
        ]
    )
    error = 1.0 / np.sqrt(np.maximum(bend[:joints] / _STEP**2, 1.0 / (2.0 * WIDTH) ** 2))
    variance = np.exp(found[:joints])
    return variance, variance * error


def _collect_pose_residuals(senses: Sequence[TrackSense], joints: int) -> _PoseResiduals:
    """Held-out residuals of all tracks by pose."""
    keys = [np.stack([s.used.log.astype(float), s.used.t], axis=1) for s in senses]
    poses = np.unique(np.concatenate([key[key[:, 0] >= 0] for key in keys]), axis=0)
    ends = np.cumsum([0, *(len(found.gp.outputs) for found in senses)])
    shape = len(poses), int(ends[-1])
    r = np.zeros(shape)
    jac = np.zeros((*shape, joints))
    var = np.full(shape, np.inf)
    index = {tuple(pose): k for k, pose in enumerate(poses.tolist())}
    for k, (found, key) in enumerate(zip(senses, keys, strict=True)):
        at = np.array([index.get(tuple(one), -1) for one in key.tolist()])
        noise = found.gp.noise + found.used.floor
        mine = (at >= 0) & (found.variance <= SURE * noise).all(axis=1)
        columns = slice(ends[k], ends[k + 1])
        r[at[mine], columns] = found.residual[mine]
        var[at[mine], columns] = found.variance[mine]
        jac[at[mine], columns] = found.gp.means(found.used.x)[1][mine]
    seen = np.isfinite(var).any(axis=1)
    return _PoseResiduals(r[seen], jac[seen], var[seen])


def _pose_error_loss(p: Array, rows: _PoseResiduals) -> float:
    """Minus ln density (nats) of all residuals for ln Q
    (M,) and ln of the tracks' own share, with Q's prior.
    """
    common = np.exp(p[:-1])
    own = rows.var * np.exp(p[-1])
    seen = np.isfinite(own)
    scaled = rows.jac / own[..., None]
    inner = np.einsum("pki,pkj->pij", scaled, rows.jac) + np.diag(1.0 / common)
    side = np.einsum("pki,pk->pi", scaled, rows.r)
    square = float(np.where(seen, rows.r**2 / own, 0.0).sum())
    square -= float((side * np.linalg.solve(inner, side[..., None])[..., 0]).sum())
    logdet = float(
        np.log(own[seen]).sum()
        + np.linalg.slogdet(inner)[1].sum()
        + len(rows.r) * np.log(common).sum()
    )
    away = (p[:-1] - 2.0 * np.log(STILL)) / (2.0 * WIDTH)
    return 0.5 * (square + logdet + float(away @ away))
