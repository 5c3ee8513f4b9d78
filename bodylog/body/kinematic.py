"""A learned body with a URDF: kinematics as the mean of each track, a Gaussian process on what that leaves."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import ModelError
from ..kinematics import identifiability
from ..kinematics.calibration import Sighted
from ..kinematics.links import CameraHint, Found, Track, find
from ..kinematics.urdf import Robot, implausible
from ..settings import Settings
from ..threads import one_thread
from ..types import Features, Finding
from . import encoders
from .gp import GP
from .kinematic_gp import KinematicGP
from .kinematic_scores import findings, gain, scores, zeros
from .learning import Learned
from .lengths import stretched
from .pairs import Pairs, pairs
from .residuals import RESIDUAL, Together, model, residual, together
from .select import farthest

UNFIT = 0.1
"""Share of a track's motion that kinematics of the right robot does not leave: a real NAO's leaves 0.03."""
_LEAST_NOISE = 1e-6
_CORNERS = 4
"""Of one thing, the most tracks that are calibrated each by itself: a tag's corners."""


@dataclass(frozen=True, eq=False)
class Robotics:
    """What is known of a robot: its URDF · hints by camera name · doubt: σ of its joints' zeros, rad."""

    robot: Robot
    hints: Mapping[str, CameraHint]
    doubt: float


@one_thread("scipy.linalg")
def learn(features: Sequence[Features], settings: Settings, found: Learned, given: Robotics) -> Learned:
    """The body learned without a URDF, with kinematics as its tracks' mean; as it was, with a remark, if that is unfit.

    ModelError where no joint that moved is in the URDF.
    """
    names, robot = found.model.joints, given.robot
    boards = sorted({name for f in features for name, (tracks, _) in f.boards.items() if len(tracks) > _CORNERS})
    if boards:
        apart = f"{boards[0]} is a board, whose corners are not calibrated together"
        return _unused(found, apart, "follow one tag of it")
    missing = [name for name in names if name not in robot.by_name]
    if len(missing) == len(names):
        have = ", ".join(list(robot.by_name)[:12])
        raise ModelError(f"{robot.source}: none of the joints that moved ({', '.join(names)}) is in it; it has {have}")
    why = f"joint {missing[0]!r} moved and is not in it" if missing else implausible(robot)
    if why:
        return _unused(found, why)
    tracks = {name: gp for name, gp in found.model.senses.items() if isinstance(gp, GP) and name != "encoders"}
    order = sorted(tracks, key=lambda name: (name in found.poor, name))
    parts = {name: pairs(features, name, found.joints, settings.fit.every) for name in order}
    parts = {name: part.rows(farthest(part.x, settings.fit.samples)) for name, part in parts.items()}
    held, left_out = still(features, names), dict[str, str]()
    for _ in range(len(parts)):
        seen = {name: _track(name, part) for name, part in parts.items()}
        links = find(robot, names, held, seen, given.hints, given.doubt)
        whys = dict(_unexplained(links, parts))
        foreign = {name: why for name, why in whys.items() if name in found.poor}
        if not foreign or len(foreign) == len(parts):
            break
        left_out |= foreign
        parts = {name: part for name, part in parts.items() if name not in foreign}
    if whys:
        return _unused(found, next(iter(whys.values())))
    return _learned(_without(found, left_out), links, parts, tracks, settings.fit.seed)


def _without(found: Learned, left_out: Mapping[str, str]) -> Learned:
    """Without tracks that neither kinematics nor a process explains."""
    if not left_out:
        return found
    senses = {name: model for name, model in found.model.senses.items() if name not in left_out}
    said = [Finding("warning", f"{name}: left out: {found.poor[name]}; {why}") for name, why in left_out.items()]
    return replace(found, model=replace(found.model, senses=senses), findings=(*found.findings, *said))


def _track(name: str, part: Pairs) -> Track:
    camera, _, marker = name.rpartition("/")
    return Track(camera, marker, Sighted(part.x, part.y[:, None], part.floor[:, None]))


def still(features: Sequence[Features], names: Sequence[str]) -> dict[str, float]:
    """The median angle, rad, of joints that are heard and did not move."""
    found: dict[str, float] = {}
    told = (encoders.referred(one, None).joints for one in features)
    for series in (joints for joints in told if joints is not None):
        for name, column in zip(series.names, series.values.T, strict=True):
            if name not in names and np.isfinite(column).any():
                found.setdefault(name, float(np.nanmedian(column)))
    return found


def _unused(found: Learned, why: str, advice: str = "give this robot's own with --urdf") -> Learned:
    text = f"the URDF is not used: {why}; {advice}, or type --no-urdf"
    return replace(found, findings=(*found.findings, Finding("warning", text)))


def _unexplained(links: Found, parts: Mapping[str, Pairs]) -> Iterator[tuple[str, str]]:
    """Tracks of which kinematics leaves too much, and how much."""
    calibrated = links.calibrated
    for (name, part), sight, weight in zip(parts.items(), calibrated.rig.sights, calibrated.weights, strict=True):
        left, spread = calibrated.noise**0.5, float(np.sqrt(part.y.var(axis=0).mean()))
        if left > UNFIT * spread or weight.mean() < 0.5:
            ends = f"from {sight.chain.start} to {sight.chain.end}"
            yield name, f"{ends} it leaves {left:.1f} px of {name}, which moved by {spread:.0f} px"


def _learned(
    found: Learned, links: Found, pairs_of: Mapping[str, Pairs], plain: Mapping[str, GP], seed: int
) -> Learned:
    calibrated = links.calibrated
    rig, theta, weights = calibrated.rig, calibrated.theta, calibrated.weights
    parts = {
        name: residual(rig, k, theta, part, weights[k][:, 0], found.joints, seed)
        for k, (name, part) in enumerate(pairs_of.items())
    }
    for k, part in enumerate(parts.values()):
        off = stretched(rig, k, theta, part.rows, part.kernel, RESIDUAL)
        if off is not None and off.wrong:
            return _unused(found, off.said)
    both = together(rig, theta, parts)
    gains = {name: gain(plain[name], part) for name, part in both.parts.items()}
    worst = min(gains, key=lambda name: gains[name])
    if gains[worst] < 0.0:
        return _unused(found, f"{worst} is {-gains[worst]:.0f} nats likelier without it")
    covariance = rig.prior[1] * (both.root @ both.root.T) * rig.prior[1][:, None]
    offsets = identifiability.offsets(rig, both.theta, covariance)
    senses = {name: model(rig, k, both, name) for k, name in enumerate(both.parts)}
    told = [*(s for name, gp in senses.items() for s in scores(name, gp, both.parts[name])), *zeros(offsets)]
    kept = {score.name: score for score in (*found.scores, *told)}
    return replace(
        _with(found, senses, both),
        scores=tuple(kept.values()),
        findings=(*found.findings, *findings(links, offsets, gains)),
    )


def _with(found: Learned, senses: Mapping[str, KinematicGP], both: Together) -> Learned:
    """The body with these senses and their noise."""
    noise = found.model.noise
    variances, errors = dict(noise.senses), dict(noise.std_error)
    for name, part in both.parts.items():
        variance = np.maximum(senses[name].noise + part.pairs.floor.mean(axis=0), _LEAST_NOISE)
        variances[name] = tuple(float(v) for v in variance)
        errors[name] = tuple(float(v) for v in variance * np.sqrt(2.0 / len(part.pairs.x)))
    noise = replace(noise, senses=variances, std_error=errors)
    return replace(found, model=replace(found.model, senses={**found.model.senses, **senses}, noise=noise))


