"""Postures that images of the robot's own surface tell:
one row for each joint, with the covariance between them.

The errors of corners last, as highlights and silhouettes slide slowly, and a belief must not be
surer than what lasts. Images within the span in which a joint's motion outgrows the error count as
one; each direction of the joints' space has its own span, see `correlated_noise`.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...body_model import BodyModel
from ...types import Array, Features, PostureReadings
from ..noise.correlated_noise import ErrorCorrelation
from .records import Measured, Sighting, build_health
from .track import find_ascending_times, find_longest_gap

LASTS_S = 1.1
"""Correlation time of a corner's error, and of what many corners share."""
LASTING_SHARE = 4.0
"""Factor on the covariance beside the images that count as one. Of six drawn logs whose errors
wander as stated, NEES of the smoother is 1.3 to 1.7 with 2, and 0.9 to 1.1 with 4.
"""


@dataclass(frozen=True)
class PostureModel:
    """What is expected of a posture: the joints' angles themselves, without a model's error."""

    outputs: tuple[str, ...]
    unit: str = "rad"

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        """At x (N,M) rad: x (N,M) · identities (N,M,M) · zeros (N,M)."""
        return x, np.tile(np.eye(x.shape[1]), (len(x), 1, 1)), np.zeros(x.shape)


def read_postures(features: Features, body: BodyModel) -> Mapping[str, Measured]:
    """Read the postures of every camera, in the body's order of joints."""
    return {name: _read_posture(name, one, body) for name, one in features.postures.items()}


def _read_posture(name: str, found: PostureReadings, body: BodyModel) -> Measured:
    order = [found.names.index(joint) for joint in body.joints]
    rising = find_ascending_times(found.t)
    values = found.values[rising][:, order]
    t = found.t[rising]
    stated = LASTING_SHARE * found.cov[rising][:, order][:, :, order]
    cov = inflate_lasting_errors(t, stated, np.array(body.noise.process, float))
    counts = build_health(
        len(found.t), len(t), {"time runs backwards": (~rising).sum()}, find_longest_gap(t)
    )
    var = np.einsum("nii->ni", cov).copy()
    model = PostureModel(body.joints)
    return Measured(Sighting(name, model, t, values, var, found.source_ns[rising], cov=cov), counts)


def inflate_lasting_errors(t: Array, cov: Array, process: Array) -> Array:
    """Covariance (N,M,M) of postures at t (N,) s, such that a smoother does not take errors that
    last for independent ones; process (M,) rad²/s³: white acceleration of the joints.
    """
    if len(t) < 2:
        return cov
    like = ErrorCorrelation(process, np.full(len(process), np.inf), 0.0, whole=True)
    steps = np.diff(t, prepend=2.0 * t[0] - t[1])
    root = np.linalg.cholesky(cov)
    white = np.linalg.inv(root)
    # how quickly motion outgrows the error, along the axes of its own
    drift, axes = np.linalg.eigh(white * like.wander @ white.swapaxes(1, 2))
    span = np.maximum(drift, 1e-12) ** -like.power
    kept = np.exp(-steps[:, None] * (2.0 / span + 1.0 / LASTS_S))
    spread = root @ axes
    factor = (1.0 + kept) / (1.0 - kept)
    return np.asarray((spread * factor[:, None]) @ spread.swapaxes(1, 2))
