"""Where the arm is wont to be: a weak prior for joints no encoder speaks of, lest pictures alone lose them."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...body_model import ForwardModel
from ...types import Array
from ..measurements.records import Evidence

LASTING = 4.0
"""How many times their process variance joints move that pictures hardly hold: in seconds, accelerations that last take
an arm farther than white ones, of which encoders' noise shows some tenths of a second."""
WIDER = 2.0
"""How many times the spread of the explored angles a joint may be from their mean, in one standard deviation."""


@dataclass(frozen=True, eq=False)
class PosturePrior:
    """joints (M,) bool without an encoder · their mean (M,) rad · variance density (M,) rad²·s of a steady reminder."""

    joints: Array
    mean: Array
    density: Array

    def fill(self, t: Array, encoders: Array, var: Array) -> tuple[Array, Array]:
        """Encoder rows (E,M) and variances with a reminder at each instant, as weak as the time since the last."""
        dt = np.diff(t, prepend=t[0])
        encoders, var = encoders.copy(), var.copy()
        encoders[1:, self.joints] = self.mean[self.joints]
        var[1:, self.joints] = self.density[self.joints] / dt[1:, None]
        return encoders, var

    def add_prior(self, readings: Array, var: Array, joints: Array, since: Array) -> tuple[Array, Array, Array]:
        """Readings said (M,) rad and variances with a reminder of those `joints` (M,) bool that say nothing; and which.

        since (M,): s after the last one.
        """
        own = joints & self.joints & ~np.isfinite(readings)
        return np.where(own, self.mean, readings), np.where(own, self.density / since, var), own


def learn_prior(evidence: Evidence, process: Array, start: Array) -> PosturePrior | None:
    """The habit of joints that no encoder of a log speaks of, by what its tracks' models were learned from."""
    silent: Array = np.ones(len(process), bool)
    if evidence.encoders is not None:
        silent = np.all(~np.isfinite(evidence.encoders.values), axis=0)
    return prior_of(silent, {s.name: s.model for s in evidence.sightings}, process, start)


def adrift_prior(models: Mapping[str, ForwardModel], process: Array, start: Array) -> PosturePrior | None:
    """The habit of joints adrift, all that may be; process (M,) rad²/s³ as it is where encoders speak."""
    return prior_of(np.ones(len(process), bool), models, LASTING * process, start)


def prior_of(silent: Array, models: Mapping[str, ForwardModel], process: Array, start: Array) -> PosturePrior | None:
    """The habit of the `silent` joints (M,) bool; None when all encoders speak or no track's model tells.

    A reminder of density R under white acceleration q alone holds a joint to the variance √2 q^¼ R^¾: R is such that
    this is the explored angles' own, widened. Seen joints are wont to be where they were explored; those only felt,
    now and then, stay where they started.
    """
    distinct = {id(model): model for model in models.values()}
    known = [model.samples for model in distinct.values() if hasattr(model, "samples") and len(model.samples) > 1]
    if not silent.any() or not known:
        return None
    explored, seen = np.concatenate(known), any(name != "touch" for name in models)
    var = np.square(WIDER * explored.std(axis=0))
    density = (var / (np.sqrt(2.0) * process**0.25)) ** (4.0 / 3.0)
    silent = silent & (density > 0)
    return PosturePrior(silent, explored.mean(axis=0) if seen else start, density) if silent.any() else None
