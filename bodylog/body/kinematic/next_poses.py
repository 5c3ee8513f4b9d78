"""Which postures to record next: those after which a body is least
unsure of what every other posture would show.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

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
"""Visible ones that are weighed, and predicted; the cost is quadratic in them."""
_MOST_ROWS = 1200
"""Coordinates of all tracks at all those postures."""
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
    """Postures (N,M), rad or m where `sliding`, in the order in which they tell most.

    std_px (N+1,): root mean square std of where visible postures will be seen, by what the body
    does not know: now, and after each posture; px in images, and mm in space where there are no
    images.
    """

    joints: tuple[str, ...]
    sliding: tuple[bool, ...]
    postures: Array
    std_px: Array
    unit: str = "px"


@dataclass(frozen=True, eq=False)
class _Predicted:
    """What a body predicts of K postures, R coordinates each: covariance (KR,KR), without noise ·
    noise (K,R) of a sighting · there (K,): which show a track at all · known (KR,): coordinates of
    visible tracks, which are to be predicted well.
    """

    covariance: Array
    noise: Array
    there: Array
    known: Array

    def list_removed_variances(self) -> Array:
        """Summed variance (K,) that seeing each posture takes away; none where it shows nothing."""
        found = np.full(len(self.noise), -np.inf)
        for k in np.flatnonzero(self.there).tolist():
            rows, inner = self._predict_sighting(k)
            across = self.covariance[self.known, rows]
            found[k] = np.trace(np.linalg.solve(inner, across.T @ across))
        return found

    def condition_on(self, posture: int) -> "_Predicted":
        """The same once a posture is seen (R&W 2.24)."""
        rows, inner = self._predict_sighting(posture)
        lean = np.linalg.solve(inner, self.covariance[rows])
        return replace(self, covariance=self.covariance - self.covariance[:, rows] @ lean)

    @property
    def rms_std(self) -> float:
        """Root mean square std of the known coordinates."""
        return float(np.sqrt(max(float(np.diag(self.covariance)[self.known].mean()), 0.0)))

    def _predict_sighting(self, posture: int) -> tuple[slice, Array]:
        """A posture's rows, and the covariance (R,R) of what will be measured there."""
        width = self.noise.shape[1]
        rows = slice(posture * width, (posture + 1) * width)
        return rows, self.covariance[rows, rows] + np.diag(self.noise[posture])


def propose_postures(body: BodyModel, count: int, candidates: Array) -> Proposal:
    """The best of some postures (K,M) to record, one by one:
    each leaves the body the least variance of its predictions.

    That is their mean over all visible candidates, by the unknowns and the residual process together
    (I-optimality; Atkinson, Donev & Tobias 2007, ch. 10). EvidenceError where too few are visible.
    """
    senses = kinematic_senses(body, CALIBRATION)
    shown = [is_surely_visible(body, sense, candidates) for sense in senses.values()]
    seen = np.flatnonzero(np.any(shown, axis=0))
    if len(seen) < count:
        raise EvidenceError(
            f"only {len(seen)} of {len(candidates)} postures would be seen, {count} are needed"
        )
    width = sum(len(sense.outputs) for sense in senses.values())
    most = min(len(seen), _MOST_VISIBLE, max(count, _MOST_ROWS // width))
    seen = seen[np.linspace(0, len(seen) - 1, most).round().astype(int)]
    predicted, unit = _predict_all_tracks(body, senses, candidates[seen], np.array(shown)[:, seen])
    left = [predicted.rms_std]
    chosen = list[int]()
    for _ in range(count):
        gains = predicted.list_removed_variances()
        gains[chosen] = -np.inf
        chosen.append(int(np.argmax(gains)))
        predicted = predicted.condition_on(chosen[-1])
        left.append(predicted.rms_std)
    rig = next(iter(senses.values())).rig
    sliding = tuple(rig.slides(m) for m in range(len(body.joints)))
    return Proposal(body.joints, sliding, candidates[seen[chosen]], np.array(left), unit)


def _predict_all_tracks(
    body: BodyModel, senses: Mapping[str, KinematicGP], x: Array, there: Array
) -> tuple[_Predicted, str]:
    """The predictions of all tracks at x (K,M), posture by posture, and the unit of those that count.

    A posture has u and v, or x, y and z, of each track, without covariance where it is not there
    (S,K). Tracks share the unknowns; each has a residual process of its own.
    """
    count = len(x)
    sizes = [len(sense.outputs) for sense in senses.values()]
    unknown = np.concatenate(
        [
            np.where(one[:, None, None], sense.unknowns(x), 0.0)
            for sense, one in zip(senses.values(), there, strict=True)
        ],
        axis=1,
    )
    width = unknown.shape[1]
    flat = unknown.reshape(count * width, -1)
    covariance = (flat @ flat.T).reshape(count, width, count, width)
    noise = np.empty((count, width))
    end = 0
    for (name, sense), one in zip(senses.items(), there, strict=True):
        process = GP.covariance(sense, x)[0] * one * one[:, None]
        for d in range(len(sense.outputs)):
            covariance[:, end, :, end] += process * sense.share[d]
            noise[:, end] = body.noise.senses[name][d]
            end += 1
    units = [sense.unit for sense in senses.values()]
    unit = "px" if "px" in units else units[0]
    counts = there & (np.array(units) == unit)[:, None]
    known = np.repeat(counts.T, sizes, axis=1).reshape(-1)
    whole = covariance.reshape(count * width, count * width)
    return _Predicted(whole, noise, np.any(there, axis=0), known), unit


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
