"""The table of methods: the function of each and what it can do."""

from collections.abc import Mapping

from ...types import Capabilities
from . import filtering, kalman, predictive_coding, smoother
from .contract import Method

METHODS: Mapping[str, Method] = {
    "laplace": Method(filtering.laplace, Capabilities(), live=True),
    "smoother": Method(smoother.estimate, Capabilities(causal=False)),
    "ekf": Method(filtering.ekf, Capabilities()),
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
