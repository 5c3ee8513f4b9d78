"""Records of measurements, shared by gathering, screening and estimation."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ...body_model import ForwardModel
from ...types import Array, Fault, Finding, Health, Hypothesis


@dataclass(frozen=True, eq=False)
class Encoders:
    """Encoder rows: t (N,) s strictly rising · values (N,M) rad, NaN where missing · source_ns (N,).

    relative: variance (N,M) of each reading over its encoder's, None where all are 1.
    """

    t: Array
    values: Array
    source_ns: Array
    relative: Array | None = None


@dataclass(frozen=True, eq=False)
class Sighting:
    """Measurements of one sense: t (N,) s · values, var (N,D) unit, unit² · source_ns · the model that predicts them.

    D is any number of rows, the same for all of one sense. cov (N,D,D) unit²: covariance of the rows, with `var` its
    diagonal; None where rows are independent. displaced (N,D): displacement of a moved camera, already subtracted from
    the values. common: share of the model's variance that comes from the exploration's encoder errors, common to all
    tracks.
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
    """All measurements. `encoders` stay when unused (all NaN), for their clock; `first` (M,) rad, NaN if unknown.

    faults: sensors with faults, whose readings are removed · hypotheses: alternatives compared · read (N,M) rad: all
    encoder readings, unused ones included · joints: their names (M,).
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
