"""What a detector of faults is: one function from measurements to a verdict."""

from collections.abc import Callable
from typing import NamedTuple

from ...body_model import BodyModel
from ...types import Fault, Finding, Hypothesis
from ..measurements.records import Evidence


class Verdict(NamedTuple):
    """The measurements without what is faulty, the faults, remarks, and what was weighed for and against in nats."""

    evidence: Evidence
    faults: tuple[Fault, ...] = ()
    findings: tuple[Finding, ...] = ()
    hypotheses: tuple[Hypothesis, ...] = ()


Detector = Callable[[Evidence, BodyModel], Verdict]
"""One way a sensor fails."""
