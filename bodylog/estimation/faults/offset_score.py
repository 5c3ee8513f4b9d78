"""Score test for encoder offsets: the evidence an offset would win, to first order, at the cost of one pass.

Innovations of a filter without an offset b are ν + Ψ b (Friedland 1969, "Treatment of bias in recursive filtering"),
where Ψ follows from the filter's covariances. So b is found by regression of ν on Ψ.
"""

from dataclasses import dataclass

import numpy as np

from ...types import Array
from ..inference.conditioning import raised
from ..inference.initial_path import OFFSET_STD
from ..inference.motion import carry
from ..inference.problem import Problem
from ..inference.solution import Solution
from ..measurements.long_arrays import seen as seen_rows
from ..measurements.timeline import spans
from ..noise.correlated_noise import counts

CLIP = 4.0
"""Standard deviations at which innovations are clipped, so that single blunders do not look like an offset."""
SPAN = 0.5
"""s over which an offset is taken as constant."""


@dataclass(frozen=True, eq=False)
class _Frames:
    """F sightings of a track: events (F,), J (D,M,F), S⁻¹ (D,D,F), S⁻¹ν (D,F) clipped, gated information (M,M,F)."""

    events: Array
    jac: Array
    inverse: Array
    pull: Array
    stiff: Array


def offset_score(problem: Problem, solved: Solution, walk: float) -> tuple[Array, Array, Array]:
    """Nats (M,) that an offset of each encoder with random walk `walk` rad²/s would win; 0 without images.

    Also returns that offset over spans of the log (S,M) rad, and its variance (S,M).
    """
    tracks = [_frames(problem, solved, k) for k in range(len(problem.evidence.sightings))]
    visual = [track for track, s in zip(tracks, problem.evidence.sightings, strict=True) if s.name != "touch"]
    if not visual:
        return np.zeros(len(problem.start)), *np.zeros((2, 1, len(problem.start)))
    shift = _shift(solved, tracks, problem.precision.order)
    score, weight = _by_encoders(solved, shift)
    for track in visual:
        psi = -np.einsum("dmf,mkf->dkf", track.jac, _at(solved, shift, track.events))
        score[track.events] += np.einsum("dkf,df->fk", psi, track.pull)
        weight[track.events] += np.einsum("dkf,dkf->fk", psi, np.einsum("def,ekf->dkf", track.inverse, psi))
    duplication = 1.0 if problem.precision.likeliest is None else _scatter(solved)
    return _filtered_offsets(problem.timeline.t, score / duplication, weight / duplication, walk)


def _frames(problem: Problem, solved: Solution, track: int) -> _Frames:
    """Innovations of one track's sightings and their information."""
    readings, trace = solved.readings, solved.trace
    seen: Array = seen_rows(problem.evidence.sightings[track].values)
    events = problem.timeline.sightings[track][seen]
    x, cov = _at(solved, trace.prior, events), _at(solved, trace.prior_cov, events)
    size = problem.evidence.sightings[track].values.shape[1]
    y, jac, var = (_at(solved, part[:, track, :size], events) for part in (readings.y, readings.jac, readings.var))
    nu, s = y - (jac * x).sum(axis=1), np.einsum("dmf,emf->def", np.einsum("dmf,mkf->dkf", jac, cov), jac)
    own = np.einsum("ddf->df", s)
    own += var
    d2 = np.einsum("df,df->f", nu, np.einsum("def,ef->df", _inverse(s), nu))
    noise = raised(var, own, d2)
    own += _correlated_error(solved, track, seen)
    inverse = _inverse(s)
    pull = np.einsum("def,ef->df", inverse, nu)
    reach = np.sqrt(np.maximum(np.einsum("df,df->f", nu, pull) / len(nu), 1e-9))
    information = np.einsum("dmf,dkf->mkf", jac, jac / noise[:, None])
    return _Frames(events, jac, inverse, pull * np.minimum(1.0, CLIP / reach), information)


def _at(solved: Solution, a: Array, events: Array) -> Array:
    """Values of folded a (L,…,C) at the given events: (…,F)."""
    return np.ascontiguousarray(np.moveaxis(solved.fold.pick(a, events), 0, -1))


def _inverse(s: Array) -> Array:
    """Inverse of symmetric s (D,D,F)."""
    if len(s) != 2:
        return np.moveaxis(np.linalg.inv(np.moveaxis(s, -1, 0)), 0, -1)
    (a, b), (_, c) = s
    return np.asarray(np.stack([c, -b, -b, a]).reshape(s.shape) / (a * c - b * b))


def _correlated_error(solved: Solution, track: int, seen: Array) -> Array:
    """Variance (D,F) added for correlated model error, so that frames of like postures count as one."""
    points, model = solved.tangents.points[track][seen], solved.tangents.model_var(track)[seen]
    # within 0.3 rad errors of the body model are correlated, and look like an offset
    duplicates = counts(np.exp(-np.linalg.norm(np.diff(points, axis=0), axis=1) / 0.3))
    return np.asarray((model * (2.0 * duplicates - 2.0)[:, None]).T)


def _shift(solved: Solution, tracks: list[_Frames], order: int) -> Array:
    """Derivative (L,M,M,C) of the predicted belief at each instant with respect to each encoder's offset."""
    readings, trace, fold = solved.readings, solved.trace, solved.fold
    gated = raised(readings.encoder_var, _spread(solved), trace.encoder_d**2)
    information = np.where(np.isfinite(readings.encoders), 1.0 / gated, 0.0)
    stiff = np.zeros(trace.prior_cov.shape)
    np.einsum("liic->lic", stiff)[:] = information
    for track in tracks:
        fold.put(stiff, track.events, fold.pick(stiff, track.events) + np.moveaxis(track.stiff, -1, 0))
    # pseudo-readings of the posture prior have no offset
    weight = np.where(np.isfinite(trace.encoder_d), information, 0.0)
    m, shift = weight.shape[1], np.empty_like(stiff)
    # at first, encoders with readings carry their offset over
    begin = np.zeros((order, *stiff.shape[1:]))
    begin[0, np.arange(m), np.arange(m), 1:] = np.any(weight > 0, axis=(0, 2))[:, None]
    for sweep in range(8):
        # the first guess is so rough that half of each segment forgets it about as well
        rows = slice(0 if sweep else len(shift) // 2, None)
        parts = (part[rows] for part in (shift, readings.dt, stiff, weight, trace.p))
        end = _propagate(begin.copy(), *parts)
        moved, begin[..., 1:] = np.abs(end[0, ..., :-1] - begin[0, ..., 1:]).max(initial=0.0), end[..., :-1]
        if sweep and moved < 0.05:  # of the offset
            break
    return shift


def _propagate(
    moved: Array, shift: Array, dt: Array, stiff: Array, weight: Array, p: Array
) -> Array:  # fmt: skip
    """Propagate the states' derivatives `moved` (O,M,M,C) through all segments into `shift`; return the end."""
    (m, stretches), states = weight.shape[1:], moved.reshape(-1, *moved.shape[2:])
    force = np.empty((m, m, stretches))
    own = force.reshape(m * m, stretches)[:: m + 1]
    for i, step in enumerate(dt):
        carry(moved, step)
        shift[i] = moved[0]
        np.einsum("ijc,jkc->ikc", stiff[i], shift[i], out=force)
        own -= weight[i]
        # x⁺ − x⁻ = P⁺ Hᵀ R⁻¹ ν
        states -= np.einsum("aic,ikc->akc", p[i, : len(states), :m], force)
    return moved


def _by_encoders(solved: Solution, shift: Array) -> tuple[Array, Array]:
    """Ψᵀ S⁻¹ ν (E,M) and the diagonal of Ψᵀ S⁻¹ Ψ (E,M) from all encoder readings."""
    d, spread = solved.trace.encoder_d, _spread(solved)
    # Ψ = (1 − shift) / √S
    inverse = np.where(np.isfinite(d), 1.0 / spread, 0.0)
    pull = np.where(np.isfinite(d), np.clip(d, -CLIP, CLIP) / np.sqrt(spread), 0.0)
    score = pull - np.einsum("lijc,lic->ljc", shift, pull)
    weight = inverse * (1.0 - 2.0 * np.einsum("liic->lic", shift))
    weight += np.einsum("lijc,lijc,lic->ljc", shift, shift, inverse)
    return solved.fold.unfold(score), solved.fold.unfold(weight)


def _scatter(solved: Solution) -> Array:
    """Ratio (M,), at least 1, of each encoder's innovation scatter to its stated variance.

    A smoother's forward pass lags behind the arm, which would look like an offset without this factor.
    """
    d = np.nan_to_num(solved.trace.encoder_d)
    known = np.isfinite(solved.trace.encoder_d).sum(axis=(0, 2))
    squares = np.square(np.clip(d, -CLIP, CLIP)).sum(axis=(0, 2))
    return np.asarray(np.maximum(squares / np.maximum(known, 1), 1.0))


def _spread(solved: Solution) -> Array:
    """Variance (L,M,C) of each encoder's innovation."""
    return np.asarray(np.einsum("liic->lic", solved.trace.prior_cov) + solved.readings.encoder_var)


def _filtered(score: list[float], weight: list[float], grown: list[float]) -> tuple[list[float], list[float]]:
    """One offset and its variance, first of all and after each span, whose walk has the variance `grown`."""
    offsets, var = [b := 0.0], [p := OFFSET_STD**2]
    for pull, stiff, more in zip(score, weight, grown, strict=True):
        p += more
        p /= 1.0 + stiff * p
        b += p * (pull - stiff * b)
        offsets.append(b)
        var.append(p)
    return offsets, var


def _filtered_offsets(t: Array, score: Array, weight: Array, walk: float) -> tuple[Array, Array, Array]:
    """Filter each offset over spans from scores (E,M) and weights (E,M); returns as `offset_score` does."""
    starts = np.unique(np.searchsorted(t, spans(t, SPAN)))
    steps = np.diff(t[starts], append=t[-1])
    score, weight = np.add.reduceat(score, starts), np.add.reduceat(weight, starts)
    grown = (walk * steps).tolist()
    pairs = [_filtered(*each, grown) for each in zip(score.T.tolist(), weight.T.tolist(), strict=True)]
    offsets, var = (np.transpose(each) for each in zip(*pairs, strict=True))
    before, grown = offsets[:-1], var[:-1] + walk * steps[:, None]
    innovation, share = score - weight * before, 1.0 + weight * grown
    nats = before * (score - 0.5 * weight * before) + 0.5 * (innovation * innovation * grown / share - np.log(share))
    return nats.sum(axis=0), offsets[1:], var[1:]
