"""Linear system of sightings in the changes, with the body's uncertainty marginalised."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate, pairwise

import numpy as np

from ...errors import ModelError
from ...types import Array
from ..data.pairs import Pairs
from ..gp.model import GP
from ..gp.posed_gp import PosedGP

_TURNS = 4
_OUTLYING = 5.0
_OFF_SIGMA = 3.0


@dataclass(frozen=True)
class ChangePart:
    """A group of unknowns: a joint's zero from its onset (s) on, a camera's pose, a marker's place,
    or the sag of all joints under a weight at a hand, which is one of those that the arm may hold.
    """

    kind: str
    name: str
    place: slice
    onset: float = -np.inf
    unit: str = "rad"
    hand: int = 0

    @property
    def thing(self) -> tuple[str, str]:
        """Kind and name of what it belongs to."""
        return self.kind, self.name

    @property
    def is_pose(self) -> bool:
        """Whether it is of a camera or a marker."""
        return self.kind in ("camera", "marker")


@dataclass(frozen=True, eq=False)
class Sinking:
    """Levers of what sinks under a pull at a hand, in shares of the longest: of joints and links
    (n,M,K) along each of K directions, and of R joints that stood still in the exploration
    (n,R,K), which images show (n,D,R) per rad.

    The unknowns (K+2M+R,) are the pull along each direction, rad at the longest lever, by how much
    more each joint gives way than that, how much each link does, and by how much more each joint
    that stood still.
    """

    joints: Array
    links: Array
    still: Array
    shown: Array

    def bend_joints(self, rows: Array, unknowns: Array) -> tuple[Array, Array]:
        """How far joints bend (n,M) rad in some rows, and the derivatives (n,M,K+2M+R)."""
        pull, by_joint, by_link, by_still = self._split_unknowns(unknowns)
        joints = self.joints[rows]
        links = self.links[rows]
        share = 1.0 + by_joint
        each = np.eye(len(share))
        columns = (
            joints * share[:, None] + links * by_link[:, None],
            (joints @ pull)[..., None] * each,
            (links @ pull)[..., None] * each,
            np.zeros((*joints.shape[:2], len(by_still))),
        )
        bends = (joints @ pull) * share + (links @ pull) * by_link
        return -bends, -np.concatenate(columns, axis=2)

    def show_still_joints(self, rows: Array, unknowns: Array) -> tuple[Array, Array]:
        """What images show beside that (n,D) in some rows, and the derivatives (n,D,K+2M+R)."""
        pull, by_joint, by_link, by_still = self._split_unknowns(unknowns)
        still = self.still[rows]
        shown = self.shown[rows]
        share = 1.0 + by_still
        sunk = shown * (still @ pull)[:, None]
        nothing = np.zeros((*shown.shape[:2], len(by_joint) + len(by_link)))
        columns = ((shown * share) @ still, nothing, sunk)
        return -(sunk @ share), -np.concatenate(columns, axis=2)

    def _split_unknowns(self, unknowns: Array) -> list[Array]:
        _, count, ways = self.joints.shape
        return np.split(unknowns, [ways, ways + count, ways + 2 * count])


@dataclass(frozen=True, eq=False)
class ChangeTrack:
    """Sightings of one track, the correlation of their angles' errors, and the forward model.

    sinkings: under a pull at each hand that the arm may hold.
    camera, marker: their names · scale: tracks of one camera with the same number have the same
    unit of length · first: the first of its directions of unknowns among those of all tracks.
    """

    name: str
    model: PosedGP
    part: Pairs
    coupling: tuple[Array, Array, Array, Array]
    camera: str
    marker: str
    scale: int = 0
    first: int = 0
    sinkings: tuple[Sinking, ...] = ()

    @property
    def unknown_directions(self) -> slice:
        """Its directions of unknowns among those of all tracks."""
        return slice(self.first, self.first + self.model.root.shape[1])

    def find_place(self, part: ChangePart) -> Array | None:
        """Where (K,) the motion of this track's own camera or marker is among all changes; None
        where the part is of others.

        A camera's further displacements, behind its first and its turn, are in other units.
        """
        own = {"camera": self.camera, "marker": self.marker}.get(part.kind)
        if own != part.name:
            return None
        place = np.arange(part.place.start, part.place.stop)
        if part.kind == "marker":
            return place
        begin = 3 * (self.scale + 1) if self.scale else 0
        return np.concatenate([place[begin : begin + 3], place[3:6]])


@dataclass(frozen=True, eq=False)
class ChangeProblem:
    """Joints, tracks, the unknowns' parts with their prior std
    (P,), onsets (S,) s; rows in use, factor on the noise.
    """

    joints: tuple[str, ...]
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
) -> dict[str, PosedGP]:
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
    posed = [place for part, place in zip(parts, places, strict=True) if part.is_pose]
    moved = {}
    for number, track in enumerate(problem.tracks):
        own = np.arange(about.before)[track.unknown_directions]
        kept = np.isin(rows, np.concatenate([own, *posed]))
        spread = np.linalg.cholesky(cov[np.ix_(kept, kept)])
        poses = rows[kept][len(own) :] - about.before
        unknowns = np.zeros(len(problem.std))
        unknowns[poses] = problem.std[poses] * mean[kept][len(own) :]
        model = track.model.move_unknowns(track.model.root @ mean[own])
        model, columns = _move_poses(problem, replace(track, model=model), unknowns)
        columns = columns[:, poses] * problem.std[poses]
        drift = mean[directions + ends[number] : directions + ends[number + 1]]
        moved[track.name] = _condition_on_log(model, columns, mean[own], spread, drift)
    return moved


def _move_poses(
    problem: ChangeProblem, track: ChangeTrack, unknowns: Array
) -> tuple[PosedGP, Array]:
    """A track's model with its camera and marker moved as in u (P,), and the derivatives (·,P) of
    its own unknowns by u.
    """
    camera = np.zeros(6)
    marker = np.zeros(track.model.marker_freedom)
    own = [(part, place) for part in problem.parts if (place := track.find_place(part)) is not None]
    for part, place in own:
        (camera if part.kind == "camera" else marker)[:] += unknowns[place]
    moved, by_camera, by_marker = track.model.move_poses(camera, marker)
    columns = np.zeros((len(by_camera), len(unknowns)))
    for part, place in own:
        columns[:, place] = by_camera if part.kind == "camera" else by_marker
    return moved, columns


def _condition_on_log(
    model: PosedGP, columns: Array, known: Array, spread: Array, drift: Array
) -> PosedGP:
    """The model given a log: the mean of its directions is known (Q,), changes have columns (·,K),
    both have this spread (Q+K,Q+K), and the log has its own drift (D,).
    """
    return replace(
        model,
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
    directions = max(track.unknown_directions.stop for track in problem.tracks)
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
            columns[:, track.unknown_directions] = unknown[:, d]
            columns[:, directions + ends[number] + d] = np.sqrt(track.model.drift[d])
            columns[:, before:] = by_unknowns[:, d] * problem.std
            cov = problem.scale * _output_covariance(track, kept, slope[:, d], d, like)
            try:
                chol = np.linalg.cholesky(cov)
            except np.linalg.LinAlgError:
                text = f"field {track.name}: its noise is no covariance; fit the body again"
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
    rows = place[i]
    columns = place[j]
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
    part = track.part
    t = part.t[kept]
    shift = np.zeros((len(kept), part.x.shape[1]))
    sunk = np.zeros((len(kept), len(track.model.outputs)))
    for one in problem.parts:
        value = unknowns[one.place]
        if one.kind == "joint":
            shift[:, problem.joints.index(one.name)] += (t >= one.onset) * value[0]
        elif one.kind == "load":
            sinking = track.sinkings[one.hand]
            shift += sinking.bend_joints(kept, value)[0]
            sunk += sinking.show_still_joints(kept, value)[0]
    x = part.x[kept] + shift
    moved, columns = _move_poses(problem, track, unknowns)
    value, slope = moved.means(x)
    by = moved.design(x) @ columns
    for one in problem.parts:
        if one.kind == "joint":
            active = (t >= one.onset)[:, None]
            by[..., one.place] = (slope[..., problem.joints.index(one.name)] * active)[..., None]
        elif one.kind == "load":
            sinking = track.sinkings[one.hand]
            bends = sinking.bend_joints(kept, unknowns[one.place])[1]
            shows = sinking.show_still_joints(kept, unknowns[one.place])[1]
            by[..., one.place] = slope @ bends + shows
    return part.y[kept] - value - sunk, by, moved.unknowns(x), slope, x
