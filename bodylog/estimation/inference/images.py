"""A log's images, linearised about the path; only images whose linearisation point moved are predicted again."""

from dataclasses import dataclass, field, replace

import numpy as np

from ...types import Array
from ..measurements.records import Sighting
from .knots import Knots
from .posed import Rows
from .row_errors import WHITE, Looks, kappa, reads

RESTING = 1e-6
"""rad: an image whose linearisation point moves less keeps its tangent."""


@dataclass(eq=False)
class Images:
    """One track's F images with a sighting: events, knots (F,), early (F,) s, y, pixel (D,F), and their tangents.

    errors: whether errors correlate from image to image · weight (F,): 1, or less for outliers · extra (D,F): variance
    added for outliers.
    """

    sighting: Sighting
    events: Array
    knots: Array
    early: Array
    y: Array
    pixel: Array
    errors: bool
    points: Array = field(init=False)
    mean: Array = field(init=False)
    jac: Array = field(init=False)
    model: Array = field(init=False)
    weight: Array = field(init=False)
    extra: Array = field(init=False)

    @staticmethod
    def of(sighting: Sighting, events: Array, knots: Knots, scale: float, errors: bool) -> "Images":
        """From a track's sightings at the log's `events` (F,), with perception's variances times `scale`."""
        seen = np.isfinite(sighting.values).all(axis=1)
        at, early = knots.holding(events[seen])
        y, pixel = sighting.values[seen].T.copy(), scale * sighting.var[seen].T
        return Images(sighting, events[seen], at, early, y, pixel, errors)

    def __post_init__(self) -> None:
        """No tangent yet, and no outlier."""
        count = len(self.events)
        self.weight, self.extra = np.ones(count), np.zeros(self.y.shape)
        self.points = np.empty((0, count))

    def follow(self, points: Array) -> bool:
        """Linearise again about the points (M,F) rad where these moved; return whether any did."""
        moved = np.ones(points.shape[1], bool)
        if len(self.points):
            moved = np.abs(points - self.points).max(axis=0) > RESTING
        if not moved.any():
            return False
        mean, jac, model = self.sighting.model.predict(points.T[moved])
        if not len(self.points):
            d, (m, f) = mean.shape[1], points.shape
            self.points, self.mean, self.model = np.empty((m, f)), np.empty((d, f)), np.empty((d, f))
            self.jac = np.empty((d, m, f))
        self.points[:, moved], self.mean[:, moved], self.model[:, moved] = points[:, moved], mean.T, model.T
        self.jac[..., moved] = np.moveaxis(jac, 0, -1)
        return True

    def looks(self, at: Array | None = None) -> Looks:
        """What errors depend on, optionally of the images `at` (N,) only."""
        parts = self.y, self.jac, self.pixel, self.model, self.points
        y, jac, pixel, model, points = parts if at is None else (part[..., at] for part in parts)
        reach = np.broadcast_to(getattr(self.sighting.model, "reach", np.inf), len(self.points))
        return Looks(y, jac, pixel, model, points, reach)

    def last(self, events: Array) -> Looks:
        """What errors depend on in the last image before each of `events` (N,); zero Jacobians before the first."""
        at = np.searchsorted(self.events, events, "right") - 1
        found = self.looks(np.maximum(at, 0))
        return replace(found, jac=found.jac * (at >= 0))

    def rows(self, before: list["Images"], encoder: Array) -> Rows:
        """Linear rows with the errors of this track and of all tracks `before`, as in their last images."""
        y = self.y - self.mean + np.einsum("dmf,mf->df", self.jac, self.points)
        if not self.errors:
            return Rows(self.knots, self.early, y, self.jac, self.pixel + self.model + self.extra)
        others = [one.last(self.events) for one in before]
        own = self.looks()
        white = WHITE * self.pixel + self.extra
        return Rows(self.knots, self.early, y, self.jac, white, reads(others, own, encoder), kappa(own))
