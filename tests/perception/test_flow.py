"""Flow between the frames of a film, by cells of a grid."""

from functools import partial

import numpy as np
import pytest

from bodylog.perception.surface.flow import measure_grid_flow
from bodylog.types import Array, LazyImage


def _moving_film(height: int, width: int) -> list[LazyImage]:
    picture = np.random.default_rng(0).integers(0, 255, (height, width), dtype=np.uint8)

    def shifted(number: int, _: int) -> Array:
        return np.roll(picture, 2 * number, axis=1)

    return [LazyImage(0.1 * number, number, partial(shifted, number)) for number in range(4)]


@pytest.mark.parametrize("size", [(2, 320), (11, 11), (8, 8), (300, 1), (1, 1)])
def test_pictures_of_a_few_pixels_have_no_flow(size: tuple[int, int]) -> None:
    seen = measure_grid_flow(_moving_film(*size))
    assert seen is not None and not seen.flow.any()


def test_flow_follows_a_picture_that_moves() -> None:
    rng = np.random.default_rng(1)
    wide = np.kron(rng.integers(0, 255, (12, 20)), np.ones((10, 10))).astype(np.uint8)
    film = [LazyImage(0.1 * k, k, lambda _, k=k: np.roll(wide, 2 * k, axis=1)) for k in range(4)]
    seen = measure_grid_flow(film)
    assert seen is not None and np.median(seen.flow[..., 0]) == pytest.approx(2.0, abs=0.3)
