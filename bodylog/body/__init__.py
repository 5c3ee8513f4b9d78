"""Stage: body. What the robot should see, learned from exploration logs."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ..settings import Settings
from ..types import BodyModel, Features
from .encoders import Polynomial

if TYPE_CHECKING:
    from .learning import Learned

__all__ = ["Polynomial", "learn"]


def learn(
    features: Sequence[Features], settings: Settings, provenance: Mapping[str, Any], update: BodyModel | None = None
) -> "Learned":
    """`learning.learn`, imported when there is something to learn from: predicting needs none of it."""
    from . import learning

    return learning.learn(features, settings, provenance, update)
