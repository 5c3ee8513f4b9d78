"""Motion of the joints: white acceleration or white jerk, whichever the encoders' evidence prefers."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...types import Hypothesis
from ..inference.reacquisition import left_open, silent
from .encoder_noise import FEWEST

if TYPE_CHECKING:
    from ..inference.problem import Problem

EVEN = 0.0
"""Nats that white jerk must win: both motions have one parameter per joint, so neither is the simpler one."""


def with_preferred_order(problem: "Problem") -> "Problem":
    """The problem with white jerk where the encoders' evidence prefers it, if its noise is learned from the log.

    Also where images leave silent joints open: over seconds accelerations last, which a log's readings, hundredths of a
    second apart, may not show. Where they determine all silent joints these keep white acceleration.
    """
    encoders, precision, learned = problem.evidence.encoders, problem.precision, problem.precision.learned
    unread = problem.posture_prior is not None
    if encoders is None or learned is None or unread or (np.isfinite(encoders.values).sum(axis=0) <= FEWEST).any():
        return problem
    lasting = bool(left_open(problem.timeline.t, problem.evidence).any())
    if not lasting and silent(problem.timeline.t, encoders).any():
        return problem
    white, jerk = learned
    nats = jerk.evidence - white.evidence
    chosen = bool(nats > EVEN) or lasting
    order = Hypothesis("white jerk", "joints", nats, EVEN, chosen)
    evidence = replace(problem.evidence, hypotheses=(*problem.evidence.hypotheses, order))
    if chosen:
        precision = replace(precision, encoder=jerk.encoder, order=3).held(jerk.process, encoders)
    return replace(problem, evidence=evidence, precision=precision)
