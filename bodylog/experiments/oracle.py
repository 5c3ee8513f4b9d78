"""An oracle: a filter and a smoother given the true arm,
camera and noise; the motion's order is by evidence.

Joints move with white acceleration or white jerk, with the order and
density of greatest evidence; a textbook extended Kalman filter and
Rauch-Tung-Striebel smoother do the rest. `estimation` shares no code.
"""

from dataclasses import dataclass
from math import factorial

import numpy as np

from ..types import Array
from .drawn import place_in_image

DENSITIES = {2: np.geomspace(0.003, 3.0, 7), 3: np.geomspace(0.03, 300.0, 9)}
"""rad²/s³ of white acceleration · rad²/s⁵ of white jerk: tried by order of the motion."""
PASSES = 2
"""Times that frames are linearised again at the smoother's own path."""
STEP = 1e-6
"""rad: step of the camera's numerical slopes."""


@dataclass(frozen=True, eq=False)
class OracleInputs:
    """Readings at times t (E,) s: encoders (E,M) rad,
    place (E,2) px, NaN where absent; and their variances.
    """

    t: Array
    encoders: Array
    place: Array
    encoder_var: float
    pixel_var: Array


@dataclass(frozen=True, eq=False)
class OracleBeliefs:
    """The filter's and the smoother's beliefs: (E,M) rad
    each, and the motion's order of greatest evidence.
    """

    filtered: Array
    smoothed: Array
    order: int


def estimate_by_oracle(inputs: OracleInputs) -> OracleBeliefs:
    """The beliefs by the order and density of greatest evidence."""
    runs = {order: _filter_forward(inputs, order, DENSITIES[order], None) for order in DENSITIES}
    order = max(runs, key=lambda o: float(runs[o].nats.max()))
    best = DENSITIES[order][[int(runs[order].nats.argmax())]]
    joints = inputs.encoders.shape[1]
    run = _filter_forward(inputs, order, best, None)
    filtered = run.mean[:, 0, :joints]
    path = None
    for _ in range(PASSES):
        path = _smooth_backward(run)[..., :joints]
        run = _filter_forward(inputs, order, best, path)
    return OracleBeliefs(filtered, _smooth_backward(run)[:, 0, :joints], order)


@dataclass(frozen=True, eq=False)
class _FilterPass:
    """A filter's pass: move (E,D,D) · prior, mean (E,Q,D)
    · prior_cov, cov (E,Q,D,D) · evidence (Q,) nats.
    """

    move: Array
    prior: Array
    prior_cov: Array
    mean: Array
    cov: Array
    nats: Array


def discretise_motion(order: int, dt: float, joints: int) -> tuple[Array, Array]:
    """Transition (D,D) and noise (D,D) of unit density over
    dt s, of `order` derivatives driven by white noise.
    """
    move = np.array(
        [
            [dt ** (j - i) / factorial(j - i) if j >= i else 0.0 for j in range(order)]
            for i in range(order)
        ]
    )
    up = [order - 1 - i for i in range(order)]
    noise = [
        [dt ** (a + b + 1) / ((a + b + 1) * factorial(a) * factorial(b)) for b in up] for a in up
    ]
    return np.kron(move, np.eye(joints)), np.kron(np.array(noise), np.eye(joints))


def _filter_forward(
    inputs: OracleInputs, order: int, densities: Array, path: Array | None
) -> _FilterPass:
    joints = inputs.encoders.shape[1]
    count = len(densities)
    first = np.array([column[np.isfinite(column)][0] for column in inputs.encoders.T])
    z = np.tile(np.concatenate([first, np.zeros((order - 1) * joints)]), (count, 1))
    p = np.tile(np.eye(order * joints), (count, 1, 1))
    nats = np.zeros(count)
    rows: tuple[list[Array], ...] = ([], [], [], [], [])
    for k, dt in enumerate(np.diff(inputs.t, prepend=inputs.t[0])):
        move, noise = discretise_motion(order, float(dt), joints)
        z = z @ move.T
        p = move @ p @ move.T + densities[:, None, None] * noise
        prior = z
        prior_cov = p
        at = z[:, :joints] if path is None else path[k]
        z, p, more = _update_with_readings(inputs, k, z, p, at)
        nats = nats + more
        for row, value in zip(rows, (move, prior, prior_cov, z, p), strict=True):
            row.append(value)
    moves, priors, prior_covs, means, covs = (np.array(row) for row in rows)
    return _FilterPass(moves, priors, prior_covs, means, covs, nats)


def _update_with_readings(
    inputs: OracleInputs, k: int, z: Array, p: Array, at: Array
) -> tuple[Array, Array, Array]:
    """One update with all readings of an instant, the
    camera linearised at (Q,M) rad; its evidence (Q,) nats.
    """
    joints, (count, size) = inputs.encoders.shape[1], z.shape
    use = np.flatnonzero(np.isfinite(inputs.encoders[k]))
    h = [np.tile(np.eye(size)[use], (count, 1, 1))]
    y = [np.tile(inputs.encoders[k, use], (count, 1))]
    r = [np.full(len(use), inputs.encoder_var)]
    if np.isfinite(inputs.place[k]).all():
        steps = STEP * np.eye(joints)
        near = at[:, None] + np.concatenate([np.zeros((1, joints)), steps, -steps])
        seen = place_in_image(near.reshape(-1, joints)).reshape(count, -1, 2)
        slope = np.swapaxes(seen[:, 1 : joints + 1] - seen[:, joints + 1 :], 1, 2) / (2.0 * STEP)
        h.append(np.concatenate([slope, np.zeros((count, 2, size - joints))], axis=2))
        y.append(inputs.place[k] - seen[:, 0] + np.einsum("qdm,qm->qd", slope, at))
        r.append(inputs.pixel_var)
    design = np.concatenate(h, axis=1)
    noise = np.diag(np.concatenate(r))
    if not len(noise):
        return z, p, np.zeros(count)
    off = np.concatenate(y, axis=1) - np.einsum("qdk,qk->qd", design, z)
    spread = design @ p @ np.swapaxes(design, 1, 2) + noise
    gain = np.swapaxes(np.linalg.solve(spread, design @ p), 1, 2)
    keep = np.eye(size) - gain @ design
    cov = keep @ p @ np.swapaxes(keep, 1, 2) + gain @ noise @ np.swapaxes(gain, 1, 2)
    scaled = np.linalg.solve(spread, off[..., None])[..., 0]
    nats = -0.5 * ((off * scaled).sum(axis=1) + np.linalg.slogdet(2.0 * np.pi * spread)[1])
    return z + np.einsum("qkd,qd->qk", gain, off), cov, nats


def _smooth_backward(run: _FilterPass) -> Array:
    """The smoothed means (E,Q,D)."""
    smooth = [run.mean[-1]]
    for k in range(len(run.mean) - 2, -1, -1):
        gain = np.swapaxes(
            np.linalg.solve(run.prior_cov[k + 1], run.move[k + 1] @ run.cov[k]), 1, 2
        )
        smooth.append(run.mean[k] + np.einsum("qij,qj->qi", gain, smooth[-1] - run.prior[k + 1]))
    return np.array(smooth[::-1])
