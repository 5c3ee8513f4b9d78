"""What kinematics leaves of each track: its kernel, and θ and the residual's Gaussian process learned together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..kinematics.rig import Rig
from ..types import Array
from .evidence import Hyper, Prior, Spread, cholesky
from .explicit import Condensed, Rows, condensed, posterior, search
from .gp import GP, se, shortened
from .kinematic_gp import KinematicGP
from .lasting import lasting
from .pairs import Joint, Pairs, coupled
from .select import farthest
from .sparse import basis, inducing
from .train import Coupling, Samples, lifted

MOST = 500
"""Sightings of a track that a residual is learned from: kinematics carries the rest, and more cost O(n³)."""
RESIDUAL = Prior(np.ones(()), 0.35)
"""Length scales of what kinematics leaves: of bends and gears, as long as a turn's own cosine (evidence.ROTATION)."""
_ROUNDS = 4
_SETTLED = 0.01
"""Posterior standard deviations by which θ still moves when it rests."""


@dataclass(frozen=True, eq=False)
class Part:
    """One track: samples kept, coupling of their angles, kernel, variance (px²) of a lasting error, rows about θ."""

    pairs: Pairs
    known: Coupling
    kernel: Hyper
    drift: float
    rows: Rows

    @property
    def chol(self) -> Array:
        """Factor (n,n) of kernel and noise."""
        z = self.pairs.x / self.kernel.scales
        return cholesky(se(z, z, self.kernel.amplitude), self.rows.spread, self.kernel.noise)


@dataclass(frozen=True, eq=False)
class Together:
    """θ (P,) of greatest posterior, its root (P,P) in prior deviations, each track's rows and posterior there."""

    theta: Array
    root: Array
    parts: Mapping[str, Part]
    condensed: Mapping[str, Condensed]


def residual(
    rig: Rig, index: int, theta: Array, part: Pairs, weight: Array, chosen: Sequence[Joint], seed: int
) -> Part:
    """Kernel of what kinematics leaves of a track near theta; sightings of small weight (n,), or too many, left out."""
    kept = part.rows(np.flatnonzero(weight > 0.5))
    kept = kept.rows(farthest(kept.x, MOST))
    known = coupled(kept, chosen)
    mean, std = rig.prior
    seen = rig.see(rig.sights[index], theta, kept.x)
    design = seen.design[:, 0] * std
    left = kept.y - seen.image[:, 0] - design @ ((mean - theta) / std)
    rows = Rows(kept.x, left, design, spread_of(kept, seen.slope[:, 0], known))
    kernel, rows, drift = lasting(kept.t, search(rows, RESIDUAL, seed), rows)
    return Part(kept, known, kernel, drift, rows)


def spread_of(part: Pairs, slope: Array, known: Coupling) -> Spread:
    """Known noise of sightings: their own, and that of the angles seen through slopes (n,D,M)."""

    class Slopes:
        def means(self, _: Array) -> tuple[Array, Array]:
            return part.y, slope

    data = Samples(part.x, part.y, part.floor, part.variance, known)
    return lifted(data, Slopes(), (slice(0, part.y.shape[1]),))[0]  # type: ignore[arg-type]


def together(rig: Rig, theta: Array, parts: Mapping[str, Part]) -> Together:
    """θ under all tracks' residuals by Gauss-Newton from near by, and the residuals' posteriors there."""
    mean, std = rig.prior
    bases = {name: basis(part.kernel, _centres(part)) for name, part in parts.items()}
    for _ in range(_ROUNDS):
        found = [condensed(bases[name], _about(rig, k, theta, part)) for k, (name, part) in enumerate(parts.items())]
        information = np.sum([one.information for one in found], axis=0)
        z, root, _ = posterior(information, np.sum([one.pull for one in found], axis=0))
        step = mean + std * z - theta
        theta = theta + step
        if np.abs(np.linalg.solve(root, step / std)).max() < _SETTLED:
            break
    there, solved = {}, {}
    for k, (name, part) in enumerate(parts.items()):
        there[name] = replace(part, rows=_about(rig, k, theta, part))
        rows = there[name].rows
        left = rows.residual + rows.design @ ((mean - theta) / std)
        solved[name] = condensed(bases[name], replace(rows, residual=left))
    return Together(theta, root, there, solved)


def _centres(part: Part) -> Array:
    return inducing([part.kernel], part.pairs.x, float(part.rows.spread.diagonal.min()) + part.kernel.noise)


def _about(rig: Rig, index: int, theta: Array, part: Part) -> Rows:
    """The rows of a track about another θ, their noise as it was."""
    mean, std = rig.prior
    seen = rig.see(rig.sights[index], theta, part.pairs.x)
    design = seen.design[:, 0] * std
    left = part.pairs.y - seen.image[:, 0] - design @ ((mean - theta) / std)
    return replace(part.rows, residual=left, design=design)


def model(rig: Rig, index: int, found: Together, name: str) -> KinematicGP:
    """The forward model of one track."""
    part, solved = found.parts[name], found.condensed[name]
    sub, used = rig.alone(index)
    outputs = part.pairs.y.shape[1]
    share = np.broadcast_to(part.rows.spread.share, outputs)
    plain = shortened(
        GP(
            ("u", "v"),
            "px",
            centres=_centres(part),
            scales=part.kernel.scales[None],
            amplitude=np.array([part.kernel.amplitude]),
            mean=np.zeros(outputs),
            weights=np.ascontiguousarray(solved.weights),
            factor=solved.factor[None],
            noise=part.kernel.noise * share,
            samples=part.pairs.x,
            targets=part.pairs.y,
            spread=np.outer(np.maximum(part.rows.spread.diagonal - part.drift, 0.0), share),
        )
    )
    return KinematicGP.on(
        plain,
        rig=sub,
        theta=found.theta[used],
        root=(rig.prior[1][:, None] * found.root)[used],
        lean=np.einsum("dpm,pk->dkm", solved.lean, found.root),
        drift=part.drift * share,
    )
