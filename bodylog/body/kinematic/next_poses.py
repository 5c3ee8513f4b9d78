"""Which postures to record next: those whose sightings
would narrow the calibration most, one after the other.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...body_model import BodyModel
from ...errors import EvidenceError
from ...kinematics.robot import Limits
from ...types import Array
from ..gp.model import GP
from .model import KinematicGP, kinematic_senses
from .placements import CALIBRATION, IMAGE_SIZES

CANDIDATES = 2000
"""Random postures that are weighed."""
_MOST_VISIBLE = 300
"""Visible ones that are weighed; the cost is quadratic in them."""
_NEAREST = 0.5
_FARTHEST = 2.0
"""Depths of postures, over the least and the greatest depth of the sightings learned from."""
_EDGE = 0.05
"""Share of an image's width at its edges in which a marker may be cut off."""
_MARGIN = 0.02
"""Share of a joint's range that is left free at its limits."""
_SEED = 0


@dataclass(frozen=True, eq=False)
class Proposal:
    """Postures (N,M), rad or m where `sliding`, in the order
    of their worth · nats (N,) each adds to the ones before.

    std_px (N+1,): root mean square std of where visible postures will be seen, by what the
    calibration does not know: now, and after each posture; px in images, and mm in space
    where there are no images.
    """

    joints: tuple[str, ...]
    sliding: tuple[bool, ...]
    postures: Array
    nats: Array
    std_px: Array
    unit: str = "px"


def propose_postures(body: BodyModel, count: int, candidates: Array) -> Proposal:
    """The best of some postures (K,M) to record, chosen
    greedily by the nats that each adds about the calibration.

    Predictions are Gaussian together, through the unknowns that the adjustment's information leaves
    open, and each posture adds most to the determinant of that information, given those before it
    (D-optimality; Fedorov 1972). EvidenceError
    where too few are visible.
    """
    senses = kinematic_senses(body, CALIBRATION)
    shown = [is_surely_visible(body, sense, candidates) for sense in senses.values()]
    seen = np.flatnonzero(np.any(shown, axis=0))
    if len(seen) < count:
        raise EvidenceError(
            f"only {len(seen)} of {len(candidates)} postures would be seen, {count} are needed"
        )
    seen = seen[
        np.unique(np.linspace(0, len(seen) - 1, min(len(seen), _MOST_VISIBLE)).round().astype(int))
    ]
    there = np.array(shown)[:, seen]
    covariance, noise = _predict_all_tracks(body, senses, candidates[seen], there)
    units = [sense.unit for sense in senses.values()]
    unit = "px" if "px" in units else units[0]
    counts = there & (np.array(units) == unit)[:, None]
    sizes = [len(sense.outputs) for sense in senses.values()]
    known = np.repeat(counts.T, sizes, axis=1).reshape(-1)
    nats = list[float]()
    left = [_rms_std_of_visible(covariance, known)]
    chosen = list[int]()
    for _ in range(count):
        best, gained = _most_useful(covariance, noise, there, chosen)
        rows = _posture_rows(best, len(noise[0]))
        inner = covariance[np.ix_(rows, rows)] + np.diag(noise[best])
        covariance = covariance - covariance[:, rows] @ np.linalg.solve(inner, covariance[rows])
        chosen.append(best)
        nats.append(gained)
        left.append(_rms_std_of_visible(covariance, known))
    rig = next(iter(senses.values())).rig
    sliding = tuple(rig.slides(m) for m in range(len(body.joints)))
    return Proposal(
        body.joints, sliding, candidates[seen[chosen]], np.array(nats), np.array(left), unit
    )


def _predict_all_tracks(
    body: BodyModel, senses: Mapping[str, KinematicGP], x: Array, there: Array
) -> tuple[Array, Array]:
    """Covariance (KR,KR) of the predictions of all tracks
    at x (K,M) by the calibration, posture by posture, and noise (K,R).

    R: u and v, or x, y and z, of each track, without covariance where it is not there (S,K). The residual process
    counts as noise: six sightings teach it little beyond their own surroundings.
    """
    each = zip(senses.values(), there, strict=True)
    rows = np.concatenate(
        [np.where(one[:, None, None], sense.calibration_doubt(x), 0.0) for sense, one in each],
        axis=1,
    )
    count, width = rows.shape[:2]
    flat = rows.reshape(count * width, -1)
    covariance = flat @ flat.T
    noise = np.empty((count, width))
    end = 0
    for name, sense in senses.items():
        columns = slice(end, end := end + len(sense.outputs))
        noise[:, columns] = GP.predict(sense, x)[2] + np.array(body.noise.senses[name])
    return covariance, noise


def _most_useful(
    covariance: Array, noise: Array, there: Array, taken: list[int]
) -> tuple[int, float]:
    """The posture whose sighting adds most nats about the calibration, and how many."""
    gains = np.full(there.shape[1], -np.inf)
    for k in np.setdiff1d(np.flatnonzero(there.any(axis=0)), taken).tolist():
        rows = _posture_rows(k, noise.shape[1])
        inner = covariance[np.ix_(rows, rows)] + np.diag(noise[k])
        gains[k] = 0.5 * (np.linalg.slogdet(inner)[1] - np.log(noise[k]).sum())
    best = int(np.argmax(gains))
    return best, float(gains[best])


def _posture_rows(posture: int, width: int) -> Array:
    return np.arange(posture * width, (posture + 1) * width)


def _rms_std_of_visible(covariance: Array, known: Array) -> float:
    """Root mean square std of the predictions that are of visible tracks."""
    return float(np.sqrt(max(float(np.diag(covariance)[known].mean()), 0.0)))


def random_postures(body: BodyModel, limits: Mapping[str, Limits]) -> Array:
    """Postures (K,M) within the joints' limits, or
    within the explored range of a joint without limits.
    """
    samples = np.concatenate(
        [sense.samples for sense in kinematic_senses(body, CALIBRATION).values()]
    )
    low = samples.min(axis=0)
    high = samples.max(axis=0)
    for m, joint in enumerate(body.joints):
        if (limit := limits.get(joint)) is not None:
            free = _MARGIN * (limit.upper - limit.lower)
            low[m] = limit.lower + free
            high[m] = limit.upper - free
    return np.random.default_rng(_SEED).uniform(low, high, (CANDIDATES, len(low)))


def is_surely_visible(body: BodyModel, sense: KinematicGP, postures: Array) -> Array:
    """Whether a track would surely be in the image and
    about as far as before: (K,) bool of postures (K,M).

    Its predicted place is a share _EDGE of the width from
    the edges, which is two standard deviations at least.
    What hides a point from a tracker is not known: it counts as visible.
    """
    camera = sense.rig.cameras[0]
    if camera.tracks_space:
        return np.ones(len(postures), bool)
    width, height = body.provenance.get(IMAGE_SIZES, {}).get(camera.name, 2.0 * camera.lens[2:4])
    image, _, variance = sense.predict(postures)
    edge = _EDGE * width
    inside = ((image > edge) & (image < np.array([width, height]) - edge)).all(axis=1)
    inside &= (variance < np.square(0.5 * edge)).all(axis=1)
    depth = _depth_before_camera(sense, postures)
    learned = _depth_before_camera(sense, sense.samples)
    near = depth > _NEAREST * max(float(learned.min()), 0.0)
    return np.asarray(inside & near & (depth < _FARTHEST * float(learned.max())))


def _depth_before_camera(sense: KinematicGP, postures: Array) -> Array:
    """Depth (K,) m of a track before its camera."""
    rig = sense.rig
    sight = rig.sights[0]
    arm = sight.chain.at(rig.angles(sense.theta, postures))
    marker = rig.carrier_pose(0, sense.theta)
    point = marker[:3, :3] @ sight.points[0] + marker[:3, 3]
    camera = rig.camera_pose(0, sense.theta)
    place = arm.rotation @ point + arm.place
    return np.asarray(place @ camera[2, :3] + camera[2, 3])
