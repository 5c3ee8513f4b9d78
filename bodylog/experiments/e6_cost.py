"""E6, cost: learning grows as n³, prediction as N·n, a step as N + M. Times differ from run to run, verdicts do not.

N and M grow together: separately, a fixed cost hides the difference of N + M and N·M.
"""

from collections.abc import Callable, Sequence
from time import perf_counter

import numpy as np

from ..types import Array
from .judging import Bound, Claim, variants
from .lab import Lab
from .printed import DT
from .records import Experiment, Readings, Table, Trial, column

SAMPLES = (400, 800, 1600)
PREDICTED = (2000, 4000, 8000)
SIZES = (512, 1024, 2048)
"""Senses and as many joints."""
REPEATS = 9


def _run(lab: Lab, seed: int, tried: Readings) -> Trial:
    rng = np.random.default_rng([seed, 6])
    costs: dict[str, dict[int, float]] = {
        "learn": {n: spent(_learning(n, rng)) for n in SAMPLES},
        "predict": {n: spent(_predicting(n, rng), 10) for n in PREDICTED},
        "step": {n: spent(_stepping(n, n, rng)) for n in SIZES},
        "sparse step": {n: spent(_sparse(8 * n, 8 * n, rng)) for n in SIZES},
    }
    figures = {f"{what} exponent": exponent(by) for what, by in costs.items()}
    figures |= {f"{what} {size}": cost for what, by in costs.items() for size, cost in by.items()}
    return {"figures": figures, "panels": []}


def spent(work: Callable[[], object], times: int = 1) -> float:
    """Least seconds of one call, after a first that does not count."""
    work()
    found = []
    for _ in range(REPEATS):
        started = perf_counter()
        for _ in range(times):
            work()
        found.append((perf_counter() - started) / times)
    return min(found)


def exponent(costs: dict[int, float]) -> float:
    """Slope of log cost over log size."""
    return float(np.polyfit(np.log(list(costs)), np.log(list(costs.values())), 1)[0])


def _learning(n: int, rng: np.random.Generator) -> Callable[[], object]:
    k = _covariance(rng.uniform(-0.4, 0.4, (n, 3)))
    s = rng.standard_normal((n, 2))

    def learn() -> Array:
        """α = K⁻¹ s by Cholesky (Algorithm 1)."""
        root = np.linalg.cholesky(k)
        return np.linalg.solve(root.T, np.linalg.solve(root, s))

    return learn


def _covariance(x: Array) -> Array:
    """K (n,n) with noise on its diagonal."""
    apart = np.square(x[:, None] - x[None]).sum(axis=2)
    return np.asarray(np.exp(-0.5 * apart) + 0.01 * np.eye(len(x)))


def _predicting(n: int, rng: np.random.Generator) -> Callable[[], object]:
    x, weights, at = rng.uniform(-0.4, 0.4, (n, 3)), rng.standard_normal((n, 2)), np.zeros(3)
    return lambda: np.exp(-0.5 * np.square(at - x).sum(axis=1)) @ weights


def _stepping(senses: int, joints: int, rng: np.random.Generator) -> Callable[[], object]:
    """One step of the belief (Eq. partialF1), every sense's slope over all joints."""
    slopes, e, x, ex = (
        rng.standard_normal((senses, joints)),
        rng.standard_normal(senses),
        np.zeros(joints),
        np.zeros(joints),
    )
    return lambda: x + DT * (-ex + e @ slopes)


def _sparse(senses: int, joints: int, rng: np.random.Generator) -> Callable[[], object]:
    """The same step when a sense depends on one joint, as an encoder does."""
    slopes, e, x, ex = rng.standard_normal(senses), rng.standard_normal(senses), np.zeros(joints), np.zeros(joints)
    which = rng.integers(joints, size=senses)
    return lambda: x + DT * (-ex + np.bincount(which, e * slopes, joints))


def counted(senses: int, joints: int, each: int) -> int:
    """Multiplications of Σ_i e_i g_i′ where a sense depends on `each` joints, counted while they are done."""
    count, total = 0, [0.0] * joints
    for i in range(senses):
        for j in range(each):
            total[(i + j) % joints] += 0.5 * 0.5
            count += 1
    return count


def _claims(trials: Sequence[Trial], tried: Readings) -> tuple[Claim, ...]:
    def claim(number: int, text: str, name: str, limit: float) -> Claim:
        found = {"timed": _typical(trials, name)}
        return variants(f"E6.{number}", text, "exponent of the measured cost", "1", Bound("≤", limit), found, "")

    counts = {
        "dense slopes, multiplications counted": [_power(counted, lambda n: n)],
        "one joint per sense, multiplications counted": [_power(counted, lambda n: 1)],
    }
    timed = {
        "dense slopes, timed": _typical(trials, "step"),
        "one joint per sense, timed": _typical(trials, "sparse step"),
    }
    explanation = "Σ_i e_i g_i′ has N·M products where every sense depends on every joint"
    return (
        claim(1, "learning costs at most O(n³) in n samples", "learn", 3.3),
        claim(2, "prediction of the means costs at most O(N · n)", "predict", 1.3),
        variants(
            "E6.3",
            "a step of the optimisation costs at most O(N + M)",
            "exponent of the cost, N and M growing together",
            "1",
            Bound("≤", 1.25),
            {**timed, **counts},
            "how many joints a sense depends on",
            explanation,
        ),
    )


def _power(count: Callable[[int, int, int], int], each: Callable[[int], int]) -> float:
    return exponent({n: float(count(n, n, each(n))) for n in (8, 16, 32, 64)})


def _typical(trials: Sequence[Trial], name: str) -> list[float]:
    return [float(np.median(column(trials, f"{name} exponent")))]


def _tables(trials: Sequence[Trial]) -> tuple[Table, ...]:
    names = [name for name in trials[0]["figures"] if not name.endswith("exponent")]
    rows = [(name, f"{1e6 * np.median(column(trials, name)):.1f}") for name in names]
    return (Table("Least time, µs, by what is done and how large", ("what", "µs"), tuple(rows)),)


EXPERIMENT = Experiment("E6", "What it costs", _run, _claims, (), _tables)
