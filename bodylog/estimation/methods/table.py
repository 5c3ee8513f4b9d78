"""The table of methods, and which settings each ignores."""

from collections.abc import Mapping
from importlib import import_module

from ...settings import METHOD_MODULES, EstimationSettings
from ...types import Finding
from .contract import Method

METHODS: Mapping[str, Method] = {
    name: import_module(f".{module}", __package__).METHODS[name]
    for name, module in METHOD_MODULES.items()
}


def warn_of_ignored_settings(settings: EstimationSettings) -> tuple[Finding, ...]:
    """Warnings for settings that differ from their defaults and that the method ignores."""
    heeds = METHODS[settings.method].heeds
    paper = settings.preset == "paper"
    asked = {"bias": "on", "precision": "model"}.items()
    set_to = {
        name: value
        for name, value in asked
        if getattr(settings, name) == value and (paper or name not in heeds)
    }
    if settings.motion != "auto" and "motion" not in heeds:
        set_to["motion"] = settings.motion
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
