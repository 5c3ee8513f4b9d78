"""The table of methods: the function of each, what it can do, and which settings it ignores."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from ...body_model import BodyModel
from ...settings import EstimationSettings
from ...types import Capabilities, Estimate, Features, Finding
from . import filtering, kalman, predictive_coding, smoother


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
        {"precision", "bias", "process", "sigma_encoders", "sigma_vision", "sigma_touch"}
    )
    literal_touch: bool = False
    encoder_model: bool = False
    live: bool = False


METHODS: Mapping[str, Method] = {
    "filter": Method(filtering.estimate_by_filter, Capabilities(), live=True),
    "smoother": Method(smoother.estimate_by_smoother, Capabilities(causal=False)),
    "ekf": Method(filtering.estimate_by_filter, Capabilities()),
    "kalman": Method(
        kalman.estimate_by_kalman_filter,
        Capabilities(moves=False, density=False, repairs=False, from_paper=True),
        senses=frozenset({"encoders"}),
        heeds=frozenset(),
    ),
    "predictive-coding": Method(
        predictive_coding.estimate_by_predictive_coding,
        Capabilities(moves=False, density=False, repairs=False, from_paper=True),
        heeds=frozenset({"precision", "lambda", "sigma_encoders", "sigma_vision", "sigma_touch"}),
        literal_touch=True,
        encoder_model=True,
    ),
}


def ignored_settings(settings: EstimationSettings) -> tuple[Finding, ...]:
    """Warnings for settings that differ from their defaults and that the method ignores."""
    heeds = METHODS[settings.method].heeds
    paper = settings.preset == "paper"
    asked = {"bias": "on", "precision": "model"}.items()
    set_to = {
        name: value
        for name, value in asked
        if getattr(settings, name) == value and (paper or name not in heeds)
    }
    if settings.common_cause is not None and "touch" not in METHODS[settings.method].senses:
        set_to["common_cause"] = str(settings.common_cause)
    ignored = {
        **set_to,
        **{key: value for key, value in settings.typed.items() if key not in heeds},
    }
    by = f"{settings.method}{' with the preset paper' * paper}"
    return tuple(
        Finding(
            "warning",
            f"{name}: {value!r} is ignored by {by}; leave it out, or type --method filter",
        )
        for name, value in ignored.items()
    )
