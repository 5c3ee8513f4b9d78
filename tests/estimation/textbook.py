"""An oracle: a textbook extended Kalman filter and smoother in full matrices, given the truth.

It has the arm's kinematics and the camera (from the URDF and the pinhole's definition, sharing no code with the
package), the variances of encoders and pixels, and whichever constant process noise gives the least error.
"""

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass

import numpy as np

PASSES = 3
"""Times frames are linearised again at the smoothed angles."""


@dataclass(frozen=True)
class Eye:
    """Where a sphere on a link appears: chain of (translation, rotation, joint name), angles of joints at rest."""

    chain: tuple
    rest: dict
    names: tuple
    radius: float
    view: tuple

    def point(self, x):
        """Position (…,3) of the link at angles (…,M) of `names`; complex angles give derivatives."""
        turn, place = np.eye(3), np.zeros(3)
        for shift, rotation, joint in self.chain:
            place = place + turn @ shift
            turn = turn @ rotation
            if joint is not None:
                angle = x[..., self.names.index(joint)] if joint in self.names else np.array(self.rest[joint])
                turn = turn @ spun(angle)
        return place

    def place(self, x):
        """Centre (…,2) px of the sphere's outline."""
        position, rotation, focal, centre = self.view
        a, b, c = np.moveaxis((self.point(x) - position) @ rotation.T, -1, 0)
        scale = focal * c / (c * c - self.radius**2)
        return np.stack([a * scale, b * scale], axis=-1) + centre

    def line(self, x):
        """Place (…,2) and its Jacobian (…,2,M), by complex steps."""
        steps = [self.place(x + 1e-30j * e).imag / 1e-30 for e in np.eye(len(self.names))]
        return self.place(x), np.stack(steps, axis=-1)


def spun(angle):
    """Rotations (…,3,3) about the third axis."""
    c, s, one, nil = np.cos(angle), np.sin(angle), np.ones_like(angle), np.zeros_like(angle)
    return np.moveaxis(np.array([[c, -s, nil], [s, c, nil], [nil, nil, one]]), (0, 1), (-2, -1))


def tilted(roll, pitch, yaw):
    """Rotation (3,3) of URDF's fixed-axis angles."""
    up, side = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1.0, 0], [0, 0, 1], [1, 0, 0]])
    return spun(yaw) @ (up.T @ spun(pitch) @ up) @ (side.T @ spun(roll) @ side)


def urdf_chain(path, link):
    """The chain from the root to `link`, all joints about their third axis."""
    found, steps = {j.find("child").get("link"): j for j in ElementTree.parse(path).iter("joint")}, []
    while link in found:
        joint = found[link]
        origin = joint.find("origin")
        read = [np.array((origin.get(k) or "0 0 0").split(), float) for k in ("xyz", "rpy")]
        steps.append((read[0], tilted(*read[1]), None if joint.get("type") == "fixed" else joint.get("name")))
        link = joint.find("parent").get("link")
    return tuple(steps[::-1])


def pinhole(position, target, size):
    """View (position, rotation, focal px, centre px) of an upright camera at `position` that looks at `target`."""
    ahead = (target - position) / np.linalg.norm(target - position)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return position, np.array([right, np.cross(ahead, right), ahead]), 0.9 * size[0], (np.array(size) - 1) / 2


def eyes(arm, joints, size, radius=0.025):
    """What the head's and the side's camera see of the effector of `arm`, whose other joints rest at home."""
    chain, rest = urdf_chain(arm.urdf, "effector"), dict(zip(arm.joints, arm.home, strict=True))
    home = Eye(chain, rest, (), radius, ()).point(np.zeros(0))
    aside = home + np.array([0.017, 0.0, 0.03])
    return [Eye(chain, rest, joints, radius, pinhole(home + np.array(c), aside, size)) for c in (arm.camera, arm.side)]


def smoothed(t, readings, encoder_var, frames, processes):
    """Filtered and smoothed mean (E,Q,6) and covariance (E,Q,6,6) at t (E,) s, for process noises (Q,) rad²/s³.

    readings (E,M), NaN where silent; frames [(eye, places (E,2), NaN where unseen, variance (2,))].
    """
    path = None
    for _ in range(PASSES):
        forth = _forth(t, readings, encoder_var, frames, np.asarray(processes), path)
        back = _back(*forth)
        path = back[0][..., : readings.shape[1]]
    return forth[3:5], back


def filtered(t, readings, encoder_var, frames, processes):
    """Iterated extended Kalman filter alone: mean (E,Q,2M), covariance."""
    return _forth(t, readings, encoder_var, frames, np.asarray(processes), None)[3:5]


def _forth(t, readings, encoder_var, frames, q, path):
    m = readings.shape[1]
    first = [column[np.isfinite(column)][0] for column in readings.T]
    z, p = np.tile([*first, *np.zeros(m)], (len(q), 1)), np.tile(np.eye(2 * m), (len(q), 1, 1))
    rows = [[] for _ in range(5)]
    for k, dt in enumerate(np.diff(t, prepend=t[0])):
        move = np.eye(2 * m) + dt * np.eye(2 * m, k=m)
        block = np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], np.eye(m))
        prior, prior_cov = z @ move.T, move @ p @ move.T + q[:, None, None] * block
        seen = [(eye, y[k], var) for eye, y, var in frames if np.isfinite(y[k]).all()]
        at = prior[:, :m] if path is None else path[k]
        for _ in range(3 if path is None and seen else 1):
            z, p = _updated(prior, prior_cov, readings[k], encoder_var, seen, at)
            at = z[:, :m]
        for row, value in zip(rows, (move, prior, prior_cov, z, p), strict=True):
            row.append(value)
    return tuple(np.array(row) for row in rows)


def _updated(z, p, reading, encoder_var, seen, at):
    """One update with all of an instant, frames linearised at angles (Q,M)."""
    m, count = len(reading), len(z)
    use = np.flatnonzero(np.isfinite(reading))
    h, y, r = [np.tile(np.eye(2 * m)[use], (count, 1, 1))], [np.tile(reading[use], (count, 1))], [encoder_var[use]]
    for eye, place, var in seen:
        mean, jac = eye.line(at)
        h.append(np.concatenate([jac, np.zeros_like(jac)], axis=-1))
        y.append(place - mean + np.einsum("qdm,qm->qd", jac, at))
        r.append(var)
    h, y, r = np.concatenate(h, axis=1), np.concatenate(y, axis=1), np.diag(np.concatenate(r))
    gain = _turned(np.linalg.solve(h @ p @ _turned(h) + r, h @ p))
    keep = np.eye(2 * m) - gain @ h
    change = np.einsum("qkd,qd->qk", gain, y - np.einsum("qdk,qk->qd", h, z))
    return z + change, keep @ p @ _turned(keep) + gain @ r @ _turned(gain)


def _turned(matrices):
    """The transpose of each of (…,n,m) matrices."""
    return np.swapaxes(matrices, -1, -2)


def _back(moves, priors, prior_covs, means, covs):
    """Rauch, Tung and Striebel's way back."""
    smooth, cov = [means[-1]], [covs[-1]]
    for k in range(len(means) - 2, -1, -1):
        gain = _turned(np.linalg.solve(prior_covs[k + 1], moves[k + 1] @ covs[k]))
        smooth.append(means[k] + np.einsum("qij,qj->qi", gain, smooth[-1] - priors[k + 1]))
        cov.append(covs[k] + gain @ (cov[-1] - prior_covs[k + 1]) @ _turned(gain))
    return np.array(smooth[::-1]), np.array(cov[::-1])
