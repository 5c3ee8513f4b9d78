"""From samples to a GP: kernels by evidence, input noise as output noise (McHutchon & Rasmussen 2011)."""

import numpy as np

from ..types import Array
from .evidence import Hyper, Posterior, condition, maximise, starts
from .gp import GP

EXACT = 3000
"""Above so many samples the sparse posterior takes over."""

_RESTARTS = 4
_SCOUTS = 250
_ROUNDS = 8
_SETTLED = 0.01


def train(
    x: Array,
    y: Array,
    outputs: tuple[str, ...],
    unit: str,
    floor: Array | None = None,
    input_variance: Array | None = None,
    shared: bool = False,
    seed: int = 0,
) -> GP:
    """A GP of y (n,D) on x (n,M) rad; floor (n,D) known noise variance, input_variance (n,M) rad²; shared kernels."""
    floor = np.zeros(y.shape) if floor is None else floor
    groups = [slice(0, y.shape[1])] if shared else [slice(d, d + 1) for d in range(y.shape[1])]
    kernels = [kernel(x, y[:, g], floor[:, g].mean(axis=1), seed) for g in groups]
    spread = floor
    for _ in range(_ROUNDS):
        if input_variance is None:
            break
        gp = _assemble(x, y, spread, groups, kernels, outputs, unit)
        lifted = floor + np.einsum("ndm,nm->nd", gp.means(x)[1] ** 2, input_variance)
        change = np.abs(lifted - spread).mean(axis=0) / (lifted + gp.noise).mean(axis=0)
        spread = lifted
        kernels = [polish(k, x, y[:, g], spread[:, g].mean(axis=1)) for k, g in zip(kernels, groups, strict=True)]
        if change.max() < _SETTLED:
            break
    return _assemble(x, y, spread, groups, kernels, outputs, unit)


def kernel(x: Array, y: Array, floor: Array, seed: int) -> Hyper:
    """Kernel of greatest evidence for outputs y (n,G) that share it: restarts on few samples, then all of them."""
    scouts = _spaced(len(x), _SCOUTS)
    sx, sy = _deviation(x), float(np.mean(_deviation(y)))
    few = (x / sx)[scouts], (y / sy)[scouts], (floor / sy**2)[scouts]
    found = maximise(*few, starts(few[0], seed, _RESTARTS))
    best = Hyper(found.scales * sx, found.amplitude * sy**2, found.noise * sy**2)
    return polish(best, x, y, floor) if len(scouts) < len(x) else best


def polish(start: Hyper, x: Array, y: Array, floor: Array) -> Hyper:
    """The kernel of greatest evidence near `start`."""
    sx, sy = _deviation(x), float(np.mean(_deviation(y)))
    first = Hyper(start.scales / sx, start.amplitude / sy**2, start.noise / sy**2)
    found = maximise(x / sx, y / sy, floor / sy**2, [first])
    return Hyper(found.scales * sx, found.amplitude * sy**2, found.noise * sy**2)


def assemble(
    x: Array, y: Array, spread: Array, kernels: list[Hyper], outputs: tuple[str, ...], unit: str
) -> GP:
    """The exact GP with one given kernel per output; spread (n,D) is the samples' noise variance."""
    groups = [slice(d, d + 1) for d in range(y.shape[1])]
    return _assemble(x, y, spread, groups, kernels, outputs, unit)


def _assemble(
    x: Array,
    y: Array,
    spread: Array,
    groups: list[slice],
    kernels: list[Hyper],
    outputs: tuple[str, ...],
    unit: str,
) -> GP:
    parts = [condition(k, x, y[:, g], spread[:, g].mean(axis=1)) for k, g in zip(kernels, groups, strict=True)]
    each = [(k, p) for k, p, g in zip(kernels, parts, groups, strict=True) for _ in range(g.stop - g.start)]
    return GP(
        outputs,
        unit,
        centres=x,
        scales=np.array([k.scales for k, _ in each]),
        amplitude=np.array([k.amplitude for k, _ in each]),
        mean=np.concatenate([p.mean for p in parts]),
        weights=np.concatenate([p.alpha.T for p in parts]),
        factor=np.array([f for p, g in zip(parts, groups, strict=True) for f in [_inverse(p)] * (g.stop - g.start)]),
        noise=np.array([k.noise for k, _ in each]),
        samples=x,
        targets=y,
        spread=spread,
    )


def _inverse(part: Posterior) -> Array:
    from scipy.linalg.lapack import dtrtri

    return np.ascontiguousarray(dtrtri(part.chol, lower=1)[0])


def _deviation(values: Array) -> Array:
    deviation = values.std(axis=0)
    return np.where(deviation > 1e-9 * np.maximum(1.0, np.abs(values).max(axis=0)), deviation, 1.0)


def _spaced(count: int, wanted: int) -> Array:
    return np.unique(np.linspace(0, count - 1, min(count, wanted)).round().astype(int))
