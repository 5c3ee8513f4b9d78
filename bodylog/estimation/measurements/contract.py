"""The interface of a sense: one file that lists its measurements and reads them."""

from collections.abc import Mapping
from typing import NamedTuple, Protocol

from ...body_model import BodyModel
from ...types import Features, Health
from .records import Sighting


class Measured(NamedTuple):
    """Measurements of one name (t (N,) · values (N,D) · cov (N,D,D) or var (N,D) · model), and counts of use."""

    sighting: Sighting
    health: Health


class Sense(Protocol):
    """One kind of sense, with any number of rows D; `Sighting.model` predicts g (D), J (D,M), variance (D)."""

    @property
    def group(self) -> str:
        """The group it belongs to: vision or touch."""

    def names(self, features: Features, body: BodyModel) -> tuple[str, ...]:
        """Names of its measurements that the features contain and the body predicts."""

    def read(self, name: str, features: Features, body: BodyModel, whole: bool) -> Measured:
        """Read the measurements of one name; `whole`: those of one event count as one."""


def health(seen: int, used: int, reasons: Mapping[str, int], gap: float = 0.0) -> Health:
    """Counts of use, without the reasons of no rejection; gap: the largest, in s."""
    return Health(seen, int(used), {reason: int(count) for reason, count in reasons.items() if count}, gap)
