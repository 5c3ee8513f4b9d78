"""What explains a log: white noise alone, errors that
last, play, and columns beside them, each by its evidence.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations, islice

import numpy as np

from ...linear_algebra import mix_normals
from ...types import Array
from ..faults.threshold import EVIDENCE_THRESHOLD_NATS, PRIOR_STD_RAD, SIGNIFICANT_SIGMA
from ..inference.tangents import OFFSET_STD
from ..measurements.arm_errors import PLAY_STD
from ..measurements.track import camera_of_track
from ..noise.lasting_error import MOST_COUNTS
from .columns import Column, Delay, EncoderShift, Play
from .elimination import compute_column_nats
from .encoder_error import LEAST_STD
from .factor_problem import CHANGE, FactorProblem, Noise
from .gauss_newton import path_from_beliefs, solve_problem
from .load import FIRST_BEND, LoadColumns, bend_under_load, count_groups, refine_loads
from .noise_search import FEWEST_READINGS, FLAT_NATS, Learned, learn_noise
from .timed_columns import list_displaced_images, list_timed_loads, weigh_displacements

FIRST_STD = 1e-3
"""rad: σ of a lasting error with which the search begins."""
DRIFTS_S = 5.0
"""s: errors that last longer can imitate an encoder that drifts, and a load."""
SILENT_STD = 1e-5
"""rad: width of a group of columns whose joint does not bend."""
MOST_BEND = 0.1
"""rad: an arm that bends farther under a load is broken; its images show something else."""
COMPARED_NATS = 0.01
"""Twice what the last step of a search may gain where explanations are compared. With 0.1 a load
wins 38 nats for 32."""
MOST_TIMES = 2
"""Times in which a load is carried that are looked for: each takes a second or two to compare."""
OFFSET = "offset"
"""Name of the column of an encoder that is off all the time."""
DELAY_STD = 0.05
"""s: of what is left of a camera's delay."""


@dataclass(frozen=True)
class RemainingDelay:
    """How much later a camera is than was allowed for:
    seconds ± std, and the nats by which that wins.
    """

    camera: str
    seconds: float
    std: float
    nats: float


@dataclass(frozen=True)
class Explanation:
    """A log explained: its columns, and noise, path and sizes with most evidence.

    white: by white noise alone, without columns · nats: gain over it · lasting: gain by errors
    that last, beside the columns · gains {column: nats} · delays: what is left of each camera's
    with all this accounted for.
    """

    columns: tuple[Column, ...]
    learned: Learned
    white: Learned
    nats: float
    lasting: float
    gains: Mapping[str, float]
    delays: tuple[RemainingDelay, ...] = ()

    @property
    def is_sound(self) -> bool:
        """Whether white noise alone explains the log as well."""
        return self.nats <= _compute_required_gain(self.white.noise)

    @property
    def lasts(self) -> bool:
        """Whether errors that last win over none, beside the columns."""
        return self.lasting > EVIDENCE_THRESHOLD_NATS

    def settle_columns(self, problem: FactorProblem) -> FactorProblem:
        """The problem with these columns, of the sizes that the log gives, with their covariance:
        a filter, too, knows them from the first reading on as it knows the noise.
        """
        sizes = zip(self.columns, self.learned.sizes.tolist(), strict=True)
        about = tuple(replace(one, mean=size) for one, size in sizes)
        return replace(problem, columns=about, settled=self.learned.sizes_cov)


@dataclass(frozen=True)
class _Basis:
    """What explanations of a log begin with: noise that is known before images,
    the encoders' usual step (s), and white noise alone by evidence.
    """

    noise: Noise
    step_s: float
    white: Learned


def find_explanation(
    problem: FactorProblem,
    noise: Noise,
    step_s: float,
    count_variance: Array,
    halves: Array,
    loads: tuple[LoadColumns, ...],
) -> Explanation:
    """The most probable explanation of a log: white noise alone, or errors of its hardware.

    noise: white noise alone, with the offsets that are known · step_s: the encoders' usual step ·
    count_variance (M,) rad²: of readings in whole counts · halves (M,) rad: half of each joint's
    play in the exploration · loads: of which one may be carried, as of `build_load_columns`.
    """
    white = fit_white_noise(problem, noise, step_s)
    sides = [_fit_noise(problem, one, step_s, white) for one in _list_lasting_noises(white.noise)]
    lasting = _choose_most_probable(sides)
    if (
        white.nats - lasting.nats <= _compute_required_gain(noise)
        or _is_of_counts(lasting.noise, count_variance)
        or _is_short(lasting.noise, step_s)
    ):
        return conclude_white_noise(problem, white)
    basis = _Basis(noise, step_s, white)
    problem, lasting, played = _allow_play(problem, basis, halves, sides)
    problem, lasting, displaced = _displace_images(problem, basis, lasting)
    others = played is not None or displaced is not None
    unloaded = (problem, lasting)
    problem, lasting, loaded = _allow_load(problem, basis, loads, lasting, others, halves)
    offset = None
    if loaded is not None or _is_long(lasting.noise):
        off = _find_offset(*unloaded, basis, loaded)
        if off is not None:
            problem, lasting, offset = off
            loaded = None
    each = {"play": played, "displaced": displaced, "load": loaded, "offset": offset}
    gains = {name: gain for name, gain in each.items() if gain is not None}
    found = learn_noise(
        problem, lasting.noise, lasting.path, step_s, rounds=2, curvature=lasting.curvature
    )
    gained = white.nats - found.nats
    plain = replace(white.noise, groups=lasting.noise.groups)
    without = _fit_noise(problem, plain, step_s, lasting).nats if gains else white.nats
    delays = tuple(_measure_remaining_delays(problem, found, step_s))
    if "load" in gains:
        problem, found = _solve_refined_load(problem, found, step_s)
    return Explanation(problem.columns, found, white, gained, without - found.nats, gains, delays)


def _solve_refined_load(
    problem: FactorProblem, found: Learned, step_s: float
) -> tuple[FactorProblem, Learned]:
    """The problem with columns of a load that hold for angles, and its noise and sizes."""
    columns = refine_loads(problem.columns, found.sizes, _find_turning(found.noise))
    refined = replace(problem, columns=columns)
    found = _fit_noise(refined, found.noise, step_s, found, flat=FLAT_NATS)
    return refined, mix_silent_groups(found, columns)


def conclude_white_noise(problem: FactorProblem, white: Learned) -> Explanation:
    """White noise alone as what explains a log."""
    return Explanation(problem.columns, white, white, 0.0, 0.0, {})


def _allow_play(
    problem: FactorProblem, basis: _Basis, halves: Array, sides: Sequence[Learned]
) -> tuple[FactorProblem, Learned, float | None]:
    """The problem and its noise with play where the log shows it, and the nats that it wins.

    sides: noise without play, with errors that last at encoders and at links.
    """
    lasting = _choose_most_probable(sides)
    turning = _find_turning(basis.noise)
    play = tuple(one for one in _list_plays(halves) if turning[one.joint])
    late = tuple(Delay("delay", DELAY_STD, camera=name) for name in _list_cameras(problem))
    loose = problem.with_columns(play)
    # a delay that was corrected for play hides the play: both are free where they are compared
    free = loose.with_columns(late)
    each = [_fit_noise(free, one.noise, basis.step_s, one) for one in sides]
    loosely = _choose_most_probable(each)
    least = -EVIDENCE_THRESHOLD_NATS if halves.any() else EVIDENCE_THRESHOLD_NATS
    if lasting.nats - loosely.nats <= least:
        return problem, lasting, None
    beside = _fit_noise(problem.with_columns(late), lasting.noise, basis.step_s, lasting)
    gain = min(lasting.nats, beside.nats) - loosely.nats
    if gain <= least:
        return problem, lasting, None
    return loose, _fit_noise(loose, loosely.noise, basis.step_s, loosely), gain


def _displace_images(
    problem: FactorProblem, basis: _Basis, before: Learned
) -> tuple[FactorProblem, Learned, float | None]:
    """The problem and its noise with the windows of time in which a camera's images are displaced,
    one after the other while they win EVIDENCE_THRESHOLD_NATS, and the nats that all win.

    Such windows are looked for by errors that last, too, which stand for part of what a
    displacement shows.
    """
    total = None
    while True:
        known = ((basis.noise, basis.white.path), (before.noise, before.path))
        tried = list(chain(*(list_displaced_images(problem, *one) for one in known)))
        each = [shifts for shifts, _ in tried]
        won = weigh_displacements(problem, before.noise, before.path, each)
        gains = [one - cost for one, (_, cost) in zip(won, tried, strict=True)]
        if max(gains, default=0.0) <= EVIDENCE_THRESHOLD_NATS:
            return problem, before, total
        shifts, cost = tried[int(np.argmax(gains))]
        more = problem.with_columns(shifts)
        after = _fit_noise(more, before.noise, basis.step_s, before)
        gain = before.nats - after.nats - cost
        if gain <= EVIDENCE_THRESHOLD_NATS:
            return problem, before, total
        total = gain if total is None else total + gain
        problem = more
        before = after


def _allow_load(
    problem: FactorProblem,
    basis: _Basis,
    loads: tuple[LoadColumns, ...],
    before: Learned,
    others: bool,
    halves: Array,
) -> tuple[FactorProblem, Learned, float | None]:
    """The problem and its noise with a load where the log shows one, and the nats that it wins.

    A load stands for none of the noise that is known before images, and for no play that the
    exploration had · others: whether play or displaced images explain part of the log.
    """
    if not loads:
        return problem, before, None
    each = (list_timed_loads(problem, basis.noise, basis.white.path, one) for one in loads)
    timed = chain(*(islice(one, 1 + MOST_TIMES) for one in each))
    sides = _list_lasting_noises(basis.white.noise)
    own, other = sides[::-1] if before.noise.joints.at_link.any() else sides
    tried = ((_learn_load(problem, basis, one, before, own), one, cost) for one, cost in timed)
    bent, load, cost = min(tried, key=lambda one: one[0].nats + one[2])
    # which load it is does not depend on where errors last
    bent = _choose_most_probable([bent, _learn_load(problem, basis, load, before, other)])
    # each of the loads is as likely before the log
    cost += float(np.log(len(loads)))
    # noise that is found beside a load may explain the log without it, too
    alone = replace(bent.noise, groups=before.noise.groups)
    before = _choose_most_probable([before, _fit_noise(problem, alone, basis.step_s, before)])
    gain = before.nats - bent.nats - cost
    # what lasts long and is gone beside a load stood for it: neither is simpler; play leaves none
    rival = not others and _is_long(before.noise) and not _is_long(bent.noise)
    bends = bend_under_load(load, bent.sizes[-len(load) :], bent.path.knots, bent.path.angles)
    least = 0.0 if rival else EVIDENCE_THRESHOLD_NATS
    replaces = _replaces_play(problem, before, bent, halves)
    if gain <= least or replaces or np.abs(bends).max() > MOST_BEND:
        return problem, before, None
    return problem.with_columns(load), bent, gain


def _find_offset(
    problem: FactorProblem, before: Learned, basis: _Basis, loaded: float | None
) -> tuple[FactorProblem, Learned, float] | None:
    """The problem and its noise with one encoder that is off all the time, and the nats that it
    wins, where these are more than the `loaded` ones of a load, if there is one; None where no
    encoder is off.

    Of 18 drawn logs with loads of up to 1°, an offset wins 3 nats at most, and the load 4 to 54; of
    4 in which an encoder is off by 1.1°, it wins 22 to 58, and up to 10 more than a load.
    """
    best = None
    for joint in np.flatnonzero(_find_turning(basis.noise)).tolist():
        shifted = problem.with_columns([EncoderShift(OFFSET, PRIOR_STD_RAD, joint=joint)])
        each = _list_lasting_noises(basis.white.noise)
        found = _choose_most_probable(
            [_fit_noise(shifted, one, basis.step_s, before) for one in each]
        )
        if best is None or found.nats < best[1].nats:
            best = (shifted, found)
    if best is None or abs(best[1].sizes[-1]) < OFFSET_STD:
        return None
    gain = before.nats - best[1].nats
    # what lasts long and is gone beside an offset stood for it, as it may for a load
    rival = loaded is None and _is_long(before.noise) and not _is_long(best[1].noise)
    least = 0.0 if rival else max(loaded or 0.0, EVIDENCE_THRESHOLD_NATS)
    return (*best, gain) if gain > least else None


def _replaces_play(problem: FactorProblem, before: Learned, bent: Learned, halves: Array) -> bool:
    """Whether some joint's play is evidently less beside a load than without it, and than half of
    it was in the exploration: a load that comes and goes with the play stands for it.
    """
    stds = [np.sqrt(np.diag(one.sizes_cov)) for one in (before, bent)]
    return any(
        min(before.sizes[k], halves[one.joint]) - bent.sizes[k]
        > SIGNIFICANT_SIGMA * np.hypot(stds[0][k], stds[1][k])
        for k, one in enumerate(problem.columns)
        if isinstance(one, Play)
    )


def _learn_load(
    problem: FactorProblem, basis: _Basis, load: LoadColumns, before: Learned, lasting: Noise
) -> Learned:
    """The noise beside a load by evidence, from noise with errors that last."""
    noise = replace(lasting, groups=(FIRST_BEND,) * count_groups(load))
    return _fit_noise(problem.with_columns(load), noise, basis.step_s, before)


def _list_plays(halves: Array) -> Iterator[Play]:
    """Yield each joint's play: as in the exploration, which had halves (M,) rad, to about half of
    its size.
    """
    for j, half in enumerate(halves.tolist()):
        yield Play("play", CHANGE * half if half > 0.0 else PLAY_STD, half, joint=j)


def fit_white_noise(problem: FactorProblem, noise: Noise, step_s: float) -> Learned:
    """White noise alone by the evidence of a log; arguments as of `find_explanation`."""
    return _fit_noise(problem, noise, step_s, rounds=2, flat=FLAT_NATS)


def mix_silent_groups(found: Learned, columns: Sequence[Column]) -> Learned:
    """The columns' sizes as a mixture: each group of columns, or all but one or two of them,
    each as probable before the log.

    The most probable width of a group is never none. So a joint that does not bend would bend a
    little, and where images hardly tell joints apart it would take that from another.
    """
    groups = found.noise.groups
    means = np.array([column.mean for column in columns])
    most = min(2, len(groups) - 1)
    sets = [one for count in range(most + 1) for one in combinations(range(len(groups)), count)]
    nats = np.empty(len(sets))
    sizes = np.empty((len(sets), len(columns)))
    covs = np.empty((len(sets), len(columns), len(columns)))
    for k, silent in enumerate(sets):
        left = tuple(SILENT_STD if g in silent else std for g, std in enumerate(groups))
        precision = replace(found.noise, groups=left).list_column_stds(columns) ** -2.0
        nats[k] = compute_column_nats(found.schur[None], precision)[0]
        covs[k] = np.linalg.inv(found.schur[1:, 1:] + np.diag(precision))
        sizes[k] = means + covs[k] @ found.schur[1:, 0]
    weights = np.exp(nats.min() - nats)
    weights /= weights.sum()
    mean, cov = mix_normals(weights, sizes, covs)
    return replace(found, sizes=mean, sizes_cov=cov)


def _measure_remaining_delays(
    problem: FactorProblem, found: Learned, step_s: float
) -> Iterator[RemainingDelay]:
    """Yield each camera's delay that is left beside what explains the log."""
    for name in _list_cameras(problem):
        late = Delay("delay", DELAY_STD, camera=name)
        delayed = _fit_noise(problem.with_columns([late]), found.noise, step_s, found)
        std = float(np.sqrt(delayed.sizes_cov[-1, -1]))
        yield RemainingDelay(name, float(delayed.sizes[-1]), std, found.nats - delayed.nats)


def _find_turning(noise: Noise) -> Array:
    """Which joints (M,) bool turn in the log."""
    return np.ones(len(noise.joints.white), bool) if noise.resting is None else ~noise.resting


def _list_cameras(problem: FactorProblem) -> tuple[str, ...]:
    """Names of the cameras whose images there are."""
    return tuple(
        dict.fromkeys(camera_of_track(one.name) for one in problem.sightings if one.name != "touch")
    )


def _is_of_counts(noise: Noise, count_variance: Array) -> bool:
    """Whether what lasts is no more than whole counts make, which white noise has already."""
    joints = noise.joints
    small = joints.error_variance < MOST_COUNTS * count_variance
    return bool(small[joints.learned].all())


def _is_short(noise: Noise, step_s: float) -> bool:
    """Whether what lasts is gone within a few readings: stamps
    that jitter make such errors, and readings hold them.
    """
    joints = noise.joints
    return bool((joints.seconds[joints.learned] < 2.0 * FEWEST_READINGS * step_s).all())


def _is_long(noise: Noise) -> bool:
    """Whether what lasts can imitate a load, or an encoder that drifts."""
    joints = noise.joints
    return bool((joints.seconds[joints.learned] >= DRIFTS_S).any())


def _compute_required_gain(noise: Noise) -> float:
    """Nats that errors which last must win over white noise: those of the exploration are there
    unless the log says otherwise.
    """
    return -EVIDENCE_THRESHOLD_NATS if noise.prior.known else EVIDENCE_THRESHOLD_NATS


def _choose_most_probable(found: Sequence[Learned]) -> Learned:
    """The noise with most evidence."""
    return min(found, key=lambda one: one.nats)


def add_lasting_errors(noise: Noise, std: float) -> Noise:
    """The noise with errors of `std` rad that last at all encoders
    but those whose offset was found, and those of joints that rest.
    """
    joints = noise.joints
    given = np.zeros(len(joints.white)) if joints.error is None else joints.error
    learned = given <= LEAST_STD
    if noise.resting is not None:
        learned &= ~noise.resting
    error = np.where(learned, std, given)
    seconds = np.where(learned, np.exp(noise.prior.seconds[0]), joints.seconds)
    return replace(noise, joints=replace(joints, error=error, seconds=seconds, learned=learned))


def _list_lasting_noises(noise: Noise) -> tuple[Noise, Noise]:
    """The noise with errors that last, at the encoders and at the links."""
    std = np.exp(noise.prior.error[0]) if noise.prior.known else FIRST_STD
    own = add_lasting_errors(noise, std)
    at_link = replace(own.joints, at_link=own.joints.learned)
    return own, replace(own, joints=at_link)


def _fit_noise(
    problem: FactorProblem,
    noise: Noise,
    step_s: float,
    before: Learned | None = None,
    rounds: int = 1,
    flat: float = COMPARED_NATS,
) -> Learned:
    """Noise by evidence, from the path that this noise gives; one round is enough to compare.

    before: what was learned of a like problem, with whose path and curvature this begins · flat:
    as `learn_noise` takes it.
    """
    solution = solve_problem(problem, noise, None if before is None else before.path, rounds=4)
    path = path_from_beliefs(problem, noise, solution.beliefs)
    curvature = {} if before is None else before.curvature
    return learn_noise(problem, noise, path, step_s, rounds, curvature, flat)
