"""Where no URDF is used: the axes of the joints as each track's mean, found from what it shows, and
a Gaussian process on the residuals.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import lgamma

import numpy as np

from ...kinematics.axis_chain import AxisChain
from ...kinematics.axis_search import AxisSightings, find_axes
from ...kinematics.camera import lens_without_distortion
from ...kinematics.links import FREE_LENS, scale_lens_std
from ...runtime.blas_threads import one_thread
from ...settings import Settings
from ...sources import group_of
from ...types import Array, Features, Finding, Score
from .. import exploration_report
from ..data.pairs import Pairs, correlate_angle_errors
from ..data.subsampling import choose_spaced_rows
from ..gp.axis_gp import AxisGP
from ..gp.fit import Coupling, Samples
from ..gp.inducing import build_basis, choose_inducing_points
from ..gp.marginal_likelihood import Hyper, Spread, cholesky_with_jitter
from ..gp.model import GP, drop_negligible_rows, se_kernel
from ..learning import LearnedBody
from ..noise_estimates import replace_sense_noise
from .explicit import (
    ResidualRows,
    condense_posterior,
    hold_out_blocks,
    posterior_of_unknowns,
    search_residual_kernel,
    solve_linear_unknowns,
)
from .lasting import fit_slow_error
from .residuals import MOST, RESIDUAL, build_residual_process, spread_of
from .scores import evidence_of_gp_alone

MOST_JOINTS = 8
"""Most joints whose axes are looked for: the orders to try grow by their square."""
MOST_TRIES = 2
"""Tracks of a camera without axes, after which others of it are not tried: a search in vain takes
4 s for three joints and 27 s for seven.
"""
LEAST_OWN_RAD = 0.003
"""Least std of each joint's own motion, beside what it moves in line with the others. Of drawn
arms with 0.003 rad and more error bars held, and with 0.001 rad errors were up to 2.4 times those.
"""
_ROUNDS = 4
_SETTLED = 0.01
"""Posterior standard deviations of a step of the unknowns that ends the iteration."""


@dataclass(frozen=True, eq=False)
class _FoundAxes:
    """A track's model, the nats that it wins over a Gaussian process alone, its known noise
    (px² or mm²) beside that of the model, and what it is scored by.
    """

    model: AxisGP
    gain: float
    floor: Array
    scores: tuple[Score, ...]


@one_thread("scipy.linalg")
def learn_axes(found: LearnedBody, features: Sequence[Features], settings: Settings) -> LearnedBody:
    """The body with found axes as the mean of each track that is likelier with them."""
    if settings.fit.preset == "paper" or len(found.model.joints) > MOST_JOINTS:
        return found
    size = next((one.picture_size for one in features if one.picture_size), None)
    better = dict[str, _FoundAxes]()
    chains = dict[str, AxisChain]()
    tried = list[str]()
    for name, part in found.used.items():
        plain = found.model.senses.get(name)
        camera = name.rpartition("/")[0]
        given_up = camera not in chains and tried.count(camera) >= MOST_TRIES
        if type(plain) is not GP or given_up or not _tells_axes(part):
            continue
        tried.append(camera)
        sightings = _list_sightings(plain, None if camera else size)
        chain = find_axes(sightings, settings.fit.seed, chains.get(camera))
        learned = _learn_on_chain(name, plain, chain, sightings, found, settings.fit.seed)
        if learned.gain > lgamma(len(chain.order) + 1.0):
            better[name] = learned
            chains[camera] = learned.model.chain
    return _with_axes(found, better) if better else found


def _tells_axes(part: Pairs) -> bool:
    """Whether a track has twice as many numbers as a chain has unknowns, and each
    joint moved on its own: joints that move as one show no axes of their own.
    """
    joints = part.x.shape[1]
    if part.y.size < 2 * (8 + 4 * joints):
        return False
    moved = part.x - part.x.mean(axis=0)
    own = [_residual_std(np.delete(moved, m, axis=1), moved[:, m]) for m in range(joints)]
    return min(own) > LEAST_OWN_RAD


def _residual_std(others: Array, joint: Array) -> float:
    """Standard deviation of a joint's angle that no sum of the others' explains, rad."""
    explained = others @ np.linalg.lstsq(others, joint, rcond=None)[0]
    return float(np.std(joint - explained))


def _list_sightings(plain: GP, size: tuple[int, int] | None) -> AxisSightings:
    """The samples of a Gaussian process with their noise, and the prior of the camera's lens."""
    std = np.sqrt(plain.spread + plain.noise)
    if plain.targets.shape[1] == 3:
        return AxisSightings(plain.samples, plain.targets, std, np.zeros(0), np.zeros(0))
    width, height = size or _likely_size(plain.targets)
    lens = lens_without_distortion(width, width, height)
    lens_std = scale_lens_std(FREE_LENS, width)
    return AxisSightings(plain.samples, plain.targets, std, lens, lens_std)


def _likely_size(places: Array) -> tuple[int, int]:
    """An image's width and height, px, that contain all places (n,2) px."""
    width, height = (1.1 * float(v) for v in places.max(axis=0))
    return (640, 480) if width < 640.0 and height < 480.0 else (int(width), int(height))


def _learn_on_chain(
    name: str, plain: GP, chain: AxisChain, sightings: AxisSightings, found: LearnedBody, seed: int
) -> _FoundAxes:
    """The model of a track with a chain near this one as its mean."""
    part = found.used[name]
    track = _Track(part, correlate_angle_errors(part, found.joints), sightings)
    rows = track.linearise_about(chain)
    kernel, rows, drift = fit_slow_error(part.t, search_residual_kernel(rows, RESIDUAL, seed), rows)
    track = replace(track, noise=rows.spread)
    model = _solve_unknowns(chain, track, kernel, drift)
    some = choose_spaced_rows(len(part.x), MOST)
    few = track.linearise_about(model.chain).some(some)
    kept = part.rows(some)
    z = few.x / kernel.scales
    chol = cholesky_with_jitter(se_kernel(z, z, kernel.amplitude), few.spread, kernel.noise)
    alone = evidence_of_gp_alone(plain, kept, correlate_angle_errors(kept, found.joints))
    gain = solve_linear_unknowns(chol, few).evidence - alone
    floor = part.floor[part.block >= 0] if (part.block >= 0).any() else part.floor
    return _FoundAxes(model, gain, floor, tuple(_scores_of_axes(name, model, chol, few, kept)))


@dataclass(frozen=True, eq=False)
class _Track:
    """A track's sightings, the covariance of their angles, and the prior of the lens.

    noise: of the sightings; None while it follows from the slope of each chain.
    """

    pairs: Pairs
    coupling: Coupling
    sightings: AxisSightings
    noise: Spread | None = None

    def compare_with_prior(self, chain: AxisChain) -> tuple[Array, Array]:
        """The prior's mean (P,) less the chain's unknowns, and its std (P,).

        Axes may be anywhere: their prior says how far they may be off, not from where.
        """
        std = chain.prior_std(self.sightings.lens_std)
        away = np.zeros(len(std))
        away[chain.of_lens] = self.sightings.lens - chain.lens
        return away, std

    def linearise_about(self, chain: AxisChain) -> ResidualRows:
        """Residuals about a chain, with z = 0 at the prior's mean."""
        image, slope, design = chain.see(self.pairs.x)
        away, std = self.compare_with_prior(chain)
        noise = self.noise or spread_of(self.pairs, slope, self.coupling)
        residual = self.pairs.y - image - design @ away
        return ResidualRows(self.pairs.x, residual, design * std, noise)


def _solve_unknowns(chain: AxisChain, track: _Track, kernel: Hyper, drift: float) -> AxisGP:
    """The axes of greatest posterior near a chain, by Gauss-Newton, and the
    process of the residuals there.
    """
    rows = track.linearise_about(chain)
    quietest = float(rows.spread.diagonal.min()) + kernel.noise
    basis = build_basis(kernel, choose_inducing_points([kernel], rows.x, quietest))
    for _ in range(_ROUNDS):
        solved = condense_posterior(basis, track.linearise_about(chain))
        z, root, _ = posterior_of_unknowns(solved.information, solved.pull)
        away, std = track.compare_with_prior(chain)
        step = away + std * z
        chain = chain.move_axes(step)
        if (np.abs(step) < _SETTLED * std * np.linalg.norm(root, axis=1)).all():
            break
    away, std = track.compare_with_prior(chain)
    rows = track.linearise_about(chain)
    solved = condense_posterior(
        basis, replace(rows, residual=rows.residual + rows.design @ (away / std))
    )
    share = np.broadcast_to(rows.spread.share, track.pairs.y.shape[1])
    spread = np.outer(np.maximum(rows.spread.diagonal - drift, 0.0), share)
    samples = Samples(track.pairs.x, track.pairs.y, spread)
    residual = build_residual_process(kernel, basis.centres, solved, kernel.noise * share, samples)
    return AxisGP.on(
        drop_negligible_rows(residual),
        root=std[:, None] * root,
        lean=np.einsum("dpm,pk->dkm", solved.lean, root),
        drift=drift * share,
        chain=chain,
    )


def _scores_of_axes(
    name: str, model: AxisGP, chol: Array, rows: ResidualRows, part: Pairs
) -> Iterator[Score]:
    """Yield held-out error, and its square over the stated variance, of a track on found axes."""
    residual, variance = hold_out_blocks(chol, rows, part.block)
    yield Score(f"rmse/held_out/{name}", float(np.sqrt(np.mean(residual**2))), model.unit)
    yield Score(f"nis/held_out/{name}", float(np.mean(residual**2 / variance)), "1")


def _with_axes(found: LearnedBody, better: Mapping[str, _FoundAxes]) -> LearnedBody:
    """The body with these models, their noise, scores and remarks."""
    body = found.model
    models = {name: one.model for name, one in better.items()}
    variances = {n: one.model.noise + one.floor.mean(axis=0) for n, one in better.items()}
    counts = {n: len(one.floor) for n, one in better.items()}
    noise = replace_sense_noise(body.noise, variances, counts)
    model = replace(body, senses={**body.senses, **models}, noise=noise)
    observed = {n: s for n, s in model.senses.items() if isinstance(s, GP) and n != "encoders"}
    reported = exploration_report.exploration_scores(found.joints, observed, noise)
    own = [score for one in better.values() for score in one.scores]
    scores = {score.name: score for score in (*found.scores, *reported, *own)}
    return replace(
        found,
        model=model,
        scores=tuple(scores.values()),
        findings=(*found.findings, *_axis_findings(better, body.joints)),
    )


def _axis_findings(better: Mapping[str, _FoundAxes], joints: Sequence[str]) -> Iterator[Finding]:
    """Yield a remark on each group of tracks: the order of its joints, and the nats won."""
    groups = dict[str, list[_FoundAxes]]()
    for name, one in better.items():
        groups.setdefault(group_of(name), []).append(one)
    for group, ones in groups.items():
        order = ", ".join(joints[m] for m in ones[0].model.chain.order)
        nats = sum(one.gain for one in ones)
        yield Finding(
            "info", f"{group}: {nats:.0f} nats likelier with axes of the joints, in order {order}"
        )
