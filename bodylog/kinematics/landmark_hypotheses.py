"""Which single change since earlier logs explains a log's
landmarks: one joint's zero, a moved camera, or none.

One fit with every joint free gives the log's information on φ, as a
Gaussian. Each hypothesis is a prior of φ: the belief of earlier logs,
widened along what it frees. Evidence and posterior follow in closed form:

    ln Z_h = ½ ln |Λ_h| − ½ ln |Λ_h + D| + ½ (b + Λ_h m)ᵀ (Λ_h + D)⁻¹ (b + Λ_h m) − ½ mᵀ Λ_h m
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..types import Array
from .landmarks import MOVED_STD, LandmarkBelief, LandmarkModel

OFFSET_STD = 0.1
"""rad (m: a tenth): prior std of an offset that a faulty joint has; 5.7°."""
CAMERA = "camera"
"""Name of the hypothesis that the camera moved."""
SOUND = ""
"""Name of the hypothesis that nothing changed."""


@dataclass(frozen=True, eq=False)
class Information:
    """What one log tells of φ: precision (P,P), and precision times estimate (P,)."""

    precision: Array
    pull: Array


@dataclass(frozen=True)
class ChangeHypothesis:
    """A hypothesis: its ln evidence, nats, and of a joint
    its offset δ ± std, rad or m, with its prior std.
    """

    name: str
    nats: float
    value: float = 0.0
    std: float = 0.0
    beforehand: float = 0.0


def widen_zero_belief(
    model: LandmarkModel, belief: LandmarkBelief, camera_may_move: bool = False
) -> LandmarkModel:
    """The model with a belief in which every joint may be off, and the camera moved if it may."""
    variance = np.zeros(len(belief.mean))
    for index, std in _offset_stds(model).values():
        variance[index] = std**2
    if camera_may_move:
        variance[_of_camera(model)] = MOVED_STD**2
    return replace(model, belief=LandmarkBelief(belief.mean, belief.covariance + np.diag(variance)))


def _of_camera(model: LandmarkModel) -> slice:
    """Where in φ a camera shows that it moved."""
    return model.of_camera_change if model.changes else slice(6)


def _offset_stds(model: LandmarkModel) -> Mapping[str, tuple[int, float]]:
    """The index in φ of each joint's zero, and the prior std of an offset."""
    begin = (model.of_changes if model.changes else model.rig.of_joints).start
    return {
        joint: (begin + m, OFFSET_STD * (0.1 if model.rig.slides(m) else 1.0))
        for m, joint in enumerate(model.rig.joints)
    }


def information_of_log(model: LandmarkModel, phi: Array, covariance: Array) -> Information:
    """What the log alone tells, from a posterior φ
    (P,) ± covariance (P,P) and the model's belief.
    """
    assert model.belief is not None
    std = model.prior[1]
    posterior = np.linalg.inv(covariance / std / std[:, None])
    prior = np.linalg.inv(model.belief.covariance / std / std[:, None])
    values, vectors = np.linalg.eigh(posterior - prior)
    log_information = vectors * np.maximum(values, 0.0) @ vectors.T
    pull = log_information @ (phi / std) + prior @ ((phi - model.belief.mean) / std)
    return Information(log_information / std / std[:, None], pull / std)


def weigh_hypotheses(
    model: LandmarkModel,
    belief: LandmarkBelief,
    evidence: Information,
    camera_may_move: bool = True,
) -> list[ChangeHypothesis]:
    """Every hypothesis with its evidence, the sound one first."""
    count = len(belief.mean)
    found = [_weigh_hypothesis(SOUND, belief, evidence, np.zeros(count), None)]
    for joint, (index, std) in _offset_stds(model).items():
        added = std**2 * (np.arange(count) == index)
        found.append(_weigh_hypothesis(joint, belief, evidence, added, index))
    if camera_may_move:
        added = np.zeros(count)
        added[_of_camera(model)] = MOVED_STD**2
        found.append(_weigh_hypothesis(CAMERA, belief, evidence, added, None))
    return found


def _weigh_hypothesis(
    name: str, belief: LandmarkBelief, evidence: Information, added: Array, index: int | None
) -> ChangeHypothesis:
    """One hypothesis, whose prior has the variances
    `added` (P,) more; its offset at `index` of φ.
    """
    std = np.sqrt(np.diag(belief.covariance) + added)
    covariance = (belief.covariance + np.diag(added)) / std / std[:, None]
    mean = belief.mean / std
    prior = np.linalg.inv(covariance)
    precision = prior + evidence.precision * std * std[:, None]
    # relative to the prior's mean, so that no large numbers cancel
    pull = evidence.pull * std - (evidence.precision * std * std[:, None]) @ mean
    beyond = np.linalg.solve(precision, pull)
    nats = -0.5 * (
        np.linalg.slogdet(precision)[1] + np.linalg.slogdet(covariance)[1]
    ) + 0.5 * float(pull @ beyond)
    if index is None:
        return ChangeHypothesis(name, float(nats))
    variance = float(added[index])
    share = prior[index] / std[index]
    value = variance * float(share @ beyond)
    spread = (
        float(share @ np.linalg.solve(precision, share))
        - float(prior[index, index]) / float(std[index]) ** 2
    )
    left = max(variance + variance**2 * spread, 0.0)
    return ChangeHypothesis(
        name, float(nats), value, float(np.sqrt(left)), float(np.sqrt(variance))
    )


def join_changes(
    logs: Sequence[Sequence[ChangeHypothesis]], learned_from: int, margin: float
) -> list[ChangeHypothesis]:
    """The hypotheses of several logs with one change in common, the sound one first, from those of
    each log, the sound one first.

    learned_from: the number of logs behind the belief. Its own error is in every log alike: of a
    log's variance the share 1 / (learned_from + 1), as its logs tell as much as this one each. A
    joint of which offsets of its own in some logs win `margin` nats has their evidence, and no
    offset in common. The camera's evidence is the product of that of the logs in which it may have
    moved, as if it had moved differently in each: a lower bound.
    """
    gains = dict[str, list[float]]()
    offsets = dict[str, list[ChangeHypothesis]]()
    for changes in logs:
        for one in changes[1:]:
            gains.setdefault(one.name, []).append(one.nats - changes[0].nats)
            if one.beforehand:
                offsets.setdefault(one.name, []).append(one)
    return [
        ChangeHypothesis(SOUND, 0.0),
        *(
            _join_offsets(offsets[name], np.array(own), learned_from, margin)
            if name in offsets
            else ChangeHypothesis(name, sum(own))
            for name, own in gains.items()
        ),
    ]


def _join_offsets(
    logs: Sequence[ChangeHypothesis], gains: Array, learned_from: int, margin: float
) -> ChangeHypothesis:
    """One offset in all logs, or one each in those with gains (L,) > 0."""
    prior = logs[0].beforehand ** 2
    posterior = np.array([one.std**2 for one in logs])
    variance = 1.0 / np.maximum(1.0 / posterior - 1.0 / prior, 1e-6 / prior)
    measured = np.array([one.value for one in logs]) / posterior * variance
    share = 1.0 / (learned_from + 1.0)
    own = (1.0 - share) * variance
    body = np.sqrt(share * variance)[:, None]
    ones = np.ones((len(logs), 1))
    sound = _ln_density(measured, own, body)
    nats = _ln_density(measured, own, np.hstack([body, np.sqrt(prior) * ones])) - sound
    apart = _ln_density(measured, own + prior * (gains > 0.0), body) - sound
    weights = _solve_low_rank(ones, own, body)[:, 0]
    precision = 1.0 / prior + float(weights.sum())
    common = apart - nats < margin
    return ChangeHypothesis(
        logs[0].name,
        nats if common else apart,
        float(weights @ measured) / precision if common else 0.0,
        precision**-0.5,
        logs[0].beforehand,
    )


def _ln_density(measured: Array, own: Array, factors: Array) -> float:
    """Logarithm of a normal density about 0, less its constant, with the covariance
    diag(own) + U Uᵀ of own (L,) and factors U (L,R): time grows with L alone.
    """
    small = np.eye(factors.shape[1]) + factors.T @ (factors / own[:, None])
    square = measured @ _solve_low_rank(measured[:, None], own, factors)[:, 0]
    return float(-0.5 * (np.log(own).sum() + np.linalg.slogdet(small)[1] + square))


def _solve_low_rank(right: Array, own: Array, factors: Array) -> Array:
    """(diag(own) + U Uᵀ)⁻¹ right (L,C), of own (L,) and factors U (L,R), by Woodbury's identity."""
    scaled = factors / own[:, None]
    small = np.eye(factors.shape[1]) + factors.T @ scaled
    return np.asarray(right / own[:, None] - scaled @ np.linalg.solve(small, scaled.T @ right))
