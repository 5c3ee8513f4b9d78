import numpy as np

from bodylog.body.data.subsampling import (
    choose_farthest_rows,
    choose_pivot_rows,
    choose_spaced_rows,
)
from bodylog.body.gp.model import se_kernel


def test_farthest_points_cover_better_than_evenly_spaced_ones() -> None:
    x = np.random.default_rng(0).normal(0, 1, (3000, 3))

    def gap(rows: np.ndarray) -> float:
        return float(np.min(np.linalg.norm(x[:, None] - x[rows], axis=2), axis=1).max())

    rows = choose_farthest_rows(x, 60)
    assert len(rows) == 60 and (np.diff(rows) > 0).all()
    assert gap(rows) < 0.7 * gap(choose_spaced_rows(3000, 60))


def test_nothing_is_thinned_when_it_fits_and_duplicates_end_it() -> None:
    assert np.array_equal(choose_farthest_rows(np.zeros((4, 2)), 9), np.arange(4))
    assert len(choose_farthest_rows(np.zeros((40, 2)), 9)) == 1


def test_pivots_leave_no_more_variance_than_allowed() -> None:
    z = np.random.default_rng(0).uniform(-1, 1, (500, 2))
    rows = choose_pivot_rows(z, 400, 1e-6)
    gram, cross = se_kernel(z[rows], z[rows], 1.0), se_kernel(z, z[rows], 1.0)
    left = 1.0 - np.einsum("ij,ji->i", cross, np.linalg.solve(gram, cross.T))
    assert len(rows) < 60 and left.max() < 2e-6
    assert len(choose_pivot_rows(z, 7, 1e-6)) == 7
