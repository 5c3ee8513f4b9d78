"""E6, cost: learning grows as n³, prediction as N·n, a step as N + M. Times differ from run to run, verdicts do not."""

from collections.abc import Callable, Sequence
from functools import partial
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from ..types import Array
from .lab import Lab
from .records import Bound, Claim, Experiment, Table, Trial, column, judge

if TYPE_CHECKING:
    from ..body.gp import GP

SAMPLES = (400, 800, 1600)
PREDICTED = (2000, 4000, 8000)
SENSES, JOINTS = (4, 8, 16), (3, 6, 12)
REPEATS = 9
STEPS = 20


def _run(lab: Lab, seed: int) -> Trial:
    rng = np.random.default_rng([seed, 6])
    costs: dict[str, dict[int, float]] = {
        "learn": {n: spent(_learning(n, rng)) for n in SAMPLES},
        "predict": {n: spent(_predicting(n, rng), 10) for n in PREDICTED},
        "predict ours": {n: spent(_with_variance(n, rng), 10) for n in (100, 200, 400)},
        "senses": {n: spent(_stepping(n, 3, rng)) / STEPS for n in SENSES},
        "joints": {m: spent(_stepping(2, m, rng)) / STEPS for m in JOINTS},
    }
    figures = {f"{what} exponent": exponent(by) for what, by in costs.items()}
    figures |= {f"{what} {size}": cost for what, by in costs.items() for size, cost in by.items()}
    return {"figures": figures, "panels": []}


def spent(work: Callable[[], object], times: int = 1) -> float:
    """Least seconds one call took, after a first that does not count."""
    work()
    found = []
    for _ in range(REPEATS):
        begun = perf_counter()
        for _ in range(times):
            work()
        found.append((perf_counter() - begun) / times)
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


def _with_variance(n: int, rng: np.random.Generator) -> Callable[[], object]:
    return partial(_body(n, 3, rng).predict, np.zeros((1, 3)))


def _body(n: int, m: int, rng: np.random.Generator) -> "GP":
    """A forward model of m joints learned from n samples, with the printed hyperparameters."""
    from ..body.paper import paper
    from ..body.train import build, samples

    data = samples(rng.uniform(-0.4, 0.4, (n, m)), rng.standard_normal((n, 2)))
    return build(data, paper(data), ("u", "v"), "px")


def _stepping(senses: int, joints: int, rng: np.random.Generator) -> Callable[[], object]:
    from ..estimation.methods.grid import Plan, Sense
    from ..estimation.methods.predictive_coding import explicitly

    model, t = _body(46, joints, rng), 0.05 * np.arange(STEPS)
    seen = np.zeros((STEPS, 2))
    heard = tuple(Sense(f"s{i}", seen, model, np.full(seen.shape, 5.0)) for i in range(senses))
    return partial(explicitly, Plan(heard, None, t, 0.05, np.ones(joints), np.zeros(joints)))


def _claims(trials: Sequence[Trial]) -> tuple[Claim, ...]:
    def claim(text: str, name: str, limit: float, of_ours: str | None = None, said: str = "") -> Claim:
        figures = _typical(trials, name), _typical(trials, of_ours or name)
        return judge("E6", text, "exponent of the measured cost", "1", Bound("≤", limit), figures, said)

    variance = "ours also predicts the variance, which costs n² up to 500 samples and inducing points above"
    return (
        claim("learning costs O(n³) in n samples", "learn", 3.3),
        claim("prediction of the mean costs O(n)", "predict", 1.3, "predict ours", variance),
        claim("a step costs at most O(N) in N senses", "senses", 1.25),
        claim("a step costs at most O(M) in M joints", "joints", 1.25),
    )


def _typical(trials: Sequence[Trial], name: str) -> list[float]:
    return [float(np.median(column(trials, f"{name} exponent")))]


def _tables(trials: Sequence[Trial]) -> tuple[Table, ...]:
    names = [name for name in trials[0]["figures"] if not name.endswith("exponent")]
    rows = [(name, f"{1e6 * np.median(column(trials, name)):.1f}") for name in names]
    return (Table("Least time, µs, by what is done and how large", ("what", "µs"), tuple(rows)),)


EXPERIMENT = Experiment("E6", "What it costs", _run, _claims, _tables)
