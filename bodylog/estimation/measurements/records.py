"""The records of what each sense measured, shared by whatever gathers, screens and uses it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ...body_model import ForwardModel
from ...types import Array, Fault, Finding, Health, Hypothesis


@dataclass(frozen=True, eq=False)
class Encoders:
    """Encoder rows: t (N,) s strictly rising · values (N,M) rad, NaN where silent · source_ns (N,).

    relative: each reading's variance (N,M) over its encoder's, None where they are all alike.
    """

    t: Array
    values: Array
    source_ns: Array
    relative: Array | None = None


@dataclass(frozen=True, eq=False)
class Sighting:
    """What one sense measured: t (N,) s · values, var (N,D) unit, unit² · source_ns · the model that predicts it.

    D is any number of rows, the same for all of one sense. cov (N,D,D) unit²: where the rows of one measurement err
    together, with `var` its diagonal; None where each errs by itself. displaced (N,D): what was taken off the values
    because the camera had moved. common: share of the model's variance that comes
    of exploring encoders' errors, which all tracks' models learn.
    """

    name: str
    model: ForwardModel
    t: Array
    values: Array
    var: Array
    source_ns: Array
    common: float = 0.0
    cov: Array | None = None
    displaced: Array | None = None


@dataclass(frozen=True, eq=False)
class Evidence:
    """Everything heard: `encoders` also when unused (then all NaN), for their clock; `first` (M,) rad, NaN if none.

    faults: sensors that lied, which are not used where they did · hypotheses: what was weighed · read (N,M) rad: what
    the encoders read, also those that are not to be used · joints: their names (M,).
    """

    encoders: Encoders | None
    sightings: tuple[Sighting, ...]
    first: Array
    used: Mapping[str, Health]
    findings: tuple[Finding, ...]
    faults: tuple[Fault, ...] = ()
    hypotheses: tuple[Hypothesis, ...] = ()
    read: Array = field(default_factory=lambda: np.empty((0, 0)))
    joints: tuple[str, ...] = ()
