"""Colour names and HSV ranges."""

import cv2
import numpy as np
import pytest

from bodylog.errors import ConfigError
from bodylog.perception.colours import hsv_ranges
from bodylog.sources import NAMED_COLOURS


@pytest.mark.parametrize(
    ("name", "hue"), [("red", 0), ("red", 176), ("green", 60), ("yellow", 28), ("blue", 115)]
)
def test_colour_name_matches_only_its_own_hue(name: str, hue: int) -> None:
    hsv = np.array(
        [[[hue, 200, 200], [(hue + 90) % 180, 200, 200], [hue, 20, 200], [hue, 200, 10]]],
        dtype=np.uint8,
    )
    assert hsv_ranges.mask_of_range(hsv, hsv_ranges.resolve_colour(name, "effector")).tolist() == [
        [255, 0, 0, 0]
    ]


def test_low_hue_above_high_hue_wraps_round() -> None:
    wrapped = hsv_ranges.resolve_colour({"low": (170, 50, 50), "high": (10, 255, 255)}, "hand")
    hsv = np.stack([np.arange(180), np.full(180, 200), np.full(180, 200)], axis=1)[None].astype(
        np.uint8
    )
    assert np.flatnonzero(hsv_ranges.mask_of_range(hsv, wrapped)).tolist() == [
        *range(11),
        *range(170, 180),
    ]


def test_colour_names_have_a_range_and_round_trip() -> None:
    assert hsv_ranges.covered_hue_names(
        hsv_ranges.range_between((90, 0, 0), (89, 255, 255))
    ) == set(NAMED_COLOURS)
    for name in NAMED_COLOURS:
        ((low, high), *_) = hsv_ranges.resolve_colour(name, "effector").parts
        assert hsv_ranges.nearest_hue_name((low[0] + high[0]) / 2) == name


_UNSOUND = [
    {"low": (0, 0, 0)},
    {"low": (0, 0), "high": (1, 1)},
    {"low": (0, 0, 0), "high": (200, 0, 0)},
]


@pytest.mark.parametrize("bounds", _UNSOUND)
def test_unsound_bounds_are_named(bounds: dict[str, tuple[int, ...]]) -> None:
    with pytest.raises(ConfigError, match=r"colours\.elbow: found"):
        hsv_ranges.resolve_colour(bounds, "elbow")  # type: ignore[arg-type]


def test_ranges_are_those_of_opencv() -> None:
    green = np.zeros((1, 1, 3), dtype=np.uint8)
    green[..., 1] = 200
    assert (
        hsv_ranges.mask_of_range(
            cv2.cvtColor(green, cv2.COLOR_BGR2HSV), hsv_ranges.resolve_colour("green", "effector")
        )[0, 0]
        == 255
    )
