"""Fit a GP to samples: kernels by evidence, input
noise as output noise (McHutchon & Rasmussen 2011).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...types import Array
from ..data.subsampling import choose_spaced_rows
from .inducing import Basis, build_basis, choose_inducing_points, sparse_posterior, sufficient_sums
from .marginal_likelihood import (
    FLAT,
    Hyper,
    Prior,
    Spread,
    condition_gp,
    draw_kernel_starts,
    independent_noise,
    inverse_lower,
    maximise_evidence,
)
from .model import GP

EXACT = 500
"""Most samples for which kernels and held-out
residuals use the exact posterior, at a cost of O(n³).
"""

FEW = 100
"""Most samples for exact predictions; inducing
points predict the same from more samples, faster.
"""

CANDIDATES = 12
"""First guesses compared before the search for a kernel."""

_SCOUTS = 200
_ROUNDS = 8
_SETTLED = 0.01


@dataclass(frozen=True, eq=False)
class Coupling:
    """Covariance of input errors between samples: value (L,)
    rad² of samples i > j (L,) in one input `joint` (L,).
    """

    i: Array
    j: Array
    joint: Array
    value: Array

    def rows(self, chosen: Array, count: int) -> "Coupling":
        """The covariance between some of `count` samples, in ascending order."""
        place = np.full(count, -1)
        place[chosen] = np.arange(len(chosen))
        i = place[self.i]
        j = place[self.j]
        kept = (i >= 0) & (j >= 0)
        return Coupling(i[kept], j[kept], self.joint[kept], self.value[kept])


@dataclass(frozen=True, eq=False)
class Samples:
    """x (n,M) rad · y (n,D) · floor (n,D) known variance
    · variance (n,M) rad² of x, coupled between samples.
    """

    x: Array
    y: Array
    floor: Array
    variance: Array | None = None
    coupling: Coupling | None = None

    def rows(self, chosen: Array) -> "Samples":
        """Return some rows, in ascending order."""
        variance = None if self.variance is None else self.variance[chosen]
        coupling = None if self.coupling is None else self.coupling.rows(chosen, len(self.x))
        return Samples(self.x[chosen], self.y[chosen], self.floor[chosen], variance, coupling)


@dataclass(frozen=True, eq=False)
class FittedKernels:
    """Kernels, one for each group of outputs, and the
    known noise of the samples they were fitted to.
    """

    groups: tuple[slice, ...]
    kernels: tuple[Hyper, ...]
    spreads: tuple[Spread, ...]


def samples_without_noise(x: Array, y: Array) -> Samples:
    """Samples without known noise."""
    return Samples(x, y, np.zeros(y.shape))


def train_gp(
    data: Samples, outputs: tuple[str, ...], unit: str, seed: int = 0, exact: int = EXACT
) -> GP:
    """The GP of greatest evidence, one kernel for
    all outputs, fitted to at most `exact` samples.
    """
    return build_gp(data, fit_kernels(data, FLAT, True, seed, exact), outputs, unit)


def fit_kernels(
    data: Samples, prior: Prior, shared: bool, seed: int, exact: int = EXACT
) -> FittedKernels:
    """Kernels of greatest evidence, from at most `exact` of
    the samples, and the noise of all samples under them.
    """
    if len(data.x) <= exact:
        return fit_kernels_and_noise(data, prior, shared, seed)
    part = data.rows(choose_spaced_rows(len(data.x), exact))
    found = fit_kernels_and_noise(part, prior, shared, seed)
    if data.variance is None:
        return replace(
            found, spreads=tuple(independent_noise(data.floor[:, g]) for g in found.groups)
        )
    return replace(
        found,
        spreads=propagate_input_noise(
            data,
            assemble_exact_gp(part, found, (), ""),
            found.groups,
            () if data.floor.any() else tuple(kernel.noise for kernel in found.kernels),
        ),
    )


def build_gp(
    data: Samples, found: FittedKernels, outputs: tuple[str, ...], unit: str, few: int = FEW
) -> GP:
    """The GP with given kernels: exact for up to `few` samples, on inducing points for more."""
    make = assemble_exact_gp if len(data.x) <= few else assemble_sparse_gp
    return make(data, found, outputs, unit)


def fit_kernels_and_noise(data: Samples, prior: Prior, shared: bool, seed: int) -> FittedKernels:
    """Kernels of greatest evidence under the prior;
    noise from the inputs is refined until it settles.
    """
    count = data.y.shape[1]
    groups = (slice(0, count),) if shared else tuple(slice(d, d + 1) for d in range(count))
    spreads = tuple(independent_noise(data.floor[:, g]) for g in groups)
    kernels = tuple(
        search_kernel(data.x, data.y[:, g], s, prior, seed)
        for g, s in zip(groups, spreads, strict=True)
    )
    # before the inputs' noise is known, white noise holds it
    white: tuple[float, ...] = ()
    stated = data.floor.any()
    for _ in range(_ROUNDS):
        if data.variance is None:
            break
        before = _noise_by_output(spreads, kernels)
        found = assemble_exact_gp(data, FittedKernels(groups, kernels, spreads), (), "")
        spreads = propagate_input_noise(data, found, groups, white)
        parts = zip(kernels, groups, spreads, strict=True)
        kernels = tuple(polish_kernel(k, data.x, data.y[:, g], s, prior) for k, g, s in parts)
        white = () if stated else tuple(kernel.noise for kernel in kernels)
        after = _noise_by_output(spreads, kernels)
        if np.abs(after - before).mean() < _SETTLED * after.mean():
            break
    return FittedKernels(groups, kernels, spreads)


def _noise_by_output(spreads: Sequence[Spread], kernels: Sequence[Hyper]) -> Array:
    """Variance (n,D) of the samples' noise."""
    parts = zip(spreads, kernels, strict=True)
    return np.hstack([np.outer(s.diagonal + k.noise, s.share) for s, k in parts])


def search_kernel(x: Array, y: Array, spread: Spread, prior: Prior, seed: int) -> Hyper:
    """Kernel of greatest evidence for outputs y (n,G) that
    share it: from guesses on few samples, then on all.
    """
    scouts = choose_spaced_rows(len(x), _SCOUTS)
    own = y / np.sqrt(spread.share)
    sx = _column_deviations(x)
    sy = float(np.mean(_column_deviations(own)))
    few = x[scouts] / sx, own[scouts] / sy, independent_noise(spread.diagonal[scouts] / sy**2)
    found = maximise_evidence(
        *few, prior.scaled(1.0 / sx), draw_kernel_starts(few[0], seed, CANDIDATES)
    )
    best = Hyper(found.scales * sx, found.amplitude * sy**2, found.noise * sy**2)
    return polish_kernel(best, x, y, spread, prior) if len(scouts) < len(x) else best


def polish_kernel(start: Hyper, x: Array, y: Array, spread: Spread, prior: Prior) -> Hyper:
    """The kernel of greatest evidence near `start`, for outputs in units of their own noise."""
    y = y / np.sqrt(spread.share)
    sx = _column_deviations(x)
    sy = float(np.mean(_column_deviations(y)))
    first = Hyper(start.scales / sx, start.amplitude / sy**2, start.noise / sy**2)
    found = maximise_evidence(
        x / sx, y / sy, spread.scaled(1.0 / sy**2), prior.scaled(1.0 / sx), first.theta[None]
    )
    return Hyper(found.scales * sx, found.amplitude * sy**2, found.noise * sy**2)


def propagate_input_noise(
    data: Samples, gp: GP, groups: Sequence[slice], white: tuple[float, ...] = ()
) -> tuple[Spread, ...]:
    """Floor plus input noise propagated through the mean's
    slope: σ² + J Σₓ Jᵀ, one for each group of outputs.

    white: variance of each group beyond it, in equal parts: the
    sensor's, where samples state none. Beside a stated one it is the model's misfit.
    """
    slope = gp.means(data.x)[1]
    diagonal = data.floor + np.einsum("ndm,nm->nd", slope**2, np.asarray(data.variance))
    beyond = white or (0.0,) * len(groups)
    return tuple(
        _coupled_noise(data, slope[:, g], diagonal[:, g], noise)
        for g, noise in zip(groups, beyond, strict=True)
    )


def assemble_exact_gp(
    data: Samples, found: FittedKernels, outputs: tuple[str, ...], unit: str
) -> GP:
    """The exact GP of the samples with given kernels and noise."""
    parts = zip(found.groups, found.kernels, found.spreads, strict=True)
    exact = [condition_gp(k, data.x, data.y[:, g], s) for g, k, s in parts]
    weights = np.concatenate([p.alpha.T for p in exact])
    mean = np.concatenate([p.mean for p in exact])
    return _make_gp(
        data,
        found,
        outputs,
        unit,
        data.x,
        weights,
        np.array([inverse_lower(p.chol) for p in exact]),
        mean,
    )


def assemble_sparse_gp(
    data: Samples, found: FittedKernels, outputs: tuple[str, ...], unit: str
) -> GP:
    """The GP of all samples on inducing points."""
    bases = inducing_bases(data, found)
    parts = [
        sparse_posterior(base, sufficient_sums(base, data.x, data.y[:, g], s))
        for base, g, s in zip(bases, found.groups, found.spreads, strict=True)
    ]
    weights = np.concatenate([p.weights for p in parts])
    mean = np.concatenate([p.mean for p in parts])
    return _make_gp(
        data,
        found,
        outputs,
        unit,
        bases[0].centres,
        weights,
        np.array([p.factor for p in parts]),
        mean,
    )


def inducing_bases(data: Samples, found: FittedKernels) -> list[Basis]:
    """Each kernel on the common inducing points."""
    quietest = min(
        float(s.diagonal.min()) + k.noise for s, k in zip(found.spreads, found.kernels, strict=True)
    )
    centres = choose_inducing_points(found.kernels, data.x, quietest)
    return [build_basis(k, centres) for k in found.kernels]


def _make_gp(
    data: Samples,
    found: FittedKernels,
    outputs: tuple[str, ...],
    unit: str,
    centres: Array,
    weights: Array,
    factor: Array,
    mean: Array,
) -> GP:
    each = [
        np.ones(g.stop - g.start) * s.share
        for g, s in zip(found.groups, found.spreads, strict=True)
    ]
    return GP(
        outputs,
        unit,
        centres=centres,
        scales=np.array([k.scales for k in found.kernels]),
        amplitude=np.array([k.amplitude for k in found.kernels]),
        mean=mean,
        weights=np.ascontiguousarray(weights),
        factor=factor,
        noise=np.concatenate(
            [k.noise * share for k, share in zip(found.kernels, each, strict=True)]
        ),
        samples=data.x,
        targets=data.y,
        spread=np.hstack(
            [np.outer(s.diagonal, share) for s, share in zip(found.spreads, each, strict=True)]
        ),
    )


def _coupled_noise(data: Samples, slope: Array, diagonal: Array, white: float) -> Spread:
    known = independent_noise(diagonal, white)
    if data.coupling is None:
        return known
    c = data.coupling
    count = len(data.x)
    value = (slope[c.i, :, c.joint] * slope[c.j, :, c.joint] / known.share).mean(axis=1) * c.value
    place, into = np.unique(c.i * count + c.j, return_inverse=True)
    value = np.bincount(into, value, minlength=len(place))
    return replace(known, i=place // count, j=place % count, value=value)


def _column_deviations(values: Array) -> Array:
    deviation = values.std(axis=0)
    return np.where(deviation > 1e-9 * np.maximum(1.0, np.abs(values).max(axis=0)), deviation, 1.0)
