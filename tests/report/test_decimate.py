import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bodylog.report.page.decimate import extreme_indices, thin_band, thin_curve


@given(st.integers(0, 5000), st.integers(3, 900), st.integers(0, 2**32 - 1))
def test_thinning_keeps_the_extremes_the_ends_and_the_order(n, points, seed):
    values = np.random.default_rng(seed).normal(size=n)
    keep = extreme_indices(values, points)
    assert len(keep) <= max(points, 3) + 2
    assert (np.diff(keep) > 0).all()
    if n:
        assert (values[keep].min(), values[keep].max()) == (values.min(), values.max())
        assert (keep[0], keep[-1]) == (0, n - 1)


@pytest.mark.parametrize("seed", range(5))
def test_thin_keeps_one_gap_in_a_million(seed):
    values = np.random.default_rng(seed).normal(size=1_000_000)
    hole = 123_456 + 99_999 * seed
    values[hole] = np.nan
    t, kept = thin_curve(np.arange(1e6), values, 2000)
    assert t[np.isnan(kept)].tolist() == [hole]


def test_thin_keeps_a_series_without_values():
    assert np.isnan(thin_curve(np.arange(1e4), np.full(10_000, np.nan), 300)[1]).all()


@given(st.integers(1, 4000), st.integers(1, 500), st.integers(0, 2**32 - 1))
def test_envelope_is_never_narrower_than_the_band(n, points, seed):
    rng = np.random.default_rng(seed)
    low = rng.normal(size=n)
    high = low + rng.gamma(1.0, size=n)
    t, below, above = thin_band(np.arange(float(n)), low, high, points)
    assert len(t) <= max(n if n <= points else 0, points) and (np.diff(t) > 0).all()
    assert (below.min(), above.max()) == (low.min(), high.max())
    assert (below <= low[t.astype(int)]).all() and (above >= high[t.astype(int)]).all()
