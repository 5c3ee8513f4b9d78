"""A map of landmarks in images: where each is predicted,
from which side, and the map as a prior of their places.
"""

from dataclasses import dataclass

import numpy as np

from ..body_model import LandmarkMap
from ..types import Array
from .landmark_adjustment import Landmarks, PlacePrior
from .landmarks import LandmarkModel, LandmarkSightings

LEAST_FACING = 0.75
"""Cosine of the angle between the directions of two looks
at a landmark, below which they show different things.
"""
_NEAREST_M = 0.05


@dataclass(frozen=True, eq=False)
class PredictedLandmarks:
    """Landmarks (K,) at times (F,): image (K,F,2) px ·
    by_place (K,F,2,3) px/m · front (K,F): before the camera.
    """

    image: Array
    by_place: Array
    front: Array


def predict_landmarks(
    model: LandmarkModel, phi: Array, landmarks: Landmarks, t: Array, log: int, height: float
) -> PredictedLandmarks:
    """Where landmarks appear at image times t (F,) s of a log, in images `height` px high."""
    count = len(landmarks.body)
    frames = len(t)
    uv = np.full((count * frames, 2), 0.5 * height)
    piece = np.repeat(np.arange(count), frames)
    logs = np.full(count * frames, log)
    for _ in range(2):  # the row in which it appears tells when it was exposed
        seen = LandmarkSightings(piece, logs, np.tile(t, count), uv, height)
        predicted = model.predict(phi, seen, landmarks.body, landmarks.places)
        uv = predicted.image
    shape = (count, frames)
    front = predicted.depth.reshape(shape) > _NEAREST_M
    return PredictedLandmarks(
        uv.reshape(*shape, 2), predicted.by_place.reshape(*shape, 2, 3), front
    )


def looking(slopes: Array) -> Array:
    """Unit vectors (…,3), in the link, along which a place
    moves without moving in the image, of slopes (…,2,3).
    """
    along = np.cross(slopes[..., 0, :], slopes[..., 1, :])
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    return np.asarray(along / np.maximum(length, 1e-12))


def nearest_views(known: LandmarkMap, by_place: Array) -> tuple[Array, Array]:
    """Of each landmark the view (K,) that looks most alike
    to by_place (K,2,3) px/m, and the cosine (K,) between.
    """
    cosine = np.einsum("vi,vi->v", looking(known.view_slopes), looking(by_place)[known.view_of])
    order = np.lexsort((-cosine, known.view_of))
    first = order[np.unique(known.view_of[order], return_index=True)[1]]
    views = np.full(known.count, -1)
    facing = np.full(known.count, -1.0)
    views[known.view_of[first]] = first
    facing[known.view_of[first]] = cosine[first]
    return views, facing


def view_maps(by_place: Array, view_slopes: Array) -> Array:
    """Derivatives (n,2,2) of places in an image by those in
    a view, of surfaces that faced the camera in the view.
    """
    return np.asarray(by_place @ np.linalg.pinv(view_slopes))


def place_prior(known: LandmarkMap, learned: Array, unknowns: Array, at: Array) -> PlacePrior:
    """The map as a prior of places for unknowns φ (P,), of
    which `learned` (p,) are those of the map, there at (p,).
    """
    slopes = np.zeros((known.count, 3, len(unknowns)))
    centre = np.array(unknowns, float)
    slopes[..., learned] = known.slopes
    centre[learned] = at
    return PlacePrior(known.places, known.precision, slopes, centre)
