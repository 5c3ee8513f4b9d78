"""Learn a body: features of exploration logs -> BodyModel, scores, findings."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from ..body_model import HELD, BodyModel, ForwardModel, Noise
from ..errors import EvidenceError, ModelError
from ..runtime.blas_threads import one_thread
from ..settings import FitSettings, Settings
from ..types import Features, Finding, Score
from . import exploration_report, noise_estimates, pose_errors
from .data import trainable
from .data.exploration import select_joints
from .data.pairs import (
    NO_ERRORS,
    Pairs,
    SmoothedJoint,
    drop_impossible_values,
    find_moving_joints,
    has_moved,
    join_pairs,
    pair_sightings,
    pairs_of_samples,
    smooth_all_joints,
    sparse_joints,
)
from .gp.model import GP
from .senses import encoder_calibration, encoder_function, touch, track

Keep = Literal["all", "explained", "telling"]
"""Tracks that keep a model: all that have one, for kinematics to explain; those explained by the
joints; those of which one image also tells something about the joints."""


HELD_QUANTILES = (0.05, 0.95)
"""Quantiles between which a joint that is not learned stood: single false readings are beyond."""


@dataclass(frozen=True, eq=False)
class LearnedBody:
    """A body model, its scores on held-out data, remarks
    on the exploration, and the joints it was learned over.

    poor: tracks, and why, that a Gaussian process alone cannot explain, kept for kinematics ·
    vague: tracks that it explains, and why one image of them tells nothing about the joints ·
    faint: warnings for joints whose motion the senses hardly show · lasting: errors of encoders ·
    used: the sightings of each track that its model was learned from.
    """

    model: BodyModel
    scores: tuple[Score, ...]
    findings: tuple[Finding, ...]
    joints: tuple[SmoothedJoint, ...] = ()
    poor: Mapping[str, str] = field(default_factory=dict)
    vague: Mapping[str, str] = field(default_factory=dict)
    faint: tuple[Finding, ...] = ()
    lasting: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    used: Mapping[str, Pairs] = field(default_factory=dict)


@one_thread("scipy.linalg")
def learn_from_features(
    features: Sequence[Features],
    settings: Settings,
    provenance: Mapping[str, Any],
    update: BodyModel | None = None,
    keep: Keep = "explained",
    advice: str = "",
    lasting: Mapping[str, tuple[float, float]] = NO_ERRORS,
) -> LearnedBody:
    """Learn a body model from the features of one or many exploration logs.

    A body to update keeps its joints, its given senses, and touch unless a log has
    touches; its own samples count as one more log. `keep`: see `Keep` · advice: what to
    do about a track that tells nothing · lasting: see `smooth_all_joints`. Where logs have a
    reference, its angles are used and the encoders' function is learned as well.

    LogError without joints, ConfigError for an unknown joint, ModelError for another robot's body,
    EvidenceError when nothing was seen or moved.
    """
    features, absurd = drop_impossible_values(features)
    wanted = settings.body.joints if update is None else _require_known_joints(features, update)
    angled = [encoder_function.with_true_angles(f, update) for f in features]
    if update is None and not any(name != "hand" for f in features for name in f.tracks):
        raise EvidenceError(_nothing_seen(angled))  # before joints are smoothed, which takes long
    available = smooth_all_joints(angled, wanted, lasting)
    chosen = _choose_moved_joints(angled, available, wanted)
    chosen, unseen = (chosen, []) if wanted else select_joints(features, chosen, settings.fit)
    corners = _board_of_each_corner(features) if keep == "all" else {}
    tracks = dict(_pairs_by_track(features, chosen, settings.fit, update))
    senses, poor, vague = _learn_senses(tracks, chosen, settings.fit, keep, corners, advice)
    if not senses:
        raise EvidenceError(_refusal_message(features, poor, chosen))
    names = tuple(j.name for j in chosen)
    gps = {name: found.gp for name, found in senses.items()}
    learned, repeated = _learn_all_noise(features, chosen, senses, update)
    constants, cells, touched = touch.learn_touch(angled, names, gps.get("effector"))
    read = encoder_calibration.learn_encoder_functions(features, chosen, learned)
    given: Mapping[str, ForwardModel] = {}
    if update is not None:
        given = {n: g for n, g in update.senses.items() if n not in _senses_of_tracks(update)}
        constants, cells = (
            (constants, {**update.cells, **cells}) if touched else (update.touch, update.cells)
        )
    scores = (
        *exploration_report.exploration_scores(chosen, gps, learned),
        *_scores_of_tracks(senses, names, learned),
        *read.scores,
    )
    still = exploration_report.still_findings(
        [j for j in available if j in chosen or not has_moved(j)], chosen
    )
    gaps = exploration_report.missing_findings(angled, [j.name for j in available], wanted)
    dropped = _dropped_findings(features, senses, poor)
    about = {**_image_provenance(features), **_held_provenance(features, names)}
    about |= {**repeated, **provenance}
    return LearnedBody(
        BodyModel(names, {**given, **gps, **read.model}, read.noise, constants, about, cells),
        scores,
        (
            trainable.learned_joints_finding(available, chosen),
            *still,
            *absurd,
            *unseen,
            *gaps,
            *dropped,
            *touched,
            *read.findings,
        ),
        tuple(chosen),
        {name: reason for name, reason in poor.items() if name in senses},
        vague,
        tuple(exploration_report.faint_findings(chosen, gps, learned)),
        lasting,
        {name: one.used for name, one in senses.items()},
    )


def _choose_moved_joints(
    features: Sequence[Features], available: list[SmoothedJoint], wanted: tuple[str, ...] | None
) -> list[SmoothedJoint]:
    """The joints wanted, or those that moved; EvidenceError without any."""
    chosen = [j for j in available if wanted or has_moved(j)]
    if not chosen:
        possible = (
            ", ".join(j.name for j in available)
            or f"none ({'; '.join(sparse_joints(features).values())})"
        )
        raise EvidenceError(
            f"no joint moved; the log has {possible}; record an exploration, or name [body] joints"
        )
    return chosen


def _learn_all_noise(
    features: Sequence[Features],
    chosen: Sequence[SmoothedJoint],
    senses: Mapping[str, track.TrackSense],
    update: BodyModel | None,
) -> tuple[Noise, dict[str, Any]]:
    """Noise of joints and senses, pooled with that of
    a body to update, and its part of the provenance.
    """
    gps, floors = (
        {n: getattr(found, part) for n, found in senses.items()} for part in ("gp", "floor")
    )
    learned = noise_estimates.learn_noise([j.acceleration for j in chosen], gps, floors)
    learned, repeated = (
        _encoder_noise_from_poses(learned, senses, len(chosen))
        if all(f.poses for f in features)
        else (learned, {})
    )
    return learned if update is None else noise_estimates.pool_noise(
        learned, update.noise
    ), repeated


def _scores_of_tracks(
    senses: Mapping[str, track.TrackSense], names: tuple[str, ...], noise: Noise
) -> Iterator[Score]:
    """Scores of all tracks."""
    for name, found in senses.items():
        yield from track.scores_of_track(name, found, names, noise)
    for name, found in senses.items():
        yield Score(f"explained/{name}", trainable.explained_motion_share(found), "1")


def _dropped_findings(
    features: Sequence[Features], senses: Mapping[str, track.TrackSense], poor: Mapping[str, str]
) -> Iterator[Finding]:
    """Remarks on tracks without a model, and on sightings left out of the others."""
    for name, reason in _by_board(features, {n: r for n, r in poor.items() if n not in senses}):
        yield Finding("warning", f"{name}: left out: {reason}")
    for name, found in senses.items():
        yield from track.track_findings(name, found)


def _encoder_noise_from_poses(
    learned: Noise, senses: Mapping[str, track.TrackSense], count: int
) -> tuple[Noise, dict[str, Any]]:
    """Encoder noise from still poses, and its std (rad) for the provenance."""
    found = pose_errors.learn_pose_errors(senses, count)
    if found is None:
        return learned, {}
    variance, error = (tuple(float(v) for v in values) for values in found)
    std = {"pose_std": [v**0.5 for v in variance]}
    return replace(
        learned, encoder=variance, std_error={**learned.std_error, "encoder": error}
    ), std


def _learn_senses(
    tracks: Mapping[str, Pairs],
    chosen: Sequence[SmoothedJoint],
    fit: FitSettings,
    keep: Keep,
    corners: Mapping[str, str],
    advice: str,
) -> tuple[dict[str, track.TrackSense], dict[str, str], dict[str, str]]:
    """Each track's model, the reasons why others have none
    or a poor one, and why models that are kept are vague.

    corners: tracks that a URDF joins to boards ·
    advice: what to do about a track that tells nothing.
    """
    found = dict[str, track.TrackSense]()
    poor = dict[str, str]()
    vague = dict[str, str]()
    for name, part in tracks.items():
        fewest = trainable.FEWEST_OF_BOARD if name in corners else trainable.FEWEST
        reason = trainable.reason_untrainable(part, [] if keep == "all" else chosen, fewest)
        if reason is None:
            try:
                found[name] = track.learn_track(part, chosen, fit)
            except np.linalg.LinAlgError as problem:
                reason = f"no model of its {len(part.x)} sightings: {problem}"
        if name in found and fit.preset == "paper":
            continue  # the paper's constants are used whatever they predict
        if name in found:
            reason = trainable.reason_unexplained(found[name])
            hidden = None if reason else trainable.reason_vague(found[name], chosen)
            if hidden and keep == "telling":
                reason = f"{hidden}: {advice}" if advice else hidden
            elif hidden:
                vague[name] = hidden
        if reason is not None:
            poor[name] = reason
            if keep != "all":
                found.pop(name, None)
    return found, poor, vague


def _nothing_seen(features: Sequence[Features]) -> str:
    """The message without any track, with the joints that moved."""
    names = find_moving_joints(features)
    moved = (
        f"though {len(names)} joints moved ({', '.join(names)})" if names else "and no joint moved"
    )
    return (
        f"no track to learn from, {moved}; type: bodylog info LOG, and name a marker in [features]"
    )


def _refusal_message(
    features: Sequence[Features], poor: Mapping[str, str], chosen: Sequence[SmoothedJoint]
) -> str:
    """The message when no track can be learned, and advice."""
    moved = f"{len(chosen)} joints moved ({', '.join(joint.name for joint in chosen)})"
    reasons = "; ".join(f"{name}: {reason}" for name, reason in _by_board(features, poor))
    advice = (
        "type bodylog features LOG to see what else there is, or record a marker that all joints "
        "move in view"
    )
    return f"no track can be learned, though {moved}: {reasons}; {advice}"


def _board_of_each_corner(features: Sequence[Features]) -> dict[str, str]:
    """The board of each track that is one of three or more points of a rigid thing."""
    boards = [item for found in features for item in found.boards.items()]
    return {track: name for name, (tracks, _) in boards if len(tracks) > 2 for track in tracks}


def _by_board(features: Sequence[Features], poor: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """Yield each poor track, or a whole board once,
    with the reason and in how many images it was seen.
    """
    corners = _board_of_each_corner(features)
    boards = dict[str, list[str]]()
    for name in poor:
        boards.setdefault(corners.get(name, name), []).append(name)
    for board, tracks in boards.items():
        best = max(
            tracks,
            key=lambda name: sum(
                trainable.count_sightings(f, name)[1] for f in features if name in f.tracks
            ),
        )
        reason = f"{poor[best]}, {trainable.describe_sighting_counts(features, best)}"
        corner = f"{len(tracks)} corners; of {best}, seen most often: " if len(tracks) > 1 else ""
        yield (board if len(tracks) > 1 else best), f"{corner}{reason}"


def _pairs_by_track(
    features: Sequence[Features],
    chosen: Sequence[SmoothedJoint],
    fit: FitSettings,
    update: BodyModel | None,
) -> Iterator[tuple[str, Pairs]]:
    known = {} if update is None else _senses_of_tracks(update)
    for name in sorted(
        {name for f in features for name in f.tracks if name != "hand"} | set(known)
    ):
        parts = (
            [pair_sightings(features, name, chosen, fit.every)]
            if any(name in f.tracks for f in features)
            else []
        )
        if name in known:
            parts.append(
                pairs_of_samples(known[name].samples, known[name].targets, known[name].spread)
            )
        yield name, join_pairs(parts)


def _senses_of_tracks(body: BodyModel) -> dict[str, GP]:
    """The senses learned from tracks."""
    return {n: g for n, g in body.senses.items() if isinstance(g, GP) and n != "encoders"}


def _image_provenance(features: Sequence[Features]) -> dict[str, Any]:
    """The cameras' topics, first camera first, and the image width, px, if all logs agree on it."""
    cameras = next((list(f.cameras.values()) for f in features if f.cameras), [])
    widths = {f.picture_size[0] for f in features if f.picture_size is not None}
    known = {"cameras": cameras, "image_width": widths.pop() if len(widths) == 1 else None}
    return {key: value for key, value in known.items() if value}


def _held_provenance(features: Sequence[Features], learned: Sequence[str]) -> dict[str, Any]:
    """Between which readings [low, high] each joint stood over which nothing is learned."""
    held = dict[str, list[float]]()
    for joints in (one.joints for one in features if one.joints is not None):
        for name, y in zip(joints.names, joints.values.T, strict=True):
            if name not in learned and np.isfinite(y).any():
                low, high = np.nanquantile(y, HELD_QUANTILES).tolist()
                before = held.get(name, [low, high])
                held[name] = [min(low, before[0]), max(high, before[1])]
    return {HELD: held} if held else {}


def _require_known_joints(features: Sequence[Features], update: BodyModel) -> tuple[str, ...]:
    for index, found in enumerate(features):
        names = () if found.joints is None else found.joints.names
        missing = [name for name in update.joints if name not in names]
        if names and missing:
            which = f"log {index + 1} of {len(features)}"
            available = ", ".join(names)
            raise ModelError(
                f"{which}: joint {missing[0]!r} of the body to update is missing; it has "
                f"{available}"
            )
    return update.joints
