"""Statistics of images: the spread about the mean, whatever the mean."""

import numpy as np
import pytest

from bodylog.logs.datasets.statistics import Sampled, combine_statistics, of_numbers


def test_std_is_that_of_all_pixels() -> None:
    rng = np.random.default_rng(0)
    images = [rng.integers(low, low + 20, (64, 64, 3), dtype=np.uint8) for low in (0, 100, 235)]
    found = Sampled()
    for image in images:
        assert found.seen(image) is image
    pixels = np.concatenate([image[::8, ::8, ::-1].reshape(-1, 3) for image in images]) / 255.0
    stats = found.stats(len(images))
    assert np.ravel(stats["mean"]) == pytest.approx(pixels.mean(axis=0))
    assert np.ravel(stats["std"]) == pytest.approx(pixels.std(axis=0))


def test_images_of_one_colour_do_not_spread() -> None:
    found = Sampled()
    for _ in range(300):
        found.seen(np.full((64, 64, 3), 77, np.uint8))
    assert np.ravel(found.stats(300)["std"]).max() < 1e-15


def test_statistics_of_the_largest_numbers_are_finite() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(size=(40, 3)) * [1.0, 1e307, 1e-320]
    found = of_numbers(values)
    small = of_numbers(values / [1.0, 1e307, 1e-320])
    assert found["mean"][1] == pytest.approx(1e307 * small["mean"][1], rel=1e-12)
    assert found["std"][1] == pytest.approx(1e307 * small["std"][1], rel=1e-12)
    halves = combine_statistics([{"x": of_numbers(values[:25])}, {"x": of_numbers(values[25:])}])
    for name in ("mean", "std"):
        assert halves["x"][name] == pytest.approx(found[name], rel=1e-12)
