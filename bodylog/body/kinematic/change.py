"""Changes since a body was learned: a joint's zero, a
camera's or a marker's pose, each compared by evidence.

Residuals of the body's predictions are r = A u + B z + g + noise: u the
changes, z ~ N(0, I) the uncertainty of the body's unknowns θ, g the
residual's process. A change must win nats with z and g marginalised.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ...body_model import BodyModel
from ...errors import ModelError
from ...kinematics.rotations import vector_from_rotation
from ...runtime.blas_threads import one_thread
from ...types import Array, Board, Features
from ..data.pairs import NO_ERRORS
from .change_problem import FEWEST, PAYLOAD, pose_problem
from .change_system import (
    ChangeFit,
    ChangePart,
    ChangeProblem,
    drop_unexplained_sightings,
    fit_parts,
    linear_evidence,
    linearise_sightings,
    move_models,
)

CHANGE_NATS = 20.0
"""Nats that a change since learning must win, more than the 12 of `estimation/faults/threshold.py`:
it explains every sighting of a log at once, and so does a residual process learned too small.
"""
CHANGE_MARGIN_NATS = 5.0
"""Nats by which a change must win over any other for a name of its own."""
LEAST = 0.01
"""rad: smallest offset that counts as a fault, as in `estimation`."""
_PROMISING = 6
_FINER = 4
_STEP = 1e-6
"""m, rad: step of numerical derivatives of a pose."""
_NEAR = np.array([-0.8, -0.6, -0.4, -0.2, 0.2, 0.4, 0.6, 0.8])


@dataclass(frozen=True, eq=False)
class Change:
    """One change since the body was learned: `kind` joint,
    camera or marker · value ± std (K,) rad or m · nats won.

    A joint has one value, its zero's. shift: by how far a camera's or marker's own centre moved ±
    std, in length_unit, as of `PosedGP` · turn: by how much a camera or board turned ± std, rad.
    since: s, None from the start on · alternatives: explanations nearly as good · unit: of a
    joint's.
    """

    kind: str
    name: str
    value: Array
    std: Array
    nats: float
    since: float | None = None
    alternatives: tuple[str, ...] = ()
    unit: str = "rad"
    shift: tuple[float, float] | None = None
    turn: tuple[float, float] | None = None
    length_unit: str = "m"


@dataclass(frozen=True, eq=False)
class FoundChanges:
    """Changes since a body was learned, most likely first, and the body with cameras and markers
    where they are now.

    doubt (M,M) rad²: covariance of the angles by other changes that explain the log about as well.
    """

    changes: tuple[Change, ...]
    body: BodyModel
    doubt: Array


@one_thread("scipy.linalg")
def find_changes(
    features: Features,
    body: BodyModel,
    lasting: Mapping[str, tuple[float, float]] = NO_ERRORS,
    offsets: Collection[str] = (),
) -> FoundChanges:
    """Find changes between the exploration logs and these features.

    lasting: as `smooth_all_joints` takes it · offsets: joints that an estimate of this log holds to
    be off from its start on, without a load. No change where no track has kinematics, a joint lacks
    readings, or too little is seen.
    """
    none = FoundChanges((), body, np.zeros((len(body.joints),) * 2))
    if (problem := pose_problem(features, body, lasting)) is None:
        return none
    problem = drop_unexplained_sightings(problem)
    if sum(len(kept) for kept in problem.kept) < FEWEST:
        return none
    found = _prefer_joint_pair(_search_parts(problem, len(body.joints)), problem)
    if not found.parts:
        return none
    centres = _marker_centres(problem, features.boards)
    estimated = _fit_offsets(found, offsets)
    changes = tuple(
        one
        for one in (*_weighted_changes(found, centres), *_doubt_offsets(found, estimated))
        if one.kind != "joint" or abs(one.value[0]) > LEAST
    )
    doubt = _weigh_explanations(found, body.joints, estimated)
    if not any(part.is_pose for part in found.parts):
        return FoundChanges(changes, body, doubt)
    moved = move_models(found.problem, *_allow_for_load(found))
    return FoundChanges(changes, replace(body, senses={**body.senses, **moved}), doubt)


_Alternatives = tuple[tuple[str, str], ...]
_Explanation = tuple[tuple[ChangePart, ...], ChangeFit]
"""Parts and their fit."""


@dataclass(frozen=True, eq=False)
class _Search:
    """Accepted parts with their common fit, and the alternatives of each."""

    problem: ChangeProblem
    parts: tuple[ChangePart, ...]
    fit: ChangeFit
    alternatives: Mapping[tuple[str, str], _Alternatives]


def _search_parts(problem: ChangeProblem, most: int) -> _Search:
    """Add one part after the other while each wins
    CHANGE_NATS nats; drop parts that later ones explain.
    """
    accepted = tuple[ChangePart, ...]()
    known = fit_parts(problem, ())
    won = dict[tuple[str, str], _Alternatives]()
    while len(accepted) < most:
        taken = {*won, *(other for alternatives in won.values() for other in alternatives)}
        tried = _try_remaining_parts(problem, accepted, known, taken)
        if not tried or tried[0][1].evidence < known.evidence + CHANGE_NATS:
            break
        part, best = tried[0]
        if np.isfinite(part.onset):
            problem, part, best = _refine_onset(problem, accepted, part, best)
        won[part.thing] = _find_alternatives(part, tried)
        accepted, known = _drop_unneeded_parts(problem, (*accepted, part), best)
    return _Search(problem, accepted, known, won)


def _prefer_joint_pair(found: _Search, problem: ChangeProblem) -> _Search:
    """The search's result, or the best pair of joints
    if more likely: one other part may imitate both.
    """
    constant = [part for part in problem.parts if part.kind == "joint" and np.isinf(part.onset)]
    if not found.parts or len(constant) < 2:
        return found
    about = linearise_sightings(problem, found.fit.unknowns)
    best = max(combinations(constant, 2), key=lambda pair: linear_evidence(about, problem, pair))
    fit = fit_parts(problem, best)
    things = tuple(part.thing for part in best)
    alone = [fit_parts(problem, (part,), fit.unknowns).evidence for part in best]
    needs_both = fit.evidence > max(alone) + CHANGE_NATS
    gain = fit.evidence - found.fit.evidence
    if set(things) == set(found.alternatives) or not needs_both or gain < -CHANGE_MARGIN_NATS:
        return found
    if gain > CHANGE_MARGIN_NATS:
        return _Search(problem, best, fit, dict.fromkeys(things, ()))
    known = {thing: (*others, *things) for thing, others in found.alternatives.items()}
    return replace(found, alternatives=known)


def _fit_offsets(found: _Search, offsets: Collection[str]) -> _Explanation:
    """What an estimate explains a log by: joints' offsets, where a load was found and it allows for
    none; else what was found.
    """
    has_load = any(part.kind == "load" for part in found.parts)
    constant = (part for part in found.problem.parts if np.isinf(part.onset))
    chosen = [part for part in constant if part.kind == "joint" and part.name in offsets]
    if not has_load or not chosen:
        return found.parts, found.fit
    others = [part for part in found.parts if part.kind not in ("joint", "load")]
    parts = (*chosen, *others)
    return parts, fit_parts(found.problem, parts, found.fit.unknowns)


def _doubt_offsets(found: _Search, estimated: _Explanation) -> Iterator[Change]:
    """Yield each offset that an estimate holds where a load was found, with the load beside it."""
    parts, fit = estimated
    if parts is found.parts:
        return
    without = fit_parts(found.problem, ()).evidence
    things = {part.thing for part in found.parts}
    for part in parts:
        if part.kind == "joint" and part.thing not in things:
            yield _make_change(part, fit, fit.evidence - without, (("load", PAYLOAD),))


def _weigh_explanations(found: _Search, names: tuple[str, ...], estimated: _Explanation) -> Array:
    """Covariance (M,M) rad² of joints' zeros by single changes, pairs of joints, and a load beside
    a pose that was found, each as probable as its evidence says, about what an estimate explains
    the log by.
    """
    problem = found.problem
    fits = _fit_explanations(found)
    taken = {part.thing for part in estimated[0]}
    evidence = np.array([fit.evidence for _, fit in fits])
    share = np.exp(evidence - evidence.max())
    share = share / share.sum()
    doubt = np.zeros((len(names), len(names)))
    for (parts, fit), weight in zip(fits, share, strict=True):
        apart = _compare_explanations(problem, names, (parts, fit), estimated)
        # what was found has its own covariance in the body, or in the estimate
        others = [part for part in parts if part.thing not in taken]
        own = _move_zeros(problem, others, fit.unknowns, names)[1]
        most = _take_greatest(apart, np.abs(apart))
        by_unknowns = _take_greatest(own, np.einsum("nmp,pq,nmq->nm", own, fit.cov, own))
        doubt += weight * (np.outer(most, most) + by_unknowns @ fit.cov @ by_unknowns.T)
    return doubt


def _compare_explanations(
    problem: ChangeProblem, names: tuple[str, ...], one: _Explanation, estimated: _Explanation
) -> Array:
    """How far apart (n,M) rad joints are by one explanation and by that of an estimate; by what
    else they say, where both have a load at the same hand: the estimate weighs that itself.
    """
    hands = [{part.hand for part in parts if part.kind == "load"} for parts, _ in (one, estimated)]
    same = set.intersection(*hands)
    moved = [
        _move_zeros(
            problem,
            [part for part in parts if part.kind != "load" or part.hand not in same],
            fit.unknowns,
            names,
        )[0]
        for parts, fit in (one, estimated)
    ]
    return np.asarray(moved[0] - moved[1])


def _take_greatest(values: Array, size: Array) -> Array:
    """The value (M,...) of each joint where its size (n,M) is greatest, of those (n,M,...) of n
    sightings.
    """
    return np.asarray(values[size.argmax(axis=0), np.arange(size.shape[1])])


def _fit_explanations(found: _Search) -> list[_Explanation]:
    """What was found, then single changes, pairs of joints, and loads beside poses that were found,
    with their fits; a load beside others costs as much as it must win to be allowed for.
    """
    constant = [part for part in found.problem.parts if np.isinf(part.onset)]
    joints = [part for part in constant if part.kind == "joint"]
    loads = [part for part in constant if part.kind == "load"]
    things = {part.thing for part in found.parts}
    beside = [load for load in loads if load.thing not in things]
    tried = [(one, 0.0) for one in (*((part,) for part in constant), *combinations(joints, 2))]
    if any(part.is_pose for part in found.parts):
        tried += [((*found.parts, load), CHANGE_MARGIN_NATS) for load in beside]
    fits = [(found.parts, found.fit)]
    for parts, cost in tried:
        with suppress(ModelError):  # no joint is where these would have it
            fit = fit_parts(found.problem, parts)
            fits.append((parts, replace(fit, evidence=fit.evidence - cost)))
    return fits


def _move_zeros(
    problem: ChangeProblem, parts: Sequence[ChangePart], unknowns: Array, names: tuple[str, ...]
) -> tuple[Array, Array]:
    """How far (n,M) rad joints are from what they read in n sightings, by these parts of unknowns
    (P,), and the derivatives (n,M,P).
    """
    count = sum(len(kept) for kept in problem.kept)
    moved = np.zeros((count, len(names)))
    by_unknowns = np.zeros((count, len(names), len(problem.std)))
    for part in parts:
        value = unknowns[part.place]
        if part.kind == "joint":
            moved[:, names.index(part.name)] += value[0]
            by_unknowns[:, names.index(part.name), part.place] = 1.0
        elif part.kind == "load":
            bent = [
                track.sinkings[part.hand].bend_joints(kept, value)
                for track, kept in zip(problem.tracks, problem.kept, strict=True)
            ]
            moved += np.concatenate([bends for bends, _ in bent])
            by_unknowns[..., part.place] = np.concatenate([columns for _, columns in bent])
    return moved, by_unknowns


def _allow_for_load(found: _Search) -> tuple[tuple[ChangePart, ...], ChangeFit]:
    """The parts and their fit, with a load where it wins CHANGE_MARGIN_NATS beside a pose: a
    camera would take up a part of it.
    """
    least = found.fit.evidence + CHANGE_MARGIN_NATS
    chosen = found.parts, found.fit
    if any(part.kind == "load" for part in found.parts):
        return chosen
    for load in (part for part in found.problem.parts if part.kind == "load"):
        with_load = (*found.parts, load)
        fit = fit_parts(found.problem, with_load, found.fit.unknowns)
        if fit.evidence >= max(least, chosen[1].evidence):
            chosen = with_load, fit
    return chosen


def _weighted_changes(found: _Search, centres: Mapping[str, Array]) -> Iterator[Change]:
    """Yield every part but a load with the nats lost without it; centres: of markers (3,) m."""
    for part in found.parts:
        if part.kind == "load":
            continue
        others = tuple(one for one in found.parts if one is not part)
        without = fit_parts(found.problem, others, found.fit.unknowns)
        change = _make_change(
            part, found.fit, found.fit.evidence - without.evidence, found.alternatives[part.thing]
        )
        yield _add_displacement(change, part, found, centres)


def _drop_unneeded_parts(
    problem: ChangeProblem, parts: tuple[ChangePart, ...], fit: ChangeFit
) -> tuple[tuple[ChangePart, ...], ChangeFit]:
    """Drop parts that others, found later, explain as well."""
    for part in parts[:-1]:
        others = tuple(one for one in parts if one is not part)
        without = fit_parts(problem, others, fit.unknowns)
        if without.evidence > fit.evidence - CHANGE_MARGIN_NATS:
            return _drop_unneeded_parts(problem, others, without)
    return parts, fit


def _refine_onset(
    problem: ChangeProblem, accepted: tuple[ChangePart, ...], part: ChangePart, fit: ChangeFit
) -> tuple[ChangeProblem, ChangePart, ChangeFit]:
    """Refine the onset of a part between those that were tried."""
    reach = float(np.diff(problem.onsets[1:]).max())
    kept = tuple(np.arange(len(one.part.x)) for one in problem.tracks)
    for turn in range(_FINER):
        ways = [replace(part, onset=float(onset)) for onset in part.onset + reach * _NEAR]
        posed = [
            replace(problem, parts=tuple(way if one is part else one for one in problem.parts))
            for way in ways
        ]
        fits = [
            fit_parts(one, (*accepted, way), fit.unknowns)
            for one, way in zip(posed, ways, strict=True)
        ]
        best = int(np.argmax([one.evidence for one in fits]))
        if fits[best].evidence > fit.evidence:
            problem = posed[best]
            part = ways[best]
            fit = fits[best]
        if turn == 0:
            # sightings that only an intermediate onset explains looked like outliers
            problem = drop_unexplained_sightings(replace(problem, kept=kept, scale=1.0))
            fit = fit_parts(problem, (*accepted, part), fit.unknowns)
        reach *= 0.5 if turn == 0 else 0.3
    return problem, part, fit


def _try_remaining_parts(
    problem: ChangeProblem,
    accepted: tuple[ChangePart, ...],
    known: ChangeFit,
    taken: set[tuple[str, str]],
) -> list[tuple[ChangePart, ChangeFit]]:
    """Fits of each remaining part added to the accepted ones, most likely first."""
    about = linearise_sightings(problem, known.unknowns)
    begin = linear_evidence(about, problem, accepted)
    promised = []
    for part in problem.parts:
        if part.thing not in taken:
            # all onsets together are as likely as none
            cost = 0.0 if np.isinf(part.onset) else float(np.log(len(problem.onsets) - 1))
            promised.append(
                (linear_evidence(about, problem, (*accepted, part)) - begin - cost, cost, part)
            )
    promised.sort(key=lambda one: -one[0])
    least = promised[0][0] if promised else 0.0
    if least < 0.5 * CHANGE_NATS:
        return []
    some = [one for k, one in enumerate(promised) if k < _PROMISING or one[0] > 0.8 * least][
        : 2 * _PROMISING
    ]
    some += [
        one
        for one in promised
        if one not in some and np.isinf(one[2].onset) and one[0] > 0.5 * least
    ]
    tried = [
        (part, fit_parts(problem, (*accepted, part), known.unknowns), cost)
        for _, cost, part in some
    ]
    costed = [(part, replace(fit, evidence=fit.evidence - cost)) for part, fit, cost in tried]
    return sorted(costed, key=lambda one: -one[1].evidence)


def _find_alternatives(
    best: ChangePart, tried: Sequence[tuple[ChangePart, ChangeFit]]
) -> _Alternatives:
    """Other things whose change explains the sightings within CHANGE_MARGIN_NATS of the best."""
    top = tried[0][1].evidence
    near = [
        part.thing
        for part, fit in tried
        if fit.evidence > top - CHANGE_MARGIN_NATS and part.thing != best.thing
    ]
    return tuple(dict.fromkeys(near))


def _make_change(
    part: ChangePart, fit: ChangeFit, nats: float, alternatives: _Alternatives
) -> Change:
    since = None if np.isinf(part.onset) else part.onset
    names = tuple(name for _, name in alternatives)
    value = fit.unknowns[part.place]
    std = fit.std[part.place]
    return Change(part.kind, part.name, value, std, nats, since, names, part.unit)


def _marker_centres(problem: ChangeProblem, boards: Mapping[str, Board]) -> dict[str, Array]:
    """Each marker's centre (3,) m, in the marker: of
    all corners of a board, else of the points seen.
    """
    points = dict[str, list[Array]]()
    for track in problem.tracks:
        points.setdefault(track.marker, []).append(track.model.marker_point)
    centres = {name: np.mean(seen, axis=0) for name, seen in points.items()}
    whole = {name.rpartition("/")[2]: corners.mean(axis=0) for name, (_, corners) in boards.items()}
    return {name: whole.get(name, centre) for name, centre in centres.items()}


def _add_displacement(
    change: Change, part: ChangePart, found: _Search, centres: Mapping[str, Array]
) -> Change:
    """The change with the displacement of its own centre, and its turn; unchanged for a joint.

    A pose's unknowns turn a marker about the origin of its link, which may be far from it: their
    first three numbers are no displacement of the marker.
    """
    if change.kind == "joint":
        return change
    tracks = found.problem.tracks
    track, place = next(
        (one, place) for one in tracks if (place := one.find_place(part)) is not None
    )
    model = track.model
    value = found.fit.unknowns[place]
    size = len(value)
    centre = np.zeros(3) if change.kind == "camera" else centres[change.name]
    before = model.locate_pose(change.kind, np.zeros(size))
    after = model.locate_pose(change.kind, value)

    def displacement(there: Array) -> Array:
        """How far its centre is from where it was (3,) m, and its turn (3,) rad from `after`."""
        moved = (there - before)[:3, :3] @ centre + (there - before)[:3, 3]
        return np.concatenate([moved, vector_from_rotation(there[:3, :3] @ after[:3, :3].T)])

    slope = np.stack(
        [
            displacement(model.locate_pose(change.kind, value + h))
            - displacement(model.locate_pose(change.kind, value - h))
            for h in _STEP * np.eye(size)
        ],
        axis=1,
    ) / (2.0 * _STEP)
    cov = slope @ found.fit.cov[np.ix_(place, place)] @ slope.T
    turned = vector_from_rotation(after[:3, :3] @ before[:3, :3].T)
    return replace(
        change,
        shift=_vector_length(displacement(after)[:3], cov[:3, :3]),
        turn=_vector_length(turned, cov[3:, 3:]) if size == 6 else None,
        length_unit=model.length_unit,
    )


def _vector_length(vector: Array, cov: Array) -> tuple[float, float]:
    """The length of a vector (3,) with covariance (3,3), and its standard deviation."""
    length = float(np.linalg.norm(vector))
    along = vector / max(length, 1e-12)
    return length, float(along @ cov @ along) ** 0.5
