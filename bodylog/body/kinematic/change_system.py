"""Linear system of sightings in the changes, with the body's uncertainty marginalised."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate, pairwise

import numpy as np

from ...errors import ModelError
from ...types import Array
from ..data.pairs import Pairs
from ..gp.model import GP
from .model import KinematicGP

_TURNS = 4
_OUTLYING = 5.0
_OFF_SIGMA = 3.0


@dataclass(frozen=True)
class ChangePart:
    """A group of unknowns: a joint's zero from its onset (s) on, a camera's pose, a marker's place,
    or the sag of all joints under a weight at the hand, after them of those that stood still.
    """

    kind: str
    name: str
    place: slice
    onset: float = -np.inf
    unit: str = "rad"

    @property
    def thing(self) -> tuple[str, str]:
        """Kind and name of what it belongs to."""
        return self.kind, self.name

    @property
    def is_pose(self) -> bool:
        """Whether it is of a camera or a marker."""
        return self.kind in ("camera", "marker")


@dataclass(frozen=True, eq=False)
class ChangeTrack:
    """Sightings of one track, the correlation of their angles' errors, and the forward model.

    sinking: what the largest sag of each joint, as its lever over the longest of all, is at each
    sighting (n,M) rad, and what images show of that of joints that stood still (n,D,R) px.
    """

    name: str
    model: KinematicGP
    part: Pairs
    coupling: tuple[Array, Array, Array, Array]
    sinking: tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class ChangeProblem:
    """Tracks, the unknowns' parts with their prior std
    (P,), onsets (S,) s; rows in use, factor on the noise.
    """

    tracks: tuple[ChangeTrack, ...]
    parts: tuple[ChangePart, ...]
    std: Array
    onsets: tuple[float, ...]
    kept: tuple[Array, ...]
    scale: float = 1.0


@dataclass(frozen=True, eq=False)
class System:
    """About unknowns u: information (Q,Q) and pull (Q,) of z and
    drifts (`before` of them) and u in deviations · rest, nats.

    rows: residuals, columns and standard deviation of each track and output, and both whitened.
    """

    information: Array
    pull: Array
    rest: float
    before: int
    rows: list[tuple[Array, Array, Array, Array, Array]] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class ChangeFit:
    """Most likely unknowns u (P,) of some parts,
    their covariance (P,P), and the evidence in nats.
    """

    unknowns: Array
    cov: Array
    evidence: float

    @property
    def std(self) -> Array:
        """Standard deviations (P,) of the unknowns."""
        return np.asarray(np.sqrt(np.diag(self.cov)))


def drop_unexplained_sightings(problem: ChangeProblem) -> ChangeProblem:
    """Drop sightings that no change explains, and scale
    the noise to the residuals of all changes together.
    """
    every = problem.parts
    for _ in range(2 * _TURNS):
        unknowns = fit_parts(problem, every).unknowns
        about = linearise_sightings(problem, unknowns)
        at = solve_system(about, np.arange(len(about.pull)))[0]
        left = [np.abs(rest - columns @ at) / std for rest, columns, std, _, _ in about.rows]
        white = np.concatenate(
            [w_rest - w_columns @ at for _, _, _, w_rest, w_columns in about.rows]
        )
        free = float(
            np.trace(np.linalg.solve(about.information + np.eye(len(at)), about.information))
        )
        freedom = max(len(white) - free, 0.2 * len(white))
        scale = (float(np.median(np.abs(white))) / 0.6745) ** 2 * len(white) / freedom
        worst = [np.max(own, axis=0) for own in _by_track(problem, left)]
        sound = [size < _OUTLYING * max(1.0, scale) ** 0.5 for size in worst]
        kept = tuple(rows[good] for rows, good in zip(problem.kept, sound, strict=True))
        whole = all(good.all() for good in sound)
        before = problem.scale
        after = max(1.0, problem.scale * scale) if whole else 1.0
        problem = replace(problem, kept=kept, scale=after)
        if whole and after < 1.2 * before:
            break
    return problem


def fit_parts(
    problem: ChangeProblem, parts: Sequence[ChangePart], begin: Array | None = None
) -> ChangeFit:
    """Fit the unknowns of some parts, all others zero, by Gauss-Newton."""
    chosen = np.zeros(len(problem.std), bool)
    for part in parts:
        chosen[part.place] = True
    unknowns = np.where(chosen, 0.0 if begin is None else begin, 0.0)
    for _ in range(_TURNS if chosen.any() else 1):
        about = linearise_sightings(problem, unknowns)
        rows = np.append(np.arange(about.before), about.before + np.flatnonzero(chosen))
        at, covariance, evidence = solve_system(about, rows)
        step = np.zeros(len(problem.std))
        step[chosen] = at[about.before :] * problem.std[chosen] - unknowns[chosen]
        unknowns = unknowns + step
        scales = problem.std[chosen]
        cov = np.zeros((len(problem.std), len(problem.std)))
        cov[np.ix_(chosen, chosen)] = covariance[about.before :, about.before :] * np.outer(
            scales, scales
        )
        if (np.abs(step[chosen]) <= 0.02 * np.sqrt(np.diag(cov)[chosen])).all():
            break
    return ChangeFit(unknowns, cov, evidence)


def move_models(
    problem: ChangeProblem, parts: Sequence[ChangePart], fit: ChangeFit
) -> dict[str, KinematicGP]:
    """The tracks' models with cameras and markers where they are now, by a fit of these parts.

    What was learned of z and u, the body's unknowns and the changes, is their posterior given the
    log, with its drifts and joints' zeros marginalised: z and u are mean + spread w, w ~ N(0, I).
    """
    about = linearise_sightings(problem, fit.unknowns)
    ends = _output_ends(problem)
    directions = about.before - ends[-1]
    places = [about.before + np.arange(len(problem.std))[part.place] for part in parts]
    rows = np.concatenate([np.arange(about.before), *places])
    mean, cov, _ = solve_system(about, rows)
    posed = [part for part in parts if part.is_pose]
    own = [place for part, place in zip(parts, places, strict=True) if part.is_pose]
    kept = np.isin(rows, np.concatenate([np.arange(directions), *own]))
    spread = np.linalg.cholesky(cov[np.ix_(kept, kept)])
    moved = {}
    for number, track in enumerate(problem.tracks):
        columns = _columns_of_changes(problem, track.model, posed)
        drift = mean[directions + ends[number] : directions + ends[number + 1]]
        moved[track.name] = _move_model(track.model, columns, mean[kept], spread, drift)
    return moved


def _columns_of_changes(
    problem: ChangeProblem, model: KinematicGP, posed: Sequence[ChangePart]
) -> Array:
    """What each standard deviation of changes of cameras and markers is in the model's θ (P,·)."""
    columns = [np.zeros((len(model.theta), 0))]
    for part in posed:
        std = problem.std[part.place]
        own = np.zeros((len(model.theta), len(std)))
        if (place := _find_changed_unknowns(model, part)) is not None:
            own[place] = np.diag(std)
        columns.append(own)
    return np.concatenate(columns, axis=1)


def _find_changed_unknowns(model: KinematicGP, part: ChangePart) -> slice | None:
    """The place in the model's θ of what a part changes; None where it is not of this model."""
    thing = model.rig.cameras[0] if part.kind == "camera" else model.rig.carriers[0]
    if not part.is_pose or thing.name != part.name:
        return None
    whole = model.rig.of_camera(0) if part.kind == "camera" else model.rig.of_carrier(0)
    return slice(whole.start, whole.start + part.place.stop - part.place.start)


def _move_model(
    model: KinematicGP, columns: Array, mean: Array, spread: Array, drift: Array
) -> KinematicGP:
    """The model with the mean (Q,) and spread (Q,Q) of its directions and of changes, columns (P,·)
    of θ, and its drift (D,) in this log.
    """
    known = mean[: model.root.shape[1]]
    shift = columns @ mean[len(known) :]
    return replace(
        model,
        theta=model.theta + model.root @ known + shift,
        printed=model.printed + shift,
        mean=model.mean + np.sqrt(model.drift) * drift,
        weights=model.weights - np.einsum("dpn,p->dn", model.lean, known),
        root=np.concatenate([model.root, columns], axis=1) @ spread,
        lean=np.einsum("dpn,pq->dqn", model.lean, spread[: len(known)]),
    )


def outlier_share(problem: ChangeProblem, parts: Sequence[ChangePart]) -> float:
    """The share of sightings more than 3 standard deviations
    off where some parts have their likeliest values.
    """
    unknowns = fit_parts(problem, parts).unknowns
    about = linearise_sightings(problem, unknowns)
    chosen = np.isin(np.arange(len(about.pull)), np.arange(about.before))
    for part in parts:
        chosen[about.before + part.place.start : about.before + part.place.stop] = True
    at = np.zeros(len(about.pull))
    at[chosen] = solve_system(about, np.flatnonzero(chosen))[0]
    off = [
        np.abs(rest - columns @ at) > _OFF_SIGMA * std for rest, columns, std, _, _ in about.rows
    ]
    either = [np.any(own, axis=0) for own in _by_track(problem, off)]
    return float(np.concatenate(either).mean())


def _by_track(problem: ChangeProblem, rows: Sequence[Array]) -> list[Sequence[Array]]:
    """The rows (n,) of all outputs, by track."""
    ends = _output_ends(problem)
    return [rows[begin:end] for begin, end in pairwise(ends)]


def _output_ends(problem: ChangeProblem) -> list[int]:
    """Where each track's outputs begin among those of all tracks, and where the last ones end."""
    return [0, *accumulate(len(track.model.outputs) for track in problem.tracks)]


def linear_evidence(about: System, problem: ChangeProblem, parts: Sequence[ChangePart]) -> float:
    """Evidence (nats) of some parts, all others zero, at the present linearisation."""
    chosen = np.zeros(len(problem.std), bool)
    for part in parts:
        chosen[part.place] = True
    return solve_system(
        about, np.append(np.arange(about.before), about.before + np.flatnonzero(chosen))
    )[2]


def solve_system(about: System, rows: Array) -> tuple[Array, Array, float]:
    """Mean, covariance, in prior deviations, of some unknowns, and the evidence in nats."""
    matrix = about.information[np.ix_(rows, rows)] + np.eye(len(rows))
    covariance = np.linalg.inv(matrix)
    mean = covariance @ about.pull[rows]
    logdet = float(np.linalg.slogdet(matrix)[1])
    return mean, covariance, about.rest + 0.5 * float(mean @ about.pull[rows]) - 0.5 * logdet


def linearise_sightings(problem: ChangeProblem, unknowns: Array) -> System:
    """Linearise all sightings about some unknowns u (P,)."""
    directions = problem.tracks[0].model.root.shape[1]
    ends = _output_ends(problem)
    drifts = ends[-1]
    before = directions + drifts
    size = before + len(unknowns)
    information = np.zeros((size, size))
    pull = np.zeros(size)
    rest = 0.0
    rows = []
    for number, (track, kept) in enumerate(zip(problem.tracks, problem.kept, strict=True)):
        left, by_unknowns, unknown, slope, x = _linearise_track(problem, track, unknowns, kept)
        like = GP.covariance(track.model, x)[0]
        for d in range(ends[number + 1] - ends[number]):
            columns = np.zeros((len(kept), size))
            columns[:, :directions] = unknown[:, d]
            columns[:, directions + ends[number] + d] = np.sqrt(track.model.drift[d])
            columns[:, before:] = by_unknowns[:, d] * problem.std
            cov = problem.scale * _output_covariance(track, kept, slope[:, d], d, like)
            try:
                chol = np.linalg.cholesky(cov)
            except np.linalg.LinAlgError:
                text = (
                    f"field {track.model.rig.sights[0].name}: its noise is no covariance; fit "
                    "the body again"
                )
                raise ModelError(text) from None
            total = left[:, d] + by_unknowns[:, d] @ unknowns
            white = np.linalg.solve(chol, np.column_stack([total, columns]))
            information += white[:, 1:].T @ white[:, 1:]
            pull += white[:, 1:].T @ white[:, 0]
            rest -= 0.5 * float(white[:, 0] @ white[:, 0]) + float(np.log(np.diag(chol)).sum())
            rows.append((total, columns, np.sqrt(np.diag(cov)), white[:, 0], white[:, 1:]))
    return System(information, pull, rest, before, rows)


def _output_covariance(
    track: ChangeTrack, kept: Array, slope: Array, output: int, like: Array
) -> Array:
    """Covariance (n,n) px² of one output's sightings: residual
    process, their own noise, and that of their angles.
    """
    model = track.model
    part = track.part
    cov = like * model.share[output]
    own = (
        part.floor[kept, output]
        + model.noise[output]
        + (np.square(slope) * part.variance[kept]).sum(axis=1)
    )
    cov[np.diag_indices(len(kept))] += np.maximum(own, 1e-6)
    place = np.full(len(part.x), -1)
    place[kept] = np.arange(len(kept))
    i, j, m, value = track.coupling
    rows, columns = place[i], place[j]
    both = (rows >= 0) & (columns >= 0)
    rows = rows[both]
    columns = columns[both]
    m = m[both]
    value = value[both]
    add = slope[rows, m] * slope[columns, m] * value
    np.add.at(cov, (rows, columns), add)
    np.add.at(cov, (columns, rows), add)
    return np.asarray(cov)


def _linearise_track(
    problem: ChangeProblem, track: ChangeTrack, unknowns: Array, kept: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """About u (P,): residuals (n,D), derivatives by u
    (n,D,P) and z (n,D,p), slopes (n,D,M), and angles x (n,M).
    """
    model = track.model
    part = track.part
    t = part.t[kept]
    shift = np.zeros((len(kept), part.x.shape[1]))
    sinks = track.sinking[0][kept]
    shown = track.sinking[1][kept]
    sunk = np.zeros(shown.shape[:2])
    theta = model.theta.copy()
    for one in problem.parts:
        value = unknowns[one.place]
        if one.kind == "joint":
            shift[:, model.rig.joints.index(one.name)] += (t >= one.onset) * value[0]
        elif one.kind == "load":
            shift += sinks * value[: sinks.shape[1]]
            sunk += shown @ value[sinks.shape[1] :]
        elif (place := _find_changed_unknowns(model, one)) is not None:
            theta[place] += value
    x = part.x[kept] + shift
    moved = replace(model, theta=theta)
    value, slope = moved.means(x)
    design = moved.design(x)
    unknown = moved.unknowns(x)
    by = np.zeros((*value.shape, len(unknowns)))
    for one in problem.parts:
        if one.kind == "joint":
            active = (t >= one.onset)[:, None]
            by[..., one.place] = (slope[..., model.rig.joints.index(one.name)] * active)[..., None]
        elif one.kind == "load":
            by[..., one.place] = np.concatenate([slope * sinks[:, None], shown], axis=2)
        elif (place := _find_changed_unknowns(model, one)) is not None:
            by[..., one.place] = design[..., place]
    return part.y[kept] - value - sunk, by, unknown, slope, x
