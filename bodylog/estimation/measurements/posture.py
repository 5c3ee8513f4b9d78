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

POSTURE_ERROR_S = 0.3
"""Correlation time of what a posture is off by. A corner's own error lasts longer (1.1 s), but its
place on the link follows that: of three rendered logs the errors of postures are correlated by 0.5
after 0.1 to 0.25 s.
"""
LASTING_SHARE = 2.0
"""Factor on the covariance beside the images that count as one.

Of three logs of two simulated arms (0.02 rad of noise) NEES of the smoother is 0.83 to 1.17 with 2,
and 0.83 to 1.10 with 3 at errors 2 % larger. Six drawn logs whose covariance is exact ask for 3
(NEES 1.1; 1.4 with 2). That of images is larger than their errors, by 1.2 to 8 times.
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
    drift, axes = np.linalg.eigh(white * like.scaled_process @ white.swapaxes(1, 2))
    span = np.maximum(drift, 1e-12) ** -like.span_exponent
    kept = np.exp(-steps[:, None] * (2.0 / span + 1.0 / POSTURE_ERROR_S))
    spread = root @ axes
    factor = (1.0 + kept) / (1.0 - kept)
    return np.asarray((spread * factor[:, None]) @ spread.swapaxes(1, 2))
