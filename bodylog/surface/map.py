"""The map of a robot's surface: landmarks that are found
again in images by how they look, where they are predicted.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from ..types import Array

if TYPE_CHECKING:
    from ..body_model import LandmarkMap
    from ..kinematics.landmark_adjustment import Landmarks
    from ..kinematics.landmark_fit import LandmarkFit
    from ..kinematics.landmarks import LandmarkModel, LandmarkSightings
    from ..perception.surface.corner_tracks import KeyFrames

MOST_LANDMARKS = 200
_MOST_VIEWS = 3
_PASSES = ((10, 3), (6, 1), (5, 1))
"""Reach in px and stride over the images of each
look: ever nearer to where a better model predicts.
"""
_LEAST_FOUND = 5
"""Sightings of a landmark that is kept."""
_LEAST_SHARE = 0.35
"""Share of the images that show a landmark from a known side in which it is found, at least."""
MOST_ERROR_PX = 2.5
"""Root mean square error of a landmark that is kept."""
_CANDIDATE_PX = 2.5
_ROUNDS = 3
_APART_PX = 5.0
"""Distance at which landmarks of one link count as two."""


@dataclass(frozen=True, eq=False)
class FoundAgain:
    """Sightings of a map's landmarks, as rows by landmark, log
    and time, and how often each could have been found (K,).

    numbers (k,): the landmarks that were found, in the order of the rows' pieces.
    """

    seen: "LandmarkSightings"
    numbers: Array
    possible: Array


def find_again(
    model: "LandmarkModel",
    phi: Array,
    known: "LandmarkMap",
    landmarks: "Landmarks",
    keys: "Sequence[KeyFrames]",
    reach_px: int,
    every: int = 1,
) -> FoundAgain | None:
    """Look for landmarks within reach_px of where φ predicts
    them, in every n-th image; None where none is found.
    """
    import numpy as np

    from ..kinematics.landmark_map import LEAST_FACING, nearest_views, predict_landmarks, view_maps
    from ..kinematics.landmarks import LandmarkSightings
    from ..perception.surface.patches import match_templates, warp_patches

    height = next(image.shape[0] for key in keys for image in key.images)
    rows = list[Array]()
    possible = np.zeros(known.count, int)
    for log, key in enumerate(keys):
        t = key.t[::every]
        there = predict_landmarks(model, phi, landmarks, t, log, height)
        for number, image in enumerate(key.images[::every]):
            views, facing = nearest_views(known, there.by_place[:, number])
            some = np.flatnonzero((facing >= LEAST_FACING) & there.front[:, number])
            maps = view_maps(there.by_place[some, number], known.view_slopes[views[some]])
            templates, fit = warp_patches(known.patches[views[some]], maps)
            some = some[fit]
            templates = templates[fit]
            found = match_templates(image, templates, there.image[some, number], reach_px)
            possible[some[found.score > -1.0]] += 1
            sure = np.flatnonzero(found.sure)
            rows.append(
                np.column_stack(
                    [some[sure], np.full((len(sure), 2), [log, t[number]]), found.uv[sure]]
                )
            )
    table = np.concatenate(rows)
    if not len(table):
        return None
    table = table[np.lexsort((table[:, 2], table[:, 1], table[:, 0]))]
    numbers, piece = np.unique(table[:, 0].astype(int), return_inverse=True)
    seen = LandmarkSightings(
        piece.reshape(-1), table[:, 1].astype(int), table[:, 2], table[:, 3:5], height
    )
    return FoundAgain(seen, numbers, possible)


def refine(
    model: "LandmarkModel",
    phi: Array,
    free: Array,
    known: "LandmarkMap",
    landmarks: "Landmarks",
    keys: "Sequence[KeyFrames]",
    passes: Sequence[tuple[int, int]] = _PASSES,
) -> "tuple[LandmarkFit, Array] | None":
    """Adjust from landmarks found again alone: the fit,
    and which landmarks (k,) it uses; None without enough.
    """
    import numpy as np

    from ..kinematics.landmark_adjustment import adjust_landmarks
    from ..kinematics.landmark_fit import LEAST_PIECES, LandmarkFit

    kept = np.arange(known.count)
    result = None
    for reach, every in passes:
        found = find_again(model, phi, known.take(kept), landmarks, keys, reach, every)
        if found is None:
            return None
        often = found.seen.lengths >= np.maximum(
            _LEAST_FOUND, _LEAST_SHARE * found.possible[found.numbers]
        )
        seen = found.seen.take(np.flatnonzero(often))
        numbers = found.numbers[often]
        for _ in range(_ROUNDS):
            if len(numbers) < LEAST_PIECES:
                return None
            phi, placed, reduced = adjust_landmarks(model, phi, seen, landmarks.take(numbers), free)
            good = np.flatnonzero(rms_errors(seen, reduced.residual) < MOST_ERROR_PX)
            result = LandmarkFit(model, phi, free, seen, numbers, placed, reduced), kept[numbers]
            landmarks = _with_places(landmarks, numbers, placed.places)
            if len(good) == len(numbers):
                break
            seen = seen.take(good)
            numbers = numbers[good]
        kept = kept[numbers]
        landmarks = landmarks.take(numbers)
    return result


def rms_errors(seen: "LandmarkSightings", residual: Array) -> Array:
    """Root mean square error (K,) px of each landmark, from residuals (R,2) px."""
    import numpy as np

    return np.asarray(np.sqrt(seen.sums(np.square(residual).sum(axis=1)) / seen.lengths))


def _with_places(landmarks: "Landmarks", numbers: Array, places: Array) -> "Landmarks":
    moved = landmarks.places.copy()
    moved[numbers] = places
    return replace(landmarks, places=moved)


def build_map(
    fit: "LandmarkFit", seen: "LandmarkSightings", keys: "Sequence[KeyFrames]"
) -> "tuple[LandmarkFit, LandmarkMap] | None":
    """Find the landmarks of a fit again in its logs' films, and adjust from these sightings alone.

    seen: all moving pieces · keys: of each log. None where too few landmarks are found again.
    """
    import numpy as np

    from ..kinematics.landmark_adjustment import Landmarks, assign_pieces
    from ..kinematics.landmark_fit import explained_pieces

    model = fit.model
    phi = fit.phi
    chosen = assign_pieces(model, phi, seen.thinned(2))
    moves = np.array([len(body.chain.column) > 0 for body in model.bodies])[chosen.body]
    sound = (chosen.error < _CANDIDATE_PX) & explained_pieces(model, chosen) & moves
    used = np.flatnonzero(sound)
    part = seen.take(used)
    landmarks = Landmarks(chosen.body[used], chosen.places[used])
    first = _with_views(model, phi, part, landmarks, keys)
    if first is None:
        return None
    known, landmarks = first
    refined = refine(model, phi, fit.free, known, landmarks, keys, _PASSES[:2])
    if refined is None:
        return None
    found, _ = refined
    apart = distinct_landmarks(found)
    second = _with_views(
        model, found.phi, found.seen.take(apart), found.landmarks.take(apart), keys
    )
    if second is None:
        return None
    known, landmarks = second
    refined = refine(model, found.phi, fit.free, known, landmarks, keys, _PASSES[1:])
    if refined is None:
        return None
    found, numbers = refined
    return found, _map_of(found, known.take(numbers))


def _map_of(fit: "LandmarkFit", known: "LandmarkMap") -> "LandmarkMap":
    """The map with places, and what they depend on, from a fit."""
    import numpy as np

    reduced = fit.reduced
    model = fit.model
    delays = np.arange(model.of_delays.start, model.of_delays.stop)
    shared = np.setdiff1d(np.arange(model.of_moves.start), delays)
    slopes = -np.linalg.solve(reduced.place_matrix, reduced.cross[..., shared] * fit.free[shared])
    return replace(
        known, places=fit.landmarks.places, precision=reduced.place_matrix, slopes=slopes
    )


def distinct_landmarks(fit: "LandmarkFit") -> Array:
    """Numbers of the landmarks that lie apart from every
    other one of their link that is seen more often.
    """
    import numpy as np

    seen = fit.seen
    landmarks = fit.landmarks
    predicted = fit.model.predict(fit.phi, seen, landmarks.body, landmarks.places)
    depth = seen.sums(predicted.depth) / seen.lengths
    apart = _APART_PX * depth / float(np.exp(fit.phi[6]))
    chosen = list[int]()
    for number in np.argsort(-seen.lengths, kind="stable").tolist():
        others = [one for one in chosen if landmarks.body[one] == landmarks.body[number]]
        distance = np.linalg.norm(landmarks.places[others] - landmarks.places[number], axis=1)
        if (distance > apart[number]).all():
            chosen.append(number)
        if len(chosen) == MOST_LANDMARKS:
            break
    return np.array(sorted(chosen), int)


def _with_views(
    model: "LandmarkModel",
    phi: Array,
    seen: "LandmarkSightings",
    landmarks: "Landmarks",
    keys: "Sequence[KeyFrames]",
) -> "tuple[LandmarkMap, Landmarks] | None":
    """A map of the landmarks with views from where they
    were seen, as differently as can be; None without any.
    """
    import numpy as np

    from ..body_model import LandmarkMap
    from ..kinematics.landmark_map import looking
    from ..perception.surface.patches import cut_patch

    predicted = model.predict(phi, seen, landmarks.body, landmarks.places)
    directions = looking(predicted.by_place)
    image_of = [dict(zip(key.t.tolist(), key.images, strict=True)) for key in keys]
    view_of = list[int]()
    patches = list[Array]()
    slopes = list[Array]()
    for number, (begin, length) in enumerate(
        zip(seen.begins.tolist(), seen.lengths.tolist(), strict=True)
    ):
        rows = [
            row for row in range(begin, begin + length) if seen.t[row] in image_of[seen.log[row]]
        ]
        for row in _spread_rows(rows, directions):
            patch = cut_patch(image_of[seen.log[row]][seen.t[row]], seen.uv[row])
            if patch is not None:
                view_of.append(number)
                patches.append(patch)
                slopes.append(predicted.by_place[row])
    if not view_of:
        return None
    numbers, place = np.unique(view_of, return_inverse=True)
    count = len(numbers)
    unknowns = len(phi)
    known = LandmarkMap(
        landmarks.body[numbers],
        landmarks.places[numbers],
        np.zeros((count, 3, 3)),
        np.zeros((count, 3, unknowns)),
        place.reshape(-1),
        np.array(patches),
        np.array(slopes),
    )
    return known, landmarks.take(numbers)


def _spread_rows(rows: Sequence[int], directions: Array) -> list[int]:
    """At most _MOST_VIEWS of the rows, the middle one and
    those that look from farthest away of the ones before.
    """
    import numpy as np

    if not rows:
        return []
    chosen = [rows[len(rows) // 2]]
    while len(chosen) < min(_MOST_VIEWS, len(rows)):
        nearest = (directions[list(rows)] @ directions[chosen].T).max(axis=1)
        chosen.append(rows[int(np.argmin(nearest))])
    return chosen
