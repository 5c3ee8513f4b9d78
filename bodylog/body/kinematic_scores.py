"""What a kinematic body says of itself: held-out errors, what is gained, links chosen, joints' zeros."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ..kinematics.identifiability import Offset, said
from ..kinematics.links import Found
from ..types import Finding, Score
from .evidence import Hyper, condition
from .explicit import held_out, solved
from .gp import GP
from .kinematic_gp import KinematicGP
from .residuals import Part, spread_of


def gain(plain: GP, part: Part) -> float:
    """How many nats likelier the same sightings are with kinematics than by a Gaussian process alone."""
    kernel = Hyper(plain.scales[0], float(plain.amplitude[0]), float(plain.noise.mean()))
    spread = spread_of(part.pairs, plain.means(part.pairs.x)[1], part.known)
    own = np.sqrt(np.broadcast_to(spread.share, part.pairs.y.shape[1]))
    alone = condition(kernel, part.pairs.x, part.pairs.y / own, spread).evidence
    alone -= len(part.pairs.x) * float(np.log(own).sum())
    return solved(part.chol, part.rows).evidence - alone


def scores(name: str, gp: KinematicGP, part: Part) -> Iterator[Score]:
    """Held-out error of one track, what kinematics alone leaves, an error that lasts, noise, length scales."""
    residual, variance = held_out(part.chol, part.rows, part.pairs.block)
    left = part.pairs.y - gp.kinematics(part.pairs.x)
    yield Score(f"held_out.{name}", float(np.sqrt(np.mean(residual**2))), "px")
    yield Score(f"held_out_standardised.{name}", float(np.mean(residual**2 / variance)), "1")
    yield Score(f"kinematics_alone.{name}", float(np.sqrt(np.mean(left**2))), "px")
    yield Score(f"lasting_error.{name}", float(np.sqrt(part.drift)), "px")
    yield Score(f"frames_used.{name}", len(part.pairs.x) / max(part.pairs.frames, 1), "1")
    for output, value in zip(gp.outputs, gp.noise, strict=True):
        yield Score(f"noise.{name}.{output}", float(np.sqrt(value)), gp.unit)
    for joint, scale in zip(gp.rig.joints, gp.scales[0], strict=True):
        yield Score(f"length_scale.{name}.{joint}", float(scale), "rad")


def zeros(found: Sequence[Offset]) -> Iterator[Score]:
    """The zeros that are identifiable, rad or m, and their standard deviations."""
    for one in found:
        if one.identifiable:
            yield Score(f"offset.{one.joint}", one.value, one.unit)
            yield Score(f"offset_std.{one.joint}", one.std, one.unit)


def findings(links: Found, found: Sequence[Offset], gains: Mapping[str, float]) -> Iterator[Finding]:
    """Links chosen, nats gained, zeros that are surely off, and those that cannot be told."""
    rig = links.calibrated.rig
    sure = "" if links.margin is None else f" ({links.margin:.0f} nats likelier than other links)"
    for sight in rig.sights:
        camera, marker = rig.cameras[sight.camera].link, rig.carriers[sight.carrier].link
        yield Finding("info", f"{sight.name.strip('/')}: camera on {camera}, marker on {marker}{sure}")
    for name in links.lacking:
        text = f"{name}: stands between camera and marker and is not in the log; it is taken to stand at zero"
        yield Finding("warning", text)
    for name, nats in gains.items():
        yield Finding("info", f"{name}: {nats:.0f} nats likelier with the URDF")
    for one in found:
        if one.identifiable and abs(one.value) > 2.0 * one.std:
            yield Finding("info", f"{one.joint}: its zero is off by {one.shown}")
    for text in said(found):
        yield Finding("info", text)
