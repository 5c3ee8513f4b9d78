import numpy as np
import pytest

from bodylog.sim import motion

POINTS = motion.spread_points(12, np.array([0.4, 0.3, 0.0]), np.random.default_rng(0))


PATHS = {
    "wander": motion.wander_through_points(POINTS, 1.0),
    "reaches": motion.reach_between_points(POINTS, 1.5),
    "still": motion.stand_still(POINTS[0]),
}


@pytest.mark.parametrize("path", PATHS.values(), ids=PATHS)
def test_rate_is_the_derivative_of_position(path):
    t = np.linspace(0.01, 10, 700)
    difference = (path.position(t + 1e-5) - path.position(t - 1e-5)) / 2e-5
    np.testing.assert_allclose(path.rate(t), difference, atol=1e-5)


def test_paths_go_through_their_points():
    t = np.arange(12.0)
    np.testing.assert_allclose(
        motion.wander_through_points(POINTS, 1.0).position(t), POINTS, atol=1e-12
    )
    np.testing.assert_allclose(
        motion.reach_between_points(POINTS, 1.0).position(t), POINTS, atol=1e-12
    )


def test_reaches_rest_at_every_point():
    np.testing.assert_allclose(
        motion.reach_between_points(POINTS, 1.5).rate(np.arange(12) * 1.5), 0.0, atol=1e-9
    )


@pytest.mark.parametrize("seed", range(5))
def test_spread_fills_the_box_evenly(seed):
    swing = np.array([0.4, 0.3, 0.2])
    points = motion.spread_points(64, swing, np.random.default_rng(seed))
    assert np.all(np.abs(points) <= swing)
    for axis in range(3):
        counts = np.histogram(points[:, axis], 8, (-swing[axis], swing[axis]))[0]
        assert counts.min() >= 5 and counts.max() <= 11
    # Of the 27 cells of a 3 x 3 x 3 grid none stays empty, which chance alone would leave about two of.
    cells = np.clip(((points / swing + 1) * 1.5).astype(int), 0, 2)
    assert len({tuple(cell) for cell in cells}) == 27
