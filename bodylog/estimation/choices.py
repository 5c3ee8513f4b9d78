"""Which methods can run on which senses: the rows of a comparison."""

from itertools import combinations

import numpy as np

from ..types import BodyModel, Features

ENCODERS_ONLY = ("kalman",)
"""Methods whose model has no picture in it."""


def subsets(features: Features, body: BodyModel) -> list[tuple[str, ...]]:
    """Every non-empty choice among the senses a log has something from, all of them first."""
    here = [name for name, heard in _heard(features, body).items() if heard]
    return [chosen for size in range(len(here), 0, -1) for chosen in combinations(here, size)]


def usable(method: str, senses: tuple[str, ...]) -> bool:
    """Whether a method can use all these senses."""
    return senses == ("encoders",) if method in ENCODERS_ONLY else True


def _heard(features: Features, body: BodyModel) -> dict[str, bool]:
    seen = [name for name, track in features.tracks.items() if name in body.senses and np.isfinite(track.values).any()]
    felt = bool(features.touches and features.synchrony and features.hand is not None and "effector" in body.senses)
    return {"encoders": features.joints is not None, "vision": bool(seen), "touch": felt}
