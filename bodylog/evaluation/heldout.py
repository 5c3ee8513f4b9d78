"""Pictures withheld from an estimate, and how probable it holds what they show: a score that needs no truth."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..types import Array, BodyModel, Estimate, Features, Score, Series

EVERY = 5
"""One picture in so many is withheld."""


def withhold(features: Features, every: int = EVERY) -> tuple[Features, Mapping[str, Series]]:
    """The features with each `every`-th frame of a track unseen, and those frames that did show something.

    A track that would show nothing any more is left as it is.
    """
    tracks, withheld = dict(features.tracks), {}
    for name, track in features.tracks.items():
        rows = np.arange(len(track.t)) % every == every - 1
        shown = np.isfinite(track.values).all(axis=1)
        rows = rows & (shown & ~rows).any()
        shown &= rows
        tracks[name] = replace(track, values=np.where(rows[:, None], np.nan, track.values))
        std = None if track.std is None else track.std[shown]
        withheld[name] = Series(track.t[shown], track.values[shown], track.names, "px", track.source_ns[shown], std)
    return replace(features, tracks=tracks), withheld


def held_out(estimate: Estimate, withheld: Mapping[str, Series], body: BodyModel) -> tuple[Score, ...]:
    """Mean log density (nats) per withheld frame of what the body can predict; nothing where no frame was withheld."""
    nats = [_nats(estimate, name, seen, body) for name, seen in withheld.items() if name in body.senses and len(seen.t)]
    return (Score("held_out", float(np.concatenate(nats).mean()), "nats"),) if nats else ()


def _nats(estimate: Estimate, name: str, seen: Series, body: BodyModel) -> Array:
    """Log density (F,) of a track's withheld places under what was foretold of them."""
    if name in estimate.predicted:
        known = estimate.predicted[name]
        rows = np.minimum(np.searchsorted(known.t, seen.t), len(known.t) - 1)
        same = known.t[rows] == seen.t  # a frame whose time ran backwards was left out
        values, mean, cov = seen.values[same], known.values[rows[same]], estimate.predicted_cov[name][rows[same]]
    else:
        values, (mean, cov) = seen.values, _carried(estimate, name, seen, body)
    apart = values - mean
    squares = np.einsum("fd,fd->f", apart, np.linalg.solve(cov, apart[..., None])[..., 0])
    return np.asarray(-0.5 * (squares + np.linalg.slogdet(2.0 * np.pi * cov)[1]))


def _carried(estimate: Estimate, name: str, seen: Series, body: BodyModel) -> tuple[Array, Array]:
    """Mean (F,D) px and covariance (F,D,D) by the angles, of an estimate that did not use the track."""
    joints = estimate.joints
    columns = [joints.names.index(joint) for joint in body.joints]
    x = np.stack([np.interp(seen.t, joints.t, joints.values[:, j]) for j in columns], axis=1)
    nearest = np.minimum(np.searchsorted(joints.t, seen.t), len(joints.t) - 1)
    mean, jac, var = body.senses[name].predict(x)
    spread = np.asarray(estimate.cov[nearest][:, columns][:, :, columns])
    cov = np.einsum("fdj,fjk,fek->fde", jac, spread, jac, optimize=True)
    noise = np.broadcast_to(body.noise.senses.get(name, (1.0,) * mean.shape[1]), mean.shape)
    noise = noise if seen.std is None else np.where(np.isfinite(seen.std), seen.std**2, noise)
    np.einsum("fdd->fd", cov)[:] += var + noise
    return mean, cov
