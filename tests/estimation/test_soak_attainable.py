"""How near the belief about simulated reaches comes to what could be known, over ten seeds.

What could be known: the same filter and smoother, but with a body learned from true angles, the true encoder noise and
the constant process noise of least error against truth.
"""

from dataclasses import replace

import numpy as np
import pytest

from bodylog import body
from bodylog.estimation import estimate
from bodylog.experiments.lab import Lab
from bodylog.settings import Body, Estimation, Settings

SEEDS = range(10)
FACTORS = {"laplace": 1.10, "smoother": 1.20}
ENCODER_STD = 0.02
PROCESSES = np.geomspace(0.003, 3.0, 10)
pytestmark = pytest.mark.soak


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    pytest.importorskip("pybullet")
    return Lab(tmp_path_factory.mktemp("reaches"))


def error(heard, found):
    return float(np.sqrt(np.mean((found.joints.values - heard.true(found.joints.names, found.joints.t)) ** 2)))


def attainable(heard, told, method):
    """Least error (rad) of a belief that is told everything."""
    settings = Estimation(method=method, precision="model", bias="off")
    noise = [replace(told.noise, encoder=(ENCODER_STD**2,) * 3, process=(q,) * 3) for q in PROCESSES]
    return min(error(heard, estimate(heard.features, replace(told, noise=one), settings)) for one in noise)


@pytest.mark.parametrize("method", FACTORS)
def test_the_error_is_close_to_the_attainable_over_the_seeds(lab, method):
    ratios = []
    for seed in SEEDS:
        explored, heard = lab.heard("babble", seed, duration=lab.exploration), lab.heard("reach", seed)
        own = lab.body("default", seed)
        settings = Settings(body=Body(joints=own.joints))
        told = body.learn([replace(explored.features, reference=explored.truth)], settings, {}).model
        mine = error(heard, estimate(heard.features, own, Estimation(method=method)))
        ratios.append(mine / attainable(heard, told, method))
        print(f"{method} {seed} {mine:.5f} rad, {ratios[-1]:.3f} times the attainable")
    print(f"{method}: {np.mean(ratios):.3f} ({np.min(ratios):.3f} to {np.max(ratios):.3f}) times the attainable")
    assert np.mean(ratios) <= FACTORS[method]
