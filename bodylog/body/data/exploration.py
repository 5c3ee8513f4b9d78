"""Select joints of unnamed topics: those whose motion some track shows."""

from collections.abc import Sequence

import numpy as np

from ...settings import FitSettings
from ...types import TRACK_AXES, Array, Features, Finding
from ..exploration_report import joint_influence
from ..gp.cross_validation import held_out_residuals
from ..gp.fit import FittedKernels, Samples, assemble_exact_gp, fit_kernels
from ..gp.marginal_likelihood import ROTATION
from .pairs import Pairs, SmoothedJoint, pair_sightings
from .subsampling import choose_farthest_rows
from .trainable import SURE, log_ratio

SAMPLES = 200
FEWEST = 8
"""Sightings that suffice to see whether a joint moves a track, and the fewest that are judged."""
TURN = 2 * np.pi
"""rad: no posture of an arm needs more."""


def select_joints(
    features: Sequence[Features], chosen: Sequence[SmoothedJoint], fit: FitSettings
) -> tuple[list[SmoothedJoint], list[Finding]]:
    """Drop joints of further topics unless a track shows
    their motion, and wheels if they surely do harm.

    A gripper's fingers on a topic of their own, for example, do not move the arm's marker. A wheel
    that turns steadily serves as a clock: it explains any track between its neighbours in time, and
    misleads in held-out time.
    """
    beside = {name for found in features for name in found.beside}
    extra = [k for k, joint in enumerate(chosen) if joint.name in beside]
    wheels = [k for k, joint in enumerate(chosen) if joint.range > TURN and k not in extra]
    if not extra and not wheels:
        return list(chosen), []
    parts = _sample_moving_tracks(features, chosen, fit)
    known = [k for k in range(len(chosen)) if k not in extra and k not in wheels]
    # as one: angles in degrees all seem to be wheels
    if not parts or any(_lowers_held_out_error(part, known, wheels, fit, -SURE) for part in parts):
        known += wheels
    effects = (
        np.max([_joint_effects(part, fit) for part in parts], axis=0)
        if extra and parts
        else np.zeros(len(chosen))
    )
    for k in sorted(extra, key=lambda k: -effects[k]):
        if effects[k] > 1.0 and any(
            _lowers_held_out_error(part, known, [k], fit, SURE) for part in parts
        ):
            known.append(k)
    left = [joint for k, joint in enumerate(chosen) if k not in known]
    return [chosen[k] for k in sorted(known)], [
        _left_out_finding(joint, joint.name in beside) for joint in left
    ]


def _left_out_finding(joint: SmoothedJoint, extra: bool) -> Finding:
    text = "no track shows its motion; to include it, name it in [body] joints"
    return Finding(
        "info" if extra else "warning", f"{joint.name}: moved {joint.range:.3f}, left out: {text}"
    )


def _sample_moving_tracks(
    features: Sequence[Features], chosen: Sequence[SmoothedJoint], fit: FitSettings
) -> list[Pairs]:
    """Some sightings of each track that moves."""
    tracks = sorted({name for found in features for name in found.tracks if name != "hand"})
    parts = [pair_sightings(features, track, chosen, fit.every) for track in tracks]
    moved = [part for part in parts if len(part.x) >= FEWEST and part.y.std(axis=0).all()]
    return [part.rows(choose_farthest_rows(part.x, SAMPLES)) for part in moved]


def _joint_effects(part: Pairs, fit: FitSettings) -> Array:
    """How far each joint's own motion (M,) moves a
    track, over the model's leave-one-out residual.
    """
    data, kernels = _fit_joint_columns(part, range(part.x.shape[1]), fit)
    residual = float(
        np.sqrt(np.mean(held_out_residuals(data, kernels, np.arange(len(data.x)))[0] ** 2))
    )
    gp = assemble_exact_gp(data, kernels, *TRACK_AXES[data.y.shape[1]])
    return np.array(joint_influence(gp)) / residual


def _lowers_held_out_error(
    part: Pairs, known: Sequence[int], more: Sequence[int], fit: FitSettings, sure: float
) -> bool:
    """Whether more joints lower a track's error in
    held-out blocks of time, by `sure` standard errors.
    """
    if not known or not more:
        return True
    own, other = (
        held_out_residuals(*_fit_joint_columns(part, of, fit), part.block)[0]
        for of in ([*known, *more], known)
    )
    mean, error = log_ratio(own, other, part.block)
    return mean + sure * error < 0.0


def _fit_joint_columns(
    part: Pairs, columns: Sequence[int], fit: FitSettings
) -> tuple[Samples, FittedKernels]:
    """Samples of some joints (columns of part.x), and the Gaussian process learned from them."""
    of = list(columns)
    data = Samples(part.x[:, of], part.y, part.floor, part.variance[:, of])
    return data, fit_kernels(data, ROTATION, True, fit.seed)
