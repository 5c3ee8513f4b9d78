"""Motion of the joints: white acceleration or white jerk, whichever the encoders' evidence prefers."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...types import Hypothesis
from .encoder_noise import FEWEST

if TYPE_CHECKING:
    from ..inference.problem import Problem

EVEN = 0.0
"""Nats that white jerk must win: both motions have one parameter per joint, so neither is the simpler one."""


def with_preferred_order(problem: "Problem") -> "Problem":
    """The problem with white jerk where the encoders' evidence prefers it, if its noise is learned from the log.

    Encoders that are silent for long keep white acceleration: a jerk's variance grows with the fifth power of time.
    """
    encoders, precision, learned = problem.evidence.encoders, problem.precision, problem.precision.learned
    silent = problem.path is not None or problem.resets is not None or problem.posture_prior is not None
    if encoders is None or learned is None or silent or (np.isfinite(encoders.values).sum(axis=0) <= FEWEST).any():
        return problem
    white, jerk = learned
    nats = jerk.evidence - white.evidence
    chosen = bool(nats > EVEN)
    order = Hypothesis("white jerk", "joints", nats, EVEN, chosen)
    evidence = replace(problem.evidence, hypotheses=(*problem.evidence.hypotheses, order))
    if chosen:
        precision = replace(precision, encoder=jerk.encoder, order=3).held(jerk.process, encoders)
    return replace(problem, evidence=evidence, precision=precision)
