"""What each part of the noise model is worth: errors and NEES without it, on the logs where it matters.

A part is taken out by a patch. Log by log, estimates with it and without it are made of the same readings.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bodylog.estimation.inference import tangents
from bodylog.estimation.methods import filtering
from bodylog.estimation.noise import (
    correlated_noise,
    encoder_noise,
    evidence_search,
    noise_model,
    quantisation,
)
from bodylog.estimation.noise.noise_model import NoiseModel
from tests.estimation.resting import Drawn, drawn
from tests.validation import error_bars, figures, logs
from tests.validation import motion_order as motions

COUNT, STILL = 3, 20
"""Logs of a kind; still arms have one posture each, so that few say little."""


def table():
    """A row for each part and kind of log: how much larger the error is without the part; NEES with it and without."""
    head = ("without", "log", *(f"`{method}`: larger error; NEES" for method in error_bars.METHODS))
    rows = [(part, name, *cells(part, name)) for part, (names, _) in PARTS.items() for name in names]
    return figures.table(head, rows)


def cells(part, name):
    """One cell for each method."""
    for method in error_bars.METHODS:
        before, after = scores("", name, method), scores(part, name, method)
        change = 100.0 * (after[0] / before[0] - 1.0)
        error = f"{change:+.1f} %" if change < 100.0 else f"× {after[0] / before[0]:.2g}"
        yield f"{error}; {figures.joined(before[1])} → {figures.joined(after[1])}"


@cache
def scores(part, name, method):
    """RMS error and mean NEES over the logs of a kind, without the part if one is named."""
    with pytest.MonkeyPatch.context() as patch:
        if part:
            PARTS[part][1](patch)
        runs = [figures.found(log, body, method) for log, body in read(name)]
    return figures.rms([run.rmse for run in runs]), np.mean([run.nees for run in runs], axis=0)


@cache
def read(name):
    """The logs of a kind, with their bodies."""
    return list(error_bars.still(STILL)) if name == "still arms" else [LOGS[name](seed) for seed in range(COUNT)]


def simulated(scenario, seconds, cameras=1):
    """The simulator's motion before its cameras, and the body learned from an exploration."""
    return lambda seed: (logs.drawn(scenario, 2000 + seed, seconds, cameras), logs.learned(seed + 3, cameras))


def counted(motion, **how):
    """Encoders of a given step and noise before a camera."""
    return lambda seed: of(drawn(200 + seed, Drawn(motion, **how)))


def false_readings(seed):
    """Sines, eight readings of which are false by 0.5 rad (RMS)."""
    rng = np.random.default_rng([seed, 9])

    def change(t, values, names):
        values[rng.choice(len(t), 8, replace=False)] += rng.normal(0.0, 0.5, (8, values.shape[1]))
        return values

    log, body = motions.sines(seed)
    return logs.with_encoders(log, change), body


def bold_track(seed):
    """Sines, the track of which claims a third of its error."""
    log, body = motions.sines(seed)
    tracks = {name: replace(track, std=track.std / 3.0) for name, track in log.features.tracks.items()}
    return replace(log, features=replace(log.features, tracks=tracks)), body


def of(world):
    """A drawn world as a log, and its body."""
    return logs.of(world), world.body


LOGS = {
    "sines": motions.sines,
    "white acceleration": motions.white_acceleration,
    "slow sines, encoders of 0.02 rad": counted("slow", noise=0.02),
    "reaches, one camera": simulated("reach", 10.0),
    "reaches, two cameras": simulated("reach", 10.0, 2),
    "babble, one camera": simulated("babble", 40.0),
    "babble, two cameras": simulated("babble", 40.0, 2),
    "reaches, steps of 0.1 mrad": counted("reach", step=1e-4),
    "reaches, steps of 1.5 mrad": counted("reach", step=1.5e-3),
    "slow sines, steps of 0.01 rad": counted("slow", step=0.01),
    "sines, false readings": false_readings,
    "sines, a track that claims a third of its error": bold_track,
}


def setting(owner, name, value):
    """A patch of one name."""
    return lambda patch: patch.setattr(owner, name, value)


def learned_alone(problem, whole):
    """No noise from images."""
    return problem.precision, None


def sure(part, values, names):
    """Process variances from images, pixel variances as claimed."""
    return replace(part.precision, process=values[: len(part.start)])


def alone(problem, part, solved):
    """A filter's process variances of greatest evidence."""
    return part.precision.with_memory_bound(part.precision.process, problem.evidence.encoders)


def always_jerk(problem):
    """White jerk, whatever the evidence."""
    white, jerk = problem.precision.learned
    learned = white, replace(jerk, evidence=np.inf)
    return evidence_search.with_preferred_order(replace(problem, precision=replace(problem.precision, learned=learned)))


def stating_all(patch):
    """The whole covariance is stated."""
    kept = NoiseModel.with_memory_bound
    patch.setattr(NoiseModel, "with_memory_bound", lambda *args: replace(kept(*args), stated=1.0))


def unbounded(patch):
    """A filter's memory without a bound."""
    for owner in (encoder_noise, evidence_search):
        patch.setattr(owner, "compute_least_process", lambda t, encoder, order: np.full(len(encoder), 1e-30))


def never_dithered(t, y):
    """Readings as they are, with the least variance of their step."""
    return y, 0.0, quantisation.dither_readings(t, y)[2]


def independent(self, step):
    """No correlation between frames."""
    return np.zeros(step.shape[:-1])


PARTS = {
    "white jerk where evidence prefers it": (
        ("sines", "babble, one camera"), setting(filtering, "with_preferred_order", lambda problem: problem)),
    "white acceleration where evidence prefers it": (
        ("white acceleration", "slow sines, encoders of 0.02 rad"),
        setting(filtering, "with_preferred_order", always_jerk)),
    "a smoother's process of least error": (
        ("sines", "white acceleration", "slow sines, encoders of 0.02 rad"),
        setting(evidence_search, "find_least_error_process", lambda part, solved: (part.precision.process, 1.0))),
    "process noise that follows sudden motion": (
        ("reaches, steps of 0.1 mrad",),
        setting(encoder_noise, "_raise_until_followed", lambda folded, ratio, variance, order: ratio)),
    "restarts at jumps": (
        ("sines, false readings",), setting(encoder_noise, "_find_far_bends", lambda bend: np.zeros(len(bend), bool))),
    "dithering of steps": (
        ("reaches, steps of 1.5 mrad", "slow sines, steps of 0.01 rad"),
        setting(encoder_noise, "dither_readings", never_dithered)),
    "variance that repeats share": (
        ("reaches, steps of 1.5 mrad",), setting(filtering, "weigh_repeated_readings", lambda evidence, *_: evidence)),
    "least process noise, for a memory of 1 s": (("still arms",), unbounded),
    "stated share of a resting filter's variance": (("still arms",), stating_all),
    "noise by the evidence of images": (
        ("reaches, one camera", "reaches, two cameras"), setting(filtering, "tune_by_evidence", learned_alone)),
    "pixel variances by evidence": (
        ("sines, a track that claims a third of its error",), setting(evidence_search, "_set_noise_values", sure)),
    "a filter's own process noise": (
        ("reaches, one camera", "reaches, two cameras"), setting(evidence_search, "_tune_filter_noise", alone)),
    "process noise by tracks in view": (
        ("reaches, one camera", "reaches, two cameras"), setting(evidence_search, "_list_partial_views", lambda problem: [])),
    "common errors of near places": (("still arms",), setting(noise_model, "PIXEL_CORRELATION_PX", 0.0)),
    "common errors of near postures": (
        ("babble, one camera", "babble, two cameras"),
        setting(correlated_noise.ErrorCorrelation, "correlate_posture_steps", independent)),
    "weight of errors that last": (
        ("reaches, two cameras", "babble, two cameras"),
        setting(correlated_noise.ErrorCorrelation, "compute_variance_factor", lambda self, count, like: 2.0 * count - 1.0)),
    "common errors of two tracks": (
        ("babble, two cameras",),
        setting(tangents, "compute_shared_model_factors", lambda frames, common, distinct: (1.0,) * len(frames))),
}  # fmt: skip
"""What is taken out: the logs where it matters, and the patch."""
