"""Report on an exploration: how far each joint moved, its effect on each track, and what could not be learned."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ..body_model import Noise
from ..types import Features, Finding, Score
from .data.pairs import Joint, joints, moves, sparse_joints
from .gp.model import GP


def scores(chosen: Sequence[Joint], senses: Mapping[str, GP], noise: Noise) -> Iterator[Score]:
    """Yield each joint's range, its influence on each track, and the model's std beside the pixel noise."""
    for joint in chosen:
        yield Score(f"range/{joint.name}", joint.range, "rad")
    for name, gp in senses.items():
        for joint, size in zip(chosen, influence(gp), strict=True):
            yield Score(f"influence/{name}/{joint.name}", size, gp.unit)
        spread = gp.predict(gp.samples)[2]
        yield Score(f"std/model/{name}", float(np.sqrt(spread.mean())), gp.unit)
        yield Score(f"std_over_noise/model/{name}", float(np.sqrt(spread.mean() / np.mean(noise.senses[name]))), "1")


def findings(known: Sequence[Joint], chosen: Sequence[Joint], senses: Mapping[str, GP], noise: Noise) -> list[Finding]:
    """Joints that vision does not observe: those that did not move, and those with less influence than pixel noise."""
    still = [joint for joint in known if joint not in chosen]
    left_out = "left out: vision does not observe it"
    found = [Finding("info", f"{j.name}: moved {j.range:.3f} rad, {left_out}") for j in still]
    for name, gp in senses.items():
        least = float(np.sqrt(np.mean(noise.senses[name])))
        for joint, size in zip(chosen, influence(gp), strict=True):
            if size < least:
                moved = f"{joint.name}: moved {joint.range:.3f} rad, {name} only {size:.2f} px"
                found.append(Finding("warning", f"{moved}: vision hardly observes it"))
    return found


def missing_findings(features: Sequence[Features], names: Sequence[str], wanted: Sequence[str] | None) -> list[Finding]:
    """Warnings for joints that are not learned but move what is seen: too few readings, or not selected."""
    sparse = sparse_joints(features)
    found = [Finding("warning", f"{text}; left out: its motion is an error of vision") for text in sparse.values()]
    shared = [set(f.joints.names) for f in features if f.joints is not None]
    rest = tuple(n for n in sorted(set.intersection(*shared)) if n not in names and n not in sparse) if wanted else ()
    for joint in joints(features, rest) if rest else ():
        if moves(joint):
            moved = f"{joint.name}: moved {joint.range:.3f} rad but is not among the joints learned"
            found.append(Finding("warning", f"{moved}: its motion is an error of vision"))
    return found


def influence(gp: GP) -> list[float]:
    """Root mean square effect of each joint's motion on the outputs, in their unit."""
    slope = gp.means(gp.samples)[1]
    return [float(v) for v in np.sqrt((slope**2).sum(axis=1).mean(axis=0)) * gp.samples.std(axis=0)]
