import numpy as np
import pytest

from bodylog.linear_algebra import selected_inverse
from bodylog.motion import (
    band_storage,
    motion_covariance,
    motion_log_determinant,
    motion_precision,
    motion_transition,
    solve_banded_system,
)
from bodylog.types import Array


def _random(seed: int, count: int, order: int) -> tuple[Array, Array, Array]:
    """Blocks of a random motion observed with noise, and the same as one dense matrix."""
    draw = np.random.default_rng(seed)
    diagonal, upper = motion_precision(order, draw.uniform(0.2, 2.0, count - 1))
    diagonal = diagonal + draw.uniform(0.5, 1.0, (count, 1, 1)) * np.eye(order)
    dense = np.zeros((count * order, count * order))
    for k in range(count):
        rows = slice(k * order, (k + 1) * order)
        dense[rows, rows] = diagonal[k]
        if k + 1 < count:
            after = slice((k + 1) * order, (k + 2) * order)
            dense[rows, after], dense[after, rows] = upper[k], upper[k].T
    return diagonal, upper, dense


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("count", [1, 2, 3, 4, 7, 16, 33])
def test_blocks_of_the_inverse_and_solutions_are_those_of_the_dense_matrix(count: int, order: int) -> None:
    diagonal, upper, dense = _random(count, count, order)
    inverse = np.linalg.inv(dense).reshape(count, order, count, order)
    own, between = selected_inverse(diagonal, upper)
    for k in range(count):
        assert np.allclose(own[k], inverse[k, :, k], rtol=1e-6, atol=1e-9)
    for k in range(count - 1):
        assert np.allclose(between[k], inverse[k, :, k + 1], rtol=1e-6, atol=1e-9)
    right = np.random.default_rng(0).normal(size=(count * order, 3))
    logdet, solved = solve_banded_system(band_storage(diagonal, upper), right)
    assert logdet == pytest.approx(np.linalg.slogdet(dense)[1])
    assert np.allclose(dense @ solved, right, atol=1e-8)


@pytest.mark.parametrize("order", [2, 3])
def test_precision_is_that_of_the_chain_given_its_start(order: int) -> None:
    gap = np.array([0.5, 1.7, 0.9])
    step, noise = motion_transition(order, gap), motion_covariance(order, gap)
    chain, left = np.zeros((4 * order, 4 * order)), np.eye(4 * order)
    for k in range(3):
        now, after = slice(k * order, (k + 1) * order), slice((k + 1) * order, (k + 2) * order)
        left[after, now] = -step[k]
        chain[after, after] = np.linalg.inv(noise[k])
    diagonal, upper = motion_precision(order, gap)
    expected = (left.T @ chain @ left).reshape(4, order, 4, order)
    for k in range(4):
        assert np.allclose(diagonal[k], expected[k, :, k])
    for k in range(3):
        assert np.allclose(upper[k], expected[k, :, k + 1])
    inner = chain[order:, order:]
    assert motion_log_determinant(order, gap) == pytest.approx(np.linalg.slogdet(inner)[1])


@pytest.mark.parametrize("order", [2, 3])
def test_transition_of_two_steps_is_one_long_step(order: int) -> None:
    one, two, both = np.array([0.7]), np.array([0.4]), np.array([1.1])
    assert np.allclose(motion_transition(order, two) @ motion_transition(order, one), motion_transition(order, both))
    later = motion_transition(order, two)[0]
    grown = later @ motion_covariance(order, one)[0] @ later.T + motion_covariance(order, two)[0]
    assert np.allclose(grown, motion_covariance(order, both)[0])


def test_solve_refuses_an_indefinite_matrix() -> None:
    with pytest.raises(np.linalg.LinAlgError, match="too stiff"):
        solve_banded_system(band_storage(-np.eye(2)[None], np.zeros((0, 2, 2))), np.ones((2, 1)))
