"""The body stage in one function: features of exploration logs -> BodyModel, scores, findings."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import EvidenceError
from ..settings import Fit, Settings
from ..types import Array, BodyModel, Features, Finding, Score
from . import coverage, noise, touch
from .evidence import ROTATION
from .gp import GP
from .holdout import residuals
from .pairs import Joint, Pairs, coupled, joints, moves, pairs
from .paper import SAMPLES, paper
from .select import farthest, spaced
from .train import Fitted, Samples, build, fitted

_LEAST_SIGHTINGS = 8
_OUTPUTS = ("u", "v")


@dataclass(frozen=True, eq=False)
class Learned:
    """A body model, what it scored on data held out, and remarks on the exploration."""

    model: BodyModel
    scores: tuple[Score, ...]
    findings: tuple[Finding, ...]


@dataclass(frozen=True, eq=False)
class _Sense:
    """One track's samples, as chosen from `frames` looked at, its kernels and its model."""

    data: Samples
    block: Array
    found: Fitted
    gp: GP
    sightings: int
    frames: int


def learn(features: Sequence[Features], settings: Settings, provenance: Mapping[str, Any]) -> Learned:
    """A body model from the features of one or many exploration logs, with what it says of itself.

    LogError without joints, ConfigError for an unknown joint, EvidenceError when nothing was seen or nothing moved.
    """
    heard = joints(features, settings.body.joints)
    chosen = [j for j in heard if settings.body.joints or moves(j)]
    if not chosen:
        possible = ", ".join(j.name for j in heard)
        raise EvidenceError(f"no joint moved; heard: {possible}; record an exploration, or name them in [body] joints")
    senses = {name: _sense(part, chosen, settings.fit) for name, part in _tracks(features, chosen, settings.fit)}
    if not senses:
        raise EvidenceError(
            f"no track has {_LEAST_SIGHTINGS} sightings while joints were heard; type: bodylog doctor LOG"
        )
    gps = {name: sense.gp for name, sense in senses.items()}
    learned = noise.learned([j.acceleration for j in chosen], gps, {n: s.data.floor for n, s in senses.items()})
    names = tuple(j.name for j in chosen)
    constants, remarks = touch.learned(features, names, gps.get("effector"))
    model = BodyModel(names, gps, learned, constants, provenance)
    said = coverage.findings(heard, chosen, gps, learned)
    rule = "as many as the paper's" if settings.fit.preset == "paper" else "which cover the exploration best"
    scores = (*coverage.scores(chosen, gps, learned), *_scores(model, senses))
    return Learned(model, scores, (*said, *_thinned(senses, rule), *remarks))


def _tracks(features: Sequence[Features], chosen: Sequence[Joint], fit: Fit) -> Iterator[tuple[str, Pairs]]:
    for name in sorted({name for f in features for name in f.tracks if name != "hand"}):
        part = pairs(features, name, chosen, fit.every)
        if len(part.x) >= _LEAST_SIGHTINGS:
            yield name, part


def _sense(whole: Pairs, chosen: Sequence[Joint], fit: Fit) -> _Sense:
    if fit.preset == "paper":
        part = whole.rows(spaced(len(whole.x), SAMPLES))
        data = Samples(part.x, part.y, np.zeros(part.y.shape))
        found = paper(data)
    else:
        part = whole.rows(farthest(whole.x, fit.samples))
        data = Samples(part.x, part.y, part.floor, part.variance, coupled(part, chosen))
        found = fitted(data, ROTATION, True, fit.seed)
    return _Sense(data, part.block, found, build(data, found, _OUTPUTS, "px"), len(whole.x), whole.frames)


def _scores(model: BodyModel, senses: Mapping[str, _Sense]) -> Iterator[Score]:
    for name, sense in senses.items():
        residual, variance = residuals(sense.data, sense.found, sense.block)
        yield Score(f"held_out.{name}", float(np.sqrt(np.mean(residual**2))), "px")
        yield Score(f"held_out_standardised.{name}", float(np.mean(residual**2 / variance)), "1")
        yield Score(f"frames_used.{name}", len(sense.data.x) / max(sense.frames, 1), "1")
        for output, value in zip(sense.gp.outputs, model.noise.senses[name], strict=True):
            yield Score(f"noise.{name}.{output}", float(np.sqrt(value)), sense.gp.unit)
        for joint, scale in zip(model.joints, sense.gp.scales[0], strict=True):
            yield Score(f"length_scale.{name}.{joint}", float(scale), "rad")


def _thinned(senses: Mapping[str, _Sense], rule: str) -> Iterator[Finding]:
    for name, sense in senses.items():
        if len(sense.data.x) < sense.sightings:
            yield Finding("info", f"{name}: {len(sense.data.x)} of {sense.sightings} sightings kept, {rule}")
