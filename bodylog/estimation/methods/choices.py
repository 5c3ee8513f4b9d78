"""Which methods can run on which senses, the rows of a comparison; and which settings a method does not heed."""

from itertools import combinations
from typing import Any

import numpy as np

from ...body_model import BodyModel
from ...settings import Estimation
from ...types import Features, Finding
from ..measurements.gather import chosen
from .table import METHODS

UNHEEDED = (("bias", "on"), ("precision", "model"))
"""Settings that say how lies and noise are told from the log, which the paper's methods do not ask."""


def subsets(features: Features, body: BodyModel, settings: Estimation) -> tuple[list[tuple[str, ...]], tuple[str, ...]]:
    """Every non-empty choice among the senses that may be heard and say something, all of them first.

    And the joints and tracks that may not be heard by any. UsageError where the settings name what there is not.
    """
    visual = [name for name in features.tracks if name in body.senses]
    wanted = chosen(visual, body, settings)
    here = [name for name, heard in _heard(features, body, wanted).items() if heard]
    rows = [some for size in range(len(here), 0, -1) for some in combinations(here, size)]
    return rows, tuple(name for name in (*body.joints, *visual) if name not in wanted)


def usable(method: str, senses: tuple[str, ...]) -> bool:
    """Whether a method can use all these senses."""
    return METHODS[method].senses.issuperset(senses)


def _heard(features: Features, body: BodyModel, wanted: set[str]) -> dict[str, bool]:
    joints, visual = features.joints, wanted & set(body.senses)
    tracks = [track for name, track in features.tracks.items() if name in visual]
    told = joints is not None and any(
        np.isfinite(column).any() for name, column in zip(joints.names, joints.values.T, strict=True) if name in wanted
    )
    felt = bool(features.touches and features.synchrony and features.hand is not None and "effector" in body.senses)
    seen = any(np.isfinite(track.values).all(axis=1).any() for track in tracks)
    return {"encoders": told, "vision": seen, "touch": felt and "touch" in wanted}


def unheeded(settings: Estimation) -> tuple[Finding, ...]:
    """Warnings for settings that were given, being no defaults, and that the method passes by."""
    heeds = METHODS[settings.method].heeds if settings.preset != "paper" else frozenset[str]()
    typed = [key for key in settings.typed if key not in METHODS[settings.method].heeds]
    by = f"{settings.method}{' with the preset paper' * (settings.preset == 'paper')}"
    passed: dict[str, Any] = {name: value for name, value in UNHEEDED if name not in heeds}
    passed = {name: value for name, value in passed.items() if getattr(settings, name) == value}
    passed |= {key: settings.typed[key] for key in typed}
    return tuple(
        Finding("warning", f"{name}: {value!r} is not heeded by {by}; leave it out, or type --method laplace")
        for name, value in passed.items()
    )
