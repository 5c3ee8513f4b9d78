"""Report on an exploration: how far each joint moved,
its effect on each track, and what could not be learned.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ..body_model import Noise
from ..sources import group_of
from ..types import Features, Finding, Score
from .data.pairs import SmoothedJoint, has_moved, smooth_all_joints, sparse_joints
from .gp.model import GP


def exploration_scores(
    chosen: Sequence[SmoothedJoint], senses: Mapping[str, GP], noise: Noise
) -> Iterator[Score]:
    """Yield each joint's range, its influence on each track
    or board, and the model's std beside the pixel noise.
    """
    for joint in chosen:
        yield Score(f"range/{joint.name}", joint.range, "rad")
    for group, models in _models_by_group(senses).items():
        unit = next(iter(models.values())).unit
        for joint, size in zip(chosen, group_influence(models), strict=True):
            yield Score(f"influence/{group}/{joint.name}", size, unit)
        spread = float(np.mean([gp.predict(gp.samples)[2].mean() for gp in models.values()]))
        pixels = float(np.mean([noise.senses[name] for name in models]))
        yield Score(f"std/model/{group}", spread**0.5, unit)
        yield Score(f"std_over_noise/model/{group}", (spread / pixels) ** 0.5, "1")


def still_findings(
    known: Sequence[SmoothedJoint], chosen: Sequence[SmoothedJoint]
) -> list[Finding]:
    """Remarks on joints that did not move."""
    still = [joint for joint in known if joint not in chosen]
    left_out = "left out: vision does not observe it"
    return [
        Finding("info", f"{joint.name}: moved {joint.range:.3f} rad, {left_out}") for joint in still
    ]


def faint_findings(
    chosen: Sequence[SmoothedJoint], senses: Mapping[str, GP], noise: Noise
) -> list[Finding]:
    """Warnings for joints whose motion moves a track, or all of a board, by less than its noise."""
    found = []
    for group, models in _models_by_group(senses).items():
        least = float(np.sqrt(np.mean([noise.senses[name] for name in models])))
        for joint, size in zip(chosen, group_influence(models), strict=True):
            if size < least:
                moved = f"{joint.name}: moved {joint.range:.3f} rad, {group} only {size:.2f} px"
                found.append(Finding("warning", f"{moved}: vision hardly observes it"))
    return found


def missing_findings(
    features: Sequence[Features], names: Sequence[str], wanted: Sequence[str] | None
) -> list[Finding]:
    """Warnings for joints that are not learned but move
    what is seen: too few readings, or not selected.
    """
    sparse = sparse_joints(features)
    found = [
        Finding("warning", f"{text}; left out: its motion is an error of vision")
        for text in sparse.values()
    ]
    shared = [set(f.joints.names) for f in features if f.joints is not None]
    rest = (
        tuple(n for n in sorted(set.intersection(*shared)) if n not in names and n not in sparse)
        if wanted
        else ()
    )
    for joint in smooth_all_joints(features, rest) if rest else ():
        if has_moved(joint):
            moved = f"{joint.name}: moved {joint.range:.3f} rad but is not among the joints learned"
            found.append(Finding("warning", f"{moved}: its motion is an error of vision"))
    return found


def _models_by_group(senses: Mapping[str, GP]) -> dict[str, dict[str, GP]]:
    """The models of each track, or of each board together."""
    groups: dict[str, dict[str, GP]] = {}
    for name, gp in senses.items():
        groups.setdefault(group_of(name), {})[name] = gp
    return groups


def group_influence(models: Mapping[str, GP]) -> list[float]:
    """Root mean square effect of each joint's motion on
    a track, or on all tracks of a board, in their unit.
    """
    effects = [joint_influence(gp) for gp in models.values()]
    return [float(value) for value in np.sqrt(np.mean(np.square(effects), axis=0))]


def joint_influence(gp: GP) -> list[float]:
    """Root mean square effect of each joint's motion on the outputs, in their unit."""
    slope = gp.means(gp.samples)[1]
    return [float(v) for v in np.sqrt((slope**2).sum(axis=1).mean(axis=0)) * gp.samples.std(axis=0)]
