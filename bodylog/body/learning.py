"""Learn a body: features of exploration logs -> BodyModel, scores, findings."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..body_model import BodyModel, ForwardModel, Noise
from ..errors import EvidenceError, ModelError
from ..runtime.blas_threads import one_thread
from ..settings import Fit, Settings
from ..types import Features, Finding, Score
from . import exploration_report, noise_estimates, pose_errors
from .data import trainable
from .data.exploration import shown
from .data.pairs import Joint, Pairs, earlier, joined, joints, moves, pairs, plausible, restless, silent
from .gp.model import GP
from .senses import encoder_calibration, encoder_function, touch, track


@dataclass(frozen=True, eq=False)
class Learned:
    """A body model, its scores on held-out data, remarks on the exploration, and the joints it was learned over.

    poor: tracks, and why, that a Gaussian process alone cannot explain, kept for kinematics.
    """

    model: BodyModel
    scores: tuple[Score, ...]
    findings: tuple[Finding, ...]
    joints: tuple[Joint, ...] = ()
    poor: Mapping[str, str] = field(default_factory=dict)


@one_thread("scipy.linalg")
def learn(
    features: Sequence[Features],
    settings: Settings,
    provenance: Mapping[str, Any],
    update: BodyModel | None = None,
    hopeful: bool = False,
) -> Learned:
    """Learn a body model from the features of one or many exploration logs.

    A body to update keeps its joints, its given senses, and touch unless a log has touches; its own samples count as
    one more log. `hopeful`: tracks with too little information are kept for kinematics. Where logs have a reference,
    its angles are used and the encoders' function is learned as well. LogError without joints, ConfigError for an
    unknown joint, ModelError for another robot's body, EvidenceError when nothing was seen or moved.
    """
    features, absurd = plausible(features)
    wanted = settings.body.joints if update is None else _same(features, update)
    told = [encoder_function.referred(f, update) for f in features]
    if update is None and not any(name != "hand" for f in features for name in f.tracks):
        raise EvidenceError(_nothing_seen(told))  # before joints are smoothed, which takes long
    heard = joints(told, wanted)
    chosen = [j for j in heard if wanted or moves(j)]
    if not chosen:
        possible = ", ".join(j.name for j in heard) or f"none ({'; '.join(silent(told).values())})"
        raise EvidenceError(f"no joint moved; heard: {possible}; record an exploration, or name them in [body] joints")
    chosen, unseen = (chosen, []) if wanted else shown(features, chosen, settings.fit)
    tracks = dict(_tracks(features, chosen, settings.fit, update))
    senses, poor = _senses(tracks, chosen, settings.fit, hopeful)
    if not senses:
        raise EvidenceError(_refusal(features, poor, chosen))
    names, gps = tuple(j.name for j in chosen), {name: found.gp for name, found in senses.items()}
    learned = noise_estimates.learned(
        [j.acceleration for j in chosen], gps, {n: found.floor for n, found in senses.items()}
    )
    learned, repeated = _posed(learned, senses, len(chosen)) if all(f.poses for f in features) else (learned, {})
    learned = learned if update is None else noise_estimates.pooled(learned, update.noise)
    constants, cells, touched = touch.learned(told, names, gps.get("effector"))
    read = encoder_calibration.learned(features, chosen, learned)
    given: Mapping[str, ForwardModel] = {}
    if update is not None:
        given = {n: g for n, g in update.senses.items() if n not in _seen(update)}
        constants, cells = (constants, {**update.cells, **cells}) if touched else (update.touch, update.cells)
    scores = [s for name, found in senses.items() for s in track.scores(name, found, names, learned)]
    scores += [Score(f"explained/{name}", trainable.explained(found), "1") for name, found in senses.items()]
    useless = [name for name in poor if name not in senses]
    few = [Finding("warning", f"{n}: left out: {poor[n]}; {trainable.seen(features, n)}") for n in useless]
    left_out = [f for name, found in senses.items() for f in track.findings(name, found)]
    covered = exploration_report.findings([j for j in heard if j in chosen or not moves(j)], chosen, gps, learned)
    gaps, pictures = exploration_report.unlearned(told, [j.name for j in heard], wanted), _pictures(features)
    about = {**pictures, **repeated, **provenance}
    return Learned(
        BodyModel(names, {**given, **gps, **read.model}, read.noise, constants, about, cells),
        (*exploration_report.scores(chosen, gps, learned), *scores, *read.scores),
        (trainable.moved(heard, chosen), *covered, *absurd, *unseen, *gaps, *few, *left_out, *touched, *read.findings),
        tuple(chosen),
        {name: why for name, why in poor.items() if name in senses},
    )


def _posed(
    learned: Noise, senses: Mapping[str, track.Sense], count: int
) -> tuple[Noise, dict[str, Any]]:
    """Encoder noise from still poses, and its std (rad) for the provenance."""
    found = pose_errors.learned(senses, count)
    if found is None:
        return learned, {}
    variance, error = (tuple(float(v) for v in values) for values in found)
    std = {"pose_std": [v**0.5 for v in variance]}
    return replace(learned, encoder=variance, std_error={**learned.std_error, "encoder": error}), std


def _senses(
    tracks: Mapping[str, Pairs], chosen: Sequence[Joint], fit: Fit, hopeful: bool
) -> tuple[dict[str, track.Sense], dict[str, str]]:
    """Each track's model, and the reasons why others have none; `hopeful` keeps poor models, too."""
    found, poor = dict[str, track.Sense](), dict[str, str]()
    for name, part in tracks.items():
        why = trainable.unfit(part, [] if hopeful else chosen)
        if why is None:
            try:
                found[name] = track.sense(part, chosen, fit)
            except np.linalg.LinAlgError as problem:
                why = f"no model of its {len(part.x)} sightings: {problem}"
            else:
                why = trainable.unexplained(found[name])
        if why is not None and fit.preset == "paper" and name in found:
            continue  # the paper's constants are used whatever they predict
        if why is not None:
            poor[name] = why
            if not hopeful:
                found.pop(name, None)
    return found, poor


def _nothing_seen(features: Sequence[Features]) -> str:
    """The message without any track, with the joints that moved."""
    names = restless(features)
    moved = f"though {len(names)} joints moved ({', '.join(names)})" if names else "and no joint moved"
    return f"no track to learn from, {moved}; type: bodylog info LOG, and name a marker in [features]"


def _refusal(features: Sequence[Features], poor: Mapping[str, str], chosen: Sequence[Joint]) -> str:
    """The message when no track can be learned, with what to record or type."""
    moved = f"{len(chosen)} joints moved ({', '.join(joint.name for joint in chosen)})"
    said = "; ".join(f"{name}: {why}, {trainable.seen(features, name)}" for name, why in poor.items())
    advice = "type bodylog features LOG to see what else there is, or record a marker that all joints move in view"
    return f"no track teaches a body, though {moved}: {said}; {advice}"


def _tracks(
    features: Sequence[Features], chosen: Sequence[Joint], fit: Fit, update: BodyModel | None
) -> Iterator[tuple[str, Pairs]]:
    known = {} if update is None else _seen(update)
    for name in sorted({name for f in features for name in f.tracks if name != "hand"} | set(known)):
        parts = [pairs(features, name, chosen, fit.every)] if any(name in f.tracks for f in features) else []
        if name in known:
            parts.append(earlier(known[name].samples, known[name].targets, known[name].spread))
        yield name, joined(parts)


def _seen(body: BodyModel) -> dict[str, GP]:
    """The senses learned from tracks."""
    return {n: g for n, g in body.senses.items() if isinstance(g, GP) and n != "encoders"}


def _pictures(features: Sequence[Features]) -> dict[str, Any]:
    """The cameras' topics, first camera first, and the image width, px, if all logs agree on it."""
    cameras = next((list(f.cameras.values()) for f in features if f.cameras), [])
    widths = {f.picture_size[0] for f in features if f.picture_size is not None}
    known = {"cameras": cameras, "image_width": widths.pop() if len(widths) == 1 else None}
    return {key: value for key, value in known.items() if value}


def _same(features: Sequence[Features], update: BodyModel) -> tuple[str, ...]:
    for index, found in enumerate(features):
        names = () if found.joints is None else found.joints.names
        missing = [name for name in update.joints if name not in names]
        if names and missing:
            which, heard = f"log {index + 1} of {len(features)}", ", ".join(names)
            raise ModelError(f"{which}: joint {missing[0]!r} of the body to update is not there; heard: {heard}")
    return update.joints
