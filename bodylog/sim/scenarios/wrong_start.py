"""A still arm somewhere in the explored box; the encoders
of four joints are wrong from first reading to last.

One of them by 5 to 10 degrees, all of them by 5 to 10 degrees, or all as if the arm were somewhere
else: the three levels at which vision alone is asked to find the arm.
"""

import numpy as np

from ...types import Array
from ..motion import stand_still
from ..plan import Request, Scenario, ScenarioPlan, read_angles_with_noise, swing_of_joints

_FOUR = (0, 1, 2, 3)
_LEAST, _MOST = np.deg2rad([5.0, 10.0])


def _plan_wrong_start(request: Request) -> ScenarioPlan:
    box = 0.7 * swing_of_joints(request, _FOUR)
    here, there = np.array(request.arm.home) + request.rng.uniform(-1.0, 1.0, (2, len(box))) * box
    wrong = (
        request.rng.choice([-1.0, 1.0], len(box))
        * request.rng.uniform(_LEAST, _MOST, len(box))
        * (box > 0)
    )
    one = np.arange(len(box)) == request.rng.choice(np.flatnonzero(box))
    offset = {"one": wrong * one, "all": wrong, "elsewhere": there - here}[request.variant]

    def encoders(t: Array, q: Array, noise: Array) -> Array:
        return np.asarray(read_angles_with_noise(t, q, noise) + offset)

    return ScenarioPlan(stand_still(here), 0.003, encoders)


SCENARIO = Scenario(
    "encoders wrong, vision has to find the arm",
    _plan_wrong_start,
    10.0,
    variants=("one", "all", "elsewhere"),
)
