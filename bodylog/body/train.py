"""From samples to a GP: kernels by evidence, input noise as output noise (McHutchon & Rasmussen 2011)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..types import Array
from .evidence import FLAT, Hyper, Posterior, Prior, Spread, condition, independent, maximise, starts
from .gp import GP

_RESTARTS = 4
_SCOUTS = 250
_ROUNDS = 8
_SETTLED = 0.01


@dataclass(frozen=True, eq=False)
class Coupling:
    """Covariance of input errors between samples: value (L,) rad² of samples i > j (L,) in one input `joint` (L,)."""

    i: Array
    j: Array
    joint: Array
    value: Array


@dataclass(frozen=True, eq=False)
class Samples:
    """x (n,M) rad · y (n,D) · floor (n,D) known variance · variance (n,M) rad² of x, coupled between samples."""

    x: Array
    y: Array
    floor: Array
    variance: Array | None = None
    coupling: Coupling | None = None


def samples(x: Array, y: Array) -> Samples:
    """Samples of which no noise is known."""
    return Samples(x, y, np.zeros(y.shape))


def train(
    data: Samples, outputs: tuple[str, ...], unit: str, prior: Prior = FLAT, shared: bool = True, seed: int = 0
) -> GP:
    """The exact GP of greatest evidence; one kernel shared by all outputs, or one each."""
    groups = _groups(data, shared)
    spreads = [independent(data.floor[:, g].mean(axis=1)) for g in groups]
    kernels = [search(data.x, data.y[:, g], s, prior, seed) for g, s in zip(groups, spreads, strict=True)]
    if data.variance is None:
        return assemble(data, kernels, spreads, outputs, unit)
    for _ in range(_ROUNDS):
        before = np.concatenate([s.diagonal + k.noise for s, k in zip(spreads, kernels, strict=True)])
        spreads = lifted(data, assemble(data, kernels, spreads, outputs, unit), groups)
        kernels = [polish(k, data.x, data.y[:, g], s, prior) for k, g, s in zip(kernels, groups, spreads, strict=True)]
        after = np.concatenate([s.diagonal + k.noise for s, k in zip(spreads, kernels, strict=True)])
        if np.abs(after - before).mean() < _SETTLED * after.mean():
            break
    return assemble(data, kernels, spreads, outputs, unit)


def search(x: Array, y: Array, spread: Spread, prior: Prior, seed: int) -> Hyper:
    """Kernel of greatest evidence for outputs y (n,G) that share it: restarts on few samples, then all of them."""
    scouts = np.unique(np.linspace(0, len(x) - 1, min(len(x), _SCOUTS)).round().astype(int))
    sx, sy = _deviation(x), float(np.mean(_deviation(y)))
    few = x[scouts] / sx, y[scouts] / sy, independent(spread.diagonal[scouts] / sy**2)
    found = maximise(*few, prior.scaled(1.0 / sx), starts(few[0], seed, _RESTARTS))
    best = Hyper(found.scales * sx, found.amplitude * sy**2, found.noise * sy**2)
    return polish(best, x, y, spread, prior) if len(scouts) < len(x) else best


def polish(start: Hyper, x: Array, y: Array, spread: Spread, prior: Prior) -> Hyper:
    """The kernel of greatest evidence near `start`."""
    sx, sy = _deviation(x), float(np.mean(_deviation(y)))
    first = Hyper(start.scales / sx, start.amplitude / sy**2, start.noise / sy**2)
    found = maximise(x / sx, y / sy, spread.scaled(1.0 / sy**2), prior.scaled(1.0 / sx), [first])
    return Hyper(found.scales * sx, found.amplitude * sy**2, found.noise * sy**2)


def lifted(data: Samples, gp: GP, groups: Sequence[slice]) -> list[Spread]:
    """Floor plus input noise seen through the slope of the mean: σ² + J Σₓ Jᵀ, one for each group of outputs."""
    slope = gp.means(data.x)[1]
    assert data.variance is not None
    diagonal = data.floor + np.einsum("ndm,nm->nd", slope**2, data.variance)
    return [_spread(data, slope[:, g], diagonal[:, g].mean(axis=1)) for g in groups]


def assemble(
    data: Samples, kernels: Sequence[Hyper], spreads: Sequence[Spread], outputs: tuple[str, ...], unit: str
) -> GP:
    """The exact GP with given kernels and noise, one for each output or one for all."""
    groups = _groups(data, len(kernels) < data.y.shape[1])
    parts = [condition(k, data.x, data.y[:, g], s) for k, s, g in zip(kernels, spreads, groups, strict=True)]
    owner = [index for index, g in enumerate(groups) for _ in range(g.stop - g.start)]
    return GP(
        outputs,
        unit,
        centres=data.x,
        scales=np.array([k.scales for k in kernels]),
        amplitude=np.array([k.amplitude for k in kernels]),
        mean=np.concatenate([p.mean for p in parts]),
        weights=np.concatenate([p.alpha.T for p in parts]),
        factor=np.array([_inverse(part) for part in parts]),
        noise=np.array([kernels[o].noise for o in owner]),
        samples=data.x,
        targets=data.y,
        spread=np.column_stack([spreads[o].diagonal for o in owner]),
    )


def _groups(data: Samples, shared: bool) -> list[slice]:
    count = data.y.shape[1]
    return [slice(0, count)] if shared else [slice(d, d + 1) for d in range(count)]


def _spread(data: Samples, slope: Array, diagonal: Array) -> Spread:
    if data.coupling is None:
        return independent(diagonal)
    c, count = data.coupling, len(data.x)
    value = (slope[c.i, :, c.joint] * slope[c.j, :, c.joint]).mean(axis=1) * c.value
    place, into = np.unique(c.i * count + c.j, return_inverse=True)
    return Spread(diagonal, place // count, place % count, np.bincount(into, value, minlength=len(place)))


def _inverse(part: Posterior) -> Array:
    from scipy.linalg.lapack import dtrtri

    return np.ascontiguousarray(dtrtri(part.chol, lower=1)[0])


def _deviation(values: Array) -> Array:
    deviation = values.std(axis=0)
    return np.where(deviation > 1e-9 * np.maximum(1.0, np.abs(values).max(axis=0)), deviation, 1.0)
