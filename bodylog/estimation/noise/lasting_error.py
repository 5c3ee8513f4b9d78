"""Errors of encoders that last: found by what images say against readings, without truth.

Encoders and images that have white errors alone disagree afresh in every
image. Play, load and electronics make errors that last for several images.
With J the slope of a track, its residual from the readings is then

    r(t) = −J e(t) + n(t).

The error e of each joint is an Ornstein–Uhlenbeck process of variance σ² and time constant τ, and
n has what a sound log may have: the noise of image and reading, the same or not where places or
counts are, times factors; the stated error of the learned body, a function of the posture; and a
delay, by rows of the picture. The evidence of σ and τ over that of noise alone decides. An error
that the log shows adds σ² to the variances: the belief follows the readings, so it has their error.
A body whose error is larger than stated shows as the same: images cannot tell it from an error of
the joints.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...linear_algebra import forward_substituted
from ...types import Array
from ..faults.threshold import SIGNIFICANT_SIGMA
from ..measurements.long_arrays import MIN_READINGS, find_finite_rows, measure_median_step
from ..measurements.records import Encoders, Sighting, mix_rows
from .correlated_noise import PIXEL_CORRELATION_PX, correlate_postures

STRETCHES_PER_LOG = 4
"""Stretches of a log that are looked at: each says what lasts, and time stays constant."""
ROWS_PER_STRETCH = 128
"""Rows of residuals in a stretch."""
TIMES_S = (0.15, 0.6, 2.5)
"""Time constants that the score is computed for."""
SHORTEST_S = 0.1
"""s: what lasts less is noise at 20 to 30 images a second."""
LONGEST_S = 60.0
"""s: what lasts longer than a log is constant in it."""
EVIDENCE_NATS = 8.0
"""Evidence that a lasting error must win: of 120 drawn
sound logs, in four kinds of motion, the most had 7.1.
"""
OUTLIER_MEDIANS = 3.3
"""Median sizes of a residual beyond which an image shows something else: one of 2,000 images with
normal errors, as the share beyond k medians is 2^(−k²). Images that are wrong several in a row are
no errors of encoders.
"""
MOST_COUNTS = 2.0
"""Variances of whole counts up to which an error that
lasts is that of the counts, which noise has already.
"""
MOST_STEPS = 2.5
"""Usual steps of the encoders' clock that readings beside an image may be apart."""
DELAY_S = 1e-2
"""s: standard deviation of the rest of a camera's delay,
and of the difference of its first row from its last.
"""
UNREAD_RAD = 0.03
"""rad: how far a joint without readings may be from its belief."""
_JITTER = 1e-6
"""Share of the mean variance that is added to each, so that a covariance has a Cholesky factor."""
_STATED = np.array([1.0, 1.0, 0.01])
"""Factors on the noise of images, of readings, and alike, with which the search begins."""
_LIMITS = np.log([[1e-6, 1e6], [1e-6, 1e6], [1e-6, 1e6], [1e-7, 1.0], [SHORTEST_S, LONGEST_S]])
"""Of the factors on noise, of σ (rad) and of τ (s)."""


@dataclass(frozen=True)
class LastingError:
    """Standard deviation (rad) and time constant (s) of
    encoders' errors, and the nats of evidence for them.
    """

    std: float
    seconds: float
    nats: float


@dataclass(frozen=True, eq=False)
class Residuals:
    """Images against readings in one stretch of a log, as R rows of F images.

    residual (R,) · image (R,): its variance by noise of images · reading (R,R): covariance by noise
    of readings, independent · shared (R,R): by both, if places and counts that are alike have the
    same error · model (R,R): by the body's error · delayed (R,R): by a delay of DELAY_S · slopes
    (R,M), 0 for joints without readings · t (F,) s.
    """

    residual: Array
    image: Array
    reading: Array
    shared: Array
    model: Array
    delayed: Array
    slopes: Array
    t: Array

    def compute_sound_covariance(self, factors: Array) -> Array:
        """Covariance (R,R) without a lasting error, for factors
        (3,) on the noise of images, of readings, and alike.
        """
        cov = factors[1] * self.reading
        cov += factors[2] * self.shared
        cov += self._beside_noise
        np.einsum("rr->r", cov)[:] += factors[0] * self.image
        return np.asarray(cov)

    def compute_lasting_covariance(self, seconds: float) -> Array:
        """Covariance (R,R) by encoder errors of variance 1 rad² with this time constant."""
        rows = len(self.residual) // len(self.t)
        decay = np.exp(-self._apart_s / seconds)
        return np.asarray(
            self._slope_products * np.repeat(np.repeat(decay, rows, axis=1), rows, axis=0)
        )

    @cached_property
    def _beside_noise(self) -> Array:
        return self.model + self.delayed

    @cached_property
    def _slope_products(self) -> Array:
        return np.asarray(self.slopes @ self.slopes.T)

    @cached_property
    def _apart_s(self) -> Array:
        return np.asarray(np.abs(self.t[:, None] - self.t[None, :]))


@dataclass(frozen=True, eq=False)
class FrameBelief:
    """What is believed at a sighting's frames: angles and rates (F,M), encoder offsets (F,M),
    0 without any, and whether readings or images determine all joints (F,) bool.
    """

    angles: Array
    rates: Array
    offsets: Array
    is_determined: Array


def find_lasting_error(
    encoders: Encoders,
    sightings: Sequence[Sighting],
    beliefs: Sequence[FrameBelief],
    variance: Array,
) -> LastingError | None:
    """The lasting error that a log shows; None where it shows none, or tells nothing.

    variance (M,) rad² of the readings' noise.
    """
    if len(encoders.t) < 2:
        return None
    pieces = [
        piece
        for sighting, belief in zip(sightings, beliefs, strict=True)
        # errors of a posture by the robot's surface last, too
        if sighting.name != "touch" and sighting.cov is None
        for piece in _list_stretch_residuals(encoders, sighting, belief, variance)
    ]
    lasting = _fit_lasting_error(pieces) if pieces else None
    if lasting is None or lasting.std**2 < MOST_COUNTS * encoders.count_variance.max():
        return None
    return lasting


def _list_stretch_residuals(
    encoders: Encoders, sighting: Sighting, belief: FrameBelief, variance: Array
) -> Iterator[Residuals]:
    """Yield the residuals of a track's images from the readings, stretch by stretch."""
    read = _interpolate_readings(encoders, sighting.t)
    # images follow an encoder with an offset, and one that never changes may stand anywhere within
    # its count
    changes = (np.diff(encoders.values, axis=0) != 0.0).any(axis=0)
    tells = changes & (belief.offsets == 0.0).all(axis=0)
    has_reading = np.isfinite(read) & tells
    angles = np.where(has_reading, read, belief.angles)
    values, var, mix = sighting.independent_rows
    # where images leave silent joints open, their belief is off for as long as the silence lasts
    usable = np.flatnonzero(
        find_finite_rows(values) & find_finite_rows(angles) & belief.is_determined
    )
    if len(usable) < MIN_READINGS or not has_reading.any():
        return
    own_mix = None if mix is None else mix[usable]
    mean, jac, model_var = mix_rows(own_mix, sighting.model.predict(angles[usable]))
    residual = values[usable] - mean
    width = max(ROWS_PER_STRETCH // values.shape[1], 1)
    frames = np.flatnonzero(_find_inliers(residual))
    starts = np.linspace(0, max(len(frames) - width, 0), STRETCHES_PER_LOG).astype(int)
    for start in np.unique(starts):
        part = frames[start : start + width]
        rows = usable[part]
        shown = has_reading[rows][:, None, :]
        late = np.einsum("fdm,fm->fd", jac[part], belief.rates[rows])
        yield _build_piece_residuals(
            residual[part],
            mean[part],
            var[rows],
            jac[part] * shown,
            jac[part] * ~shown,
            model_var[part],
            angles[rows],
            late,
            sighting.t[rows],
            variance,
            encoders.count_variance,
            correlate_postures(sighting.model, angles[rows]),
        )


def _interpolate_readings(encoders: Encoders, t: Array) -> Array:
    """Readings (F,M) rad at t (F,) s, between the two
    beside each; NaN where one of them is missing.
    """
    after = np.clip(np.searchsorted(encoders.t, t), 1, len(encoders.t) - 1)
    begin = encoders.t[after - 1]
    end = encoders.t[after]
    share = ((t - begin) / (end - begin))[:, None]
    read = (1.0 - share) * encoders.values[after - 1] + share * encoders.values[after]
    usual = (
        (t >= begin) & (t <= end) & (end - begin <= MOST_STEPS * measure_median_step(encoders.t))
    )
    return np.asarray(np.where(usual[:, None], read, np.nan))


def _find_inliers(residual: Array) -> Array:
    """Which images (F,) are within OUTLIER_MEDIANS times the median size of all residuals (F,D)."""
    size = np.sqrt(np.square(residual - np.median(residual, axis=0)).sum(axis=1))
    return np.asarray(size <= OUTLIER_MEDIANS * max(float(np.median(size)), 1e-12))


def _build_piece_residuals(
    residual: Array,
    places: Array,
    var: Array,
    jac: Array,
    unread: Array,
    model_var: Array,
    q: Array,
    late: Array,
    t: Array,
    variance: Array,
    counts: Array,
    near_posture: Array,
) -> Residuals:
    """The residuals (F,D) of F images, whose D rows are independent, as R = F D rows.

    places (F,D): predicted, as measured ones are near where their errors are alike · jac, unread
    (F,D,M): slopes of joints with and without readings · late (F,D): by a second · counts (M,)
    rad²: variance of the readings that comes from whole counts · near_posture (F,F): correlation of
    the body's errors.
    """
    step = q[:, None, :] - q[None, :, :]
    apart = np.sqrt(np.square(places[:, None] - places[None]).sum(axis=-1))
    # the error of a count turns from one half of it to the other
    same_count = np.exp(-0.5 * np.square(step) / np.maximum(12.0 * counts / 16.0, 1e-30))
    rows = np.eye(residual.shape[1])
    single = np.eye(len(q))
    model = _correlate_image_errors(near_posture, np.sqrt(model_var), rows)
    # images tell where a joint without readings is: along its slope they contradict nothing
    model += _project_joint_errors(unread, UNREAD_RAD**2 * single[..., None])
    reading = _project_joint_errors(jac, variance * single[..., None])
    shared = _correlate_image_errors(
        np.exp(-apart / PIXEL_CORRELATION_PX), np.sqrt(var), rows
    ) + _project_joint_errors(jac, variance * same_count)
    # a camera that exposes its rows one by one is later by a linear function of the row
    height = places[:, -1] - places[:, -1].mean()
    by_row = late * (height / max(float(np.abs(height).max()), 1e-12))[:, None]
    delayed = np.square(DELAY_S) * sum(np.outer(one.ravel(), one.ravel()) for one in (late, by_row))
    return Residuals(
        residual.ravel(),
        var.ravel(),
        reading,
        shared,
        model,
        delayed,
        jac.reshape(residual.size, -1),
        t,
    )


def _project_joint_errors(jac: Array, near: Array) -> Array:
    """Covariance (R,R) of what errors of joints, of covariance
    near (F,F,M) rad² from image to image, do in images.
    """
    rows = jac.shape[0] * jac.shape[1]
    return np.asarray(np.einsum("fdm,gem,fgm->fdge", jac, jac, near).reshape(rows, rows))


def _correlate_image_errors(near: Array, std: Array, rows: Array) -> Array:
    """Covariance (R,R) of errors (F,D) whose images
    correlate by near (F,F), and whose rows are independent.
    """
    return np.asarray(
        np.einsum("fg,fd,ge,de->fdge", near, std, std, rows).reshape(std.size, std.size)
    )


def _score_lasting_error(pieces: Sequence[Residuals], factors: Array) -> tuple[float, float]:
    """The largest score for a lasting error, in its standard
    deviations, and the time constant (s) that has it.

    The score is the slope of the log likelihood by σ² at σ
    = 0, for residuals scaled to the noise of factors (3,).
    """
    scores = np.zeros((2, len(TIMES_S)))
    for piece in pieces:
        root = np.linalg.cholesky(_stabilise_covariance(piece.compute_sound_covariance(factors)))
        white = forward_substituted(root, piece.residual[:, None])[:, 0]
        white = white / max(float(np.sqrt(np.mean(white * white))), 1e-12)
        for k, seconds in enumerate(TIMES_S):
            shape = forward_substituted(root, piece.compute_lasting_covariance(seconds))
            shape = forward_substituted(root, shape.T)
            shape -= np.trace(shape) / len(shape) * np.eye(len(shape))
            scores[:, k] += white @ shape @ white, 2.0 * np.square(shape).sum()
    each = scores[0] / np.sqrt(np.maximum(scores[1], 1e-300))
    return float(each.max()), TIMES_S[int(each.argmax())]


def _fit_lasting_error(pieces: Sequence[Residuals]) -> LastingError | None:
    """The lasting error of most evidence, if it wins EVIDENCE_NATS over none."""
    score, seconds = _score_lasting_error(pieces, _STATED)
    if score < SIGNIFICANT_SIGMA:
        return None
    factors, none = _minimise_cost(
        lambda p: _compute_residual_nats(pieces, np.exp(p)), np.log(_STATED), _LIMITS[:3]
    )
    start = np.array([*factors, np.log(_bound_error_size(pieces)), np.log(seconds)])
    found, nats = _minimise_cost(
        lambda p: _compute_residual_nats(pieces, *_split_parameters(p)), start, _LIMITS
    )
    if none - nats <= EVIDENCE_NATS:
        return None
    # play looks like a delay in part: what decides allows for one, the size of the error does not
    timely = [replace(piece, delayed=np.zeros_like(piece.delayed)) for piece in pieces]
    (*_, std, tau), _ = _minimise_cost(
        lambda p: _compute_residual_nats(timely, *_split_parameters(p)), found, _LIMITS
    )
    # a process that outlasts the log may be larger than any error in it, which the residuals bound
    return LastingError(
        min(float(np.exp(std)), _bound_error_size(pieces)), float(np.exp(tau)), none - nats
    )


def _split_parameters(p: Array) -> tuple[Array, float, float]:
    """Factors (3,) on noise, σ and τ, of their logarithms (5,)."""
    return np.exp(p[:3]), float(np.exp(p[3])), float(np.exp(p[4]))


def _minimise_cost(
    cost: Callable[[Array], float], start: Array, limits: Array
) -> tuple[Array, float]:
    """Where a cost of logarithms (P,) is least, and the cost there, between the limits (P,2)."""
    from scipy.optimize import minimize

    start = np.clip(start, limits[:, 0] + 0.1, limits[:, 1] - 1.1)
    simplex = np.vstack([start, start + np.eye(len(start))])
    options = {"xatol": 0.02, "fatol": 0.05, "maxfev": 60 * len(start), "initial_simplex": simplex}
    found = minimize(cost, start, method="Nelder-Mead", bounds=limits, options=options)
    return np.asarray(found.x), float(found.fun)


def _compute_residual_nats(
    pieces: Sequence[Residuals], factors: Array, std: float = 0.0, seconds: float = 1.0
) -> float:
    """−ln p of all residuals, for factors (3,) on noise, and a lasting error (rad, s)."""
    from scipy.linalg.lapack import dpotrf, dtrtrs

    total = 0.0
    for piece in pieces:
        cov = piece.compute_sound_covariance(factors)
        if std:
            cov += std**2 * piece.compute_lasting_covariance(seconds)
        # LAPACK has columns first: of a symmetric matrix the same one, without a copy
        root, failed = dpotrf(_stabilise_covariance(cov).T, lower=1, clean=0, overwrite_a=1)
        if failed:
            raise np.linalg.LinAlgError("the covariance of an image's residuals is singular")
        white, _ = dtrtrs(root, piece.residual, lower=1)
        total += float(0.5 * white @ white + np.log(np.diag(root)).sum())
    return total


def _stabilise_covariance(cov: Array) -> Array:
    """A covariance (R,R) with as much white noise as the rounding of its Cholesky factor needs,
    in place.
    """
    np.einsum("rr->r", cov)[:] += _JITTER * np.trace(cov) / len(cov)
    return cov


def _bound_error_size(pieces: Sequence[Residuals]) -> float:
    """The size (rad) that encoder errors have if they make all residuals."""
    squares = sum(float(np.square(piece.residual).sum()) for piece in pieces)
    slopes = sum(float(np.square(piece.slopes).sum()) for piece in pieces)
    return max(float(np.sqrt(squares / max(slopes, 1e-300))), 1e-9)
