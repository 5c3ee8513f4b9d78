"""Body learning beside scikit-learn and LAPACK: python -m tests.benchmarks.bench_body [--long | --figure PNG]."""

import resource
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bodylog.body.gp.fit import CANDIDATES, Samples, build_gp, fit_kernels, samples_without_noise
from bodylog.body.gp.marginal_likelihood import (
    FLAT,
    ROTATION,
    independent_noise,
    log_marginal_likelihood,
)
from bodylog.body.gp.model import GP, drop_negligible_rows
from bodylog.types import Array

from .goals import unmeasured
from .timing import side_by_side

_LOW, _HIGH = np.array([-0.8, -0.4, 0.1]), np.array([0.8, 0.9, 1.2])
_NOISE_PX = 0.3
_STARTS = 4


def project(q: Array) -> Array:
    """Pixels (N,2) of a three-joint arm's end effector at q (N,3) rad."""
    pan, lift, elbow = q.T
    reach = 0.42 * np.cos(lift) + 0.39 * np.cos(lift + elbow)
    height = 0.42 * np.sin(lift) + 0.39 * np.sin(lift + elbow)
    depth = 1.6 - reach * np.cos(pan)
    return np.column_stack([160 + 280 * reach * np.sin(pan) / depth, 120 - 280 * (height - 0.3) / depth])


def drawn(count: int, seed: int = 0) -> Samples:
    """Samples of the arm at random angles, with pixel noise."""
    draw = np.random.default_rng(seed)
    x = draw.uniform(_LOW, _HIGH, (count, 3))
    return samples_without_noise(x, project(x) + draw.normal(0, _NOISE_PX, (count, 2)))


def error(gp: GP) -> float:
    """Root mean square error against the true arm, px, at 2000 fresh angles."""
    x = np.random.default_rng(99).uniform(_LOW, _HIGH, (2000, 3))
    return float(np.sqrt(np.mean((gp.means(x)[0] - project(x)) ** 2)))


def exact(data: Samples) -> GP:
    """The exact GP, hyperparameters by evidence on all the samples."""
    count = len(data.x)
    return build_gp(data, fit_kernels(data, FLAT, True, 0, count), ("u", "v"), "px", count)


def peer(data: Samples, gp: GP | None = None, restarts: int = 0) -> object | None:
    """scikit-learn's regressor for the same model, fitted by its own optimiser, or with gp's hyperparameters."""
    try:
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
    except ImportError:
        return None
    centre = data.y.mean(axis=0) if gp is None else gp.mean
    variance = float(data.y.var())
    amplitude, scales, noise = (variance, 2 * data.x.std(axis=0), 0.01 * variance)
    if gp is not None:
        amplitude, scales, noise = gp.amplitude[0], gp.scales[0], gp.noise[0]
    shape = ConstantKernel(amplitude, (1e-3, 1e9)) * RBF(scales, (1e-3, 1e3)) + WhiteKernel(noise, (1e-9, 1e6))
    alpha = 1e-10 * float(amplitude)
    optimizer = "fmin_l_bfgs_b" if gp is None else None
    regressor = GaussianProcessRegressor(
        shape, alpha=alpha, optimizer=optimizer, n_restarts_optimizer=restarts, random_state=0
    )
    return regressor.fit(data.x, data.y - centre)


def agree(count: int) -> None:
    """Evidence and prediction of both at the same hyperparameters."""
    data = drawn(count)
    gp = exact(data)
    other = peer(data, gp)
    x = np.random.default_rng(5).uniform(_LOW, _HIGH, (500, 3))
    theta = np.log(np.concatenate([gp.amplitude, gp.scales[0], gp.noise[:1]]))
    ours = log_marginal_likelihood(theta, data.x, data.y, independent_noise(np.zeros(count)))[0]
    value, std = other.predict(x, return_std=True)
    mean, _, spread = drop_negligible_rows(gp).predict(x)
    apart = abs(ours / other.log_marginal_likelihood_value_ - 1)
    # its standard deviation is that of a reading: the noise is in it
    wide, off = np.abs(np.sqrt(spread + gp.noise) / std - 1).max(), np.abs(value + gp.mean - mean).max()
    print(f"  n={count}: evidence {apart:.1e} relative, mean {off:.1e} px, standard deviation {wide:.1e} relative")


def fits(count: int) -> None:
    """One fit of each, ten where a single one is too short to time."""
    data, rounds = drawn(count), 10 if count < 100 else 1

    def repeat(once: Callable[[], object]) -> Callable[[], object]:
        return lambda: [once() for _ in range(rounds)]

    cases = {f"bodylog, best of {CANDIDATES} guesses": repeat(lambda: exact(data))}
    if peer(drawn(10)) is not None:
        cases["scikit-learn, 1 start"] = repeat(lambda: peer(data))
        if count < 100:
            cases[f"scikit-learn, {_STARTS} starts"] = repeat(lambda: peer(data, restarts=_STARTS - 1))
    title = f"Fit, n = {count}, 2 outputs, {rounds} times"
    if count < 1000:
        side_by_side(title, cases, 3)
        return
    print(f"\n{title}")
    for name, case in cases.items():
        started = time.perf_counter()
        case()
        print(f"  {name:<52} {time.perf_counter() - started:10.2f} s")


def single(count: int) -> None:
    """Mean, Jacobian and variance at one point; the peer by central differences, its seven points in one call."""
    data = drawn(count)
    gp, rounds = drop_negligible_rows(exact(data)), 300
    x, steps = np.array([0.1, 0.2, 0.6]), np.vstack([np.zeros((1, 3)), 1e-5 * np.eye(3), -1e-5 * np.eye(3)])

    def repeat(once: Callable[[], object]) -> Callable[[], object]:
        return lambda: [once() for _ in range(rounds)]

    cases = {
        "mean, Jacobian, variance": repeat(lambda: gp.predict_one(x)),
        "the variance's matrix times one vector alone": repeat(lambda: gp.factor[0] @ gp.weights[0]),
    }
    other = peer(data, gp)
    if other is not None:
        around = x + steps
        cases["scikit-learn predict(return_std), differences"] = repeat(lambda: other.predict(around, return_std=True))
    side_by_side(f"One point, n = {count}, rank {gp.factor.shape[1]}, {rounds} times", cases, 3)


@dataclass(frozen=True)
class Point:
    """n samples: error (px) and seconds of the exact posterior (NaN where not run), and on inducing points."""

    count: int
    exact_px: float
    exact_s: float
    inducing: int
    sparse_px: float
    sparse_s: float


def curve() -> list[Point]:
    """Learning curve and what it costs: exact to 2000, on inducing points beyond."""
    print("\nLearning curve (rms error against the true arm, px) and seconds to fit")
    print("| n | exact px | exact s | centres | default px | default s |\n|---|---|---|---|---|---|")
    _point(10)  # the first brings the imports
    points = [_point(count) for count in (10, 20, 46, 100, 200, 500, 1000, 2000, 10_000, 100_000)]
    for p in points:
        row = ["", ""] if np.isnan(p.exact_s) else [f"{p.exact_px:.3f}", f"{p.exact_s:.3f}"]
        print(f"| {p.count} | {row[0]} | {row[1]} | {p.inducing} | {p.sparse_px:.3f} | {p.sparse_s:.3f} |")
    print(f"  peak memory so far {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB")
    return points


def _point(count: int) -> Point:
    data = drawn(count)
    px, seconds = float("nan"), float("nan")
    if count <= 2000:
        started = time.process_time()
        gp = exact(data)
        seconds, px = time.process_time() - started, error(gp)
    started = time.process_time()
    gp = build_gp(data, fit_kernels(data, ROTATION, True, 0), ("u", "v"), "px")
    return Point(count, px, seconds, len(gp.centres), error(gp), time.process_time() - started)


def draw(points: list[Point], out: Path) -> None:
    """The curve as a picture: error and seconds over samples, both axes logarithmic, with lines of n and n³."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    n = np.array([p.count for p in points], float)
    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.2), layout="constrained")
    left.loglog(n, [p.exact_px for p in points], "o-", label="exact")
    left.loglog(n, [p.sparse_px for p in points], "s--", label="as fit does it")
    left.axhline(_NOISE_PX, color="grey", lw=0.8)
    left.set(xlabel="samples", ylabel="error against the true arm, px")
    right.loglog(n, [p.exact_s for p in points], "o-", label="exact")
    right.loglog(n, [p.sparse_s for p in points], "s--", label="as fit does it")
    top, last = next(p for p in points if p.count == 2000), points[-1]
    cube, line = n[(n >= 200) & (n <= 2000)], n[n >= 2000]
    right.loglog(cube, top.exact_s * (cube / 2000) ** 3, ":", color="grey", label="n³ and n")
    right.loglog(line, last.sparse_s * line / last.count, ":", color="grey")
    right.set(xlabel="samples", ylabel="seconds to fit, one core")
    for axes in (left, right):
        axes.legend(frameon=False)
        axes.grid(alpha=0.3)
    figure.savefig(out, dpi=90, metadata={"Software": None})
    plt.close(figure)
    print(f"  drawn: {out}")


def large() -> None:
    """100,000 samples on inducing points against the exact posterior of 3,000 of them."""
    data = drawn(100_000)
    started = time.perf_counter()
    found = fit_kernels(data, ROTATION, True, 0)
    gp = build_gp(data, found, ("u", "v"), "px")
    seconds = time.perf_counter() - started
    part = data.rows(np.arange(3000))
    few = build_gp(part, fit_kernels(part, ROTATION, True, 0), ("u", "v"), "px", 3000)
    print(f"\nn = 100,000: {seconds:.1f} s, {len(gp.centres)} inducing points, error {error(gp):.4f} px", end="")
    print(f" (exact posterior of 3,000: {error(few):.4f} px)")


def main() -> None:
    """Print everything; --long adds the fit at n = 2000, minutes for the peer; --figure PNG draws the curve alone."""
    if "--figure" in sys.argv:
        draw(curve(), Path(sys.argv[sys.argv.index("--figure") + 1]))
        return
    warnings.simplefilter("ignore")
    if peer(drawn(10)) is None:
        unmeasured("learning, beside scikit-learn", "scikit-learn is not installed: pip install 'bodylog[bench]'")
    else:
        print("Agreement with scikit-learn at the same hyperparameters")
        for count in (46, 500):
            agree(count)
    for count in (46, 500, *((2000,) if "--long" in sys.argv else ())):
        fits(count)
    for count in (46, 500):
        single(count)
    large()
    curve()


if __name__ == "__main__":
    main()
