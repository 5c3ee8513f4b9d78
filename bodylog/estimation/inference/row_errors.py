"""Correlated errors of a track's images: a state e per row that decorrelates as the arm moves.

Errors of the body model correlate between postures within its reach, and those of perception between places within
the same pixel. e = L u with L Lᵀ their covariance and unit states u, u' = κ u + √(1 − κ²) w.
"""

from dataclasses import dataclass

import numpy as np

from ...types import Array

FADE = 0.5
"""Decorrelation of the model's errors: κ = exp(−FADE d), with d the postures' distance in reaches."""
NEAR = 0.5
"""px: correlation length of perception's error, which has the period of the pixels."""
WHITE = 0.02
"""Share of perception's variance that is independent in every image."""
ALIKE = 0.7
"""Share of a model's variance from the exploring encoders, which is common to all rows of all tracks."""
STILL = 1e-5
"""Least 1 − κ."""


@dataclass(frozen=True, eq=False)
class Looks:
    """One track's F images about points (M,F): y (D,F), J (D,M,F), perception's variance (D,F), the model's (D,F).

    reach (M,) rad: distance of joint angles within which the model's errors correlate.
    """

    y: Array
    jac: Array
    pixel: Array
    model: Array
    points: Array
    reach: Array


def kappa(looks: Looks) -> Array:
    """Share (D,F−1) of each row's error that is left from one image to the next."""
    steps = np.diff(looks.points, axis=1) / looks.reach[:, None]
    posture = np.exp(-FADE * np.sqrt(np.square(steps).sum(axis=0)))
    place = np.exp(-np.sqrt(np.square(np.diff(looks.y, axis=1)).sum(axis=0)) / NEAR)
    share = (looks.model / (looks.model + looks.pixel))[:, 1:]
    return np.asarray(np.minimum(share * posture + (1.0 - share) * place, 1.0 - STILL))


def reads(before: list[Looks], own: Looks, encoder: Array) -> Array:
    """L's rows (D,N,F) of a track; `before`: the tracks before it, as in their last images.

    encoder (M,): variances of the exploring encoders.
    """
    seen = [*before, own]
    jac, model = np.concatenate([one.jac for one in seen]), np.concatenate([one.model for one in seen])
    total = model + np.concatenate([(1.0 - WHITE) * one.pixel for one in seen])
    weighed = jac * encoder[None, :, None]
    own_var = np.sqrt(np.maximum((weighed * jac).sum(axis=1), np.finfo(float).tiny))
    lean = jac * (np.sqrt(model) / own_var)[:, None]
    covariance = ALIKE * np.einsum("rmf,smf->rsf", lean * encoder[None, :, None], lean)
    np.einsum("rrf->rf", covariance)[:] = total
    return lower(covariance)[-len(own.y) :]


def lower(a: Array) -> Array:
    """Cholesky factors (n,n,F) of symmetric positive definite matrices."""
    a = a.copy()
    for k in range(len(a)):
        a[k, k] = np.sqrt(np.maximum(a[k, k], np.finfo(float).tiny))
        a[k + 1 :, k] /= a[k, k]
        a[k, k + 1 :] = 0.0
        for j in range(k + 1, len(a)):
            a[j:, j] -= a[j:, k] * a[j, k]
    return a
