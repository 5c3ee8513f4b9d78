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

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...motion import WHITE_JERK
from ...types import Array, Hypothesis
from ..faults.threshold import EVIDENCE_THRESHOLD_NATS
from ..inference.filter_log import filter_roughly
from ..inference.filter_problem import FilterProblem
from ..inference.reacquisition import find_silent_joints, joints_left_open
from ..inference.scan import (
    MAX_SWEEPS,
    FilterDynamics,
    FilterReadings,
    FilterTrace,
    TraceDetail,
    filter_stretches,
)
from ..inference.solution import Solution, adjoints_for_next_round, smooth_states
from ..inference.tangents import hand_over_starts, stretch_priors
from ..measurements.long_arrays import find_finite_rows, measure_median_step
from ..measurements.records import Encoders, Sighting
from ..measurements.timeline import (
    GAP_STEPS,
    View,
    build_timeline,
    list_track_sets,
    select_visual_sightings,
)
from .correlated_noise import steady_variance
from .encoder_noise import (
    MAX_INSTANTS,
    SKIPPED_READINGS,
    average_close_readings,
    find_followable_process,
    least_process_density,
    readings_per_average,
)
from .noise_model import NoiseModel


def least_error_process(part: FilterProblem, solved: Solution) -> tuple[Array, float]:
    """Process variances (M,) of least error, as one
    factor on the problem's, and this error's share of V.

    `solved`: the solution of the filter.
    """
    order = part.precision.order
    step = 2.0 ** (0.5 * order)  # moves the cut-off by 2^¼
    factors = step ** np.arange(-6.0, 5.0)
    present = _without_gaps(part, part.timeline.t)
    moved = np.square(np.diff(_smooth_candidates(part, solved, factors), axis=0))[:, present].mean(
        axis=1
    )
    # noise's share of it grows as q^(1/2n)
    noise = moved[-1] * (factors[:-1] / factors[-2])[:, None] ** (0.5 / order)
    ratios = (moved / np.maximum(noise, np.finfo(float).tiny)).mean(axis=1)
    power = _fit_motion_power(ratios, step, order)
    over = np.log(np.maximum(ratios, np.finfo(float).tiny) / move_at_least(power, order))
    last = int(np.flatnonzero(over > 0.0).max(initial=-1))
    beyond = 0.5 + over[last] / (over[last] - over[last + 1]) if last >= 0 else 0.0
    factor = factors[max(last, 0)] * step**beyond
    return np.asarray(part.precision.process * factor), _noise_share(part) * power / (power - 1.0)


def move_at_least(power: float, order: int) -> float:
    """How far the path moves with ln q at the least error,
    squared, over that by noise; motion's spectrum is ω^−power.

    By the smoother's response 1 / (1 + u²ⁿ), u the frequency
    over the cut-off, which moves by u²ⁿ / (1 + u²ⁿ)².
    """
    return (min(power, 2.0 * order + 2.0) + 4.0 * order) / (2.0 * order + 1.0)


def _noise_share(part: FilterProblem) -> float:
    """Share of V that noise makes."""
    return 1.0 - 0.5 / part.precision.order


def _without_gaps(part: FilterProblem, t: Array) -> Array:
    """Times t (E,) s outside long silences of an encoder, in which a path moves far with q."""
    encoders = part.evidence.encoders
    known = (
        np.empty(0) if encoders is None else encoders.t[np.isfinite(encoders.values).all(axis=1)]
    )
    if len(known) < 2:
        return np.ones(len(t), bool)
    steps = np.diff(known)
    quick = np.concatenate([[True], steps <= GAP_STEPS * np.median(steps), [True]])
    return quick[np.searchsorted(known, t)]


def _fit_motion_power(ratios: Array, step: float, order: int) -> float:
    """p, from the rate at which moves over those of noise,
    1 + b q^(−p/2n), fall; ratios (10,), a step of q apart.
    """
    last = max(int(np.flatnonzero(ratios > move_at_least(2.0 * order, order)).max(initial=0)), 2)
    before, after = ratios[[last - 2, last]] - 1.0
    if after <= 0.0 or before <= after:
        return 2.0 * order + 4.0
    rate = np.log(before / after) / (2.0 * np.log(step))
    return float(np.clip(2.0 * order * rate, 2.0 * order, 2.0 * order + 4.0))


def _smooth_candidates(part: FilterProblem, solved: Solution, factors: Array) -> Array:
    """Smoothed angles (G,E,M) for each factor, with the tangents of `solved`.

    One factor after the other, as a smoother keeps covariances of all instants.
    """
    solved.tangents.draw(part, solved.fold, solved.readings)
    trace = None
    paths = []
    for process in factors[:, None] * part.precision.process:
        posed = replace(
            part, precision=replace(part.precision, process=process, stated=_noise_share(part))
        )
        path, trace = _smooth_path(posed, solved, trace)
        paths.append(path)
    return np.stack(paths)


def _smooth_path(
    posed: FilterProblem, solved: Solution, into: FilterTrace | None
) -> tuple[Array, FilterTrace]:
    """Smoothed angles (E,M); and the trace, which may be `into`, overwritten."""
    fold = solved.fold
    dynamics = posed.dynamics
    m = len(posed.start)
    var = solved.tangents.weighed(posed, fold, solved.readings, whole=True)
    readings = replace(solved.readings, var=var)
    prior = stretch_priors(posed, fold)
    before = solved.trace
    trace = filter_stretches(
        readings,
        dynamics,
        *hand_over_starts(*prior, before.z[-1], before.end_p),
        TraceDetail.MEANS,
        into,
    )
    trace = filter_stretches(
        readings,
        dynamics,
        *hand_over_starts(*prior, trace.z[-1], trace.end_p),
        TraceDetail.MEANS,
        trace,
    )
    _, start = smooth_states(readings, trace, np.zeros_like(trace.z[-1]), dynamics)
    smooth, _ = smooth_states(readings, trace, adjoints_for_next_round(start), dynamics)
    return fold.unfold(smooth[:, :m]), trace


def stack_candidates(
    part: FilterProblem, solved: Solution, processes: Array, var: Array
) -> tuple[FilterReadings, FilterDynamics, Array, Array]:
    """What `filter_stretches` takes for candidates of process
    variances (M,G) and variances of frames (L,T,D,C,G).

    Their stretches start where those of `solved` ended.
    """
    g = processes.shape[1]
    fold = solved.fold
    dynamics = replace(part.dynamics, process=np.tile(processes, fold.count))
    starts = hand_over_starts(*stretch_priors(part, fold), solved.trace.z[-1], solved.trace.end_p)
    z, p = (np.repeat(part, g, axis=-1) for part in starts)
    return (
        replace(solved.readings, var=var.reshape(*var.shape[:-2], var.shape[-2] * g)),
        dynamics,
        z,
        p,
    )


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
    lasting = bool(joints_left_open(problem.timeline.t, problem.evidence).any())
    if not lasting and find_silent_joints(problem.timeline.t, encoders).any():
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
        precision = replace(precision, encoder=learned.encoder).held(learned.process, encoders)
    return replace(problem, precision=precision)


def tune_by_evidence(problem: FilterProblem, whole: bool) -> tuple[NoiseModel, Solution | None]:
    """Process variances and pixel factors from (the middle
    of) the log, for a smoother (`whole`) or a filter.

    Rounds of steps to the greatest evidence end when all are within a standard deviation of it; a
    parabola is as wide as before until its minimum is near. Also the last solution as a warm start,
    if it covers the whole log.
    """
    log = cut_to_middle(
        drop_undetermined_images(replace(problem, precision=replace(problem.precision, fewer={})))
    )
    part = thin_encoder_readings(log)
    names = [
        s.name
        for s in part.evidence.sightings
        if s.name != "touch" and find_finite_rows(s.values).sum() > SKIPPED_READINGS
    ]
    if not names and not whole:
        return problem.precision, None
    solved = filter_roughly(part)
    half = np.ones(len(part.start) + len(names))
    for _ in range(MAX_SWEEPS if names else 0):
        logs = _log_parameters(part, names)
        candidates = np.concatenate([logs[None], logs + np.diag(half), logs - np.diag(half)])
        nats, solved = compute_candidate_costs(part, solved, np.exp(candidates), names)
        step, std = _parabola_step(nats, half)
        part = replace(part, precision=_noise_with_values(part, np.exp(logs + step), names))
        if (np.abs(_log_parameters(part, names) - logs) <= std).all():
            break
        half = np.where(np.abs(step) < 2.0 * half, np.minimum(half, std), half)
    warm = solved if part.timeline is problem.timeline else None
    if whole:
        likeliest = _tune_filter_noise(problem, part, solved).process
        return replace(
            _tune_smoother_noise(part, solved, log.evidence.encoders), likeliest=likeliest
        ), warm
    fewer = {
        view: _tune_filter_noise(problem, *_with_view(part, view)).process
        for view in _list_partial_views(problem)
    }
    return replace(_tune_filter_noise(problem, part, solved), fewer=fewer), warm


def _list_partial_views(problem: FilterProblem) -> list[View]:
    """Sets of tracks in view at times when not all are, if encoders still determine the arm."""
    usual = tuple(s.name for s in select_visual_sightings(problem.evidence.sightings))
    if problem.path or problem.precision.order > 2:
        return []
    return [
        v for v in list_track_sets(problem.evidence.sightings, problem.timeline.t)[0] if v != usual
    ]


def _with_view(part: FilterProblem, view: View) -> tuple[FilterProblem, Solution]:
    """The part with only these of its tracks, and its solution."""
    less = _with_measurements(
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
    low = (
        0.0
        if encoders is None
        else least_process_density(encoders.t, precision.encoder, precision.order)
    )
    held = replace(precision, process=np.maximum(precision.process, low))
    process, stated = least_error_process(replace(part, precision=held), solved)
    process = np.maximum(process, low)
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
    m = len(problem.start)
    alone = precision.process if precision.evident is None else precision.evident
    if encoders is None or len(encoders.t) < 2:
        return replace(part.precision, process=0.5 * (alone + part.precision.process))
    density = precision.encoder * measure_median_step(encoders.t)
    var = solved.fold.unfold(np.einsum("liic->lic", solved.trace.cov[:, :m, :m]))
    together = np.sqrt(var).mean(axis=0)
    unknown, white = (
        np.minimum(together**2 / steady_variance(density, process, precision.order), 1.0)
        for process in (precision.process, part.precision.process)
    )
    taking_part = unknown.sum() ** 2 / np.square(unknown).sum()
    # a silent encoder has no share
    share = np.isfinite(encoders.values).mean(axis=0) * np.minimum(taking_part * unknown, 1.0)
    # encoders alone may find no motion where images find some
    more = share * np.maximum(alone - part.precision.process, 0.0)
    return part.precision.held(part.precision.process + more, encoders, white)


def _log_parameters(part: FilterProblem, names: list[str]) -> Array:
    """Natural logarithms (M + tracks) of process variances, then of pixel factors."""
    return np.asarray(
        np.log([*part.precision.process, *(part.precision.scale[name] for name in names)])
    )


def _noise_with_values(part: FilterProblem, values: Array, names: list[str]) -> NoiseModel:
    m = len(part.start)
    # correlated frames predict each other well, which is no evidence of lower pixel noise
    found = dict(zip(names, np.maximum(values[m:], 1.0).tolist(), strict=True))
    return replace(part.precision, process=values[:m], scale={**part.precision.scale, **found})


def _parabola_step(nats: Array, half: Array) -> tuple[Array, Array]:
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

    Stretches start where those of `solved` ended. Also the first candidate's solution.
    """
    readings = solved.readings
    fold = solved.fold
    g = len(candidates)
    m = len(part.start)
    solved.tangents.draw(part, fold, readings)
    var = np.repeat(readings.var[..., None], g, axis=-1)
    for index, (sighting, events) in enumerate(
        zip(part.evidence.sightings, part.timeline.sightings, strict=True)
    ):
        if sighting.name in names:
            pixels = np.zeros_like(readings.var[:, index])
            fold.put(pixels[:, : sighting.var.shape[1]], events, sighting.independent_rows.var)
            scale = part.precision.scale[sighting.name]
            more = candidates[:, m + names.index(sighting.name)] - scale
            # a lasting error counts less than its variance in a filter's
            # extrapolation, so that a reading's variance may be less
            # than its pixels': no more can be taken from it than it has
            shares = np.minimum(pixels, readings.var[:, index] / scale)
            var[:, index] += shares[..., None] * more
    trace = filter_stretches(*stack_candidates(part, solved, candidates[:, :m].T, var), every=g)
    first = replace(trace, nats=trace.nats[:, ::g])
    return np.asarray(trace.nats.reshape(-1, g).sum(axis=0)), replace(solved, trace=first)


def cut_to_middle(problem: FilterProblem) -> FilterProblem:
    """The problem with only the images and encoder readings
    nearest to the middle of the images, if there are many.
    """
    evidence = problem.evidence
    found = problem.evidence.encoders
    seen_at = max((sighting.t for sighting in evidence.sightings), key=len, default=np.empty(0))
    low, high = span = _find_middle_span(seen_at, np.empty(0) if found is None else found.t)
    if span == (-np.inf, np.inf):
        return problem
    return cut_problem(problem, low, high)


def cut_problem(problem: FilterProblem, low: float, high: float) -> FilterProblem:
    """The problem with only the images and encoder readings from `low` to `high` s."""
    evidence = problem.evidence
    found = evidence.encoders
    sightings = [s.select_rows((s.t >= low) & (s.t <= high)) for s in evidence.sightings]
    if found is None:
        return _with_measurements(problem, None, sightings)
    part = found.select_rows((found.t >= low) & (found.t <= high))
    start = found.interpolate_at(np.array([low]))[0]
    return replace(
        _with_measurements(problem, part, sightings),
        start=np.where(np.isfinite(start), start, problem.start),
    )


def _find_middle_span(seen_at: Array, read_at: Array) -> tuple[float, float]:
    """First and last time (s) of the MAX_INSTANTS images and
    averages nearest to the middle of the images among readings.

    Nearest to the middle of the readings if none are among these; infinite if the log has no more.
    """
    every = np.concatenate([seen_at, read_at[:: readings_per_average(read_at)]])
    if len(every) <= MAX_INSTANTS:
        return -np.inf, np.inf
    low, high = (read_at[0], read_at[-1]) if len(read_at) else (-np.inf, np.inf)
    among = seen_at[(seen_at >= low) & (seen_at <= high)]
    centre = np.median(among if len(among) else read_at)
    away = np.partition(np.abs(every - centre), MAX_INSTANTS - 1)[MAX_INSTANTS - 1]
    return float(centre - away), float(centre + away)


def thin_encoder_readings(problem: FilterProblem) -> FilterProblem:
    """The problem with close encoder readings averaged."""
    found = problem.evidence.encoders
    if found is None or readings_per_average(found.t) == 1:
        return problem
    return _with_measurements(problem, average_close_readings(found), problem.evidence.sightings)


def drop_undetermined_images(problem: FilterProblem) -> FilterProblem:
    """The problem without images at times when no more numbers
    than encoders are silent must determine these joints.
    """
    held = problem.left_open
    if held is None:
        return problem
    sure = np.asarray(~held.any(axis=1))
    line = problem.timeline
    pairs = zip(problem.evidence.sightings, line.sightings, strict=True)
    sightings = [sighting.select_rows(sure[at]) for sighting, at in pairs]
    return (
        problem if sure.all() else _with_measurements(problem, problem.evidence.encoders, sightings)
    )


def _with_measurements(
    problem: FilterProblem, encoders: Encoders | None, sightings: Sequence[Sighting]
) -> FilterProblem:
    """The problem with only these measurements."""
    evidence = replace(problem.evidence, encoders=encoders, sightings=tuple(sightings))
    return replace(problem, evidence=evidence, timeline=build_timeline(evidence, None))
