"""The profile of a likelihood over shifts in time, which each estimator of a camera's delay feeds.

One that knows the slope of its profile climbs it by Newton's steps: `regression` on the encoders,
`gp_likelihood` of a body's own process. One that knows values alone tries a grid of shifts and
takes the parabola at the best: `flow_delay` by the whole picture, and a dataset's actions. Errors
that last longer than the likelihood allows for show in delays that leave parts of the log out.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ...types import Array
from ..inference.filter_pass import MAX_SWEEPS, ROUGHLY_CONVERGED_MOVE

Detail = TypeVar("Detail")
MAX_DELAY_S = 1.0
"""s: largest delay."""


@dataclass(frozen=True)
class Delay:
    """A delay of image timestamps (s) and its standard
    error (s); doubt: why it is not believed, "" if it is;
    changes: whether the log evidently shows another one in each half.
    """

    seconds: float
    std_error: float
    doubt: str = ""
    changes: bool = False

    @property
    def nats(self) -> float:
        """Evidence against no delay (nats)."""
        return 0.5 * (self.seconds / self.std_error) ** 2


def climb_profile(
    step_at: Callable[[float], tuple[float, float, Detail] | None],
) -> tuple[Delay, Detail] | None:
    """The delay at the top of a profile, from no delay on, and what `step_at` gives with it.

    step_at: from a delay (s) to the step (s) towards the top, its standard error (s) and anything
    else; None where the log does not determine it. None where no top is within MAX_DELAY_S.

    An image at an end that counts on one side of the top alone makes each step take the last one
    back: the top is between the two.
    """
    late = 0.0
    last = np.inf
    for _ in range(MAX_SWEEPS):
        found = None if abs(late) > MAX_DELAY_S else step_at(late)
        if found is None:
            return None
        step, error, detail = found
        late += step
        if abs(step) < ROUGHLY_CONVERGED_MOVE * error:
            return Delay(late, error), detail
        if abs(step) < error and abs(step + last) < ROUGHLY_CONVERGED_MOVE * error:
            return Delay(late - 0.5 * step, error), detail
        last = step
    return None


def fit_profile_peak(left: Array, middle: Array, right: Array) -> tuple[Array, Array]:
    """The top of parabolas through three values (nats) a step apart, in steps from the middle, and
    their bend (nats per squared step); the middle where they bend upwards."""
    bend = np.asarray(2.0 * middle - left - right)
    curved = np.where(bend > 0.0, bend, 1.0)
    return np.where(bend > 0.0, 0.5 * (right - left) / curved, 0.0), bend


def measure_jackknife_error(without: Array) -> Array:
    """Standard errors from estimates (K,...) that leave out one of K parts each (Künsch 1989)."""
    spread = np.square(without - without.mean(axis=0)).sum(axis=0)
    return np.asarray(np.sqrt((1.0 - 1.0 / len(without)) * spread))
