"""Whether error bars are true, over ten seeds of simulated reaches: the table is printed, its means are held to bounds.

A smooth error has few independent samples in 20 s, so that one log says little: means over seeds are judged, and
printed with their standard errors.
"""

from dataclasses import replace

import numpy as np
import pytest

from bodylog import body, pipeline, sim
from bodylog.estimation import estimate
from bodylog.evaluation.scores import scores
from bodylog.settings import Estimation, Settings

SEEDS = range(10)
HIDDEN = (9.0, 11.0)
METHODS = ("laplace", "smoother")
COLUMNS = ("joint_rmse", "nees", "coverage_2sigma", "hidden nees", "hidden coverage")
pytestmark = pytest.mark.soak


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """{method: {score: values (seeds,)}}, hidden ones over the two seconds in which nothing is seen."""
    pytest.importorskip("pybullet")
    folder, found = tmp_path_factory.mktemp("reaches"), {method: {} for method in METHODS}
    for seed in SEEDS:
        seen = []
        for scenario in ("babble", "reach"):
            sim.record(scenario, folder / "log.mcap", seed=seed, size=(320, 240))
            seen.append(pipeline.observe(folder / "log.mcap", Settings()))
        learned = body.learn([seen[0][1]], Settings(), {}).model
        for method in METHODS:
            for name, value in row(*seen[1], learned, method).items():
                found[method].setdefault(name, []).append(value)
    show(found)
    return found


def row(recording, features, learned, method):
    belief = estimate(features, learned, Estimation(method=method))
    assert not belief.faults
    hidden = {f"hidden {s.name}": s.value for s in scores(within(belief, *HIDDEN), recording.truth, None)}
    whole = {s.name: s.value for s in scores(belief, recording.truth, None)}
    return whole | hidden | {"hidden coverage": hidden["hidden coverage_2sigma"]}


def within(belief, low, high):
    """The belief between two times, all that scores against truth look at."""
    rows = (belief.joints.t >= low) & (belief.joints.t <= high)
    joints = replace(belief.joints, t=belief.joints.t[rows], values=belief.joints.values[rows])
    return replace(belief, joints=joints, cov=belief.cov[rows], free_energy=belief.free_energy[rows], errors={})


def show(found):
    joints = [name for name in found["laplace"] if name.startswith("nees/")]
    for method, columns in found.items():
        for name in (*COLUMNS, *joints):
            values = np.array(columns[name])
            error = values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.nan
            print(f"{method:9s} {name:32s} {values.mean():10.4f} ± {error:.4f}")


@pytest.mark.parametrize("method", METHODS)
def test_error_bars_of_every_joint_are_true_over_the_seeds(table, method):
    joints = {name: np.mean(values) for name, values in table[method].items() if name.startswith("nees/")}
    assert joints and all(0.85 < mean < 1.2 for mean in joints.values()), joints


@pytest.mark.parametrize("method", METHODS)
def test_two_standard_deviations_hold_nineteen_in_twenty(table, method):
    assert 93.0 < np.mean(table[method]["coverage_2sigma"]) < 97.0


@pytest.mark.parametrize("method", METHODS)
def test_error_bars_stay_true_where_nothing_is_seen(table, method):
    assert 0.85 < np.mean(table[method]["hidden nees"]) < 1.2
    assert 93.0 < np.mean(table[method]["hidden coverage"]) < 97.0
