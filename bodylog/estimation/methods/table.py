"""The table of methods: the function of each and what it can do."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from ...body_model import BodyModel
from ...settings import Estimation
from ...types import Capabilities, Estimate, Features
from . import filtering, kalman, predictive_coding, smoother


class Method(NamedTuple):
    """One `--method`: its function, what it can do, the senses it can use, the settings it obeys.

    heeds: settings beside method, senses, rate and start · literal_touch: accepts touch as printed in the paper ·
    encoder_model: uses the body's model of encoder readings that are no angles · live: needs no knowledge of the whole
    log, so that it can run beside a robot.
    """

    estimate: Callable[[Features, BodyModel, Estimation], Estimate]
    can: Capabilities
    senses: frozenset[str] = frozenset({"encoders", "vision", "touch"})
    heeds: frozenset[str] = frozenset({"precision", "bias", "process", "sigma_encoders", "sigma_vision", "sigma_touch"})
    literal_touch: bool = False
    encoder_model: bool = False
    live: bool = False


METHODS: Mapping[str, Method] = {
    "laplace": Method(filtering.estimate, Capabilities(), live=True),
    "smoother": Method(smoother.estimate, Capabilities(causal=False)),
    "ekf": Method(filtering.estimate, Capabilities()),
    "kalman": Method(
        kalman.estimate,
        Capabilities(moves=False, density=False, learns_noise=False, repairs=False, from_paper=True),
        senses=frozenset({"encoders"}), heeds=frozenset(),
    ),
    "predictive-coding": Method(
        predictive_coding.estimate,
        Capabilities(moves=False, density=False, repairs=False, from_paper=True),
        heeds=frozenset({"precision", "lambda", "sigma_encoders", "sigma_vision", "sigma_touch"}),
        literal_touch=True, encoder_model=True,
    ),
}  # fmt: skip
