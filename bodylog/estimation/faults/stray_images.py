"""Stray images: a tracker that holds on to something else for a while, and then comes back.

They lie together, so each is confirmed by those beside it, and a filter that weighs one image after
the other believes them. Such a run begins and ends with a jump of the track. Without its n images a
log is less surprising by Δ nats, and without as many sound ones by u. A run costs

    ln(1/ε) + ln(span) + n ln 2 + u (n − 1) / n

nats: an image begins one with probability ε and lies anywhere in the picture; after each image the
run goes on or ends, as probable; and its images follow one another as sound ones do. Where Δ is
more than that by EVIDENCE_THRESHOLD_NATS, the run is left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ...types import Array, Finding
from ...wording import list_in_words
from ..factors.robust import OUTLIER_SHARE, measure_image_span
from ..inference.filter_log import filter_roughly
from ..inference.filter_problem import FilterProblem
from ..measurements.long_arrays import MIN_READINGS, find_finite_rows
from ..noise.evidence_search import cut_problem
from .offset_changes import measure_free_energy, sum_free_energy
from .threshold import EVIDENCE_THRESHOLD_NATS

JUMP_MEDIANS = 4.0
"""Median changes of a track's velocity from image to image beyond which it jumps."""
IMAGES_AROUND_JUMP = 8
"""Images before and after a jump among which it must be large: stamps that jitter make a track that
moves fast jump all the time.
"""
ALONE_SHARE = 0.75
"""Share of a jump's size that those beside it may have: half where a run begins or ends, all of it
where a single image is off.
"""
LONGEST_RUN_S = 1.0
"""s: images that are displaced for longer are those of a camera that moved, or of a load."""
FILTERED_BESIDE_RUN_S = 4.0
"""s of the log before and after a run that are filtered with it and without."""
MOST_RUNS = 16
"""Runs of a track that are compared in one round: those with the largest jumps. What is left out
makes room for others in the next one.
"""
SOUND_RUNS = 9
"""Runs of as many sound images that a run is compared with."""
MORE_SURPRISING = 0.75
"""Quantile of the surprise of sound runs that counts: images of fast motion surprise more, above
all with stamps that jitter, and some of these runs have stray images themselves.
"""


@dataclass(frozen=True)
class StrayRun:
    """A run of a track's images of something else: number of its sighting, first and last time (s),
    how many images it has, and the nats it wins.
    """

    number: int
    begin: float
    end: float
    images: int
    nats: float


def list_possible_runs(problem: FilterProblem) -> list[StrayRun]:
    """Runs of images between two jumps that undo each other, or between a jump and an end of the
    log, not weighed yet; those with the largest jumps of each track.
    """
    found = []
    for number, sighting in enumerate(problem.evidence.sightings):
        if sighting.is_track:
            seen = find_finite_rows(sighting.values)
            found += _list_runs(number, sighting.t[seen], sighting.values[seen])
    return found


def _list_runs(number: int, t: Array, places: Array) -> list[StrayRun]:
    """The possible runs of a track's places (N,D) at t (N,) s."""
    if len(t) < MIN_READINGS:
        return []
    jumps = _measure_jumps(t, places)
    sizes = np.linalg.norm(jumps, axis=1)
    near = np.pad(sizes, 1)
    alone = np.maximum(near[:-2], near[2:]) < ALONE_SHARE * sizes
    large = alone & (sizes > JUMP_MEDIANS * _measure_usual_sizes(sizes))
    # a run begins with the image after a jump, and ends with the one before the next
    bounds = [0, *(np.flatnonzero(large) + 1).tolist(), len(t)]
    jump_at = np.pad(jumps, ((1, 1), (0, 0)))
    runs = []
    for first, end in product(bounds, bounds):
        if end - first < 2 or t[end - 1] - t[first] > LONGEST_RUN_S:
            continue
        leap = jump_at[first]
        back = jump_at[end]
        if leap @ back <= 0.0:
            size = float(np.linalg.norm(leap) + np.linalg.norm(back))
            runs.append(
                (size, StrayRun(number, float(t[first]), float(t[end - 1]), end - first, 0.0))
            )
    runs.sort(key=lambda one: -one[0])
    return [run for _, run in runs[:MOST_RUNS]]


def _measure_usual_sizes(sizes: Array) -> Array:
    """The median size (N,) of the jumps around each, or of all if that is larger."""
    around = sliding_window_view(
        np.pad(sizes, IMAGES_AROUND_JUMP, "reflect"), 2 * IMAGES_AROUND_JUMP + 1
    )
    return np.asarray(np.maximum(np.median(around, axis=1), np.median(sizes)))


def _measure_jumps(t: Array, places: Array) -> Array:
    """How much farther a track moves (N-1,D) from each image to the next than beside."""
    step = np.diff(t)[:, None]
    speed = np.diff(places, axis=0) / step
    before = np.concatenate([speed[1:2], speed[:-1]])
    after = np.concatenate([speed[1:], speed[-2:-1]])
    return np.asarray((speed - 0.5 * (before + after)) * step)


def find_stray_runs(problem: FilterProblem, possible: Sequence[StrayRun]) -> list[StrayRun]:
    """The runs that win EVIDENCE_THRESHOLD_NATS, without those that share images with a better one.

    problem: with noise by evidence.
    """
    weighed = (replace(one, nats=_weigh_run(problem, one)) for one in possible)
    evident = [one for one in weighed if one.nats > EVIDENCE_THRESHOLD_NATS]
    kept = list[StrayRun]()
    for run in sorted(evident, key=lambda one: -one.nats):
        if not any(_share_images(run, other) for other in kept):
            kept.append(run)
    return kept


def _share_images(one: StrayRun, other: StrayRun) -> bool:
    """Whether two runs have images of one track in common."""
    return one.number == other.number and one.begin <= other.end and other.begin <= one.end


def _weigh_run(problem: FilterProblem, run: StrayRun) -> float:
    """Nats that a log wins without a run, over what the run costs."""
    part = cut_problem(problem, run.begin - FILTERED_BESIDE_RUN_S, run.end + FILTERED_BESIDE_RUN_S)
    sighting = part.evidence.sightings[run.number]
    seen = np.flatnonzero(find_finite_rows(sighting.values))
    own = _select_images(sighting.t[seen], run)
    sound = seen[~own]
    if len(sound) < 2 * run.images:
        return -np.inf
    whole = filter_roughly(part)

    def measure_surprise(rows: Array) -> float:
        less = _without_images(part, run.number, rows)
        return sum_free_energy(whole) - measure_free_energy(less, whole)

    begins = np.linspace(0, len(sound) - run.images, SOUND_RUNS).astype(int).tolist()
    each = [measure_surprise(sound[one : one + run.images]) for one in begins]
    usual = float(np.quantile(each, MORE_SURPRISING))
    span = measure_image_span(sighting.values[seen], sighting.var[seen])
    begin = np.log(span).sum() - np.log(OUTLIER_SHARE)
    lasts = run.images * np.log(2.0) + usual * (run.images - 1) / run.images
    return float(measure_surprise(seen[own]) - begin - lasts)


def _select_images(t: Array, run: StrayRun) -> Array:
    """Which of the images at t (N,) s are a run's."""
    return np.asarray((t >= run.begin) & (t <= run.end))


def _without_images(problem: FilterProblem, number: int, rows: Array) -> FilterProblem:
    """The problem without some images of one track."""
    sightings = list(problem.evidence.sightings)
    values = sightings[number].values.copy()
    values[rows] = np.nan
    sightings[number] = replace(sightings[number], values=values)
    return replace(problem, evidence=replace(problem.evidence, sightings=tuple(sightings)))


def remove_stray_runs(problem: FilterProblem, runs: Sequence[StrayRun]) -> FilterProblem:
    """The problem without the images of these runs, with a warning for each track."""
    for run in runs:
        t = problem.evidence.sightings[run.number].t
        problem = _without_images(problem, run.number, _select_images(t, run))
    evidence = problem.evidence
    used = dict(evidence.used)
    findings = list(evidence.findings)
    for number in sorted({run.number for run in runs}):
        name = evidence.sightings[number].name
        own = sorted((run for run in runs if run.number == number), key=lambda run: run.begin)
        stray = sum(run.images for run in own)
        health = used[name]
        rejected = {**health.rejected, "stray": stray}
        used[name] = replace(health, used=health.used - stray, rejected=rejected)
        when = [f"{run.begin:.2f} to {run.end:.2f} s" for run in own]
        text = f"{stray} of its images show something else, and are left out: from "
        findings.append(
            Finding("warning", f"{name}: {text}{list_in_words(when, ' times', ', from ')}")
        )
    return replace(problem, evidence=replace(evidence, used=used, findings=tuple(findings)))
