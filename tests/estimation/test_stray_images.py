"""Runs of images of something else: found between jumps of the track, and left out where the log is likelier without them."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.estimation import estimate_from_features
from bodylog.estimation.faults import stray_images
from bodylog.estimation.methods.filtering import build_filter_problem, leave_out_stray_runs
from bodylog.settings import EstimationSettings
from bodylog.sim.hardware import Hardware
from bodylog.types import HARDWARE_ERRORS
from tests.estimation import mechanisms
from tests.estimation.conftest import draw
from tests.estimation.mechanisms import SOUND, Fault, Mechanism, errors_and_nees
from tests.validation import logs

RUN_S = 0.5


def stray(features, begin, off, lasts=RUN_S):
    """Images displaced by `off` px from `begin` s on, for a while."""
    (name,) = features.tracks
    track = features.tracks[name]
    inside = (track.t >= begin) & (track.t < begin + lasts)
    values = track.values + np.outer(inside, off)
    return replace(features, tracks={name: replace(track, values=values)}), track.t[inside]


@pytest.mark.parametrize("method", ["filter", "smoother"])
@pytest.mark.parametrize("seed", [4, 5])
def test_a_run_of_images_of_something_else_is_left_out(seed, method):
    world = draw(seed, duration=16.0)
    features, t = stray(logs.of(world).features, 9.6, (16.0, -8.0))
    found = estimate_from_features(features, world.body, EstimationSettings(method=method))
    assert not found.faults and HARDWARE_ERRORS not in found.settings
    health = found.used["effector"]
    assert health.rejected["stray"] == len(t) and health.used == health.seen - len(t)
    error, nees = errors_and_nees(found, logs.of(world).truth)
    assert nees < 1.6
    assert np.abs(error[(found.joints.t > 9.4) & (found.joints.t < 10.4)]).max() < 0.04
    (warning,) = (one.text for one in found.findings if "something else" in one.text)
    assert warning.endswith(f"left out: from {t[0]:.2f} to {t[-1]:.2f} s")


@pytest.mark.parametrize("hardware", [Hardware(), Hardware(jitter=4e-3), Hardware(play=8e-3, stick=4e-3)])
def test_a_sound_tracker_has_no_stray_images(hardware):
    body = mechanisms.learned(1000, SOUND)
    for seed in range(2):
        features = mechanisms.replayed(seed, Mechanism(5e-4, hardware), Fault(), reaches=True)
        problem = leave_out_stray_runs(build_filter_problem(features, body, EstimationSettings()), EstimationSettings())
        assert not any("something else" in one.text for one in problem.evidence.findings)


def test_a_run_lies_between_jumps_that_undo_each_other_or_at_an_end():
    rng = np.random.default_rng(0)
    t = np.arange(100) * 0.05
    smooth = np.column_stack([80.0 * np.sin(t), 60.0 * np.cos(0.7 * t)]) + 0.2 * rng.standard_normal((100, 2))

    def runs(*rows, off=(9.0, -5.0)):
        places = smooth.copy()
        for own in rows:
            places[own] += off
        return [(one.begin, one.end) for one in stray_images._list_runs(0, t, places)]

    assert runs() == []
    assert runs(slice(40, 46)) == [(t[40], t[45])]
    assert runs(slice(95, 100)) == [(t[95], t[99])]
    assert runs(slice(0, 4)) == [(t[0], t[3])]
    assert runs(slice(40, 41), slice(50, 51)) == []  # single images are for the gate
    assert runs(slice(25, 75)) == []  # the camera moved


def test_runs_that_share_images_are_left_out_once():
    world = draw(4, duration=16.0)
    features, t = stray(logs.of(world).features, 9.6, (16.0, -8.0))
    problem = build_filter_problem(features, world.body, EstimationSettings())
    (run,) = stray_images.list_possible_runs(problem)
    longer = replace(run, begin=run.begin - 0.2, images=run.images + 2)
    (kept,) = stray_images.find_stray_runs(problem, [longer, run, run])
    assert (kept.begin, kept.end) == (t[0], t[-1]) and kept.nats > 12.0
