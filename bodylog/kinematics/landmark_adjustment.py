"""Gauss-Newton over what landmarks share, with their places
eliminated (Schur complement), and their triangulation.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..types import Array
from .landmarks import LandmarkModel, LandmarkSightings

_KNEE_SIGMA = 2.0
"""Innovations, in standard deviations, beyond which a row loses weight (Huber)."""
RESIDUAL_STD_PX = 0.8
RESIDUAL_TIME_S = 1.1
"""A corner's error wanders: an Ornstein-Uhlenbeck process
with this deviation, per axis, and correlation time.

Measured on rendered and real robots: 0.8 px and 15 frames at 12 to 15 Hz; highlights and
silhouettes slide slowly.
"""
DATA_SHARE = 1.0 / 6.0
"""Weight of sightings against priors: about this share of
them errs independently, as a link's landmarks err alike.
"""
_STEPS = 15
_SETTLED = 0.01
"""Cost that the last step of a settled descent gains: a tenth of an unknown's deviation."""
_MOST_DAMPING = 1e8
_PLACE_STEPS = 4
_NEAREST_M = 0.05
"""Depth below which a landmark is behind the camera or too near."""


@dataclass(frozen=True, eq=False)
class PlacePrior:
    """Where earlier logs place landmarks, given what all
    share: centres (K,3) m + slopes (K,3,P) (φ − at (P,)).

    precision (K,3,3) 1/m²: of places about that, independent between landmarks.
    """

    centres: Array
    precision: Array
    slopes: Array
    at: Array

    def take(self, landmarks: Array) -> "PlacePrior":
        """The prior of the landmarks with these numbers (k,)."""
        centres = self.centres[landmarks]
        precision = self.precision[landmarks]
        return PlacePrior(centres, precision, self.slopes[landmarks], self.at)


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Places (K,3) m of the pieces on bodies with numbers
    (K,), and their prior; without one that of their bodies.
    """

    body: Array
    places: Array
    prior: PlacePrior | None = None

    def take(self, landmarks: Array) -> "Landmarks":
        """The landmarks with these numbers (k,)."""
        prior = None if self.prior is None else self.prior.take(landmarks)
        return Landmarks(self.body[landmarks], self.places[landmarks], prior)


@dataclass(frozen=True, eq=False)
class Reduced:
    """The normal equations of the shared unknowns with all places eliminated.

    matrix (P,P) · pull (P,) · cost: Huber loss of innovations and priors, twice the nats ·
    place_matrix (K,3,3) · cross (K,3,P) · place_pull (K,3) · from_prior (P,P): what the places'
    prior tells, places eliminated · rows (R,2,P): whitened design with places eliminated ·
    innovation (R,2): whitened residuals, in standard deviations · residual (R,2) px · weight (R,).
    """

    matrix: Array
    pull: Array
    cost: float
    place_matrix: Array
    cross: Array
    place_pull: Array
    from_prior: Array
    rows: Array
    innovation: Array
    residual: Array
    weight: Array


def whiten_residuals(values: Array, seen: LandmarkSightings, std_px: float) -> Array:
    """Residuals or designs (R,…) as innovations of the
    pieces' error processes, in standard deviations.

    r̃_i = (r_i − ρ_i r_{i−1}) / (σ √(1 − ρ_i²)), ρ_i = exp(−(t_i
    − t_{i−1}) / ℓ), ρ = 0 at the first row of a piece.
    """
    rho, scale = _whitening_of_rows(seen, std_px)
    shape = (-1, *[1] * (values.ndim - 1))
    before = np.roll(values, 1, axis=0)
    return np.asarray((values - rho.reshape(shape) * before) / scale.reshape(shape))


def whiten_back(values: Array, seen: LandmarkSightings, std_px: float) -> Array:
    """The transpose of `whiten_residuals`: what innovations (R,…) weigh as sums over residuals."""
    rho, scale = _whitening_of_rows(seen, std_px)
    shape = (-1, *[1] * (values.ndim - 1))
    scaled = values / scale.reshape(shape)
    return np.asarray(scaled - np.roll(rho.reshape(shape) * scaled, -1, axis=0))


def _whitening_of_rows(seen: LandmarkSightings, std_px: float) -> tuple[Array, Array]:
    """ρ (R,), 0 at the first row of a piece, and the deviation (R,) px of each innovation."""
    gaps = np.diff(seen.t, prepend=-np.inf)
    gaps[seen.begins] = np.inf
    gaps[np.diff(seen.log, prepend=-1) != 0] = np.inf
    rho = np.exp(-gaps / RESIDUAL_TIME_S)
    return rho, std_px * np.sqrt(np.maximum(1.0 - rho**2, 1e-6))


def reduce_normal(
    model: LandmarkModel,
    phi: Array,
    seen: LandmarkSightings,
    landmarks: Landmarks,
    std_px: float = RESIDUAL_STD_PX,
) -> Reduced:
    """Normal equations at φ; errors of a piece have the
    deviation std_px, places have their bodies' priors.
    """
    predicted = model.predict(phi, seen, landmarks.body, landmarks.places)
    residual = seen.uv - predicted.image
    innovation = whiten_residuals(residual, seen, std_px)
    by_place = whiten_residuals(predicted.by_place, seen, std_px)
    by_shared = whiten_residuals(predicted.by_shared, seen, std_px)
    length = np.linalg.norm(innovation, axis=1)
    weight = DATA_SHARE * np.minimum(1.0, _KNEE_SIGMA / np.maximum(length, 1e-9))
    loss = np.where(length <= _KNEE_SIGMA, length**2, _KNEE_SIGMA * (2.0 * length - _KNEE_SIGMA))
    beyond = phi - model.prior[0]
    prior_pull = model.prior_precision @ beyond
    prior = landmarks.prior or expected_places(model, landmarks.body, phi)
    off = prior.centres + prior.slopes @ (phi - prior.at) - landmarks.places
    pulled = (prior.precision @ off[..., None])[..., 0]
    weighted_place = (by_place * weight[:, None, None]).transpose(0, 2, 1)
    place_matrix = seen.sums(weighted_place @ by_place)
    place_matrix += prior.precision
    sloping = prior.precision @ prior.slopes
    cross = seen.sums(weighted_place @ by_shared) - sloping
    place_pull = seen.sums((weighted_place @ innovation[..., None])[..., 0]) + pulled
    shared = by_shared.reshape(-1, len(phi))
    scaled = shared * np.repeat(weight, 2)[:, None]
    matrix = scaled.T @ shared + model.prior_precision
    matrix += _gram(prior.slopes, sloping)
    pull = scaled.T @ innovation.reshape(-1) - prior_pull
    pull -= prior.slopes.reshape(-1, len(phi)).T @ pulled.reshape(-1)
    eliminated = np.linalg.solve(
        place_matrix, np.concatenate([cross, place_pull[..., None]], axis=2)
    )
    flat = cross.reshape(-1, len(phi))
    matrix -= flat.T @ eliminated[..., :-1].reshape(-1, len(phi))
    pull -= flat.T @ eliminated[..., -1].reshape(-1)
    rows = by_shared - by_place @ eliminated[seen.piece, :, :-1]
    left = -prior.slopes - eliminated[..., :-1]
    from_prior = _gram(left, prior.precision @ left)
    cost = float(DATA_SHARE * loss.sum() + beyond @ prior_pull + (off * pulled).sum())
    return Reduced(
        matrix,
        pull,
        cost,
        place_matrix,
        cross,
        place_pull,
        from_prior,
        rows,
        innovation,
        residual,
        weight,
    )


def _gram(left: Array, right: Array) -> Array:
    """The sum (P,P) over landmarks of leftᵀ right, both (K,3,P)."""
    count = left.shape[-1]
    return np.asarray(left.reshape(-1, count).T @ right.reshape(-1, count))


def expected_places(model: LandmarkModel, body: Array, phi: Array) -> PlacePrior:
    """Where points are expected on the bodies with numbers (K,), whatever φ is."""
    centres = np.array([one.centre for one in model.bodies])
    sizes = np.array([one.size for one in model.bodies])[body]
    precision = np.eye(3) / sizes[:, None, None] ** 2
    return PlacePrior(centres[body], precision, np.zeros((len(body), 3, len(phi))), phi)


def adjust_landmarks(
    model: LandmarkModel,
    phi: Array,
    seen: LandmarkSightings,
    landmarks: Landmarks,
    free: Array,
    std_px: float = RESIDUAL_STD_PX,
    steps: int = _STEPS,
) -> tuple[Array, Landmarks, Reduced]:
    """Descend from φ over its `free` (P,) unknowns and all places, by Levenberg-Marquardt."""
    std = model.prior[1][free]
    here = reduce_normal(model, phi, seen, landmarks, std_px)
    damping = 1e-4
    for _ in range(steps):
        scaled = here.matrix[np.ix_(free, free)] * std * std[:, None]
        right = here.pull[free] * std
        while True:
            step = np.zeros(len(phi))
            step[free] = std * np.linalg.solve(scaled + damping * np.diag(np.diag(scaled)), right)
            right_place = here.place_pull - here.cross @ step
            moved = (
                landmarks.places
                + np.linalg.solve(here.place_matrix, right_place[..., None])[..., 0]
            )
            there = replace(landmarks, places=moved)
            after = reduce_normal(model, phi + step, seen, there, std_px)
            if after.cost < here.cost or damping > _MOST_DAMPING:
                break
            damping *= 10.0
        if not after.cost < here.cost:
            break
        gain = here.cost - after.cost
        phi = phi + step
        landmarks = there
        here = after
        damping = max(damping / 10.0, 1e-9)
        if gain < _SETTLED:
            break
    return phi, landmarks, here


def triangulate_pieces(
    model: LandmarkModel, phi: Array, seen: LandmarkSightings, body: int, angles: Array
) -> tuple[Array, Array]:
    """Places (K,3) m of all pieces on one body, for given shared unknowns and joint angles (R,M)
    of the rows, and the rows' residuals (R,) px.

    The first place is nearest to all rays; Gauss-Newton
    on the image then refines it, with the body's prior.
    """
    from .camera import project_with_slopes
    from .starts import normalised_directions

    rotation, place = model.frames(phi, angles, body, seen.log)
    rays = np.concatenate(
        [normalised_directions(seen.uv, phi[6:12]), np.ones((len(seen.uv), 1))], axis=1
    )
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    part = model.bodies[body]
    focal = float(np.exp(phi[6]))
    depth = max(float(np.linalg.norm(place + rotation @ part.centre, axis=1).mean()), _NEAREST_M)
    precision = 1.0 / part.size**2
    # with A = I − r rᵀ across a ray and w = Rᵀ r: Rᵀ A R = I − w wᵀ, and Rᵀ A p = Rᵀ p − w rᵀ p
    along = np.einsum("nij,ni->nj", rotation, rays)
    across = np.einsum("nij,ni->nj", rotation, place) - along * (rays * place).sum(1)[:, None]
    sharpness = (focal / depth) ** 2
    matrix = -sharpness * seen.sums(along[:, :, None] * along[:, None])
    matrix += (sharpness * seen.lengths[:, None, None] + precision) * np.eye(3)
    right = -sharpness * seen.sums(across) + precision * part.centre
    places = np.linalg.solve(matrix, right[..., None])[..., 0]
    for turn in range(_PLACE_STEPS + 1):
        inside = np.einsum("nij,nj->ni", rotation, places[seen.piece]) + place
        image, by_point = project_with_slopes(inside, phi[6:12])
        residual = seen.uv - image
        length = np.linalg.norm(residual, axis=1)
        if turn == _PLACE_STEPS:
            break
        by_place = by_point @ rotation
        weighted = by_place * np.minimum(1.0, 4.0 / np.maximum(length, 1e-9))[:, None, None]
        weighted = weighted.transpose(0, 2, 1)
        matrix = seen.sums(weighted @ by_place) + precision * np.eye(3)
        right = seen.sums((weighted @ residual[..., None])[..., 0])
        right += precision * (part.centre - places)
        places = places + np.linalg.solve(matrix, right[..., None])[..., 0]
    length[inside[:, 2] < _NEAREST_M] = 1e3
    return places, length


@dataclass(frozen=True, eq=False)
class Assignment:
    """Which body explains each piece best: body (K,) ·
    places (K,3) m on it · error (K,) px, root mean square.

    errors (B,K) px: on every body, infinite where it was not tried or cannot be · still (K,) px: of
    a point at rest in the image.
    """

    body: Array
    places: Array
    error: Array
    errors: Array
    still: Array


_BOX_SIGMAS = 2.5
"""Sizes of a body beyond which a point is not on it."""


def assign_pieces(
    model: LandmarkModel, phi: Array, seen: LandmarkSightings, tried: Array | None = None
) -> Assignment:
    """Try every piece on every body, or on those that `tried` (B,K) names: the least error wins."""
    errors = np.full((len(model.bodies), seen.count), np.inf)
    places = np.zeros((len(model.bodies), seen.count, 3))
    angles = model.joints_at(phi, seen)[0]
    for number, part in enumerate(model.bodies):
        pieces = np.arange(seen.count) if tried is None else np.flatnonzero(tried[number])
        if not len(pieces):
            continue
        some = seen
        of_rows = angles
        if tried is not None:
            some = seen.take(pieces)
            of_rows = angles[tried[number][seen.piece]]
        there, length = triangulate_pieces(model, phi, some, number, of_rows)
        away = np.linalg.norm(there - part.centre, axis=1) / part.size
        error = np.sqrt(some.sums(np.square(length)) / some.lengths)
        errors[number, pieces] = np.where(away > _BOX_SIGMAS, np.inf, error)
        places[number, pieces] = there
    best = np.argmin(errors, axis=0)
    pieces = np.arange(seen.count)
    middle = seen.sums(seen.uv) / seen.lengths[:, None]
    still = np.sqrt(seen.sums(np.square(seen.uv - middle[seen.piece]).sum(axis=1)) / seen.lengths)
    return Assignment(best, places[best, pieces], errors[best, pieces], errors, still)
