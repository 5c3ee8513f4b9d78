"""How tracks look wherever they are drawn: one colour
for each meaning, and the 2σ ellipse of a covariance.
"""

from dataclasses import dataclass

import numpy as np

from .types import Array

SIGMAS = 2.0
"""Standard deviations that every ellipse and band shows."""
CORNERS = 32
"""Corners of an ellipse drawn as a polygon; it stays within 0.5 % of the ellipse."""


@dataclass(frozen=True)
class Ink:
    """One colour in two shades: `image` (red, green, blue,
    each 0..1) over images, `plot` (CSS) on a page's ground.
    """

    image: tuple[float, float, float]
    plot: str

    @property
    def rgb(self) -> tuple[int, int, int]:
        """The shade over images as bytes."""
        red, green, blue = (round(255 * part) for part in self.image)
        return red, green, blue


PREDICTED = Ink((1.0, 0.85, 0.1), "#b5862a")
TRUTH = Ink((0.6, 0.6, 0.6), "#111111")
MEASURED = {"effector": Ink((0.1, 0.9, 0.2), "#2a9d68"), "hand": Ink((1.0, 0.25, 0.2), "#d1495b")}
OTHER = Ink((0.3, 0.6, 1.0), "#1f77d0")
"""Measurements of any other track."""
BELIEF = Ink((0.24, 0.59, 0.94), "#1f77d0")
"""Joint angles as estimated, in plots of joints alone."""
STYLE_SHEET = {
    "predicted": PREDICTED.plot,
    "truth": TRUTH.plot,
    "other": OTHER.plot,
    "belief": BELIEF.plot,
} | {name: ink.plot for name, ink in MEASURED.items()}
"""Names of the page's colours -> CSS."""


def measurement_ink(track: str) -> Ink:
    """Colour of a track's measurements; of `camera/track`, the part after the last / decides."""
    return MEASURED.get(track.rpartition("/")[2], OTHER)


def ellipse_corners(centre: Array, cov: Array) -> Array:
    """Corners (K,CORNERS,2) of the 2σ ellipses of cov (K,2,2)
    around centre (K,2); NaN where a variance is negative.

    A unit circle times the Cholesky factor of cov: every
    corner is SIGMAS standard deviations from the centre.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, CORNERS, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    lower = np.zeros_like(cov)
    with np.errstate(invalid="ignore", divide="ignore"):
        a = np.sqrt(cov[:, 0, 0])
        b = cov[:, 0, 1]
        c = cov[:, 1, 1]
        lower[:, 0, 0] = a
        lower[:, 1, 0] = np.where(a > 0, b / a, 0.0)
        lower[:, 1, 1] = np.sqrt(np.maximum(c - lower[:, 1, 0] ** 2, 0.0))
    return np.asarray(centre[:, None] + SIGMAS * circle @ lower.transpose(0, 2, 1))
