"""Which methods can use which senses, for the rows of a comparison; and which settings a method ignores."""

from itertools import combinations

from ...body_model import BodyModel
from ...settings import Estimation
from ...types import Features, Finding
from ..measurements.gather import chosen, gather
from .table import METHODS


def subsets(features: Features, body: BodyModel, settings: Estimation) -> tuple[list[tuple[str, ...]], tuple[str, ...]]:
    """Every non-empty subset of the senses that are allowed and have readings, all of them first.

    Also the excluded joints and tracks. UsageError if the settings name an unknown one.
    """
    used = gather(features, body, settings).used
    felt = features.touches and features.synchrony and features.hand is not None
    present = {
        "encoders": used["encoders"].used > 0,
        "vision": any(one.used for name, one in used.items() if name not in ("encoders", "touch")),
        "touch": "touch" in used and felt,
    }
    here = [name for name, there in present.items() if there]
    rows = [some for size in range(len(here), 0, -1) for some in combinations(here, size)]
    visual = [name for name in features.tracks if name in body.senses]
    wanted = chosen(visual, body, settings)
    return rows, tuple(name for name in (*body.joints, *visual) if name not in wanted)


def ignored_settings(settings: Estimation) -> tuple[Finding, ...]:
    """Warnings for settings that differ from their defaults and that the method ignores."""
    heeds, paper = METHODS[settings.method].heeds, settings.preset == "paper"
    asked = {"bias": "on", "precision": "model"}.items()
    set_to = {name: value for name, value in asked if getattr(settings, name) == value and (paper or name not in heeds)}
    ignored = {**set_to, **{key: value for key, value in settings.typed.items() if key not in heeds}}
    by = f"{settings.method}{' with the preset paper' * paper}"
    return tuple(
        Finding("warning", f"{name}: {value!r} is ignored by {by}; leave it out, or type --method laplace")
        for name, value in ignored.items()
    )
