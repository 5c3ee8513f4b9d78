"""Which tracks are in view, and what becomes of the belief where not all are."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.estimation import estimate_from_features
from bodylog.estimation.inference import filter_log
from bodylog.estimation.measurements.records import Sighting
from bodylog.estimation.measurements.timeline import GAP_STEPS, list_track_sets
from bodylog.estimation.methods import filtering
from bodylog.settings import EstimationSettings
from tests.estimation.conftest import Arm


def track(name, t, hidden=(0.0, 0.0)):
    t = np.asarray(t)
    values = np.where(((t > hidden[0]) & (t < hidden[1]))[:, None], np.nan, 1.0) * np.ones(
        (len(t), 2)
    )
    return Sighting(name, Arm(), t, values, np.ones((len(t), 2)), np.zeros(len(t), int))


def test_tracks_in_view_are_found_by_gaps():
    frames = np.arange(0.0, 10.0, 0.1)
    tracks = [
        track("left", frames, (2.05, 5.05)),
        track("right", frames, (4.05, 4.05 + 0.1 * (GAP_STEPS - 2))),
    ]
    found, which = list_track_sets(tracks, np.array([0.0, 2.0, 2.1, 4.5, 5.1, 5.2, 9.95]))
    # the right one misses fewer frames than count, the left one is back with the frame that ends its gap
    assert [found[k] for k in which] == [("left", "right")] * 2 + [("right",)] * 3 + [
        ("left", "right")
    ] * 2


def test_views_accept_a_track_that_starts_late_or_ends():
    found, which = list_track_sets(
        [track("only", np.arange(4.0, 6.0, 0.1))], np.array([0.0, 3.9, 4.0, 5.85, 6.0, 9.0])
    )
    assert [found[k] for k in which] == [(), (), (), ("only",), (), ()]


def test_views_omit_touch_and_tracks_never_seen():
    frames = np.arange(0.0, 10.0, 0.1)
    tracks = [
        track("touch", frames, (2.0, 9.0)),
        track("never", frames, (-1.0, 11.0)),
        track("seen", frames),
    ]
    assert list_track_sets(tracks, frames)[0] == [("seen",)]


def test_settings_say_how_the_arm_moves_out_of_view(world, white_acceleration):
    hidden, seen = world(0, hidden=(8.0, 11.0)), world(0)
    found = estimate_from_features(hidden.features, hidden.body, EstimationSettings()).settings
    assert list(found["process_in_view"]) == ["none"]
    assert np.isfinite(found["process_in_view"]["none"]).all()
    assert (
        "process_in_view"
        not in estimate_from_features(seen.features, seen.body, EstimationSettings()).settings
    )
    # a smoother's error hardly depends on it
    assert (
        "process_in_view"
        not in estimate_from_features(
            hidden.features, hidden.body, EstimationSettings(method="smoother")
        ).settings
    )


@pytest.mark.parametrize("seed", range(2))
def test_walk_by_single_instants_equals_the_sweeps(world, seed):
    drawn = world(seed, hidden=(8.0, 11.0))
    problem = filtering.build_filter_problem(drawn.features, drawn.body, EstimationSettings())
    problem, _ = filtering.tune_noise(problem, EstimationSettings())
    precision = replace(
        problem.precision, process_by_view={(): problem.precision.process * np.array([1.0, 9.0, 4.0])}
    )
    problem = replace(problem, precision=precision)
    swept, walked = filter_log.solve_by_gauss_newton(problem), filter_log.filter_sequentially(problem)
    np.testing.assert_allclose(
        swept.trace.z, walked.trace.z, atol=1e-7
    )
    np.testing.assert_allclose(
        swept.trace.cov, walked.trace.cov, atol=1e-8
    )
