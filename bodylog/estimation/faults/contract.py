"""The interface of a fault detector: one function from measurements to a verdict."""

from collections.abc import Callable
from typing import NamedTuple

from ...body_model import BodyModel
from ...types import Fault, Finding, Hypothesis
from ..measurements.records import Evidence


class Verdict(NamedTuple):
    """The measurements without faulty ones, the faults found, remarks, and the hypotheses compared (nats)."""

    evidence: Evidence
    faults: tuple[Fault, ...] = ()
    findings: tuple[Finding, ...] = ()
    hypotheses: tuple[Hypothesis, ...] = ()


Detector = Callable[[Evidence, BodyModel], Verdict]
"""A detector of one kind of fault."""
