"""The body stage in one function: features of exploration logs -> BodyModel, scores, findings."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..errors import EvidenceError
from ..settings import Fit, Settings
from ..types import BodyModel, Features, Finding, Score
from . import coverage, noise, sense, touch
from .pairs import Joint, Pairs, joints, moves, pairs

_LEAST_SIGHTINGS = 8


@dataclass(frozen=True, eq=False)
class Learned:
    """A body model, what it scored on data held out, and remarks on the exploration."""

    model: BodyModel
    scores: tuple[Score, ...]
    findings: tuple[Finding, ...]


def learn(features: Sequence[Features], settings: Settings, provenance: Mapping[str, Any]) -> Learned:
    """A body model from the features of one or many exploration logs, with what it says of itself.

    LogError without joints, ConfigError for an unknown joint, EvidenceError when nothing was seen or nothing moved.
    """
    heard = joints(features, settings.body.joints)
    chosen = [j for j in heard if settings.body.joints or moves(j)]
    if not chosen:
        possible = ", ".join(j.name for j in heard)
        raise EvidenceError(f"no joint moved; heard: {possible}; record an exploration, or name them in [body] joints")
    tracks = _tracks(features, chosen, settings.fit)
    senses = {name: sense.sense(part, chosen, settings.fit) for name, part in tracks}
    if not senses:
        raise EvidenceError(
            f"no track has {_LEAST_SIGHTINGS} sightings while joints were heard; type: bodylog doctor LOG"
        )
    names, gps = tuple(j.name for j in chosen), {name: found.gp for name, found in senses.items()}
    learned = noise.learned([j.acceleration for j in chosen], gps, {n: found.floor for n, found in senses.items()})
    constants, touched = touch.learned(features, names, gps.get("effector"))
    scores = [s for name, found in senses.items() for s in sense.scores(name, found, names, learned)]
    left_out = [f for name, found in senses.items() for f in sense.findings(name, found)]
    return Learned(
        BodyModel(names, gps, learned, constants, provenance),
        (*coverage.scores(chosen, gps, learned), *scores),
        (*coverage.findings(heard, chosen, gps, learned), *left_out, *touched),
    )


def _tracks(features: Sequence[Features], chosen: Sequence[Joint], fit: Fit) -> Iterator[tuple[str, Pairs]]:
    for name in sorted({name for f in features for name in f.tracks if name != "hand"}):
        part = pairs(features, name, chosen, fit.every)
        if len(part.x) >= _LEAST_SIGHTINGS:
            yield name, part
