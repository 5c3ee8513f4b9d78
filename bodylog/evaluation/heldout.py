"""Log density of images withheld from an estimate: a score without truth."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..body_model import BodyModel
from ..types import Array, Estimate, Features, Score, Series

WITHHELD_INTERVAL = 5
"""One image in so many is withheld."""


def withhold_frames(features: Features) -> tuple[Features, Mapping[str, Series]]:
    """The features with one in WITHHELD_INTERVAL frames of a
    track unseen, and those frames that did show something.

    A track that would show nothing any more is left as it is.
    """
    tracks = dict(features.tracks)
    withheld = {}
    for name, track in features.tracks.items():
        rows = np.arange(len(track.t)) % WITHHELD_INTERVAL == WITHHELD_INTERVAL - 1
        shown = np.isfinite(track.values).all(axis=1)
        rows = rows & (shown & ~rows).any()
        shown &= rows
        tracks[name] = replace(track, values=np.where(rows[:, None], np.nan, track.values))
        std = None if track.std is None else track.std[shown]
        withheld[name] = replace(
            track,
            t=track.t[shown],
            values=track.values[shown],
            source_ns=track.source_ns[shown],
            std=std,
        )
    return replace(features, tracks=tracks), withheld


def score_withheld_frames(
    estimate: Estimate, withheld: Mapping[str, Series], body: BodyModel
) -> tuple[Score, ...]:
    """Mean log density (nats) per withheld frame of what the
    body can predict; nothing where no frame was withheld.
    """
    nats = [
        _withheld_log_density(estimate, name, seen, body)
        for name, seen in withheld.items()
        if name in body.senses and len(seen.t)
    ]
    return (
        (Score("log_density/held_out", float(np.concatenate(nats).mean()), "nats"),) if nats else ()
    )


def _withheld_log_density(estimate: Estimate, name: str, seen: Series, body: BodyModel) -> Array:
    """Log density (F,) of a track's withheld places under their prediction."""
    if name in estimate.predicted:
        known = estimate.predicted[name]
        rows = np.minimum(np.searchsorted(known.t, seen.t), len(known.t) - 1)
        same = known.t[rows] == seen.t  # a frame whose time ran backwards was left out
        values = seen.values[same]
        mean = known.values[rows[same]]
        cov = estimate.predicted_cov[name][rows[same]]
    else:
        values = seen.values
        mean, cov = _predict_by_angles(estimate, name, seen, body)
    apart = values - mean
    squares = np.einsum("fd,fd->f", apart, np.linalg.solve(cov, apart[..., None])[..., 0])
    return np.asarray(-0.5 * (squares + np.linalg.slogdet(2.0 * np.pi * cov)[1]))


def _predict_by_angles(
    estimate: Estimate, name: str, seen: Series, body: BodyModel
) -> tuple[Array, Array]:
    """Mean (F,D) px and covariance (F,D,D) by the
    angles, of an estimate that did not use the track.
    """
    columns = [estimate.joints.names.index(joint) for joint in body.joints]
    late = estimate.settings.get("delay", {}).get(name.rpartition("/")[0] or "camera", 0.0)
    x, cov = _interpolate_angles(estimate, seen.t - late)
    mean, jac, var = body.senses[name].predict(x[:, columns])
    spread = cov[:, columns][:, :, columns]
    cov = np.einsum("fdj,fjk,fek->fde", jac, spread, jac, optimize=True)
    noise = np.broadcast_to(body.noise.senses.get(name, (1.0,) * mean.shape[1]), mean.shape)
    noise = noise if seen.std is None else np.where(np.isfinite(seen.std), seen.std**2, noise)
    np.einsum("fdd->fd", cov)[:] += var + noise
    return mean, cov


def _interpolate_angles(estimate: Estimate, t: Array) -> tuple[Array, Array]:
    """Angles (F,M) rad and their covariance (F,M,M) at t (F,), by the past alone unless the
    estimate knew the future.

    The last belief is carried on by its rate; what that
    rate is uncertain by within one step is left out.
    """
    joints = estimate.joints
    after = np.minimum(np.searchsorted(joints.t, t), len(joints.t) - 1)
    last = np.maximum(np.searchsorted(joints.t, t, "right") - 1, 0)
    if not estimate.can.causal:
        x = np.stack([np.interp(t, joints.t, column) for column in joints.values.T], axis=1)
        return x, estimate.cov[np.where(t - joints.t[last] < joints.t[after] - t, last, after)]
    since = np.maximum(t - joints.t[last], 0.0) * estimate.can.moves
    return joints.values[last] + since[:, None] * estimate.rate.values[last], estimate.cov[last]
