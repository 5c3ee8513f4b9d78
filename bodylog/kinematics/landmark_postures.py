"""The posture that one image of the robot's surface tells: a
Gauss-Newton step from the one that the joints' curve has there.

With r the residuals of the image's corners and J their slopes by the joints,

    x = q + H⁻¹ Jᵀ R⁻¹ r,   H = Jᵀ R⁻¹ J + I / σ²,   cov x = H⁻¹.

R has the error of each corner, one that all corners of a link share, so that many of them do not
make one sure, and the doubt of each corner's place. σ = UNTOLD_STD stands for no knowledge: a joint
that the image does not show is left where other senses have it.
"""

import numpy as np

from ..types import Array
from .landmark_adjustment import RESIDUAL_STD_PX, Landmarks
from .landmark_errors import COMMON_STD_PX
from .landmarks import LandmarkModel, LandmarkSightings

UNTOLD_STD = 1.0
"""rad or m: of what an image does not tell of a joint."""


def posture_readings(
    model: LandmarkModel,
    phi: Array,
    seen: LandmarkSightings,
    landmarks: Landmarks,
    place_matrix: Array,
) -> tuple[Array, Array, Array]:
    """Postures of one log by sightings of landmarks, of which place_matrix (K,3,3) 1/m² is the
    precision: exposure times (F,) s, angles (F,M) as the log's joints count them, and their
    covariance (F,M,M).
    """
    predicted = model.predict(phi, seen, landmarks.body, landmarks.places)
    residual = seen.uv - predicted.image
    place_cov = np.linalg.inv(place_matrix)[seen.piece]
    own = predicted.by_place @ place_cov @ predicted.by_place.transpose(0, 2, 1)
    own += RESIDUAL_STD_PX**2 * np.eye(2)
    body = landmarks.body[seen.piece]
    order = np.argsort(seen.t, kind="stable")
    t, begins = np.unique(seen.t[order], return_index=True)
    exposed = t - phi[model.of_delays][0]
    angles = model.motions[0].at(exposed)[0]
    joints = angles.shape[1]
    cov = np.empty((len(t), joints, joints))
    for number, rows in enumerate(np.split(order, begins[1:])):
        same_link = body[rows][:, None] == body[rows][None]
        noise = COMMON_STD_PX**2 * np.kron(same_link, np.eye(2))
        for place, row in enumerate(rows):
            noise[2 * place : 2 * place + 2, 2 * place : 2 * place + 2] += own[row]
        slopes = predicted.by_joints[rows].reshape(-1, joints)
        weighted = np.linalg.solve(noise, slopes).T
        cov[number] = np.linalg.inv(weighted @ slopes + np.eye(joints) / UNTOLD_STD**2)
        angles[number] += cov[number] @ (weighted @ residual[rows].reshape(-1))
    return exposed, angles, cov
