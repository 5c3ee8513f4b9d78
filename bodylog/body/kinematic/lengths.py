"""Whether a URDF's link lengths fit: how far each
link would have to stretch, and the evidence for it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ...kinematics.rig import Rig
from ...types import Array
from ..data.subsampling import choose_spaced_rows
from ..gp.marginal_likelihood import Prior, cholesky_with_jitter
from ..gp.model import se_kernel
from .explicit import SEARCHED, search_residual_kernel, solve_linear_unknowns, thin_rows
from .residuals import ResidualPart

DOUBT = 0.05
"""Prior std of a link's relative stretch in a wrong URDF."""
WRONG = 0.02
"""A larger stretch means another robot: castings and prints are accurate to half a percent."""
_SURE = 4.0


@dataclass(frozen=True)
class Stretch:
    """The link between two joints: relative stretch
    share ± std against the URDF and the other links.

    Without joints: all links alike, against the metres of the camera's pose or a board's size.
    """

    before: str
    after: str
    share: float
    std: float

    @property
    def wrong(self) -> bool:
        """Whether the stretch is significant."""
        return abs(self.share) > max(WRONG, _SURE * self.std)

    @property
    def text(self) -> str:
        """The stretch in words."""
        way = "longer" if self.share > 0 else "shorter"
        size = f"{abs(self.share):.1%} ± {self.std:.1%}"
        if not self.before:
            known = "by the camera's place, or by size or square in [features]"
            return (
                f"all the robot's links are {size} {way} than in the URDF, {known}, which may be "
                "wrong too"
            )
        link = f"the robot's link between {self.before} and {self.after}"
        return f"{link} is {size} {way} than in the URDF, relative to the others"


def find_stretched_link(
    rig: Rig, index: int, theta: Array, learned: ResidualPart, prior: Prior
) -> Stretch | None:
    """The link with the largest stretch, where stretched links win the evidence; else None."""
    rows = choose_spaced_rows(len(learned.rows.x), SEARCHED)
    long, spread = _stretch_by_unknowns(rig, index)
    if spread is None:
        return None
    seen = rig.see(rig.sights[index], theta, learned.view.q, learned.view.log)
    stretch = learned.view.of(seen.stretch)[rows]
    part = thin_rows(learned.rows, SEARCHED)
    kernel = learned.kernel
    extended = replace(
        part, design=np.concatenate([part.design, stretch[..., long] @ spread], axis=2)
    )
    z = part.x / kernel.scales
    before = solve_linear_unknowns(
        cholesky_with_jitter(se_kernel(z, z, kernel.amplitude), part.spread, kernel.noise), part
    ).evidence
    kernel = search_residual_kernel(extended, prior, 0)
    z = part.x / kernel.scales
    found = solve_linear_unknowns(
        cholesky_with_jitter(se_kernel(z, z, kernel.amplitude), part.spread, kernel.noise), extended
    )
    if found.evidence < before + np.log(part.residual.size):
        return None
    extra = slice(part.design.shape[2], None)
    return _largest_stretch(
        rig, index, long, spread @ found.mean[extra], spread @ found.root[extra]
    )


def _stretch_by_unknowns(rig: Rig, index: int) -> tuple[Array, Array | None]:
    """Which steps have a length, and the stretch of each
    by the unknowns (count + 1): each apart, and all alike.
    """
    long = np.linalg.norm(rig.sights[index].chain.fixed[1:-1, :3, 3], axis=1) > 1e-3
    count = int(long.sum())
    if count < 2:
        return long, None
    return long, DOUBT * np.column_stack([np.eye(count) - 1.0 / count, np.ones(count)])


def _largest_stretch(rig: Rig, index: int, long: Array, share: Array, root: Array) -> Stretch:
    """The link with the largest stretch, or all links
    alike if that is significant; share (K,) ± root rootᵀ.
    """
    weight = np.linalg.solve(root @ root.T, np.ones(len(share)))
    weight /= weight.sum()
    uniform = Stretch("", "", float(weight @ share), float(np.linalg.norm(weight @ root)))
    if uniform.wrong:
        return uniform
    share = share - weight @ share
    root = root - weight @ root
    worst = int(np.argmax(np.abs(share)))
    return Stretch(
        *_joints_beside_links(rig, index, long)[worst],
        float(share[worst]),
        float(np.linalg.norm(root[worst])),
    )


def _joints_beside_links(rig: Rig, index: int, long: Array) -> Sequence[tuple[str, str]]:
    """The joints before and after each link with a length."""
    chain = rig.sights[index].chain
    steps = [chain.joints[c] for c in chain.column]
    return [pair for pair, kept in zip(pairwise(steps), long, strict=True) if kept]
