"""What a method is: a module of this folder describes its own in METHODS, by name."""

from collections.abc import Callable
from typing import NamedTuple

from ...body_model import BodyModel
from ...settings import EstimationSettings
from ...types import Capabilities, Estimate, Features


class Method(NamedTuple):
    """One `--method`: its function, what it can do, the senses it can use, the settings it obeys.

    heeds: settings beside method, senses, rate and start · literal_touch: accepts touch as printed
    in the paper · encoder_model: uses the body's model of encoder readings that are no angles ·
    live: needs no knowledge of the whole log, so that it can run beside a robot.
    """

    estimate: Callable[[Features, BodyModel, EstimationSettings], Estimate]
    can: Capabilities
    senses: frozenset[str] = frozenset({"encoders", "vision", "touch"})
    heeds: frozenset[str] = frozenset(
        {"precision", "bias", "motion", "process", "sigma_encoders", "sigma_vision", "sigma_touch"}
    )
    literal_touch: bool = False
    encoder_model: bool = False
    live: bool = False
