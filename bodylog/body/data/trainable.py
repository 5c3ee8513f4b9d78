"""Whether a track is worth learning: seen often enough,
moving, and predicted better than by a constant.
"""

from collections.abc import Sequence
from math import tau

import numpy as np

from ...types import TRACK_AXES, Array, Features, Finding
from ..senses.track import TrackSense
from .pairs import Pairs, SmoothedJoint

FEWEST = 8
PER_JOINT = 3
"""Fewest sightings of a track, in all and per joint that moved."""
FEWEST_OF_BOARD = 4
"""Fewest sightings of one corner of a board that a
URDF joins with the others: together they give poses.
"""
SURE = 2.0
BETTER = 0.9
"""A model is better than a constant if the mean log ratio of median held-out errors over blocks is
below ln BETTER, and below 0 by SURE standard errors. Medians are robust to a few false sightings.
"""
HOMING_ERROR = np.radians(5.0)
"""rad: prior standard deviation of joint offsets (`[kinematics] offset_prior`). A track whose
held-out error is larger than what this moves it says nothing that an encoder does not: 11 to 18°
for processes of 22 to 43 poses of a real Panda, 4.2° for 25, 1.8° for 60 poses of a real NAO, below
0.4° for arms that explored for 40 s."""
STILL = 1e-6
"""px or mm: a track that moves less stands still."""


def reason_untrainable(
    part: Pairs, chosen: Sequence[SmoothedJoint], fewest: int = FEWEST
) -> str | None:
    """Why a track's sightings cannot be learned from; None if they can."""
    least = max(fewest, PER_JOINT * len(chosen))
    if len(part.x) < least:
        moved = f"{len(chosen)} joint{'s' * (len(chosen) != 1)} moved"
        return f"only {len(part.x)} sightings with joint readings, {least} are needed as {moved}"
    if (np.ptp(part.y, axis=0) < STILL).all():
        place = ", ".join(f"{value:.1f}" for value in part.y[0])
        unit = TRACK_AXES[part.y.shape[1]][1]
        return f"stands still at ({place}) {unit} in all {len(part.x)} sightings"
    return None


def reason_unexplained(found: TrackSense) -> str | None:
    """Why a learned track is not kept: held out, it is no better than a constant."""
    mean, error = log_ratio(found.residual, found.constant, found.used.block)
    if mean + SURE * error < 0.0 and mean < np.log(BETTER):
        return None
    own, constant = (
        float(np.median(np.linalg.norm(r, axis=1))) for r in (found.residual, found.constant)
    )
    unit = found.gp.unit
    return (
        f"joints predict its {len(found.residual)} sightings, held out, to {own:.2f} {unit} "
        "(median), a constant to "
        f"{constant:.2f} {unit}: it does not move with the joints"
    )


def reason_vague(found: TrackSense, chosen: Sequence[SmoothedJoint]) -> str | None:
    """Why a learned track tells nothing about the joints;
    None where one image shows an offset of some joint.


    To be asked once delays are corrected: a late camera makes any track vague.
    """
    angle = visible_angle(found)
    # an arm's joint turns at most once: readings that span more are in a smaller unit
    shares = angle / np.array([max(1.0, joint.range / tau) for joint in chosen])
    best = int(shares.argmin())
    if shares[best] <= HOMING_ERROR:
        return None
    error = float(np.sqrt(np.mean(found.residual**2)))
    return (
        f"joints predict its {len(found.residual)} sightings, held out, to {error:.1f} "
        f"{found.gp.unit}, "
        "so that one image shows no "
        f"joint's error below {np.degrees(shares[best]):.0f}° (zeros are usually off by less than "
        f"{np.degrees(HOMING_ERROR):.0f}°)"
    )


def visible_angle(found: TrackSense) -> Array:
    """The error (M,) of each joint alone that moves the
    track by one held-out error, in the joints' unit.

    1/√Σ_d J²_dm/e²_d of mean squared slopes J² at the samples and squared held-out errors e² of the
    outputs d. Slopes of a process that follows its samples' noise are too large: they are scaled so
    that all joints' motions together, as if independent, move the track no more than it moved.
    """
    slope = np.square(found.gp.means(found.gp.samples)[1]).mean(axis=0)
    moved = np.square(found.constant).mean(axis=0)
    by_joints = (slope * found.gp.samples.var(axis=0)).sum(axis=1)
    shrunk = slope * np.minimum(1.0, moved / np.maximum(by_joints, STILL))[:, None]
    held_out = np.maximum(np.square(found.residual).mean(axis=0), STILL**2)
    return np.asarray(1.0 / np.sqrt(np.maximum((shrunk / held_out[:, None]).sum(axis=0), 1e-300)))


def explained_motion_share(found: TrackSense) -> float:
    """Share of the squared motion that held-out predictions
    explain, by medians: 1 all, 0 no more than a constant.
    """
    own, constant = (
        float(np.median(np.square(r).sum(axis=1))) for r in (found.residual, found.constant)
    )
    return 1.0 - own / constant if constant > 0.0 else 0.0


def log_ratio(own: Array, other: Array, block: Array) -> tuple[float, float]:
    """Mean over blocks of time of the log ratio of two
    models' median errors (n,D), and its standard error.
    """
    blocks = [np.flatnonzero(block == label) for label in np.unique(block)]
    logs = np.array([_log_error_ratio(own[rows], other[rows]) for rows in blocks])
    return float(logs.mean()), float(logs.std(ddof=1) / np.sqrt(len(logs))) if len(
        logs
    ) > 1 else np.inf


def _log_error_ratio(own: Array, constant: Array) -> float:
    """ln of the median error (n,D) over the constant's."""
    sizes = [float(np.median(np.linalg.norm(r, axis=1))) for r in (own, constant)]
    return float(np.log(max(sizes[0], STILL) / max(sizes[1], STILL)))


def describe_sighting_counts(features: Sequence[Features], name: str) -> str:
    """In how many images a track was seen, and why not in the others, by reason."""
    counts = [count_sightings(found, name) for found in features if name in found.tracks]
    looked = sum(c[0] for c in counts)
    used = sum(c[1] for c in counts)
    reasons: dict[str, int] = {}
    for _, _, rejected in counts:
        for reason, count in rejected.items():
            reasons[reason] = reasons.get(reason, 0) + count
    why = ", ".join(
        f"{count} {reason}" for reason, count in sorted(reasons.items(), key=lambda one: -one[1])
    )
    return f"seen in {used} of {looked} images" + (f" (others: {why})" if why else "")


def count_sightings(found: Features, name: str) -> tuple[int, int, dict[str, int]]:
    """Images searched for a track, images it was seen in, and counts of the others by reason."""
    health = found.health.get(name)
    track = found.tracks[name]
    if health is not None:
        return health.seen, health.used, dict(health.rejected)
    shown = int(np.isfinite(track.values).all(axis=1).sum())
    return len(track.t), shown, {"not seen": len(track.t) - shown} if shown < len(track.t) else {}


def learned_joints_finding(
    known: Sequence[SmoothedJoint], chosen: Sequence[SmoothedJoint]
) -> Finding:
    """The joints learned over and their ranges."""
    ranges = ", ".join(f"{joint.name} {joint.range:.3g}" for joint in chosen)
    rest = [joint.name for joint in known if joint not in chosen]
    others = f"; not learned over: {', '.join(rest)}" if rest else ""
    return Finding(
        "info", f"joints: {len(chosen)} learned over, which moved by {ranges} rad{others}"
    )
