"""A log's images as lines about the path: predicted again only as far as the path still moves there."""

from dataclasses import dataclass, field, replace

import numpy as np

from ...types import Array
from ..measurements.records import Sighting
from .knots import Knots
from .posed import Rows
from .row_errors import WHITE, Looks, kappa, reads

RESTING = 1e-6
"""rad: an image whose point of linearisation moves less keeps its tangent."""


@dataclass(eq=False)
class Images:
    """One track's F images that show something: events, knots (F,), early (F,) s, y, pixel (D,F), and their lines.

    errors: whether the track errs alike from image to image · weight (F,): 1, or less for outliers · extra (D,F):
    variance added for that.
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
        """Of a track's sightings at the log's `events` (F,), perception's variances times `scale`."""
        seen = np.isfinite(sighting.values).all(axis=1)
        at, early = knots.holding(events[seen])
        y, pixel = sighting.values[seen].T.copy(), scale * sighting.var[seen].T
        return Images(sighting, events[seen], at, early, y, pixel, errors)

    def __post_init__(self) -> None:
        """No line drawn yet, and no outlier known."""
        count = len(self.events)
        self.weight, self.extra = np.ones(count), np.zeros(self.y.shape)
        self.points = np.empty((0, count))

    def follow(self, points: Array) -> bool:
        """Draw lines about the points (M,F) rad, where these are another; whether there were any."""
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
        """What errors depend on; of the images `at` (N,) alone."""
        parts = self.y, self.jac, self.pixel, self.model, self.points
        y, jac, pixel, model, points = parts if at is None else (part[..., at] for part in parts)
        reach = np.broadcast_to(getattr(self.sighting.model, "reach", np.inf), len(self.points))
        return Looks(y, jac, pixel, model, points, reach)

    def last(self, events: Array) -> Looks:
        """What errors depend on as last seen by the instants `events` (N,); as if of no joint before the first."""
        at = np.searchsorted(self.events, events, "right") - 1
        found = self.looks(np.maximum(at, 0))
        return replace(found, jac=found.jac * (at >= 0))

    def rows(self, before: list["Images"], encoder: Array) -> Rows:
        """The lines with the errors of this and of all tracks `before`, as last seen at its images."""
        y = self.y - self.mean + np.einsum("dmf,mf->df", self.jac, self.points)
        if not self.errors:
            return Rows(self.knots, self.early, y, self.jac, self.pixel + self.model + self.extra)
        others = [one.last(self.events) for one in before]
        own = self.looks()
        white = WHITE * self.pixel + self.extra
        return Rows(self.knots, self.early, y, self.jac, white, reads(others, own, encoder), kappa(own))
