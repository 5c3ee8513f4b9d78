"""Residuals of kinematics for each track: their kernel,
and θ learned together with their Gaussian process.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from ...errors import ModelError
from ...kinematics.adjustment import Adjusted
from ...kinematics.identifiability import GIVEN
from ...kinematics.rig import Rig, RigPrediction
from ...types import TRACK_AXES, Array
from ..data.pairs import Pairs, SmoothedJoint, correlate_angle_errors
from ..gp.fit import Coupling, Samples, propagate_input_noise
from ..gp.inducing import build_basis, choose_inducing_points
from ..gp.marginal_likelihood import Hyper, Prior, Spread, cholesky_with_jitter
from ..gp.model import GP, drop_negligible_rows, se_kernel
from .explicit import (
    Condensed,
    ResidualRows,
    condense_posterior,
    posterior_of_unknowns,
    search_residual_kernel,
)
from .lasting import fit_slow_error
from .model import KinematicGP
from .sightings import (
    PointMeans,
    ThingSightings,
    average_points,
    group_points,
    most_seen_points,
    sightings_of_point,
    sound_sightings,
)

MOST = 500
"""Most sightings of a track for a residual: kinematics explains most, and the cost is O(n³)."""
RESIDUAL = Prior(np.ones(()), 0.35)
"""Prior length scales of residuals: of bending and gears, as long as a turn's cosine
(marginal_likelihood.ROTATION).
"""
PERIODIC_STD_RAD = 1e-3
"""Prior std of a joint's error over a turn: eccentric encoders, gears, gravity. See
docs/decisions.md for figures.
"""
_ROUNDS = 4
_SETTLED = 0.01
"""Posterior standard deviations of a step of θ that ends the iteration."""
_FARTHEST = 10.0
"""Prior standard deviations of a step of θ from a near start: one of 40 led to 10¹⁵."""


@dataclass(frozen=True, eq=False)
class ResidualPart:
    """One thing: rows kept, coupling of their angles,
    kernel, variance (px²) of a slow error, rows about θ.

    own: variance (px²) of one point about the mean of its part of a board · tracks, points: the
    tracks that become senses, one in each part, with their sightings and point numbers; further
    points would repeat the same information.
    """

    pairs: Pairs
    known: Coupling
    kernel: Hyper
    drift: float
    rows: ResidualRows
    view: PointMeans
    own: float
    tracks: Mapping[str, Pairs]
    points: Mapping[str, int]

    @property
    def chol(self) -> Array:
        """Factor (n,n) of kernel and noise."""
        z = self.rows.x / self.kernel.scales
        return cholesky_with_jitter(
            se_kernel(z, z, self.kernel.amplitude), self.rows.spread, self.kernel.noise
        )


@dataclass(frozen=True, eq=False)
class Beside:
    """Unknowns beside θ: mean (S,) · covariance (P+S,P+S) of θ, in prior deviations, and them."""

    mean: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class Together:
    """θ (P,) of greatest posterior, its root (P,P) in prior
    deviations, each thing's rows and posterior there.
    """

    theta: Array
    root: Array
    parts: Mapping[str, ResidualPart]
    condensed: Mapping[str, Condensed]
    beside: Beside


def fit_residual_kernel(
    rig: Rig,
    index: int,
    theta: Array,
    shown: ThingSightings,
    weight: Array,
    chosen: Sequence[SmoothedJoint],
    seed: int,
) -> ResidualPart:
    """Kernel of the residuals of kinematics near theta;
    sightings with small weight (N,C), or too many, left out.
    """
    counts = sound_sightings(weight)
    seen = rig.see(rig.sights[index], theta, shown.whole.x, shown.whole.log)
    view, kept, own = average_points(
        shown, counts, shown.image - seen.image, group_points(shown.points), MOST
    )
    known = correlate_angle_errors(kept, chosen)
    rows = linearise_residuals(
        rig, theta, kept, seen, view, spread_of(kept, view.of(seen.slope), known)
    )
    kernel, rows, drift = fit_slow_error(kept.t, search_residual_kernel(rows, RESIDUAL, seed), rows)
    current = counts & in_last_placement(rig, index, shown.whole.log)[:, None]
    points = {shown.tracks[k]: k for k in most_seen_points(shown) if current[:, k].any()}
    tracks = {track: sightings_of_point(shown, k, current) for track, k in points.items()}
    return ResidualPart(kept, known, kernel, drift, rows, view, own, tracks, points)


def in_last_placement(rig: Rig, index: int, log: Array) -> Array:
    """Which images (N,), of these logs (N,), show a thing
    where it was in the last log, which the body holds.
    """
    sight = rig.sights[index]
    placed = [sight.in_log(int(number)) for number in log]
    return np.array(
        [(one.camera, one.carrier) == (sight.camera, sight.carrier) for one in placed], bool
    )


def linearise_residuals(
    rig: Rig, theta: Array, part: Pairs, seen: RigPrediction, view: PointMeans, spread: Spread
) -> ResidualRows:
    """Residuals about θ (P,), with z = 0 at the prior's mean."""
    mean, std = rig.prior
    design = view.of(seen.design) * std
    return ResidualRows(
        view.x, part.y - view.of(seen.image) - design @ ((mean - theta) / std), design, spread
    )


def spread_of(part: Pairs, slope: Array, known: Coupling) -> Spread:
    """Known noise of sightings: their own, and that
    of the angles propagated through slopes (n,D,M).
    """

    class Slopes:
        def means(self, _: Array) -> tuple[Array, Array]:
            return part.y, slope

    data = Samples(part.x, part.y, part.floor, part.variance, known)
    outputs = (slice(0, part.y.shape[1]),)
    return propagate_input_noise(data, Slopes(), outputs)[0]  # type: ignore[arg-type]


def solve_together(
    rig: Rig,
    theta: Array,
    parts: Mapping[str, ResidualPart],
    bends: Mapping[str, Array] = MappingProxyType({}),
) -> Together:
    """θ given all tracks' residuals, by Gauss-Newton from
    a near start, and the residuals' posteriors there.

    Each joint's periodic error (`with_periodic_errors`)
    is marginalised, so that θ's covariance contains it; so are `bends` (`with_bends`), by name.
    ModelError where a step leads far from the start: the noise of the residuals is not theirs.
    """
    mean, std = rig.prior
    bases = {
        name: build_basis(part.kernel, _choose_inducing_centres(part))
        for name, part in parts.items()
    }
    for _ in range(_ROUNDS):
        rows = [
            with_periodic_errors(rig, _relinearise_residuals(rig, k, theta, part), part)
            for k, part in enumerate(parts.values())
        ]
        if bends:
            rows = [
                with_bends(rig, one, part, bends[name])
                for one, (name, part) in zip(rows, parts.items(), strict=True)
            ]
        found = [
            condense_posterior(bases[name], one) for name, one in zip(parts, rows, strict=True)
        ]
        information = np.sum([one.information for one in found], axis=0)
        z, root, _ = posterior_of_unknowns(information, np.sum([one.pull for one in found], axis=0))
        spread = root[: len(theta)] @ root[: len(theta)].T
        step = mean + std * z[: len(theta)] - theta
        if not (np.abs(step / std) < _FARTHEST).all():
            raise ModelError("its calibration does not settle beside what it leaves of the images")
        theta = theta + step
        if (np.abs(step / std) < _SETTLED * np.sqrt(np.diag(spread))).all():
            break
    more = len(rig.joints) if bends else 0
    chosen = np.r_[np.arange(len(theta)), np.arange(len(z) - more, len(z))]
    beside = Beside(z[len(z) - more :], root[chosen] @ root[chosen].T)
    values, vectors = np.linalg.eigh(spread)
    there = {}
    solved = {}
    for k, (name, part) in enumerate(parts.items()):
        there[name] = replace(part, rows=_relinearise_residuals(rig, k, theta, part))
        known = there[name].rows
        left = known.residual + known.design @ ((mean - theta) / std)
        solved[name] = condense_posterior(bases[name], replace(known, residual=left))
    return Together(theta, vectors * np.sqrt(np.maximum(values, 0.0)), there, solved, beside)


def with_bends(rig: Rig, rows: ResidualRows, part: ResidualPart, bends: Array) -> ResidualRows:
    """Rows with one more unknown for each joint, by which it is off by bends (N,M) rad or m."""
    columns = np.arange(rig.of_joints.start, rig.of_joints.stop)
    by_angle = rows.design[..., columns] / rig.prior[1][columns]
    design = by_angle * bends[part.view.picture][:, None]
    return replace(rows, design=np.concatenate([rows.design, design], axis=-1))


def with_periodic_errors(rig: Rig, rows: ResidualRows, part: ResidualPart) -> ResidualRows:
    """Rows with two more unknowns for each joint that turns:
    a and b of its error a cos q + b sin q, PERIODIC_STD_RAD.

    Over a small range of angles such an error looks like a zero, however many images there are:
    what a zero means depends on the model to that extent. Joints whose zeros are given have none.
    """
    joints = np.array(
        [m for m, doubt in enumerate(rig.doubt) if doubt > GIVEN and not rig.slides(m)], np.int64
    )
    columns = rig.of_joints.start + joints
    by_angle = rows.design[..., columns] / rig.prior[1][columns] * PERIODIC_STD_RAD
    angles = part.view.readings[part.view.picture][:, None, joints]
    design = np.concatenate(
        [rows.design, by_angle * np.cos(angles), by_angle * np.sin(angles)], axis=-1
    )
    return replace(rows, design=design)


def _choose_inducing_centres(part: ResidualPart) -> Array:
    return choose_inducing_points(
        [part.kernel], part.rows.x, float(part.rows.spread.diagonal.min()) + part.kernel.noise
    )


def _relinearise_residuals(rig: Rig, index: int, theta: Array, part: ResidualPart) -> ResidualRows:
    """The rows of a thing about another θ, with the same noise."""
    seen = rig.see(rig.sights[index], theta, part.view.readings, part.view.log)
    return linearise_residuals(rig, theta, part.pairs, seen, part.view, part.rows.spread)


def forward_models(
    rig: Rig, index: int, found: Together, name: str, printed: Adjusted
) -> dict[str, KinematicGP]:
    """The forward model of each track of a thing; they share
    θ and the residual process, evaluated at each point.
    """
    part = found.parts[name]
    solved = found.condensed[name]
    sub, used = rig.alone(index)
    share = np.broadcast_to(part.rows.spread.share, part.pairs.y.shape[1])
    root = (rig.prior[1][:, None] * found.root)[used]
    lean = np.einsum("dpm,pk->dkm", solved.lean, found.root)
    centres = _choose_inducing_centres(part)
    chain = printed.rig.sights[index].chain
    moved = not np.array_equal(chain.fixed, rig.sights[index].chain.fixed)
    made = {}
    for track, seen in part.tracks.items():
        point = part.points[track]
        near = _kernel_to_point(part, centres, point)
        plain = drop_negligible_rows(
            _residual_process_at_point(part, centres, near, solved, share, seen)
        )
        sight = replace(sub.sights[0], points=sub.sights[0].points[[point]])
        one = replace(sub, sights=(sight,))
        made[track] = KinematicGP.on(
            plain,
            rig=one,
            theta=found.theta[used],
            root=root,
            lean=lean * near,
            drift=part.drift * share,
            printed=printed.theta[used],
            resting=chain.fixed if moved else None,
        )
    return made


def _kernel_to_point(part: ResidualPart, centres: Array, point: int) -> Array:
    """Kernel factor (n,) between each centre (n,M+2) and a point of the board."""
    joints = part.view.q.shape[1]
    apart = (centres[:, joints:] - part.view.where[point]) / part.kernel.scales[joints:]
    return np.asarray(np.exp(-0.5 * np.square(apart).sum(axis=1)))


def _residual_process_at_point(
    part: ResidualPart, centres: Array, near: Array, solved: Condensed, share: Array, seen: Pairs
) -> GP:
    """The residual process at one point, over the
    joints alone, with centres weighted by `near` (n,).
    """
    joints = part.view.q.shape[1]
    spread = np.outer(np.maximum(part.rows.spread.diagonal - part.drift, 0.0), share)
    samples = part.pairs.x
    targets = part.pairs.y
    beyond = 0.0
    if len(part.view.where) > 1:
        samples = seen.x
        targets = seen.y
        spread = seen.floor
        beyond = max(part.own - float(seen.floor.mean()), 0.0)
    kernel = replace(part.kernel, scales=part.kernel.scales[:joints])
    nearby = replace(solved, weights=solved.weights * near, factor=solved.factor * near)
    noise = (kernel.noise + beyond) * share
    return build_residual_process(
        kernel, centres[:, :joints], nearby, noise, Samples(samples, targets, spread)
    )


def build_residual_process(
    kernel: Hyper, centres: Array, solved: Condensed, noise: Array, data: Samples
) -> GP:
    """The process of residuals on inducing points: centres (n,M) rad · noise (D,) beyond the
    samples' own, their `floor`.
    """
    return GP(
        *TRACK_AXES[data.y.shape[1]],
        centres=centres,
        scales=kernel.scales[None],
        amplitude=np.array([kernel.amplitude]),
        mean=np.zeros(len(noise)),
        weights=np.ascontiguousarray(solved.weights),
        factor=solved.factor[None],
        noise=noise,
        samples=data.x,
        targets=data.y,
        spread=data.floor,
    )
