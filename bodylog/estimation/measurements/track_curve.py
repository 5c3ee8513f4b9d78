"""A track as an interpolated curve, beside the positions that means of encoder readings predict."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...types import Array
from .long_arrays import (
    MIN_READINGS,
    estimate_noise_variance,
    find_finite_rows,
    measure_median_step,
)
from .records import Encoders, Sighting
from .timeline import list_span_starts

MAX_CURVE_MEANS = 600
"""Most means, evenly spread: more make a delay no truer. Those of 4 drawn logs of 120 s are off by
0.47 ms with 600 and by 0.44 ms with 2,400, which take 3.5 times as long.
"""
OFFSET_KNOT_S = 8.0
"""s between knots of an encoder's offset, or more for at least MIN_READINGS means on each. With 4,
delays of 8 drawn sound logs of 16 s are off by 0.94 ms in place of 0.82; with 2, four have none.
"""
BLUNDER_MEDIANS = 10.0
"""Median residuals against neighbours beyond which a frame is left out; with 7.4 of them, the
filter's gate, 9 in place of 10 of 12 cameras that moved by 3 px in reaches are found, as frames of
fast motion are left out."""
MAX_SPEED_NOISE_SHARE = 0.1
"""Share of noise in the track's speed above which frames are averaged in
pairs. Without averages 13 of 36 delays are measured of slow sines at 30 Hz;
with averages throughout, the standard error is up to 1.3 times as large."""
MAX_FRAME_GAP_S = 0.3
"""s: frames farther apart are not interpolated: their errors would show a moved camera. With any
gap 27 of 36 delays of reaches are measured. Averages are at most half as far apart; with
MAX_FRAME_GAP_S itself, 198 of 200 of slow sines at 12 Hz."""


@dataclass(frozen=True, eq=False)
class Curve:
    """Positions (N,2) px, or points (N,3) mm, at t (N,) s with a median
    step (s), and the predictions of B means of encoder readings.

    images: how many are averaged to a position · noise (2,) px²: stated variance of one · blur (2,)
    px²: variance of its own noise · at (B,) s · angles x (B,M) · predicted positions (B,2) · jac
    (B,2,M) · model (B,2) px²: variance of predictions · encoder (B,M) rad²: variance of the means ·
    bends (B,K): shares of the knots of encoder offsets · walks (B,K): of the steps from knot to
    knot of the offsets of the joints `walking`, which may bend more.
    """

    t: Array
    places: Array
    step: float
    images: int
    noise: Array
    blur: Array
    at: Array
    x: Array
    predicted: Array
    jac: Array
    model: Array
    encoder: Array
    bends: Array
    walks: Array
    walking: tuple[int, ...]

    @cached_property
    def whitening_root(self) -> Array:
        """Square root (B,2,2) of the inverse covariance of positions less predictions."""
        cov = np.einsum("bdm,bm,bem->bde", self.jac, self.encoder, self.jac)
        np.einsum("bdd->bd", cov)[:] += self.model + self.noise / self.images
        return np.asarray(np.linalg.cholesky(np.linalg.inv(cov)).swapaxes(1, 2))

    @cached_property
    def offset_slopes(self) -> Array:
        """Slopes (B,2,P) of whitened predictions in encoder offsets at the
        knots, all of a joint together, and then in steps of those that walk.
        """
        turned = self.whitening_root @ self.jac
        parts = ((turned, self.bends), (turned[..., list(self.walking)], self.walks))
        return np.concatenate(
            [
                np.einsum("bdm,bk->bdmk", slope, shares).reshape(*turned.shape[:2], -1)
                for slope, shares in parts
            ],
            axis=-1,
        )


@dataclass(frozen=True, eq=False)
class RegressionRows:
    """A regression at R instants t: misfit (R,2) on slopes
    (R,2,1+P), noise terms of the first slope's sums (R,).

    frames (R,4): numbers of the images that each misfit is interpolated from · image (R,4,2,2): its
    derivative with respect to their noise, in standard deviations.
    """

    t: Array
    misfit: Array
    slopes: Array
    cross: Array
    own: Array
    frames: Array
    image: Array

    def select_instants(self, rows: Array | slice) -> "RegressionRows":
        """Some of the instants."""
        return RegressionRows(
            *(getattr(self, name)[rows] for name in RegressionRows.__annotations__)
        )


def build_regression_rows(curve: Curve, late: float) -> RegressionRows:
    """Residuals and slopes of a curve delayed by `late` s."""
    place, slope, value, speed, first, sound = interpolate_curve(curve, late)
    image = curve.whitening_root * np.sqrt(curve.blur / curve.images)
    blur = np.square(image).sum(axis=(1, 2))
    misfit, slope = (
        np.einsum("bde,be->bd", curve.whitening_root, part)
        for part in (curve.predicted - place, slope)
    )
    slopes = np.concatenate([slope[..., None], curve.offset_slopes], axis=-1)
    cross = blur * (value * speed).sum(axis=1)
    own = blur * np.square(speed).sum(axis=1)
    frames = first[:, None] + np.arange(4)
    return RegressionRows(
        curve.at, misfit, slopes, cross, own, frames, value[:, :, None, None] * image[:, None]
    ).select_instants(sound)


def interpolate_curve(curve: Curve, late: float) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Cubic through a curve delayed by `late` s: positions (B,2) px and speeds (B,2) px/s, the
    weights (B,4) of both in the four images around, the first of these (B,), and whether no gap
    between them is too long.
    """
    t = curve.t
    at = curve.at + late
    i = np.clip(np.searchsorted(t, at, "right") - 1, 1, len(t) - 3)
    h = t[i + 1] - t[i]
    before = h / (t[i + 1] - t[i - 1])
    after = h / (t[i + 2] - t[i])
    s = (at - t[i]) / h

    def weigh_four(here: Array, leave: Array, there: Array, arrive: Array) -> Array:
        return np.stack(
            [-leave * before, here - arrive * after, there + leave * before, arrive * after], axis=1
        )

    square = s * s
    value = weigh_four(
        1 + square * (2 * s - 3), s * (s - 1) ** 2, square * (3 - 2 * s), square * (s - 1)
    )
    speed = weigh_four(6 * s * (s - 1), (3 * s - 1) * (s - 1), 6 * s * (1 - s), s * (3 * s - 2))
    speed /= h[:, None]
    close = np.maximum(np.maximum(t[i] - t[i - 1], h), t[i + 2] - t[i + 1]) <= MAX_FRAME_GAP_S
    near = curve.places[(i - 1)[:, None] + np.arange(4)]
    place, slope = (np.einsum("bk,bkd->bd", weights, near) for weights in (value, speed))
    return place, slope, value, speed, i - 1, close & (s >= 0) & (s <= 1)


def build_track_curve(
    encoders: Encoders, seen: Sighting, most: int, walking: tuple[int, ...] = ()
) -> Curve | None:
    """The curve of a track beside at most `most` means
    of encoder readings; None where either is too short.

    walking: joints whose encoders have an offset that the log shows.
    """
    t, places, var = _clean_track(seen)
    if (
        len(t) < MIN_READINGS
        or len(encoders.t) < MIN_READINGS
        or (step := measure_median_step(t)) > MAX_FRAME_GAP_S
    ):
        return None
    # slightly more than a step, so that readings and frames do not stay in phase
    at, x, count = _average_span_readings(
        encoders, max(step, 1.0001 * measure_median_step(encoders.t)), most
    )
    if len(at) < MIN_READINGS:
        return None
    predicted, jac, model = seen.model.predict(x)
    encoder = estimate_noise_variance(encoders.values) / count
    bends = _share_knots(encoders.t, at, OFFSET_KNOT_S)
    walks = np.cumsum(_share_knots(encoders.t, at, 0.5 * OFFSET_KNOT_S)[:, :0:-1], axis=1)
    # stated variance may include a model's misfit, scatter
    # the arm's jerk: a frame's own noise is below both
    blur = np.minimum(var, estimate_noise_variance(places))
    curve = Curve(
        t, places, step, 1, var, blur, at, x, predicted, jac, model, encoder, bends, walks, walking
    )
    while (
        4.0 * curve.step <= MAX_FRAME_GAP_S
        and len(curve.t) >= 2 * MIN_READINGS
        and _is_blurred(curve)
    ):
        curve = _average_frame_pairs(curve)
    return curve if len(curve.t) >= MIN_READINGS else None


def _share_knots(t: Array, at: Array, width: float) -> Array:
    """Shares (B,K) at `at` (B,) of knots that are `width` s apart from the first of t to the last,
    or more for at least MIN_READINGS on each.
    """
    pieces = np.clip(np.ptp(t) / width, 1, len(at) // MIN_READINGS)
    knots = np.linspace(t[0], t[-1], 1 + int(pieces))
    return np.asarray(np.maximum(0.0, 1.0 - np.abs(at[:, None] - knots) / (knots[1] - knots[0])))


def _clean_track(seen: Sighting) -> tuple[Array, Array, Array]:
    """Times (N,), positions (N,2) and typical variance
    (2,), without repeated frames and single blunders.
    """
    shown = np.flatnonzero(find_finite_rows(seen.values))
    shown = shown[
        np.append(True, (np.diff(seen.values[shown], axis=0) != 0.0).any(axis=1))[: len(shown)]
    ]
    t = seen.t[shown]
    places = seen.values[shown]
    if len(t) < MIN_READINGS:
        return t, places, np.ones(places.shape[1])
    share = ((t[1:-1] - t[:-2]) / (t[2:] - t[:-2]))[:, None]
    off = np.abs(places[1:-1] - (1.0 - share) * places[:-2] - share * places[2:]).max(axis=1)
    # at either end nothing tells a false frame from a false neighbour
    kept = np.pad(off <= BLUNDER_MEDIANS * np.median(off), 1, "edge")
    return (t[kept], places[kept], np.median(seen.var[shown], axis=0))


def _average_span_readings(
    encoders: Encoders, width: float, most: int
) -> tuple[Array, Array, Array]:
    """Mean times (B,), angles (B,M) and counts (B,M)
    of readings in spans of `width` s with all joints.
    """
    begins = list_span_starts(encoders.t, width)
    begins = begins[:: max(1, -(-len(begins) // most))]
    bounds = np.searchsorted(encoders.t, np.column_stack([begins, begins + width]))
    bounds = bounds[bounds[:, 0] < bounds[:, 1]].ravel()
    known = np.isfinite(encoders.values)
    since = (encoders.t - encoders.t[0])[:, None]
    parts = (known.astype(float), np.where(known, encoders.values, 0.0), known * since)
    count, total, time = (
        np.add.reduceat(np.append(part, part[:1], axis=0), bounds)[::2] for part in parts
    )
    full = count.min(axis=1) >= np.maximum(0.5 * np.median(count), 1.0)
    time = time[full] / count[full]
    count = count[full]
    total = total[full]
    # a delay is known to a millisecond at best: joints
    # whose mean times differ by more were not read together
    together = np.ptp(time, axis=1) < 1e-3
    return encoders.t[0] + time[together].mean(axis=1), (total / count)[together], count[together]


def _is_blurred(curve: Curve) -> bool:
    """Whether noise is too large a share of the curve's speed."""
    rows = build_regression_rows(curve, 0.0)
    return bool(rows.own.sum() > MAX_SPEED_NOISE_SHARE * np.square(rows.slopes[..., 0]).sum())


def _average_frame_pairs(curve: Curve) -> Curve:
    """The curve with frames averaged in pairs."""
    even = len(curve.t) // 2 * 2
    near = np.diff(curve.t[:even])[::2] < 1.5 * curve.step
    t, places = (0.5 * (part[:even:2] + part[1:even:2])[near] for part in (curve.t, curve.places))
    return replace(curve, t=t, places=places, step=2.0 * curve.step, images=2 * curve.images)
