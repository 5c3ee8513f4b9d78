"""Add kinematics to a learned body: the URDF as the
mean of each track, a Gaussian process on the residuals.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ...body_model import WITHOUT_URDF
from ...errors import ModelError
from ...kinematics.identifiability import GIVEN
from ...kinematics.links import CameraHint, FoundLinks, MarkerHint, MarkerTrack, find_links
from ...kinematics.robot import Robot, reason_implausible
from ...kinematics.weights import collect_weights
from ...runtime.blas_threads import one_thread
from ...settings import Settings
from ...sources import group_of
from ...types import Array, Features, Finding
from .. import exploration_report
from ..gp.model import GP
from ..learning import LearnedBody
from ..noise_estimates import replace_sense_noise
from ..senses import encoder_function
from .adjusting import (
    Resting,
    Surroundings,
    Widened,
    adjust_calibration,
    include_resting_joints,
    recorded_logs,
)
from .lengths import find_stretched_link
from .model import KinematicGP
from .move_findings import move_findings
from .moves import Move, find_moves
from .placements import KEPT, SAG, kept_calibration
from .residuals import RESIDUAL, Together, fit_residual_kernel, forward_models, solve_together
from .sag import Sag, describe_sag, left_out_share, solve_with_sag
from .scores import kinematic_findings, kinematic_scores, kinematics_gain_nats, zero_scores
from .sightings import ThingSightings, gather_sightings

UNFIT = 0.1
"""Largest residual share of a track's motion with the right robot; a real NAO's is 0.03."""


@dataclass(frozen=True, eq=False)
class Robotics:
    """A robot: its URDF · hints by camera name · doubt: prior
    std of joint zeros, rad · whether the user asked for it.

    scale: prior std of joint scales; 0 keeps them at 1 · markers: what is known of them, by name.
    """

    robot: Robot
    hints: Mapping[str, CameraHint]
    doubt: float
    asked: bool = True
    scale: float = 0.0
    markers: Mapping[str, MarkerHint] = field(default_factory=dict)


@one_thread("scipy.linalg")
def learn_kinematics(
    features: Sequence[Features], settings: Settings, found: LearnedBody, given: Robotics
) -> LearnedBody:
    """Return the body with kinematics as its tracks' mean,
    or unchanged with a remark if the URDF does not fit.

    ModelError where a requested URDF contains no joint that moved.
    """
    names = found.model.joints
    robot = given.robot
    missing = [name for name in names if name not in robot.by_name]
    if len(missing) == len(names) and given.asked:
        have = ", ".join(list(robot.by_name)[:12])
        raise ModelError(
            f"{robot.source}: none of the joints that moved ({', '.join(names)}) is in it; "
            f"it has {have}"
        )
    why = f"joint {missing[0]!r} moved and is not in it" if missing else reason_implausible(robot)
    if why:
        return leave_urdf_unused(found, why)
    tracks = {
        name: gp
        for name, gp in found.model.senses.items()
        if isinstance(gp, GP) and name != "encoders"
    }
    order = sorted(tracks, key=lambda name: (name in found.poor, name))
    parts = gather_sightings(
        features, order, found.joints, settings.fit.every, settings.fit.samples
    )
    poor = {
        name
        for name, one in parts.items()
        if not any(t in tracks and t not in found.poor for t in one.tracks)
    }
    held = still_joint_angles(features, names)
    left_out = dict[str, str]()
    for _ in range(len(parts)):
        seen = {name: track_of_sightings(name, one) for name, one in parts.items()}
        links = find_links_given(given, names, held, seen, given.hints)
        links, moves = find_moves(links, parts, found.joints, settings.fit.seed)
        if (
            any(find_unexplained_tracks(links, parts))
            and len({log for one in parts.values() for log in one.whole.log}) > 1
        ):
            links = _linked_by_one_log(given, names, held, parts)
            links, moves = find_moves(links, parts, found.joints, settings.fit.seed)
        whys = dict(find_unexplained_tracks(links, parts))
        foreign = {name: why for name, why in whys.items() if name in poor}
        if not foreign or len(foreign) == len(parts):
            break
        left_out |= foreign
        parts = {name: part for name, part in parts.items() if name not in foreign}
    if whys:
        return leave_urdf_unused(found, next(iter(whys.values())))
    beside = Surroundings(recorded_logs(features, tuple(held)), Resting(robot, held, given.doubt))
    try:
        return learn_residuals(
            _drop_unexplained_tracks(found, left_out),
            links,
            parts,
            tracks,
            settings.fit.seed,
            beside,
            moves,
        )
    except ModelError as problem:
        return leave_urdf_unused(found, str(problem))


def _linked_by_one_log(
    given: Robotics,
    names: Sequence[str],
    held: Mapping[str, float],
    parts: Mapping[str, ThingSightings],
) -> FoundLinks:
    """Links as the log with most images shows them: what
    moved between logs is on no link, seen in all at once.
    """
    numbers = np.concatenate([one.whole.log for one in parts.values()])
    log = int(np.argmax(np.bincount(numbers)))
    alone = {name: one.rows(np.flatnonzero(one.whole.log == log)) for name, one in parts.items()}
    first = {name: track_of_sightings(name, one) for name, one in alone.items() if len(one.whole.x)}
    found = find_links_given(given, names, held, first, given.hints)
    rig = found.calibrated.rig
    hints = dict(given.hints)
    carried = dict[str, str]()
    for one, sight in zip(first.values(), rig.sights, strict=True):
        hint = hints.get(one.camera, CameraHint())
        hints[one.camera] = (
            hint if hint.link else replace(hint, link=rig.cameras[sight.camera].link)
        )
        carried[one.marker] = rig.carriers[sight.carrier].link
    seen = {name: track_of_sightings(name, one) for name, one in parts.items()}
    return find_links_given(given, names, held, seen, hints, carried)


def find_links_given(
    given: Robotics,
    names: Sequence[str],
    held: Mapping[str, float],
    seen: Mapping[str, MarkerTrack],
    hints: Mapping[str, CameraHint],
    carried: Mapping[str, str] | None = None,
) -> FoundLinks:
    """The links of cameras and markers, and the priors of them."""
    return find_links(
        given.robot, names, held, seen, hints, given.doubt, given.scale, carried, given.markers
    )


def _drop_unexplained_tracks(found: LearnedBody, left_out: Mapping[str, str]) -> LearnedBody:
    """Drop tracks that neither kinematics nor a process explains."""
    if not left_out:
        return found
    senses = {name: model for name, model in found.model.senses.items() if name not in left_out}
    findings = [
        Finding("warning", f"{name}: left out: {found.poor[name]}; {why}")
        for name, why in left_out.items()
    ]
    return replace(
        found, model=replace(found.model, senses=senses), findings=(*found.findings, *findings)
    )


def track_of_sightings(name: str, shown: ThingSightings) -> MarkerTrack:
    """A thing's sightings, by its camera and marker."""
    camera, _, marker = name.rpartition("/")
    return MarkerTrack(camera, marker, shown.sighted, shown.points)


def still_joint_angles(features: Sequence[Features], names: Sequence[str]) -> dict[str, float]:
    """The median angle, rad, of joints with readings that are not among the names."""
    found: dict[str, float] = {}
    joint_series = (encoder_function.with_true_angles(one, None).joints for one in features)
    for series in (joints for joints in joint_series if joints is not None):
        for name, column in zip(series.names, series.values.T, strict=True):
            if name not in names and np.isfinite(column).any():
                found.setdefault(name, float(np.nanmedian(column)))
    return found


def leave_urdf_unused(
    found: LearnedBody, why: str, advice: str = "give this robot's own with --urdf"
) -> LearnedBody:
    """Return the body without a URDF, with a remark on why."""
    text = f"the URDF is not used: {why}; {advice}, {WITHOUT_URDF}"
    return replace(found, findings=(*found.findings, Finding("warning", text)))


def find_unexplained_tracks(
    links: FoundLinks, parts: Mapping[str, ThingSightings]
) -> Iterator[tuple[str, str]]:
    """Yield tracks with too large residuals of kinematics, and how large."""
    calibrated = links.calibrated
    for (name, one), sight, weight in zip(
        parts.items(), calibrated.rig.sights, calibrated.weights, strict=True
    ):
        camera = calibrated.rig.cameras[sight.camera]
        unit = "mm" if camera.tracks_space else "px"
        left = float(calibrated.noise[int(camera.tracks_space)]) ** 0.5
        spread = one.sighted.spread
        if left > UNFIT * spread or weight[one.seen].mean() < 0.5:
            ends = f"from {sight.chain.start} to {sight.chain.end}"
            yield (
                name,
                f"{ends} its residual for {name} is {left:.1f} {unit}, the motion "
                f"{spread:.0f} {unit}",
            )


def learn_residuals(
    found: LearnedBody,
    links: FoundLinks,
    shown: Mapping[str, ThingSightings],
    plain: Mapping[str, GP],
    seed: int,
    beside: Surroundings,
    moves: Sequence[Move] = (),
) -> LearnedBody:
    """Learn the residuals with calibrated links; return
    the body unchanged, with a remark, if they do not fit.

    moves: of cameras and markers between logs. The body holds where they were in the last log.
    """
    calibrated = links.calibrated
    rig = calibrated.rig
    theta = calibrated.theta
    weights = calibrated.weights
    each = enumerate(shown.items())
    parts = {
        name: fit_residual_kernel(rig, k, theta, one, weights[k], found.joints, seed)
        for k, (name, one) in each
    }
    for k, part in enumerate(parts.values()):
        off = find_stretched_link(rig, k, theta, part, RESIDUAL)
        if off is not None and off.wrong:
            return leave_urdf_unused(found, off.text)
    both = solve_together(rig, theta, parts)
    gains = {
        name: kinematics_gain_nats(rig, k, both, name, one, plain, found.joints)
        for k, (name, one) in enumerate(shown.items())
    }
    worst = min(gains, key=lambda name: gains[name])
    if gains[worst] < 0.0:
        return leave_urdf_unused(found, f"{worst} is {-gains[worst]:.0f} nats likelier without it")
    wide = include_resting_joints(calibrated, both, shown, beside)
    calibration, adjusted, printed = adjust_calibration(links, shown, beside, wide)
    sag = _find_sag(wide, beside)
    described = dict[str, str]()
    if sag is not None:
        sagging, bent, _ = adjust_calibration(links, shown, beside, wide, sag)
        share, better = left_out_share(adjusted, bent)
        described[SAG] = describe_sag(share, better, sagging)
        if better:
            calibration = sagging
    offsets = (*calibration.zeros, *calibration.scales)
    senses = {
        name: forward_models(rig, k, both, name, printed) for k, name in enumerate(both.parts)
    }
    all_scores = [
        *(s for name, of in senses.items() for s in kinematic_scores(name, of, both.parts[name])),
        *zero_scores(offsets),
    ]
    found = _remove_tracks(
        found, {track for one in shown.values() if len(one.points) > 1 for track in one.tracks}
    )
    found = _with_residual_models(found, senses, both)
    centres = [one.points.mean(axis=0) for one in shown.values()]
    movements = [*move_findings(adjusted.rig, adjusted.theta, adjusted.covariance, moves, centres)]
    provenance = {**found.model.provenance, KEPT: kept_calibration(calibration), **described}
    found = replace(found, model=replace(found.model, provenance=provenance))
    observed = {track: model for of in senses.values() for track, model in of.items()}
    reported = exploration_report.exploration_scores(found.joints, observed, found.model.noise)
    kept = {score.name: score for score in (*found.scores, *reported, *all_scores)}
    groups = {group_of(track) for track in observed}
    rest = {
        n: gp for n, gp in plain.items() if n in found.model.senses and group_of(n) not in groups
    }
    return replace(
        found,
        scores=tuple(kept.values()),
        findings=(*found.findings, *movements, *kinematic_findings(links, offsets, gains)),
        faint=tuple(
            exploration_report.faint_findings(found.joints, {**rest, **observed}, found.model.noise)
        ),
    )


def _find_sag(wide: Widened, beside: Surroundings) -> Sag | None:
    """Sag beside the process; None where the URDF has no masses, or zeros are given."""
    resting = beside.resting
    if resting is None or resting.doubt <= GIVEN:
        return None
    rig = wide.rig
    weights = collect_weights(resting.robot, rig.joints, resting.still)
    return solve_with_sag(rig, wide.both.theta, wide.both.parts, weights) if weights.parts else None


def _remove_tracks(found: LearnedBody, tracks: set[str]) -> LearnedBody:
    """Remove all results for single tracks of a board."""
    model = found.model
    senses = {name: one for name, one in model.senses.items() if name not in tracks}
    noise = {name: one for name, one in model.noise.senses.items() if name not in tracks}
    errors = {name: one for name, one in model.noise.std_error.items() if name not in tracks}
    model = replace(
        model, senses=senses, noise=replace(model.noise, senses=noise, std_error=errors)
    )
    scores = [one for one in found.scores if not _belongs_to_tracks(one.name, tracks)]
    findings = [one for one in found.findings if one.text.partition(":")[0] not in tracks]
    return replace(found, model=model, scores=tuple(scores), findings=tuple(findings))


def _belongs_to_tracks(name: str, tracks: set[str]) -> bool:
    """Whether a score's name belongs to one of the tracks."""
    return any(f"/{track}/" in f"{name}/" for track in tracks)


def _with_residual_models(
    found: LearnedBody, things: Mapping[str, Mapping[str, KinematicGP]], both: Together
) -> LearnedBody:
    """The body with these senses and their noise."""
    senses = {track: model for of in things.values() for track, model in of.items()}
    variances = dict[str, Array]()
    counts = dict[str, int]()
    for name, of in things.items():
        part = both.parts[name]
        for track, model in of.items():
            variances[track] = model.noise + part.tracks[track].floor.mean(axis=0)
            counts[track] = len(part.pairs.x)
    noise = replace_sense_noise(found.model.noise, variances, counts)
    return replace(
        found, model=replace(found.model, senses={**found.model.senses, **senses}, noise=noise)
    )
