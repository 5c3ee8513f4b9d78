"""E6, cost: learning grows as n³, prediction as N·n, a step as N·M. Multiplications are counted.

N and M grow together: separately, a fixed cost hides the difference of N + M and N·M.
"""

from collections.abc import Sequence

import numpy as np

from .claims import Bound, Claim
from .judging import judge_variants
from .lab import Lab
from .records import Experiment, ExperimentReadings, TextTable, Trial, figure_column

SAMPLES = (16, 32, 64)
"""Samples that are learned from, and predicted from."""
PREDICTED_SENSES = 2
SIZES = (8, 16, 32, 64)
"""Senses and as many joints."""
JOINTS = 3


def _run_cost(lab: Lab, seed: int, tried: ExperimentReadings) -> Trial:
    counted: dict[str, dict[int, int]] = {
        "learn": {n: factor_by_cholesky(_noisy_covariance(n))[1] for n in SAMPLES},
        "predict": {n: count_prediction(PREDICTED_SENSES, n, JOINTS) for n in SAMPLES},
        "dense step": {n: count_step(n, n, n) for n in SIZES},
        "sparse step": {n: count_step(n, n, 1) for n in SIZES},
    }
    figures = {f"{what} exponent": fit_exponent(counts) for what, counts in counted.items()}
    figures |= {
        f"{what} {size}": float(count)
        for what, counts in counted.items()
        for size, count in counts.items()
    }
    return {"figures": figures, "panels": []}


def fit_exponent(counts: dict[int, int]) -> float:
    """Slope of log count over log size, to six digits:
    the last bits of a logarithm depend on the processor.
    """
    return round(float(np.polyfit(np.log(list(counts)), np.log(list(counts.values())), 1)[0]), 6)


def _noisy_covariance(n: int) -> list[list[float]]:
    """K (n,n) of n places on a line, with noise on its diagonal."""
    at = np.linspace(-1.0, 1.0, n)
    found: list[list[float]] = (
        np.exp(-0.5 * np.square(at[:, None] - at)) + 0.01 * np.eye(n)
    ).tolist()
    return found


def factor_by_cholesky(matrix: list[list[float]]) -> tuple[list[list[float]], int]:
    """The lower factor of a positive definite matrix (n,n),
    and how many multiplications and divisions it took.
    """
    n = len(matrix)
    count = 0
    root = [[0.0] * n for _ in range(n)]
    for i in range(n):
        for j in range(i + 1):
            left = matrix[i][j]
            for k in range(j):
                left -= root[i][k] * root[j][k]
            count += j + 1
            root[i][j] = left**0.5 if i == j else left / root[j][j]
    return root, count


def count_prediction(senses: int, samples: int, joints: int) -> int:
    """Multiplications of k(x̂,X) α: squared distances over
    the joints, and a product for each sense, at every sample.
    """
    return samples * (joints + senses)


def count_step(senses: int, joints: int, each: int) -> int:
    """Multiplications of Σ_i e_i g_i′ where a sense
    depends on `each` joints, counted while they are done.
    """
    count = 0
    total = [0.0] * joints
    for i in range(senses):
        for j in range(each):
            total[(i + j) % joints] += 0.5 * 0.5
            count += 1
    return count


def _claim_cost(trials: Sequence[Trial], tried: ExperimentReadings) -> tuple[Claim, ...]:
    def claim(
        number: int, text: str, limit: float, names: dict[str, str], apart: str = "", why: str = ""
    ) -> Claim:
        figures = {
            label: figure_column(trials, f"{name} exponent") for label, name in names.items()
        }
        measured = "exponent of the multiplications"
        return judge_variants(
            f"E6.{number}", text, measured, "1", Bound("≤", limit), figures, apart, why
        )

    steps = {"dense slopes": "dense step", "one joint per sense": "sparse step"}
    return (
        claim(1, "learning costs at most O(n³) in n samples", 3.0, {"Cholesky": "learn"}),
        claim(2, "prediction of the means costs at most O(N · n)", 1.0, {"kernel row": "predict"}),
        claim(
            3,
            "a step of the optimisation costs at most O(N + M), N and M growing together",
            1.25,
            steps,
            "how many joints a sense depends on",
            "Σ_i e_i g_i′ has N·M products where every sense depends on every joint",
        ),
    )


def _tabulate_cost(trials: Sequence[Trial]) -> tuple[TextTable, ...]:
    names = [name for name in trials[0]["figures"] if not name.endswith("exponent")]
    rows = [(name, f"{figure_column(trials, name)[0]:.0f}") for name in names]
    return (
        TextTable(
            "Multiplications, by what is done and how large",
            ("what", "multiplications"),
            tuple(rows),
        ),
    )


EXPERIMENT = Experiment("E6", "What it costs", _run_cost, _claim_cost, (), _tabulate_cost)
