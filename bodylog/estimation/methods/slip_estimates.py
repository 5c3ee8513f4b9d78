"""Estimates of arms whose joints stick and slip: where readings show the slips,
and where slips explain a log better than a smooth motion.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...settings import EstimationSettings
from ...types import Array, Estimate, Fault, FaultKind
from ..factors.whole_log import LEARNED_S
from ..faults.encoder_offset import list_drifting_encoders
from ..faults.jumping import SURE_SLIPS
from ..faults.threshold import EVIDENCE_THRESHOLD_NATS, SIGNIFICANT_SIGMA
from ..inference.filter_problem import FilterProblem
from ..inference.reacquisition import LONG_SILENCE_S
from ..measurements.long_arrays import measure_median_step
from ..measurements.records import Encoders, interpolate_values
from ..noise.quantisation import weigh_as_one
from . import results
from .results import Beliefs
from .stick_slip import (
    REFINING_FACTORS,
    TRIED_SLIPS,
    SlipBelief,
    StickSlip,
    follow_slips,
    learn_image_noise,
    learn_slips,
    list_evident_slips,
    smooth_slips,
    sticks_and_slips,
)
from .trust import MOST_MISFIT, RoughMotion


@dataclass(frozen=True, eq=False)
class FollowedSlips:
    """A problem whose joints stick and slip, the factor on the variance of
    each sighting's images, and the beliefs at all its instants.
    """

    problem: FilterProblem
    slips: StickSlip
    scales: Sequence[float]
    belief: SlipBelief


def estimate_evident_slips(problem: FilterProblem, settings: EstimationSettings) -> Estimate | None:
    """The estimate with joints that stick and slip, where readings show that some do; else None.

    A smooth motion would lose such an arm: it rejects all readings after a slip of many times their
    noise. Where images are not where they are expected, one encoder may be off: the one without
    which all images are. Rates are means over LONG_SILENCE_S.
    """
    if settings.precision != "auto" or settings.bias != "auto" or problem.posture_prior is not None:
        return None
    encoders = problem.evidence.encoders
    sighted = any(one.name != "touch" for one in problem.evidence.sightings)
    fewest = 1 if sighted else SURE_SLIPS
    if encoders is None or max(map(len, list_evident_slips(encoders))) < fewest:
        return None
    learned = _learn_sticking(
        replace(problem, precision=replace(problem.precision, drift=None)), settings
    )
    if learned is None:
        return None
    if sighted:
        learned = (_weigh_repaired_readings(*learned), learned[1])
    found = _follow_without_encoders(*learned, ())
    if sighted and not _expects_images(found):
        tried = {j: _follow_without_encoders(*learned, (j,)) for j in range(len(problem.start))}
        nats = {j: one.belief.image_nats.sum() for j, one in tried.items() if _expects_images(one)}
        if nats:
            off = min(nats, key=lambda joint: nats[joint])
            near = (j for j in nats if j != off and nats[j] - nats[off] < EVIDENCE_THRESHOLD_NATS)
            chosen = _with_hindsight(tried[off], settings)
            faults = _name_offset(learned[0], chosen, off, near)
            return _build_slip_estimate(chosen, settings, faults)
        # images are outliers, or the camera moved, which checks of the estimate say
    return _build_slip_estimate(_with_hindsight(found, settings), settings)


def _weigh_repaired_readings(problem: FilterProblem, slips: StickSlip) -> FilterProblem:
    """The problem with readings out of which a jump was taken: its size is known to its standard
    deviation, and all of them together tell that once.
    """
    encoders = problem.evidence.encoders
    assert encoders is not None  # joints stick by what they read
    weights = encoders.relative_variance.copy()
    for fault in problem.evidence.faults:
        if fault.kind == FaultKind.JUMPING and fault.std and fault.name in problem.evidence.joints:
            joint = problem.evidence.joints.index(fault.name)
            wrong = (encoders.t >= fault.since) & (encoders.t < fault.end)
            weights[wrong, joint] += wrong.sum() * fault.std**2 / slips.white[joint]
    encoders = replace(encoders, own_variance=weights)
    return replace(problem, evidence=replace(problem.evidence, encoders=encoders))


def _follow_without_encoders(
    problem: FilterProblem, slips: StickSlip, left_out: Sequence[int]
) -> FollowedSlips:
    """The filtered beliefs without the readings of these joints."""
    encoders = problem.evidence.encoders
    assert encoders is not None  # joints stick by what they read
    values = encoders.values.copy()
    values[:, list(left_out)] = np.nan
    evidence = replace(problem.evidence, encoders=replace(encoders, values=values))
    problem = replace(problem, evidence=evidence)
    scales, belief = learn_image_noise(problem, slips, range(len(problem.timeline.t)))
    return FollowedSlips(problem, slips, scales, belief)


def _with_hindsight(found: FollowedSlips, settings: EstimationSettings) -> FollowedSlips:
    """The beliefs by the whole log for the smoother; those of the filter as they are."""
    if settings.method != "smoother":
        return found
    belief = smooth_slips(found.problem, found.slips, found.scales, found.belief)
    return replace(found, belief=belief)


def _expects_images(found: FollowedSlips) -> bool:
    """Whether images are where they are expected; true of a log without any."""
    sightings = found.problem.evidence.sightings
    for sighting, at, scale in zip(
        sightings, found.problem.timeline.sightings, found.scales, strict=True
    ):
        belief = found.belief
        place = results.predict_frames(sighting, belief.before[at], belief.before_cov[at])
        errors = results.standardise_sighting(sighting, place, scale)[0].values
        cut = np.clip(errors, -SIGNIFICANT_SIGMA, SIGNIFICANT_SIGMA)
        if cut.size and np.mean(np.square(cut)) > MOST_MISFIT:
            return False
    return True


def _name_offset(
    problem: FilterProblem, found: FollowedSlips, joint: int, near: Iterable[int]
) -> tuple[Fault, ...]:
    """The offset of a joint's readings from these beliefs, which are without them, as a fault, if
    it is one; near: joints whose offset explains the log nearly as well.
    """
    encoders = problem.evidence.encoders
    assert encoders is not None  # they are off
    t = problem.timeline.t
    angles = interpolate_values(t, found.belief.mean, encoders.t)[:, joint]
    offset = np.zeros(found.belief.mean.shape)
    offset[:, joint] = np.interp(t, encoders.t, encoders.values[:, joint] - angles)
    var = np.einsum("emm->em", found.belief.cov) + found.slips.white
    drift = np.eye(len(problem.start))[joint]
    walking = replace(
        problem,
        precision=replace(problem.precision, drift=drift),
        alternatives={joint: tuple(near)},
    )
    return list_drifting_encoders(walking, offset, var)


def _build_slip_estimate(
    found: FollowedSlips, settings: EstimationSettings, faults: tuple[Fault, ...] = ()
) -> Estimate:
    """The estimate of these beliefs."""
    problem = found.problem
    belief = found.belief
    names = (one.name for one in problem.evidence.sightings)
    scale = dict(zip(names, found.scales, strict=True))
    precision = replace(problem.precision, encoder=found.slips.white, scale=scale)
    rates = _measure_rates(problem.timeline.t, belief.mean, settings)
    beliefs = Beliefs(
        z=np.concatenate([belief.mean, rates], axis=1),
        cov=belief.cov,
        nats=belief.nats,
        before=belief.before,
        before_cov=belief.before_cov,
        encoder_errors=belief.errors,
        scale=scale,
        settings=precision.plain_numbers(),
        faults=faults,
    )
    return _describe_slips(problem, found.slips, beliefs, settings)


def _measure_rates(t: Array, angles: Array, settings: EstimationSettings) -> Array:
    """Rates (E,M) rad/s of angles (E,M) at t (E,) s over the last LONG_SILENCE_S, or over as long
    about each instant for the smoother.
    """
    ahead = 0.5 * LONG_SILENCE_S if settings.method == "smoother" else 0.0
    end = np.minimum(t + ahead, t[-1])
    begin = np.maximum(end - LONG_SILENCE_S, t[0])
    moved = interpolate_values(t, angles, end) - interpolate_values(t, angles, begin)
    lasting = np.maximum(end - begin, measure_median_step(t))
    return np.asarray(moved / lasting[:, None])


def estimate_stick_slip(
    problem: FilterProblem, beliefs: Beliefs, settings: EstimationSettings, rough: RoughMotion
) -> Estimate | None:
    """The estimate with joints that stick and slip, where it predicts images, or all
    measurements, by EVIDENCE_THRESHOLD_NATS better than a smooth motion, and images are where it
    expects them; else None.

    Rates are those of the smooth motion.
    """
    if problem.stepwise:
        return None
    learned = _learn_sticking(problem, settings)
    if learned is None:
        return None
    problem, slips = learned
    t = problem.timeline.t
    early = range(int(np.searchsorted(t, t[0] + LEARNED_S, "right")))
    scales, first = learn_image_noise(problem, slips, early)
    judged = rough.at < len(early)
    images = first.image_nats[np.unique(rough.at[judged])]
    gains = (
        float(rough.image_nats[judged].sum() - images.sum()),
        float(rough.nats[: len(early)].sum() - first.nats.sum()),
    )
    if max(gains) <= EVIDENCE_THRESHOLD_NATS:
        return None
    found = follow_slips(problem, slips, scales, range(len(t)))
    # a joint whose encoder died would stay at its last reading
    if not _expects_images(FollowedSlips(problem, slips, scales, found)):
        return None
    if settings.method == "smoother":
        found = smooth_slips(problem, slips, scales, found)
    z = beliefs.z.copy()
    z[:, : found.mean.shape[1]] = found.mean
    explained = replace(
        beliefs,
        z=z,
        cov=found.cov,
        nats=found.nats,
        before=found.before,
        before_cov=found.before_cov,
        encoder_errors=found.errors,
        places=(),
    )
    return _describe_slips(problem, slips, explained, settings)


def _learn_sticking(
    problem: FilterProblem, settings: EstimationSettings
) -> tuple[FilterProblem, StickSlip] | None:
    """The problem with its counts weighed, and its slips, where joints may stick; else None."""
    if settings.hardware_errors == "widen" or settings.typed or settings.motion != "auto":
        return None
    encoders = problem.evidence.encoders
    if encoders is None or problem.precision.drift is not None:
        return None
    encoders = _weigh_counts(encoders)
    problem = replace(problem, evidence=replace(problem.evidence, encoders=encoders))
    slips = learn_slips(encoders, problem.precision.encoder)
    return (problem, slips) if sticks_and_slips(encoders, slips) else None


def _describe_slips(
    problem: FilterProblem, slips: StickSlip, beliefs: Beliefs, settings: EstimationSettings
) -> Estimate:
    """The estimate of these beliefs, and how far joints slip."""
    made = results.build_estimate(settings.method, problem.evidence, problem.timeline, beliefs)
    # the least rate is that of joints that did not slip
    least = 1.001 * TRIED_SLIPS[2][0] / np.prod(REFINING_FACTORS)
    slipping = (slips.rate > least) if (slips.rate > least).any() else slips.size > 0.0
    joints = zip(problem.evidence.joints, slips.size.tolist(), slipping.tolist(), strict=True)
    sizes = {name: size for name, size, slipped in joints if slipped}
    errors = {"play": {}, "lasting": None, "load": None, "late": {}, "gains": {}, "slips": sizes}
    each = ", ".join(f"{name} {np.rad2deg(size):.2g}°" for name, size in sizes.items())
    text = f"joints stick and slip, by about {each} at once: angles follow the readings"
    return results.with_hardware_errors(made, errors, text)


def _weigh_counts(encoders: Encoders) -> Encoders:
    """The encoders with all readings of one count as one reading: a joint that stands still for
    long is known no better, as no process noise makes a belief forget.
    """
    return encoders.weigh_joints(lambda t, y, _: weigh_as_one(t, y))
