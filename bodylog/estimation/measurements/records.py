"""Records of measurements, shared by gathering, screening and estimation.

The interface of a sense: one function that reads all its measurements.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ...body_model import BodyModel, ForwardModel
from ...types import TRACK_AXES, Array, Fault, FaultKind, Features, Finding, Health, Hypothesis
from ..noise.quantisation import compute_quantisation_variance
from .long_arrays import estimate_noise_variance, index_true_rows


@dataclass(frozen=True, eq=False)
class Encoders:
    """Encoder rows: t (N,) s strictly rising · values
    (N,M) rad, NaN where missing · source_ns (N,).

    own_variance: variance (N,M) of each reading over its encoder's, None where all are 1 ·
    original: the encoders before changes were taken out of their readings, which are no whole
    counts since; None where none were.
    """

    t: Array
    values: Array
    source_ns: Array
    own_variance: Array | None = None
    original: "Encoders | None" = None

    @property
    def as_read(self) -> "Encoders":
        """The encoders with all changes in their readings."""
        return self.original or self

    def with_corrected_readings(self, values: Array) -> "Encoders":
        """The encoders with readings (N,M) rad out of which changes were taken."""
        return replace(self, values=values, original=self.as_read)

    def interpolate_at(self, t: Array) -> Array:
        """Readings (F,M) rad at other times t (F,) s, as `interpolate_values` gives them."""
        return interpolate_values(self.t, self.values, t)

    def select_rows(self, rows: Array | slice) -> "Encoders":
        """Some of the readings."""
        relative = self.relative_variance[rows]
        original = None if self.original is None else self.original.select_rows(rows)
        return Encoders(self.t[rows], self.values[rows], self.source_ns[rows], relative, original)

    def weigh_joints(self, weigh: Callable[[Array, Array, int], Array]) -> "Encoders":
        """The encoders with other variances over their own: weigh(t (N,) s, readings (N,) rad,
        joint) gives those (N,) of the joint's readings.
        """
        weights = np.ones(self.values.shape)
        for joint, column in enumerate(self.values.T):
            known = np.isfinite(column)
            if known.any():
                weights[known, joint] = weigh(self.t[known], column[known], joint)
        return replace(self, own_variance=weights)

    @cached_property
    def relative_variance(self) -> Array:
        """Variance (N,M) of each reading over its encoder's."""
        return np.ones(self.values.shape) if self.own_variance is None else self.own_variance

    @cached_property
    def count_variance(self) -> Array:
        """Variance (M,) rad² of readings that comes from whole counts; 0 where none are seen."""
        columns = self.as_read.values.T
        return np.array([compute_quantisation_variance(y[np.isfinite(y)]) for y in columns])

    @cached_property
    def variance(self) -> Array:
        """Variance (M,) rad² of quantisation, or of noise where that is larger."""
        return np.asarray(np.fmax(self.count_variance, estimate_noise_variance(self.values)))


def interpolate_values(t: Array, values: Array, at: Array) -> Array:
    """Values (N,D) of t (N,) s at other times (F,) s, the
    first or last one beyond the end; NaN without any.
    """
    found = np.full((len(at), values.shape[1]), np.nan)
    for own, column in zip(found.T, values.T, strict=True):
        if len(t[known := index_true_rows(np.isfinite(column))]):
            own[:] = np.interp(at, t[known], column[known])
    return found


TRACKED = tuple(axes for axes, _ in TRACK_AXES.values())
"""Outputs of tracks in images, and of points in space."""


@dataclass(frozen=True, eq=False)
class Sighting:
    """Measurements of one sense: t (N,) s · values, var (N,D)
    unit, unit² · source_ns · the model that predicts them.

    D is the number of a sense's rows (`Sense`). cov (N,D,D) unit²: covariance of the rows, with
    `var` its diagonal; None where rows are independent. displaced (N,D): displacement of a moved
    camera, already subtracted from the values. common: share of the model's variance that comes
    from the exploration's encoder errors, common to all tracks.
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

    @property
    def is_track(self) -> bool:
        """Whether it shows where a point is, in images or in space."""
        return self.name != "touch" and self.model.outputs in TRACKED

    def select_span(self, begin: float, end: float) -> "Sighting":
        """The measurements from `begin` to before `end`, s."""
        return self.select_rows((self.t >= begin) & (self.t < end))

    def select_rows(self, rows: Array | slice) -> "Sighting":
        """Some of the measurements."""
        return replace(
            self,
            t=self.t[rows],
            values=self.values[rows],
            var=self.var[rows],
            source_ns=self.source_ns[rows],
            cov=None if self.cov is None else self.cov[rows],
            displaced=None if self.displaced is None else self.displaced[rows],
        )

    @cached_property
    def independent_rows(self) -> "IndependentRows":
        """The values as independent rows: cov = L
        diag(var) Lᵀ, and mix = L⁻¹ has the determinant 1.
        """
        if self.cov is None:
            return IndependentRows(self.values, self.var)
        root = np.linalg.cholesky(self.cov)
        scale = np.einsum("ndd->nd", root)
        mix = np.linalg.inv(root / scale[:, None])
        return IndependentRows((mix @ self.values[..., None])[..., 0], scale * scale, mix)


class IndependentRows(NamedTuple):
    """Independent rows: values and var (N,D) · mix (N,D,D),
    which makes them from those of a sense; None for 1.
    """

    values: Array
    var: Array
    mix: Array | None = None


def mix_rows(
    mix: Array | None, predicted: tuple[Array, Array, Array]
) -> tuple[Array, Array, Array]:
    """Mean (…,D), Jacobian (…,D,M) and model variance
    (…,D) of the rows made by mix (…,D,D); None for 1.
    """
    if mix is None:
        return predicted
    mean, jac, var = predicted
    return (mix @ mean[..., None])[..., 0], mix @ jac, (mix * mix @ var[..., None])[..., 0]


def unmix_rows(
    mix: Array | None, predicted: tuple[Array, Array, Array]
) -> tuple[Array, Array, Array]:
    """Mean (…,D), covariance (…,D,D) and model variance (…,D)
    of a sense's own rows, from those made by mix (…,D,D).
    """
    if mix is None:
        return predicted
    mean, cov, var = predicted
    back = np.linalg.inv(mix)
    squares = np.linalg.solve(mix * mix, var[..., None])
    return (back @ mean[..., None])[..., 0], back @ cov @ back.swapaxes(-1, -2), squares[..., 0]


@dataclass(frozen=True, eq=False)
class Evidence:
    """All measurements. `encoders` stay when unused (all NaN), for their clock.

    faults: sensors with faults, whose readings are removed · hypotheses: alternatives compared ·
    read (N,M) rad: all encoder readings, unused ones included · joints: their names (M,) · unit of
    the readings, rad_per_unit its size · worn (M,) rad: half of the play that images show beyond
    the exploration's, empty where they show none.
    """

    encoders: Encoders | None
    sightings: tuple[Sighting, ...]
    used: Mapping[str, Health]
    findings: tuple[Finding, ...]
    faults: tuple[Fault, ...] = ()
    hypotheses: tuple[Hypothesis, ...] = ()
    read: Array = field(default_factory=lambda: np.empty((0, 0)))
    joints: tuple[str, ...] = ()
    unit: str = "rad"
    rad_per_unit: float = 1.0
    worn: Array = field(default_factory=lambda: np.empty(0))

    @property
    def stopped_encoders(self) -> Array:
        """Encoders (M,) bool that froze or died."""
        kinds = (FaultKind.FROZEN, FaultKind.DEAD)
        names = {
            name
            for fault in self.faults
            if fault.sense == "encoders" and fault.kind in kinds
            for name in fault.names
        }
        return np.isin(self.joints, list(names))


class Measured(NamedTuple):
    """Measurements of one name (t (N,) · values (N,D) ·
    cov (N,D,D) or var (N,D) · model), and counts of use.
    """

    sighting: Sighting
    health: Health


Sense = Callable[[Features, BodyModel], Mapping[str, Measured]]
"""Reads, by name, what the features contain and the body predicts, with any number of rows D."""


def build_health(seen: int, used: int, reasons: Mapping[str, int], gap: float = 0.0) -> Health:
    """Counts of use, without the reasons of no rejection; gap: the largest, in s."""
    return Health(
        seen, int(used), {reason: int(count) for reason, count in reasons.items() if count}, gap
    )
