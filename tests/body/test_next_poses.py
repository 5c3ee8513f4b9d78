"""Postures proposed for a calibration are visible, within limits, and narrow it more than random ones."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bodylog import body
from bodylog.body import storage as files
from bodylog.body.gp.model import GP
from bodylog.body.kinematic.learn import learn_kinematics
from bodylog.body.kinematic.next_poses import (
    is_surely_visible,
    kinematic_senses,
    propose_postures,
    random_postures,
)
from bodylog.errors import EvidenceError
from bodylog.settings import Settings
from tests.body.boards import features
from tests.body.kinematic_arms import given
from tests.kinematics import robots
from tests.kinematics.robots import ARM, JOINTS

LIMITS = {"pan": SimpleNamespace(lower=-0.5, upper=0.5), "elbow": SimpleNamespace(lower=0.2, upper=1.4)}


@pytest.fixture(scope="module")
def learned():
    explored = features(robots.angles(12))
    return learn_kinematics([explored], Settings(), body.learn_body([explored], Settings(), {}, None, True), given()).model


def test_random_postures_keep_to_the_limits(learned):
    postures = random_postures(learned, LIMITS)
    samples = np.concatenate([one.samples for one in kinematic_senses(learned, "a calibration").values()])
    for m, joint in enumerate(JOINTS):
        limit = LIMITS.get(joint, SimpleNamespace(lower=samples[:, m].min(), upper=samples[:, m].max()))
        assert limit.lower <= postures[:, m].min() and postures[:, m].max() <= limit.upper
        assert np.ptp(postures[:, m]) > 0.9 * (limit.upper - limit.lower)


def test_proposed_postures_leave_less_variance_than_random_ones(learned):
    """The same set and the same figures by another way: sightings as one block, and 30 random sets."""
    count = 4
    candidates = random_postures(learned, LIMITS)
    senses = kinematic_senses(learned, "a calibration")
    shown = [is_surely_visible(learned, sense, candidates) for sense in senses.values()]
    seen = candidates[np.all(shown, axis=0)][:40]
    found = propose_postures(learned, count, seen)
    assert len({tuple(one) for one in found.postures.tolist()}) == count
    assert (np.diff(found.std_px) < 0.0).all()
    draw = np.random.default_rng(3)
    sets = [found.postures[:0], found.postures, *(draw.choice(seen, count, replace=False) for _ in range(30))]
    left = [np.sqrt(_left_of_variance(learned, senses, seen, one).mean()) for one in sets]
    np.testing.assert_allclose(found.std_px[[0, -1]], left[:2], rtol=1e-6)
    assert left[1] < min(left[2:])


def _left_of_variance(model, senses, x, recorded):
    """Variance (N,) px² of predictions of all tracks at x (K,M) once `recorded` (n,M) are seen: one number after another."""
    both = np.concatenate([recorded, x])
    unknown = np.concatenate([sense.unknowns(both) for sense in senses.values()], axis=1)
    width = unknown.shape[1]
    covariance = np.einsum("nrp,msp->nrms", unknown, unknown)
    for r, (sense, d) in enumerate((sense, d) for sense in senses.values() for d in range(2)):
        covariance[:, r, :, r] += GP.covariance(sense, both)[0] * sense.share[d]
    covariance = covariance.reshape(len(both) * width, -1)
    noise = np.concatenate([model.noise.senses[name] for name in senses])
    for row in range(len(recorded) * width):
        gain = covariance[:, row] / (covariance[row, row] + noise[row % width])
        covariance = covariance - np.outer(gain, covariance[row])
    return np.diag(covariance)[len(recorded) * width :]


def test_postures_out_of_sight_are_refused(learned):
    narrow = replace(learned, provenance={**learned.provenance, "image_sizes": {"camera": [20, 20]}})
    with pytest.raises(EvidenceError, match="0 of 5 postures would be seen, 2 are needed"):
        propose_postures(narrow, 2, robots.angles(5))


def test_command_prints_postures(learned, tmp_path, run_cli, capsys):
    files.save(learned, tmp_path / "body.npz")
    (tmp_path / "arm.urdf").write_text(ARM)
    typed = ("calibration", tmp_path / "body.npz", "--next", "2")
    assert run_cli(*typed) == 2 and "--among POSES.csv" in capsys.readouterr().err
    assert run_cli(*typed, "--urdf", tmp_path / "arm.urdf") == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].startswith("now the body predicts images to ± ")
    assert printed[1].startswith("1: pan ") and len(printed) == 3
    table = tmp_path / "safe.csv"
    rows = robots.angles(20, seed=4)
    table.write_text("\n".join([",".join(JOINTS), *(",".join(map(repr, row.tolist())) for row in rows)]) + "\n")
    assert run_cli(*typed, "--among", table, "--json") == 0
    found = json.loads(capsys.readouterr().out)["results"][0]["next"]
    for posture in found["postures"]:
        assert np.abs(rows - np.array([posture[name] for name in JOINTS])).max(axis=1).min() < 1e-9
    assert len(found["std_px"]) == 3
    table.write_text("pan,lift\n0.1,0.2\n0.3,0.1\n")
    assert run_cli(*typed, "--among", table) == 65
    assert "safe.csv: joint 'elbow' of the body is missing; it has pan, lift" in capsys.readouterr().err
