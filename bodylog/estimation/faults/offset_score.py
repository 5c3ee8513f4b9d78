"""Score test for encoder offsets: the evidence an
offset would win, to first order, without another pass.

In a short span, innovations are those of one error e of the belief and of one offset b of the
encoders: ν = e + b in an encoder, J e in an image. Least squares, e integrated out, give b: with W
the sum of the encoders' S⁻¹, V of the images' JᵀS⁻¹J, and s = (W + V)⁻¹ W, its information is W − W
s. A filter that lags behind the arm has an e, but no b.
"""

import numpy as np

from ...types import Array
from ..inference.initial_path import OFFSET_STD
from ..inference.problem import FilterProblem
from ..inference.solution import Solution
from ..measurements.long_arrays import find_finite_rows as seen_rows
from ..measurements.timeline import list_span_starts
from ..noise.correlated_noise import count_effective_frames
from .threshold import CERTAIN_SIGMA


def offset_score(
    problem: FilterProblem, solved: Solution, walk: float
) -> tuple[Array, Array, Array]:
    """Nats (M,) that an offset of each encoder with
    random walk `walk` rad²/s would win; 0 without images.

    Also returns that offset over spans of the log (S,M) rad, and its variance (S,M).
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
    pull, weight = _encoder_sums(solved, bounds)
    seen = np.sum([_track_sums(problem, solved, k, bounds) for k in visual], axis=0)
    return _filtered_offsets(
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


def _encoder_sums(solved: Solution, bounds: Array) -> tuple[Array, Array]:
    """Sums (S,M) of S⁻¹ν, clipped so that single blunders
    do not look like an offset, and of S⁻¹ over spans.
    """
    d = solved.trace.encoder_d
    spread = np.einsum("liic->lic", solved.trace.prior_cov) + solved.readings.encoder_var
    each = np.clip(d, -CERTAIN_SIGMA, CERTAIN_SIGMA) / np.sqrt(spread), 1.0 / spread
    rows = (solved.fold.unfold(np.where(np.isfinite(d), a, 0.0)) for a in each)
    pull, weight = (np.add.reduceat(a, bounds[:-1]) for a in rows)
    return pull, weight


def _track_sums(problem: FilterProblem, solved: Solution, track: int, bounds: Array) -> Array:
    """Sums of a track's JᵀS⁻¹J, and of JᵀS⁻¹ν clipped alike, over spans: (S,M,M+1)."""
    readings = solved.readings
    trace = solved.trace
    sighting = problem.evidence.sightings[track]
    seen = seen_rows(sighting.values)
    size = np.arange(sighting.values.shape[1])
    events = problem.timeline.sightings[track][seen]
    x, cov = (solved.fold.pick(a, events) for a in (trace.prior, trace.prior_cov))
    y, jac, var = (
        solved.fold.pick(a[:, track, size], events)
        for a in (readings.y, readings.jac, readings.var)
    )
    s = jac @ cov @ jac.swapaxes(1, 2)
    nu = y[..., None] - jac @ x[..., None]
    s[:, size, size] += var + _correlated_error(solved, track, seen)
    white = np.linalg.solve(s, np.concatenate([jac, nu], axis=2))
    far = np.sqrt((nu[..., 0] * white[..., -1]).mean(axis=1))
    white[..., -1] /= np.maximum(far / CERTAIN_SIGMA, 1.0)[:, None]
    each = (jac.swapaxes(1, 2) @ white).cumsum(axis=0)
    return np.diff(np.insert(each, 0, 0.0, axis=0)[np.searchsorted(events, bounds)], axis=0)


def _correlated_error(solved: Solution, track: int, seen: Array) -> Array:
    """Variance (F,D) added for correlated model error,
    so that frames of like postures count as one.
    """
    points = solved.tangents.points[track][seen]
    model = solved.tangents.model_var(track)[seen]
    # within 0.3 rad errors of the body model are correlated, and look like an offset
    duplicates = count_effective_frames(
        np.exp(-np.linalg.norm(np.diff(points, axis=0), axis=1) / 0.3)
    )
    return np.asarray(model * (2.0 * duplicates - 2.0)[:, None])


def _filtered_offsets(
    steps: Array, score: Array, weight: Array, walk: float
) -> tuple[Array, Array, Array]:
    """Filter each offset over spans of `steps` (S,) s from
    scores and weights (S,M); returns as `offset_score` does.
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
