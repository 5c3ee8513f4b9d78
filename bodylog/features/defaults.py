"""Default features of a log without configured ones:
a body's own, or whatever moves with the joints.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..body_model import BodyModel
from ..errors import ConfigError
from ..io.toml_keys import toml_value
from ..io.values import read_json
from ..settings import ColourSettings, Settings
from ..sources import Source, check_colour, parse_source, source_as_value
from ..types import Features, Finding, Recording

if TYPE_CHECKING:
    from ..perception import FeatureSurvey


_NAMED = 6
_DEFAULTS = {"effector": ColourSettings().effector, "hand": ColourSettings().hand}


def has_no_features(settings: Settings) -> bool:
    """Whether neither [features] nor [colours] configures a feature."""
    return not settings.features and replace(settings.colours, fast=False) == ColourSettings()


def features_of_body(learned: BodyModel, settings: Settings) -> Settings:
    """The settings; without configured features, with those that the body was learned with."""
    if not has_no_features(settings):
        return settings
    stored: Any = {}
    with suppress(ValueError, KeyError, TypeError):
        stored = read_json(learned.provenance["settings"])
    with suppress(ConfigError, AttributeError, TypeError):
        features = {
            str(name): parse_source(str(name), value, "body")
            for name, value in stored.get("features", {}).items()
        }
        colours = stored.get("colours", {})
        effector, hand = (
            check_colour(colours.get(key, default), key) for key, default in _DEFAULTS.items()
        )
        named = colours.get("markers", colours.get("shapes", {}))  # older bodies: shapes
        markers = {str(name): check_colour(value, name) for name, value in named.items()}
        there = replace(settings.colours, effector=effector, hand=hand, markers=markers)
        return replace(settings, features=features, colours=there)
    return settings


def features_of_log(read: Recording, settings: Settings) -> Settings:
    """The settings; without configured features, with those tracked in a log."""
    return (
        replace(settings, features=read.facts.settings.features)
        if has_no_features(settings)
        else settings
    )


def search_again_without_default(
    log: Path,
    read: Recording,
    found: Features,
    settings: Settings,
    look: Callable[[Recording, Settings], Features],
) -> tuple[Recording, Features]:
    """A recording and its features, searched again if the default colour is not on the arm.

    The second search tracks whatever moves with the joints; the recording's settings name it.
    """
    from ..perception import find_alternative

    carried = read.signals.tracks or (read.signals.features and read.signals.features.tracks)
    other = (
        find_alternative(read, found, settings)
        if has_no_features(read.facts.settings) and not carried
        else None
    )
    if other is None:
        return read, found
    chosen, findings = _choose_effector(str(log), other.why, other.survey, settings)
    if chosen.features:
        asked = replace(read.facts.settings, features=chosen.features)
        facts = replace(read.facts, settings=asked)
        read = replace(read, facts=facts, cameras=replace(read.cameras, consumed=None))
        found = look(read, chosen)
    return read, replace(found, findings=(*findings, *found.findings))


def _choose_effector(
    log: str, why: str, survey: "FeatureSurvey", settings: Settings
) -> tuple[Settings, tuple[Finding, ...]]:
    """The settings with an effector that moves with
    the joints, and findings about it and the others.
    """
    rest = [one for one in survey.candidates if one is not survey.arm and one.seen]
    others = _group_by_reason(
        [(one.name, one.why or "also moves as the joints do") for one in rest]
    )
    default = f"effector: {settings.colours.effector} is not the arm's: {why}"
    if survey.arm is None:
        text = f"{default}; nothing else moves as the joints do; in view: {others}; "
        text += f"type: bodylog features {log} -o sheet.png"
        return settings, (Finding("warning", text),)
    arm = survey.arm
    assert arm.explained is not None  # what moves as the joints do is explained by them
    text = (
        f"{default}; {arm.name} is: in {arm.seen:.0%} of {survey.count} images, the joints explain "
    )
    text += (
        f"{arm.explained:.0%} of its motion; ready for robot.toml: [features] "
        f"{toml_line('effector', arm.source)}"
    )
    findings = Finding("info", text), Finding("info", f"effector: not followed: {others}")
    return replace(settings, features={"effector": arm.source}), findings


def _group_by_reason(named: Sequence[tuple[str, str]]) -> str:
    """Names grouped by reason; of many names the first few."""
    by_reason: dict[str, list[str]] = {}
    for name, why in named:
        by_reason.setdefault("in too few images" if why.startswith("seen in") else why, []).append(
            name
        )
    more = {
        why: f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        for why, names in by_reason.items()
    }
    return (
        "; ".join(
            f"{', '.join(names[:_NAMED])}{more[why]}: {why}" for why, names in by_reason.items()
        )
        or "nothing"
    )


def toml_line(name: str, source: Source) -> str:
    """The line of [features] that names a source."""
    return f"{name} = {toml_value(source_as_value(source))}"
