"""Offsets of encoders to first order: the nats that one of each would win, from one filtered log.

In a short span, innovations are those of one error e of the belief and of one offset b of the
encoders: ν = e + b in an encoder, J e in an image. Least squares, e integrated out, give b: with W
the sum of the encoders' S⁻¹, V of the images' JᵀS⁻¹J, and s = (W + V)⁻¹ W, its information is
W − W s. A filter that lags behind the arm has an e, but no b.
"""

import numpy as np

from ...types import Array
from ..inference.filter_pass import GATE_SIGMA
from ..inference.filter_problem import FilterProblem
from ..inference.solution import Solution
from ..inference.tangents import OFFSET_STD
from ..measurements.long_arrays import find_finite_rows
from ..measurements.timeline import list_span_starts
from ..noise.correlated_noise import count_effective_frames
from .threshold import CERTAIN_SIGMA


def score_encoder_offsets(
    problem: FilterProblem, solved: Solution, walk: float, most: float = CERTAIN_SIGMA
) -> tuple[Array, Array, Array]:
    """Nats (M,) that an offset of each encoder with
    random walk `walk` rad²/s would win; 0 without images.

    Also returns that offset over spans of the log (S,M) rad, and its variance (S,M). Innovations
    count as no more than `most` standard deviations, so that single blunders do not look like an
    offset; one of many times their noise looks smaller than it is.
    """
    t = problem.timeline.t
    m = len(problem.start)
    visual = [
        k for k, sighting in enumerate(problem.evidence.sightings) if sighting.name != "touch"
    ]
    if not visual:
        return np.zeros(m), *np.zeros((2, 1, m))
    # in a span an offset walks by less than the least fault: by two standard deviations
    begins = np.unique(np.searchsorted(t, list_span_starts(t, (0.5 * OFFSET_STD) ** 2 / walk)))
    bounds = np.append(begins, len(t))
    pull, weight = _sum_encoder_innovations(solved, bounds, most)
    tracks = [_sum_track_information(problem, solved, k, bounds, most) for k in visual]
    seen = np.sum(tracks, axis=0)
    return _filter_offset_score(
        np.diff(t[begins], append=t[-1]), *_score_offsets(pull, weight, seen), walk
    )


def _score_offsets(pull: Array, weight: Array, seen: Array) -> tuple[Array, Array]:
    """Slope and curvature (S,M) of the evidence in each
    encoder's offset, from the sums of encoders and of tracks.

    With W the encoders' information and A that of all others, 1 - (A + W)⁻¹W is (A + W)⁻¹A: as a
    difference it would be rounding where encoders know far more than images.
    """
    m = weight.shape[1]
    # known to a radian where nothing is measured
    others = seen[..., :m] + np.eye(m)
    known = np.linalg.inv(others + np.eye(m) * weight[:, None])
    read = np.divide(pull, weight, out=np.zeros_like(pull), where=weight > 0.0)
    left = (others @ read[..., None])[..., 0] - seen[..., m]
    score = weight * (known @ left[..., None])[..., 0]
    return score, weight * np.einsum("skj,sjk->sk", known, others)


def _sum_encoder_innovations(solved: Solution, bounds: Array, most: float) -> tuple[Array, Array]:
    """Sums (S,M) of S⁻¹ν, clipped at `most` standard deviations, and of S⁻¹ over spans."""
    d = solved.trace.encoder_d
    spread = np.einsum("eii->ei", solved.trace.prior_cov) + solved.readings.encoder_var
    each = np.clip(d, -most, most) / np.sqrt(spread), 1.0 / spread
    rows = (np.where(np.isfinite(d), a, 0.0) for a in each)
    pull, weight = (np.add.reduceat(a, bounds[:-1]) for a in rows)
    return pull, weight


def _sum_track_information(
    problem: FilterProblem, solved: Solution, track: int, bounds: Array, most: float
) -> Array:
    """Sums of a track's JᵀS⁻¹J, and of JᵀS⁻¹ν clipped alike, over spans: (S,M,M+1)."""
    events, jac, nu, white = _whiten_track(problem, solved, track)
    far = np.sqrt((nu * white[..., -1]).mean(axis=1))
    white[..., -1] /= np.maximum(far / most, 1.0)[:, None]
    each = (jac.swapaxes(1, 2) @ white).cumsum(axis=0)
    return np.diff(np.insert(each, 0, 0.0, axis=0)[np.searchsorted(events, bounds)], axis=0)


def _whiten_track(
    problem: FilterProblem, solved: Solution, track: int
) -> tuple[Array, Array, Array, Array]:
    """Of a track's images: their instants (F,), slopes J (F,D,M), innovations ν (F,D), and S⁻¹J
    beside S⁻¹ν (F,D,M+1).
    """
    readings = solved.readings
    trace = solved.trace
    sighting = problem.evidence.sightings[track]
    seen = find_finite_rows(sighting.values)
    size = np.arange(sighting.values.shape[1])
    events = problem.timeline.sightings[track][seen]
    x, cov = (a[events] for a in (trace.prior, trace.prior_cov))
    y, jac, var = (a[events, track, : len(size)] for a in (readings.y, readings.jac, readings.var))
    s = jac @ cov @ jac.swapaxes(1, 2)
    nu = y[..., None] - jac @ x[..., None]
    s[:, size, size] += var + _measure_correlated_error(solved, track, seen)
    return events, jac, nu[..., 0], np.linalg.solve(s, np.concatenate([jac, nu], axis=2))


def rejects_images(problem: FilterProblem, solved: Solution) -> bool:
    """Whether most images are farther from where readings put them than a filter's gate allows: the
    noise that it was given then says nothing of them.
    """
    far = [np.zeros(0)]
    for k, sighting in enumerate(problem.evidence.sightings):
        if sighting.name != "touch":
            _, _, nu, white = _whiten_track(problem, solved, k)
            far.append(np.sqrt((nu * white[..., -1]).mean(axis=1)))
    rejected = np.concatenate(far) > GATE_SIGMA
    return bool(rejected.size and rejected.mean() > 0.5)


def _measure_correlated_error(solved: Solution, track: int, seen: Array) -> Array:
    """Variance (F,D) added for correlated model error,
    so that frames of like postures count as one.
    """
    points = solved.tangents.points[track][seen]
    model = solved.tangents.model_var[track][seen]
    # within 0.3 rad errors of the body model are correlated, and look like an offset
    duplicates = count_effective_frames(
        np.exp(-np.linalg.norm(np.diff(points, axis=0), axis=1) / 0.3)
    )
    return np.asarray(model * (2.0 * duplicates - 2.0)[:, None])


def _filter_offset_score(
    steps: Array, score: Array, weight: Array, walk: float
) -> tuple[Array, Array, Array]:
    """Filter each offset over spans of `steps` (S,) s from
    scores and weights (S,M); returns as `score_encoder_offsets` does.
    """
    offset = np.zeros(score.shape[1])
    var = np.full(score.shape[1], OFFSET_STD**2)
    filtered = []
    for pull, stiff, step in zip(score, weight, steps, strict=True):
        before = offset
        ahead = var + walk * step
        share = 1.0 + stiff * ahead
        offset = before + ahead * (pull - stiff * before) / share
        var = ahead / share
        nats = 0.5 * (offset * offset / var - before * before / ahead - np.log(share))
        filtered.append((nats, offset, var))
    nats, offset, var = np.stack(filtered).swapaxes(0, 1)
    return nats.sum(axis=0), offset, var
