"""Whether a touch that is felt and a stroke that is seen have one cause, by where they are (Körding
et al. 2007).

With one cause the hand is seen where the skin is touched. By the belief x̂, P of all other senses
its place has the density N(g_v(x̂), J P Jᵀ + σ² I). With two causes it is anywhere in the image.
Samad et al. (2015) explain the rubber hand so.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..body_model import BodyModel, ForwardModel
from ..errors import UsageError
from ..settings import EstimationSettings
from ..types import Array, Estimate, Features, Synchrony
from .measurements.long_arrays import find_finite_rows
from .measurements.records import interpolate_values
from .measurements.touch import find_cell_place


def infer_common_causes(
    features: Features,
    body: BodyModel,
    settings: EstimationSettings,
    prior: float,
    solve: Callable[[Features, EstimationSettings], Estimate],
) -> Features:
    """The features with each pair's probability of a common
    cause; unchanged without touches.

    prior: probability of a common cause before place is known ·
    solve: the estimate that is made without touch. UsageError where touch is the only sense, or the
    image's size, over which a hand of another cause is spread, is not known.
    """
    if not features.synchrony or features.hand is None:
        return features
    if features.picture_size is None:
        raise UsageError(
            "common_cause: the log has no images, so their size is not known; leave "
            "common_cause out of [estimate]"
        )
    alone = solve(features, _remove_touch(settings))
    pairs = []
    for pair in features.synchrony:
        densities = _compute_cause_densities(features, body, alone, pair)
        posterior = compute_common_cause_posterior(prior, *densities)
        pairs.append(replace(pair, common_cause=posterior))
    return replace(features, synchrony=tuple(pairs))


def _remove_touch(settings: EstimationSettings) -> EstimationSettings:
    """The settings with every other sense."""
    if settings.senses is None:
        return replace(settings, without=(*settings.without, "touch"), common_cause=None)
    senses = tuple(name for name in settings.senses if name != "touch")
    if not senses:
        raise UsageError(
            "common_cause: touch is the only sense, and nothing is left to compare it with; "
            "type --with encoders,touch"
        )
    return replace(settings, senses=senses, common_cause=None)


def compute_common_cause_posterior(prior: float, one_cause: float, two_causes: float) -> float:
    """Probability of a common cause, by Bayes' rule from
    its prior and the densities of either explanation.
    """
    both = prior * one_cause + (1.0 - prior) * two_causes
    return float(prior * one_cause / both) if both > 0.0 else 0.0


def _compute_cause_densities(
    features: Features, body: BodyModel, alone: Estimate, pair: Synchrony
) -> tuple[float, float]:
    """Densities (1/px²) of where the hand is seen during a touch: with one cause, and with two."""
    assert (
        features.hand is not None
        and features.picture_size is not None
        and features.touches is not None
    )
    touch = features.touches[pair.touch]
    hand = features.hand
    width, height = features.picture_size
    during = find_finite_rows(hand.values) & (hand.t >= touch.onset) & (hand.t <= touch.offset)
    if pair.stroke is None or not during.any():
        return 0.0, 1.0 / (width * height)
    u, v, spread_variance = find_cell_place(body, touch.strongest)
    x, cov = _read_belief_at(alone, body.joints, hand.t[during])
    mean, variance = _predict_effector_place(body.senses["effector"], x, cov)
    off = (hand.values[during] - (u, v)).mean(axis=0) - mean
    total = variance + spread_variance * np.eye(2)
    density = np.exp(-0.5 * off @ np.linalg.solve(total, off)) / (
        2.0 * np.pi * np.sqrt(np.linalg.det(total))
    )
    return float(density), 1.0 / (width * height)


def _read_belief_at(alone: Estimate, joints: tuple[str, ...], t: Array) -> tuple[Array, Array]:
    """Angles (K,M) rad at times t (K,) s, and their
    covariance (M,M) rad² in the middle of these.
    """
    columns = [alone.joints.names.index(name) for name in joints]
    x = interpolate_values(alone.joints.t, alone.joints.values[:, columns], t)
    middle = int(np.argmin(np.abs(alone.joints.t - np.median(t))))
    return x, alone.cov[middle][np.ix_(columns, columns)]


def _predict_effector_place(model: ForwardModel, x: Array, cov: Array) -> tuple[Array, Array]:
    """Mean place (2,) px over angles x (K,M), and its
    covariance (2,2) px², the model's own included.
    """
    mean, jac, own = model.predict(x)
    slope = jac.mean(axis=0)
    return mean.mean(axis=0), slope @ cov @ slope.T + np.diag(own.mean(axis=0))
