"""Statistics of features and images, as LeRobot
stores them: per episode, and for the whole dataset.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..records import Array

_QUANTILE = re.compile(r"q(\d\d)")
_SAMPLE = 8
"""px between the pixels used for an image's statistics."""


def of_numbers(values: Array) -> dict[str, Any]:
    """Minimum, maximum, mean and std of each column
    over its finite numbers, and the number of rows.
    """
    table = np.where(np.isfinite(values.astype(float)), values.astype(float), np.nan).reshape(
        len(values), -1
    )
    known = np.isfinite(table).any(axis=0)
    safe = np.where(known, table, 0.0)
    scale = _power_of_two_above(safe)
    found = {
        "min": np.nanmin(safe, axis=0),
        "max": np.nanmax(safe, axis=0),
        "mean": np.nanmean(safe / scale, axis=0) * scale,
        "std": np.nanstd(safe / scale, axis=0) * scale,
    }
    return {name: values.tolist() for name, values in found.items()} | {"count": [len(table)]}


def _power_of_two_above(table: Array) -> Array:
    """A power of two above each column's finite numbers, (N,K) to (K,): dividing by it is exact, and
    no square of the quotients overflows."""
    _, exponents = np.frexp(np.nanmax(np.abs(table), axis=0, initial=0.0))
    return np.asarray(np.ldexp(1.0, np.clip(exponents, 0, 1023)))


def measure_like(values: Array, like: Mapping[str, Any]) -> dict[str, Any]:
    """Statistics of numbers (N,K) with the keys of others: min, max, mean, std, count, and
    quantiles by their names, q01 to q99; of no others, as `of_numbers`."""
    found = of_numbers(values)
    if not like:
        return found
    table = values.astype(float).reshape(len(values), -1)
    for key in like:
        if (match := _QUANTILE.fullmatch(key)) and np.isfinite(table).all():
            found[key] = np.quantile(table, int(match[1]) / 100.0, axis=0).tolist()
    return {key: found[key] for key in like if key in found}


class Sampled:
    """Statistics of a stream of images, from every eighth pixel and line, in RGB from 0 to 1."""

    def __init__(self) -> None:
        """Start without images."""
        self._mean = np.zeros(3)
        self._squares = np.zeros(3)  # of distances from the mean
        self._ends = np.array([[1.0] * 3, [0.0] * 3])
        self._count = 0

    def seen(self, image: Array) -> Array:
        """Add an image to the statistics and return it."""
        some = image[::_SAMPLE, ::_SAMPLE, ::-1].reshape(-1, 3) / 255.0
        self._merge(some)
        low = np.minimum(self._ends[0], some.min(axis=0))
        high = np.maximum(self._ends[1], some.max(axis=0))
        self._ends = np.array([low, high])
        return image

    def _merge(self, some: Array) -> None:
        """Join pixels (n,3) to the mean and squares around it (Chan, Golub & LeVeque 1983)."""
        mean = some.mean(axis=0)
        apart = mean - self._mean
        total = self._count + len(some)
        self._squares += np.square(some - mean).sum(axis=0) + apart**2 * (
            self._count * len(some) / total
        )
        self._mean = self._mean + apart * (len(some) / total)
        self._count = total

    def stats(self, count: int) -> dict[str, Any]:
        """Minimum, maximum, mean and std of each channel (3,1,1), and the number of images."""
        std = np.sqrt(self._squares / self._count)
        found = {"min": self._ends[0], "max": self._ends[1], "mean": self._mean, "std": std}
        return {name: values.reshape(3, 1, 1).tolist() for name, values in found.items()} | {
            "count": [count]
        }


def combine_statistics(
    stats: Sequence[Mapping[str, Mapping[str, Any]]],
) -> dict[str, dict[str, Any]]:
    """Combine the statistics of all episodes."""
    return (
        {name: _combine_feature_statistics([one[name] for one in stats]) for name in stats[0]}
        if stats
        else {}
    )


def _combine_feature_statistics(parts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    counts = np.array([one["count"][0] for one in parts], float)
    mean, std = (np.array([one[key] for one in parts], float) for key in ("mean", "std"))
    scale = np.maximum(_power_of_two_above(mean), _power_of_two_above(std))
    weight = (counts / counts.sum()).reshape(-1, *[1] * (mean.ndim - 1))
    whole = (weight * mean).sum(axis=0)
    apart = (mean - whole) / scale
    spread = scale * np.sqrt((weight * ((std / scale) ** 2 + apart**2)).sum(axis=0))
    return {
        "min": np.min([one["min"] for one in parts], axis=0).tolist(),
        "max": np.max([one["max"] for one in parts], axis=0).tolist(),
        "mean": whole.tolist(),
        "std": spread.tolist(),
        "count": [int(counts.sum())],
    }
