import numpy as np
import pytest

from bodylog.bfgs import minimise_with_bfgs
from bodylog.types import Array


def _bowl(seed: int, count: int) -> tuple[Array, Array]:
    draw = np.random.default_rng(seed)
    root = draw.normal(size=(count, count))
    return root @ root.T + 0.1 * np.eye(count), draw.normal(size=count)


@pytest.mark.parametrize("seed", range(5))
def test_descend_solves_a_quadratic_in_one_step(seed: int) -> None:
    curvature, centre = _bowl(seed, 4)
    calls = []

    def loss(x: Array) -> tuple[float, Array]:
        calls.append(x)
        return 0.5 * float((x - centre) @ curvature @ (x - centre)), curvature @ (x - centre)

    wide = np.full(4, 50.0)
    assert np.allclose(minimise_with_bfgs(loss, np.zeros(4), -wide, wide, curvature).at, centre, atol=1e-4)
    assert len(calls) <= 3
    assert loss(minimise_with_bfgs(loss, np.zeros(4), -wide, wide, np.eye(4)).at)[0] < 1e-4


@pytest.mark.parametrize("seed", range(5))
def test_bounds_hold_and_free_variables_are_minimised(seed: int) -> None:
    curvature, centre = _bowl(seed, 3)

    def loss(x: Array) -> tuple[float, Array]:
        return 0.5 * float((x - centre) @ curvature @ (x - centre)), curvature @ (x - centre)

    low, high = np.array([centre[0] + 0.5, -9.0, -9.0]), np.full(3, 9.0)
    found = minimise_with_bfgs(loss, high.copy(), low, high, np.eye(3)).at
    assert found[0] == low[0]
    rest = centre[1:] - np.linalg.solve(curvature[1:, 1:], curvature[1:, 0]) * 0.5
    assert np.allclose(found[1:], rest, atol=2e-3)


def test_descend_follows_a_bent_valley_to_its_end() -> None:
    def rosenbrock(x: Array) -> tuple[float, Array]:
        a, b = 1 - x[0], x[1] - x[0] ** 2
        return float(a * a + 100 * b * b), np.array([-2 * a - 400 * x[0] * b, 200 * b])

    wide = np.full(2, 5.0)
    assert np.allclose(minimise_with_bfgs(rosenbrock, np.array([-1.2, 1.0]), -wide, wide, np.eye(2)).at, 1.0, atol=1e-3)


def test_descend_stops_where_no_step_lowers_the_value() -> None:
    wide = np.ones(2)
    assert np.array_equal(minimise_with_bfgs(lambda x: (0.0, np.zeros(2)), np.zeros(2), -wide, wide, np.eye(2)).at, np.zeros(2))
    # a wrong gradient: no step finds a lower value
    assert np.array_equal(minimise_with_bfgs(lambda x: (0.0, np.ones(2)), np.zeros(2), -wide, wide, np.eye(2)).at, np.zeros(2))
