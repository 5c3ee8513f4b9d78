"""Gravity sag: each joint gives way to the weight that it carries, by its torque times a compliance.

The torques are those of the URDF's masses. Sag and a joint's
zero look alike where the torque hardly changes; then nothing separates the two, and the zero's
error bar contains that.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...kinematics.adjustment import Adjusted
from ...kinematics.rig import Rig
from ...kinematics.weights import Weights
from ...types import Array
from .placements import Calibration
from .residuals import ResidualPart, solve_together

MOST_RAD = float(np.radians(1.0))
"""Prior standard deviation of the sag under the largest torque of a log."""
BETTER_SIGMAS = 2.0
"""Standard errors, by the groups' scatter, by which images left out are predicted better."""


@dataclass(frozen=True, eq=False)
class Sag:
    """Sag that the sightings ask for: weights · doubt: prior std of each joint's compliance, rad/N m
    · theta (P,), compliance (M,) and covariance (P+M,P+M) of both, beside a process of residuals.
    """

    weights: Weights
    doubt: float
    theta: Array
    compliance: Array
    covariance: Array


def solve_with_sag(
    rig: Rig, theta: Array, parts: Mapping[str, ResidualPart], weights: Weights
) -> Sag | None:
    """θ and compliances beside a process of residuals; None where no joint carries anything.

    theta (P,): near the solution.
    """
    torques = {name: weights.torques(part.view.readings) for name, part in parts.items()}
    largest = max(float(np.abs(one).max(initial=0.0)) for one in torques.values())
    if largest == 0.0:
        return None
    doubt = MOST_RAD / largest
    both = solve_together(rig, theta, parts, {n: doubt * one for n, one in torques.items()})
    units = np.concatenate([rig.prior[1], np.full(len(rig.joints), doubt)])
    covariance = both.beside.covariance * units * units[:, None]
    return Sag(weights, doubt, both.theta, doubt * both.beside.mean, covariance)


def left_out_share(without: Adjusted, with_sag: Adjusted) -> tuple[float, bool]:
    """RMS error of groups of images that are left out, as a share of that without
    sag, and whether it is less by more than BETTER_SIGMAS.
    """
    gain = without.left_out - with_sag.left_out
    share = float(np.sqrt(with_sag.left_out.mean() / without.left_out.mean()))
    return share, bool(gain.mean() > BETTER_SIGMAS * gain.std(ddof=1) / np.sqrt(len(gain)))


def describe_sag(share: float, better: bool, found: Calibration) -> str:
    """A sentence about sag, by `left_out_share` and by whether the images identify it."""
    text = f"gravity sag: with it images left out have {share:.1%} of their error"
    if better:
        return f"{text}; zeros are those without weight"
    if any(one.identifiable for one in found.compliances):
        return f"{text}, so none is estimated; zeros contain what there is"
    return (
        "gravity sag: not identifiable, over these postures it looks like the joints' zeros, which "
        "contain it"
    )
