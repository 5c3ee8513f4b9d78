"""Scores and remarks of a kinematic body: held-out errors, evidence, links, joint zeros."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...kinematics.identifiability import Offset, describe_unidentified
from ...kinematics.links import FoundLinks
from ...kinematics.rig import SPACE, Rig
from ...types import Finding, Score
from ..data.pairs import Pairs, SmoothedJoint, correlate_angle_errors
from ..gp.fit import Coupling, Samples, propagate_input_noise
from ..gp.marginal_likelihood import Hyper, condition_gp
from ..gp.model import GP
from .explicit import hold_out_blocks, solve_linear_unknowns
from .model import KinematicGP
from .residuals import MOST, ResidualPart, Together, linearise_residuals, spread_of
from .sightings import ThingSightings, average_points

COMPUTED_MM = 0.005
"""Laser trackers measure to some 0.01 mm, and arms repeat to as much at best."""


def kinematics_gain_nats(
    rig: Rig,
    index: int,
    found: Together,
    name: str,
    shown: ThingSightings,
    plain: Mapping[str, GP],
    chosen: Sequence[SmoothedJoint],
) -> float:
    """Nats won by kinematics over a Gaussian process alone, on the same sightings.

    For a board: sightings of one point of each of its parts, each with a process of its own.
    """
    part = found.parts[name]
    alone = 0.0
    if len(shown.points) == 1:
        return solve_linear_unknowns(part.chol, part.rows).evidence - evidence_of_gp_alone(
            plain[name], part.pairs, part.known
        )
    points = [point for track, point in part.points.items() if track in plain]
    view, kept, _ = average_points(
        shown, shown.seen, shown.image, np.eye(len(shown.points), dtype=bool)[points], MOST
    )
    seen = rig.see(rig.sights[index], found.theta, shown.whole.x, shown.whole.log)
    spread = spread_of(kept, view.of(seen.slope), correlate_angle_errors(kept, chosen))
    rows = linearise_residuals(rig, found.theta, kept, seen, view, spread)
    own = max(part.own - float(np.nanmean(shown.floor)), 0.0)
    both = replace(
        part,
        pairs=kept,
        view=view,
        rows=rows,
        kernel=replace(part.kernel, noise=part.kernel.noise + own),
    )
    for point in points:
        mine = kept.rows(np.flatnonzero(view.share[:, point]))
        alone += evidence_of_gp_alone(
            plain[shown.tracks[point]], mine, correlate_angle_errors(mine, chosen)
        )
    return solve_linear_unknowns(both.chol, rows).evidence - alone


def evidence_of_gp_alone(plain: GP, part: Pairs, known: Coupling) -> float:
    """Evidence (nats) of sightings by a Gaussian process alone."""
    outputs = range(part.y.shape[1])
    groups = [slice(d, d + 1) for d in outputs] if len(plain.scales) > 1 else [slice(len(outputs))]
    data = Samples(part.x, part.y, part.floor, part.variance, known)
    total = 0.0
    for k, (group, spread) in enumerate(
        zip(groups, propagate_input_noise(data, plain, groups), strict=True)
    ):
        noise = float(plain.noise[group].mean())
        kernel = Hyper(plain.scales[k], float(plain.amplitude[k]), noise)
        y = part.y[:, group]
        own = np.sqrt(np.broadcast_to(spread.share, y.shape[1]))
        total += condition_gp(kernel, part.x, y / own, spread).evidence
        total -= len(part.x) * float(np.log(own).sum())
    return total


def kinematic_scores(
    name: str, models: Mapping[str, KinematicGP], part: ResidualPart
) -> Iterator[Score]:
    """Yield one thing's held-out error, residual of
    kinematics alone, slow error, noise and length scales.

    For a board, the held-out value is the mean of the points of each of its parts.
    """
    residual, variance = hold_out_blocks(part.chol, part.rows, part.pairs.block)
    left = np.concatenate(
        [one.y - models[track].kinematics(one.x) for track, one in part.tracks.items()]
    )
    any_ = next(iter(models.values()))
    yield Score(f"rmse/held_out/{name}", float(np.sqrt(np.mean(residual**2))), any_.unit)
    yield Score(f"nis/held_out/{name}", float(np.mean(residual**2 / variance)), "1")
    yield Score(f"rmse/kinematics/{name}", float(np.sqrt(np.mean(left**2))), any_.unit)
    yield Score(f"std/lasting/{name}", float(np.sqrt(part.drift)), any_.unit)
    used = len(np.unique(part.view.picture))
    yield Score(f"used_share/{name}", used / max(part.pairs.frames, 1), "1")
    for output, value in zip(any_.outputs, any_.noise, strict=True):
        yield Score(f"std/noise/{name}/{output}", float(np.sqrt(value)), any_.unit)
    for joint, scale in zip(any_.rig.joints, any_.scales[0], strict=True):
        yield Score(f"length_scale/{name}/{joint}", float(scale), "rad")


def zero_scores(found: Sequence[Offset]) -> Iterator[Score]:
    """Yield identifiable zeros (rad or m) and scales (1), and their standard deviations."""
    for one in found:
        if one.identifiable:
            name = "scale" if one.noun == "scale" else "offset"
            yield Score(f"{name}/{one.joint}", one.value, one.unit)
            yield Score(f"std/{name}/{one.joint}", one.std, one.unit)


def kinematic_findings(
    links: FoundLinks, found: Sequence[Offset], gains: Mapping[str, float]
) -> Iterator[Finding]:
    """Yield remarks on links chosen, nats won, significant
    zeros, and zeros that are not identifiable.
    """
    rig = links.calibrated.rig
    sure = "" if links.margin is None else f" ({links.margin:.0f} nats likelier than other links)"
    for sight in rig.sights:
        camera = rig.cameras[sight.camera]
        marker = rig.carriers[sight.carrier].link
        word = "tracker" if camera.tracks_space else "camera"
        yield Finding(
            "info", f"{sight.name.strip('/')}: {word} on {camera.link}, marker on {marker}{sure}"
        )
    exact = float(links.calibrated.noise[SPACE]) ** 0.5
    if SPACE in rig.kinds and exact < COMPUTED_MM:
        what = f"points agree with the joints to {exact:.2g} mm, more exactly than trackers measure"
        todo = "if they were computed from the joints, they tell no zeros; type --without NAME"
        yield Finding("warning", f"{what}; {todo}")
    for name in links.lacking:
        text = f"{name}: between camera and marker, but without readings; assumed at zero"
        yield Finding("warning", text)
    for name, nats in gains.items():
        yield Finding("info", f"{name}: {nats:.0f} nats likelier with the URDF")
    for one in found:
        if one.identifiable and abs(one.value) > 2.0 * one.std:
            yield Finding("info", f"{one.joint}: its {one.noun} is off by {one.shown}")
    for text in describe_unidentified(found):
        yield Finding("info", text)
