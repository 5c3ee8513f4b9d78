"""The body stage in one function: features of exploration logs -> BodyModel, scores, findings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import EvidenceError
from ..settings import Settings
from ..types import BodyModel, Features, Finding, Score
from . import noise
from .evidence import ROTATION
from .gp import GP
from .holdout import residuals
from .pairs import Joint, Pairs, coupled, joints, moves, pairs
from .touch import DEFAULT
from .train import Samples, train

_LEAST_SIGHTINGS = 8
_OUTPUTS = ("u", "v")


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
        names = ", ".join(j.name for j in heard)
        raise EvidenceError(f"no joint moved; heard: {names}; record an exploration, or name them in [body] joints")
    data = {name: pairs(features, name, chosen, settings.fit.every) for name in _tracks(features)}
    data = {name: part for name, part in data.items() if len(part.x) >= _LEAST_SIGHTINGS}
    if not data:
        raise EvidenceError("no visual track has enough sightings while joints were heard; type: bodylog doctor LOG")
    senses = {name: _train(part, chosen, settings.fit.seed) for name, part in data.items()}
    floors = {name: part.floor for name, part in data.items()}
    found = noise.learned([j.acceleration for j in chosen], senses, floors)
    model = BodyModel(tuple(j.name for j in chosen), senses, found, DEFAULT, provenance)
    return Learned(model, _scores(model, chosen, data), _findings(heard, chosen))


def _tracks(features: Sequence[Features]) -> list[str]:
    return sorted({name for f in features for name in f.tracks if name != "hand"})


def _train(part: Pairs, chosen: Sequence[Joint], seed: int) -> GP:
    data = Samples(part.x, part.y, part.floor, part.variance, coupled(part, chosen))
    return train(data, _OUTPUTS, "px", ROTATION, seed=seed)


def _scores(model: BodyModel, chosen: Sequence[Joint], data: Mapping[str, Pairs]) -> tuple[Score, ...]:
    scores = [Score(f"range.{j.name}", j.range, "rad") for j in chosen]
    for name, gp in model.senses.items():
        assert isinstance(gp, GP)
        residual, variance = residuals(gp, data[name].block)
        scores.append(Score(f"held_out.{name}", float(np.sqrt(np.mean(residual**2))), "px"))
        scores.append(Score(f"held_out_standardised.{name}", float(np.mean(residual**2 / variance)), "1"))
        scores.append(Score(f"frames_used.{name}", len(data[name].x) / max(data[name].frames, 1), "1"))
        for m, joint in enumerate(model.joints):
            scores.append(Score(f"length_scale.{name}.{joint}", float(gp.scales[0, m]), "rad"))
        for d, output in enumerate(gp.outputs):
            scores.append(Score(f"noise.{name}.{output}", float(np.sqrt(model.noise.senses[name][d])), gp.unit))
    return tuple(scores)


def _findings(heard: Sequence[Joint], chosen: Sequence[Joint]) -> tuple[Finding, ...]:
    still = [j for j in heard if j not in chosen]
    return tuple(Finding("info", f"{j.name}: moved {j.range:.3f} rad, vision says nothing about it") for j in still)
