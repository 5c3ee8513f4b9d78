"""Select joints of unnamed topics: those whose motion some track shows."""

from collections.abc import Sequence

import numpy as np

from ...settings import Fit
from ...types import Features, Finding
from ..exploration_report import influence
from ..gp.cross_validation import residuals
from ..gp.fit import Samples, assemble, fitted
from ..gp.marginal_likelihood import ROTATION
from .pairs import Joint, Pairs, pairs
from .subsampling import farthest

SAMPLES, FEWEST = 200, 8
"""Sightings that suffice to see whether a joint moves a track, and the fewest that are judged."""


def select_joints(features: Sequence[Features], chosen: Sequence[Joint], fit: Fit) -> tuple[list[Joint], list[Finding]]:
    """Drop joints of further topics that move no track by more than the model's residual.

    A gripper's fingers on a topic of their own, for example, do not move the arm's marker.
    """
    beside = {name for found in features for name in found.beside}
    if not any(joint.name in beside for joint in chosen):
        return list(chosen), []
    seen = set[str]()
    for track in sorted({name for found in features for name in found.tracks if name != "hand"}):
        part = pairs(features, track, chosen, fit.every)
        if len(part.x) >= FEWEST and part.y.std(axis=0).all():
            seen |= _moving(part, chosen, fit)
    kept = [joint for joint in chosen if joint.name not in beside or joint.name in seen]
    left = [joint for joint in chosen if joint not in kept]
    text = "no track shows its motion; to include it, name it in [body] joints"
    return kept, [Finding("info", f"{j.name}: moved {j.range:.3f}, left out: {text}") for j in left]


def _moving(part: Pairs, chosen: Sequence[Joint], fit: Fit) -> set[str]:
    """Joints whose own motion moves a track by more than the leave-one-out residual."""
    part = part.rows(farthest(part.x, SAMPLES))
    data = Samples(part.x, part.y, part.floor, part.variance)
    kernels = fitted(data, ROTATION, True, fit.seed)
    gp = assemble(data, kernels, ("u", "v"), "px")
    least = float(np.sqrt(np.mean(residuals(data, kernels, np.arange(len(data.x)))[0] ** 2)))
    return {joint.name for joint, size in zip(chosen, influence(gp), strict=True) if size > least}
