"""Whether a URDF's lengths are the robot's: how far each link would have to be stretched, and what that is worth."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ..kinematics.rig import Rig
from ..types import Array
from .evidence import Hyper, Prior, cholesky
from .explicit import SEARCHED, Rows, search, solved, thinned
from .gp import se
from .select import spaced

DOUBT = 0.05
"""Share of its length by which a link of a wrong URDF may be off; the prior's standard deviation."""
WRONG = 0.02
"""Stretched by more than this a link is another robot's: castings and prints are good to half a percent."""
_SURE = 4.0


@dataclass(frozen=True)
class Stretch:
    """The link between two joints: by what share ± std it is longer than the URDF says, beside the others."""

    before: str
    after: str
    share: float
    std: float

    @property
    def wrong(self) -> bool:
        """Whether it is surely another's."""
        return abs(self.share) > max(WRONG, _SURE * self.std)

    @property
    def said(self) -> str:
        """In words."""
        way = "longer" if self.share > 0 else "shorter"
        size = f"{abs(self.share):.1%} ± {self.std:.1%}"
        link = f"the robot's link between {self.before} and {self.after}"
        return f"{link} is {size} {way} than it says, beside its others"


def stretched(rig: Rig, index: int, theta: Array, data: Rows, kernel: Hyper, prior: Prior) -> Stretch | None:
    """The link that is off by the greatest share, where kinematics is the likelier for links that may be stretched.

    What all links have in common is left out: a camera does not tell it from its own distance.
    """
    rows = spaced(len(data.x), SEARCHED)
    seen = rig.see(rig.sights[index], theta, data.x[rows])
    chain = rig.sights[index].chain
    long = np.linalg.norm(chain.fixed[1:-1, :3, 3], axis=1) > 1e-3
    if long.sum() < 2:
        return None
    count = int(long.sum())
    spread = DOUBT * (np.eye(count) - 1.0 / count)
    part = thinned(data, SEARCHED)
    more = replace(part, design=np.concatenate([part.design, seen.stretch[:, 0][..., long] @ spread], axis=2))
    z = part.x / kernel.scales
    before = solved(cholesky(se(z, z, kernel.amplitude), part.spread, kernel.noise), part).evidence
    kernel = search(more, prior, 0)
    z = part.x / kernel.scales
    found = solved(cholesky(se(z, z, kernel.amplitude), part.spread, kernel.noise), more)
    if found.evidence < before + np.log(part.residual.size):
        return None
    extra = slice(part.design.shape[2], None)
    share, root = spread @ found.mean[extra], spread @ found.root[extra]
    worst = int(np.argmax(np.abs(share)))
    names = _names(rig, index, long)
    return Stretch(*names[worst], float(share[worst]), float(np.sqrt(np.square(root[worst]).sum())))


def _names(rig: Rig, index: int, long: Array) -> Sequence[tuple[str, str]]:
    """The joints before and after each link of some length."""
    chain = rig.sights[index].chain
    steps = [chain.joints[c] for c in chain.column]
    return [pair for pair, kept in zip(pairwise(steps), long, strict=True) if kept]
