"""Noise models by evidence: the order of motion by encoders,
and variances by the whole filter, images included.

Process variances of a smoother with the least squared error, rather than the greatest evidence.

The evidence covers motion up to the smoother's cut-off frequency. Arms move more
smoothly than white noise in derivative n, so the evidence prefers a large q, which lets
more noise pass than necessary. How far the path moves with q shows what motion adds to
the error near the cut-off. Noise makes 1 − 1/2n of a steady variance V, and grows as
q^(1/2n). For angles with spectrum ω^−p, motion adds an error that falls as q^(−(p −
1)/2n). The sum is least where the latter is 1/(p − 1) of the former. p is 2n for white
noise and 8 for minimum-jerk reaches (Flash & Hogan 1985); the rate at which moves fall
with q shows it. Beyond 2n + 2 the error hardly falls, so q stays at its value there.
The stated share of V is that of noise and motion where their sum is least, (1 − 1/2n)
p/(p − 1).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...motion import WHITE_JERK
from ...types import Array, Hypothesis
from ..faults.threshold import EVIDENCE_THRESHOLD_NATS
from ..inference.filter_log import filter_roughly
from ..inference.filter_pass import (
    MAX_SWEEPS,
    FilterReadings,
    FilterTrace,
    TraceDetail,
    filter_readings,
)
from ..inference.filter_problem import FilterProblem
from ..inference.reacquisition import find_joints_left_open, find_silent_joints
from ..inference.solution import Solution, smooth_states
from ..inference.tangents import build_state_prior
from ..measurements.long_arrays import find_finite_rows, measure_median_step
from ..measurements.records import Encoders, Sighting
from ..measurements.timeline import (
    GAP_STEPS,
    View,
    build_timeline,
    list_track_sets,
    select_visual_sightings,
)
from .correlated_noise import compute_steady_variance
from .encoder_noise import (
    MAX_INSTANTS,
    SKIPPED_READINGS,
    average_close_readings,
    compute_least_process,
    count_readings_per_average,
    find_followable_process,
)
from .noise_model import NoiseModel


def find_least_error_process(part: FilterProblem, solved: Solution) -> tuple[Array, float]:
    """Process variances (M,) of least error, as one
    factor on the problem's, and this error's share of V.

    `solved`: the solution of the filter.
    """
    order = part.precision.order
    step = 2.0 ** (0.5 * order)  # moves the cut-off by 2^¼
    factors = step ** np.arange(-6.0, 5.0)
    present = _find_times_outside_gaps(part, part.timeline.t)
    paths = _smooth_candidates(part, solved, factors)
    moved = np.square(np.diff(paths, axis=0))[:, present].mean(axis=1)
    # noise's share of it grows as q^(1/2n)
    noise = moved[-1] * (factors[:-1] / factors[-2])[:, None] ** (0.5 / order)
    ratios = (moved / np.maximum(noise, np.finfo(float).tiny)).mean(axis=1)
    power = _fit_motion_power(ratios, step, order)
    over = np.log(np.maximum(ratios, np.finfo(float).tiny) / compute_least_move(power, order))
    last = int(np.flatnonzero(over > 0.0).max(initial=-1))
    beyond = 0.5 + over[last] / (over[last] - over[last + 1]) if last >= 0 else 0.0
    factor = factors[max(last, 0)] * step**beyond
    share = _compute_noise_share(part) * power / (power - 1.0)
    return np.asarray(part.precision.process * factor), share


def compute_least_move(power: float, order: int) -> float:
    """How far the path moves with ln q at the least error,
    squared, over that by noise; motion's spectrum is ω^−power.

    By the smoother's response 1 / (1 + u²ⁿ), u the frequency
    over the cut-off, which moves by u²ⁿ / (1 + u²ⁿ)².
    """
    return (min(power, 2.0 * order + 2.0) + 4.0 * order) / (2.0 * order + 1.0)


def _compute_noise_share(part: FilterProblem) -> float:
    """Share of V that noise makes."""
    return 1.0 - 0.5 / part.precision.order


def _find_times_outside_gaps(part: FilterProblem, t: Array) -> Array:
    """Times t (E,) s outside long silences of an encoder, in which a path moves far with q."""
    encoders = part.evidence.encoders
    known = np.empty(0) if encoders is None else encoders.t[find_finite_rows(encoders.values)]
    if len(known) < 2:
        return np.ones(len(t), bool)
    steps = np.diff(known)
    quick = np.concatenate([[True], steps <= GAP_STEPS * np.median(steps), [True]])
    return quick[np.searchsorted(known, t)]


def _fit_motion_power(ratios: Array, step: float, order: int) -> float:
    """p, from the rate at which moves over those of noise,
    1 + b q^(−p/2n), fall; ratios (10,), a step of q apart.
    """
    large = np.flatnonzero(ratios > compute_least_move(2.0 * order, order))
    last = max(int(large.max(initial=0)), 2)
    before, after = ratios[[last - 2, last]] - 1.0
    if after <= 0.0 or before <= after:
        return 2.0 * order + 4.0
    rate = np.log(before / after) / (2.0 * np.log(step))
    return float(np.clip(2.0 * order * rate, 2.0 * order, 2.0 * order + 4.0))


def _smooth_candidates(part: FilterProblem, solved: Solution, factors: Array) -> Array:
    """Smoothed angles (G,E,M) for each factor, with the tangents of `solved`."""
    m = len(part.start)
    start = build_state_prior(part.start, part.dynamics)
    solved.tangents.write_stale_tangents(part, solved.readings)
    trace = None
    paths = []
    for process in factors[:, None] * part.precision.process:
        precision = replace(part.precision, process=process, stated=_compute_noise_share(part))
        posed = replace(part, precision=precision)
        var = solved.tangents.compute_smoother_variances(posed, solved.readings)
        readings = replace(solved.readings, var=var)
        trace = filter_readings(readings, posed.dynamics, *start, TraceDetail.MEANS, trace)
        paths.append(smooth_states(readings, trace, posed.dynamics)[0][:, :m])
    return np.stack(paths)


def with_preferred_order(problem: FilterProblem) -> FilterProblem:
    """The problem with white jerk where the encoders'
    evidence prefers it, if its noise is learned from the log.

    Also where images leave silent joints open, unless the evidence is surely against it: over
    seconds accelerations last, which a log's readings, hundredths of a second apart, may not show.
    Where images determine all silent joints these keep white acceleration.
    """
    encoders = problem.evidence.encoders
    learned = problem.precision.learned
    unread = problem.posture_prior is not None
    if (
        encoders is None
        or learned is None
        or unread
        or (np.isfinite(encoders.values).sum(axis=0) <= SKIPPED_READINGS).any()
    ):
        return problem
    lasting = bool(find_joints_left_open(problem.timeline.t, problem.evidence).any())
    if not lasting and find_silent_joints(problem.timeline.t, problem.evidence).any():
        return problem
    white, jerk = learned
    nats = jerk.evidence - white.evidence
    # both motions have one parameter per joint, so neither is the simpler one
    threshold = -EVIDENCE_THRESHOLD_NATS * len(encoders.values.T) if lasting else 0.0
    order = Hypothesis("white jerk", "joints", nats, threshold, bool(nats > threshold))
    evidence = replace(problem.evidence, hypotheses=(*problem.evidence.hypotheses, order))
    problem = replace(problem, evidence=evidence)
    return with_motion(problem, WHITE_JERK) if order.chosen else problem


def with_motion(problem: FilterProblem, name: str) -> FilterProblem:
    """The problem with a motion model of the table, and the noise that encoders give for white
    noise of its order, where it is learned from the log.
    """
    precision = replace(problem.precision, motion=name)
    encoders = problem.evidence.encoders
    if encoders is not None and precision.learned is not None:
        learned = precision.learned[precision.order - 2]
        precision = replace(precision, encoder=learned.encoder)
        precision = precision.with_memory_bound(learned.process, encoders)
    return replace(problem, precision=precision)


def tune_by_evidence(problem: FilterProblem, whole: bool) -> tuple[NoiseModel, Solution | None]:
    """Process variances and pixel factors from (the middle
    of) the log, for a smoother (`whole`) or a filter.

    Also the last solution as a warm start, if it covers the whole log.
    """
    one_process = replace(problem, precision=replace(problem.precision, process_by_view={}))
    log = cut_to_middle(drop_undetermined_images(one_process))
    part = thin_encoder_readings(log)
    names = [
        s.name
        for s in part.evidence.sightings
        if s.name != "touch" and find_finite_rows(s.values).sum() > SKIPPED_READINGS
    ]
    if not names and not whole:
        return problem.precision, None
    part, solved = _maximise_evidence(part, names)
    warm = solved if part.timeline is problem.timeline else None
    own = _tune_filter_noise(problem, part, solved)
    if whole:
        precision = _tune_smoother_noise(part, solved, log.evidence.encoders)
        return replace(precision, filter_process=own.process), warm
    process_by_view = {
        view: _tune_filter_noise(problem, *_restrict_to_view(part, view)).process
        for view in _list_partial_views(problem)
    }
    return replace(own, process_by_view=process_by_view), warm


def _maximise_evidence(part: FilterProblem, names: list[str]) -> tuple[FilterProblem, Solution]:
    """The problem with the process variances and the named tracks' pixel factors of most evidence,
    and the filter's last solution.

    Rounds of steps to the greatest evidence end when all are within a standard deviation of it; a
    parabola is as wide as before until its minimum is near.
    """
    solved = filter_roughly(part)
    half = np.ones(len(part.start) + len(names))
    for _ in range(MAX_SWEEPS if names else 0):
        logs = _take_log_parameters(part, names)
        candidates = np.concatenate([logs[None], logs + np.diag(half), logs - np.diag(half)])
        nats, solved = compute_candidate_costs(part, solved, np.exp(candidates), names)
        step, std = _step_to_parabola_minimum(nats, half)
        part = replace(part, precision=_set_noise_values(part, np.exp(logs + step), names))
        if (np.abs(_take_log_parameters(part, names) - logs) <= std).all():
            break
        half = np.where(np.abs(step) < 2.0 * half, np.minimum(half, std), half)
    return part, solved


def _list_partial_views(problem: FilterProblem) -> list[View]:
    """Sets of tracks in view at times when not all are, if encoders still determine the arm."""
    usual = tuple(s.name for s in select_visual_sightings(problem.evidence.sightings))
    if problem.path or problem.precision.order > 2:
        return []
    return [
        v for v in list_track_sets(problem.evidence.sightings, problem.timeline.t)[0] if v != usual
    ]


def _restrict_to_view(part: FilterProblem, view: View) -> tuple[FilterProblem, Solution]:
    """The part with only these of its tracks, and its solution."""
    less = _replace_measurements(
        part, part.evidence.encoders, [s for s in part.evidence.sightings if s.name in view]
    )
    return less, filter_roughly(less)


def _tune_smoother_noise(
    part: FilterProblem, solved: Solution, encoders: Encoders | None
) -> NoiseModel:
    """A smoother's noise model, whose forward pass stays
    within the gate, with the share of its covariance to state.
    """
    precision = part.precision
    least: Array | float = 0.0
    if encoders is not None:
        least = compute_least_process(encoders.t, precision.encoder, precision.order)
    bounded = replace(precision, process=np.maximum(precision.process, least))
    process, stated = find_least_error_process(replace(part, precision=bounded), solved)
    process = np.maximum(process, least)
    if encoders is not None:
        process = find_followable_process(encoders, precision.encoder, process, precision.order)
    return replace(precision, process=process, stated=stated)


def _tune_filter_noise(problem: FilterProblem, part: FilterProblem, solved: Solution) -> NoiseModel:
    """A filter's noise model, which fits no motion at all
    time scales, with the share of its covariance to state.

    A joint has its encoder's process variance to the extent that the encoder determines it: the
    variance by all senses over the one by encoders alone is what images leave undetermined. With
    one camera this is a direction in which joints err together. Independent errors add up to it
    only with as many times their variance as joints take part.
    """
    encoders = problem.evidence.encoders
    precision = problem.precision
    alone = precision.process if precision.evidence_process is None else precision.evidence_process
    if encoders is None or len(encoders.t) < 2:
        return replace(part.precision, process=0.5 * (alone + part.precision.process))
    unknown = _compute_share_of_encoders(problem, solved, precision.process)
    taking_part = unknown.sum() ** 2 / np.square(unknown).sum()
    # a silent encoder has no share
    share = np.isfinite(encoders.values).mean(axis=0) * np.minimum(taking_part * unknown, 1.0)
    # encoders alone may find no motion where images find some
    more = share * np.maximum(alone - part.precision.process, 0.0)
    evident = part.precision.process + more
    bounded = part.precision.with_memory_bound(evident, encoders)
    if (bounded.process == evident).all():
        return bounded
    # with the process of a joint that stands still a filter settles at no steady variance
    settled = filter_roughly(replace(part, precision=bounded), solved)
    white = _compute_share_of_encoders(problem, settled, bounded.process)
    return part.precision.with_memory_bound(evident, encoders, white)


def _compute_share_of_encoders(problem: FilterProblem, solved: Solution, process: Array) -> Array:
    """Variance (M,) of the solved filter over the steady one by encoders alone with a process (M,),
    at most 1.
    """
    encoders = problem.evidence.encoders
    assert encoders is not None
    m = len(problem.start)
    density = problem.precision.encoder * measure_median_step(encoders.t)
    together = np.sqrt(np.einsum("eii->ei", solved.trace.cov[:, :m, :m])).mean(axis=0)
    alone = compute_steady_variance(density, process, problem.precision.order)
    return np.asarray(np.minimum(together**2 / alone, 1.0))


def _take_log_parameters(part: FilterProblem, names: list[str]) -> Array:
    """Natural logarithms (M + tracks) of process variances, then of pixel factors."""
    return np.asarray(
        np.log([*part.precision.process, *(part.precision.scale[name] for name in names)])
    )


def _set_noise_values(part: FilterProblem, values: Array, names: list[str]) -> NoiseModel:
    """The noise model with process variances, then pixel factors, of values (M + tracks,)."""
    m = len(part.start)
    # correlated frames predict each other well, which is no evidence of lower pixel noise
    found = dict(zip(names, np.maximum(values[m:], 1.0).tolist(), strict=True))
    return replace(part.precision, process=values[:m], scale={**part.precision.scale, **found})


def _step_to_parabola_minimum(nats: Array, half: Array) -> tuple[Array, Array]:
    """Step to the minimum of the parabola through (−half,
    0, half) along each axis, at most 2 half; its std.

    Where the parabola has no minimum the step is downhill, and its std is half. A candidate without
    a finite cost is no better than any other: no step goes towards it.
    """
    finite = np.isfinite(nats)
    if not finite[0]:
        return np.zeros(len(half)), half
    nats = np.where(finite, nats, nats[finite].max())
    up = nats[1 : 1 + len(half)]
    down = nats[1 + len(half) :]
    bend = up - 2.0 * nats[0] + down
    curved = np.where(bend > 0.0, bend, 1.0)
    step = np.where(bend > 0.0, 0.5 * half * (down - up) / curved, 2.0 * half * np.sign(down - up))
    return np.clip(step, -2.0 * half, 2.0 * half), half / np.sqrt(curved)


def compute_candidate_costs(
    part: FilterProblem, solved: Solution, candidates: Array, names: list[str]
) -> tuple[Array, Solution]:
    """Free energy (G,) nats of the log for candidates (G,
    M + tracks): process variances, then pixel factors.

    Also the first candidate's solution.
    """
    m = len(part.start)
    solved.tangents.write_stale_tangents(part, solved.readings)
    start = build_state_prior(part.start, part.dynamics)

    def filter_candidate(values: Array, into: FilterTrace | None) -> FilterTrace:
        scale = dict(zip(names, values[m:].tolist(), strict=True))
        readings = replace(solved.readings, var=_scale_pixel_noise(part, solved.readings, scale))
        return filter_readings(
            readings, replace(part.dynamics, process=values[:m]), *start, into=into
        )

    first = filter_candidate(candidates[0], None)
    nats = [first.nats.sum()]
    trace = None
    for values in candidates[1:]:
        trace = filter_candidate(values, trace)
        nats.append(trace.nats.sum())
    return np.array(nats), replace(solved, trace=first)


def _scale_pixel_noise(
    part: FilterProblem, readings: FilterReadings, scale: Mapping[str, float]
) -> Array:
    """Variances (E,T,D) of the readings' frames with other pixel factors of some tracks."""
    var = readings.var.copy()
    for index, (sighting, events) in enumerate(
        zip(part.evidence.sightings, part.timeline.sightings, strict=True)
    ):
        if sighting.name in scale:
            usual = part.precision.scale[sighting.name]
            pixels = sighting.independent_rows.var
            rows = pixels.shape[1]
            now = readings.var[events, index, :rows]
            # a lasting error counts less than its variance in a filter's extrapolation, so that a
            # reading's variance may be less than its pixels': no more can be taken from it than it
            # has
            more = np.minimum(pixels, now / usual) * (scale[sighting.name] - usual)
            var[events, index, :rows] = now + more
    return var


def cut_to_middle(problem: FilterProblem) -> FilterProblem:
    """The problem with only the images and encoder readings
    nearest to the middle of the images, if there are many.
    """
    found = problem.evidence.encoders
    times = (sighting.t for sighting in problem.evidence.sightings)
    seen_at = max(times, key=len, default=np.empty(0))
    span = _find_middle_span(seen_at, np.empty(0) if found is None else found.t)
    return problem if span is None else cut_problem(problem, *span)


def cut_problem(problem: FilterProblem, low: float, high: float) -> FilterProblem:
    """The problem with only the images and encoder readings from `low` to `high` s."""
    evidence = problem.evidence
    found = evidence.encoders
    sightings = [s.select_rows((s.t >= low) & (s.t <= high)) for s in evidence.sightings]
    if found is None:
        return _replace_measurements(problem, None, sightings)
    part = found.select_rows((found.t >= low) & (found.t <= high))
    start = found.interpolate_at(np.array([low]))[0]
    return replace(
        _replace_measurements(problem, part, sightings),
        start=np.where(np.isfinite(start), start, problem.start),
    )


def _find_middle_span(seen_at: Array, read_at: Array) -> tuple[float, float] | None:
    """First and last time (s) of the MAX_INSTANTS images and
    averages nearest to the middle of the images among readings.

    Nearest to the middle of the readings if none are among these; None if the log has no more.
    """
    every = np.concatenate([seen_at, read_at[:: count_readings_per_average(read_at)]])
    if len(every) <= MAX_INSTANTS:
        return None
    low, high = (read_at[0], read_at[-1]) if len(read_at) else (-np.inf, np.inf)
    among = seen_at[(seen_at >= low) & (seen_at <= high)]
    centre = np.median(among if len(among) else read_at)
    away = np.partition(np.abs(every - centre), MAX_INSTANTS - 1)[MAX_INSTANTS - 1]
    return float(centre - away), float(centre + away)


def thin_encoder_readings(problem: FilterProblem) -> FilterProblem:
    """The problem with close encoder readings averaged."""
    found = problem.evidence.encoders
    if found is None or count_readings_per_average(found.t) == 1:
        return problem
    return _replace_measurements(problem, average_close_readings(found), problem.evidence.sightings)


def drop_undetermined_images(problem: FilterProblem) -> FilterProblem:
    """The problem without images at times when no more numbers than encoders are silent, or never
    read, must determine these joints.
    """
    undetermined = problem.left_open
    sure = np.full(len(problem.timeline.t), not problem.is_undetermined())
    if undetermined is not None:
        sure &= ~undetermined.any(axis=1)
    if sure.all():
        return problem
    pairs = zip(problem.evidence.sightings, problem.timeline.sightings, strict=True)
    sightings = [sighting.select_rows(sure[at]) for sighting, at in pairs]
    return _replace_measurements(problem, problem.evidence.encoders, sightings)


def _replace_measurements(
    problem: FilterProblem, encoders: Encoders | None, sightings: Sequence[Sighting]
) -> FilterProblem:
    """The problem with only these measurements."""
    evidence = replace(problem.evidence, encoders=encoders, sightings=tuple(sightings))
    return replace(problem, evidence=evidence, timeline=build_timeline(evidence, None))
