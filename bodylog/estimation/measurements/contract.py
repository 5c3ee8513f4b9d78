"""What a sense is: one file that says which measurements of it there are, and reads them with a model of each."""

from collections.abc import Mapping
from typing import NamedTuple, Protocol

from ...body_model import BodyModel
from ...types import Features, Health
from .records import Sighting


class Measured(NamedTuple):
    """Measurements of one name (t (N,) · values (N,D) · cov (N,D,D) or var (N,D) · model), and what became of them."""

    sighting: Sighting
    health: Health


class Sense(Protocol):
    """One kind of sense, with as many rows D as it likes; `Sighting.model` predicts g (D), J (D,M), variance (D)."""

    @property
    def group(self) -> str:
        """The group of senses it belongs to: vision or touch."""

    def names(self, features: Features, body: BodyModel) -> tuple[str, ...]:
        """What of it these features have and this body predicts."""

    def read(self, name: str, features: Features, body: BodyModel, whole: bool) -> Measured:
        """The measurements of that name; `whole`: those of one event count as one."""


Senses = Mapping[str, Sense]
