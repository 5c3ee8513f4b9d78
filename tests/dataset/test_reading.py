"""What one pass over an episode takes from its table."""

from types import SimpleNamespace

import numpy as np

from bodylog.dataset import reading


def test_readings_beyond_any_joint_are_missing_ones() -> None:
    """Squares of such values overflow, and no figure of the episode could be written."""
    values = np.array([[1.0, 2.0], [1e300, 3.0], [-2e9, np.inf]])
    signal = SimpleNamespace(metadata={}, ns=np.arange(3) * 10**9, values=values, names=("a", "b"))
    found = reading._stored_numbers(signal, 0)
    np.testing.assert_array_equal(found.values, [[1.0, 2.0], [np.nan, 3.0], [np.nan, np.nan]])
