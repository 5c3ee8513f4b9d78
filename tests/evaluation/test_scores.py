"""Figures of merit on estimates whose error is known exactly."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.estimation import METHODS
from bodylog.evaluation.scores import score_angles
from bodylog.findings.faults import truth_findings
from bodylog.types import Estimate, Health, Series


def made(error, std, n=500, names=("a", "b")):
    t = np.arange(n) * 0.01
    truth = np.stack([np.sin(t), np.cos(t)], axis=1)
    ns = (t * 1e9).astype(np.int64)
    found = Estimate(
        "filter", Series(t, truth + error, names, "rad", ns), Series(t, 0 * truth, names, "rad/s", ns),
        np.repeat(np.eye(2)[None] * std**2, n, axis=0), {"effector": Series(t, truth * 0 + 2.0, ("u", "v"), "std", ns)},
        np.full(n, 1.5), {"effector": Health(9, 7)}, {}, {}, {},
    )  # fmt: skip
    return found, Series(t, truth, names, "rad", ns)


def named(found, truth, joints=None):
    return {score.name: score for score in score_angles(found, truth, joints)}


def test_scores_have_the_right_values_and_units():
    found, truth = made(np.array([0.03, 0.04]), 0.05)
    score = named(found, truth)
    assert score["rmse/joint"].value == pytest.approx(np.sqrt((0.03**2 + 0.04**2) / 2))
    assert (score["rmse/joint/a"].value, score["rmse/joint/b"].value) == pytest.approx((0.03, 0.04))
    assert score["nees/joint"].value == pytest.approx((0.36 + 0.64) / 2)
    assert score["nees/joint/b"].value == pytest.approx(0.64)
    assert score["coverage_2sigma/joint"].value == 100.0
    assert score["nis/effector"].value == 4.0
    assert (score["free_energy"].value, score["used/effector"].value) == (1.5, 7.0)
    units = {name: score[name].unit for name in ("rmse/joint", "nees/joint", "coverage_2sigma/joint", "free_energy")}
    assert units == {"rmse/joint": "rad", "nees/joint": "1", "coverage_2sigma/joint": "%", "free_energy": "nats"}


@pytest.mark.parametrize("seed", range(3))
def test_nees_of_true_gaussian_errors_is_one(seed):
    error = np.random.default_rng(seed).normal(0, 0.1, (4000, 2))
    t = np.arange(4000) * 0.01
    found, truth = made(np.zeros(2), 0.1, 4000)
    found.joints.values[:] += error
    score = named(found, truth)
    assert score["nees/joint"].value == pytest.approx(1.0, abs=0.06)
    assert score["coverage_2sigma/joint"].value == pytest.approx(95.45, abs=1.0)
    assert len(t) == 4000


def test_nees_of_a_zero_error_bar_is_infinite():
    found, truth = made(np.array([0.03, 0.04]), 0.05)
    cov = found.cov.copy()
    cov[7] = 0.0
    score = named(replace(found, cov=cov), truth)
    assert score["nees/joint"].value == score["nees/joint/a"].value == np.inf
    assert score["coverage_2sigma/joint"].value < 100.0


def test_correlated_errors_are_judged_by_the_full_covariance():
    found, truth = made(np.array([0.1, 0.1]), 0.1)
    found.cov[:, 0, 1] = found.cov[:, 1, 0] = 0.009
    expected = np.array([0.1, 0.1]) @ np.linalg.solve(found.cov[0], [0.1, 0.1]) / 2
    assert named(found, truth)["nees/joint"].value == pytest.approx(expected)


def test_truth_is_matched_by_name_and_between_its_stamps():
    found, truth = made(np.zeros(2), 0.1)
    turned = Series(truth.t[::4], truth.values[::4, ::-1], ("b", "a"), "rad", truth.source_ns[::4])
    assert named(found, turned)["rmse/joint"].value < 3e-4


def test_times_beyond_the_truth_are_left_out():
    found, truth = made(np.zeros(2), 0.1)
    short = Series(truth.t[:100], truth.values[:100], truth.names, "rad", truth.source_ns[:100])
    assert named(found, short)["rmse/joint"].value < 1e-12


def test_encoders_are_scored_beside_and_may_hold_nan():
    found, truth = made(np.zeros(2), 0.1)
    noisy = truth.values + 0.02
    noisy[3] = np.nan
    joints = Series(truth.t, noisy, truth.names, "rad", truth.source_ns)
    assert named(found, truth, joints)["rmse/encoders"].value == pytest.approx(0.02)
    assert "rmse/encoders" not in named(found, truth)


def test_encoders_that_read_no_angles_are_not_held_to_angles():
    found, truth = made(np.zeros(2), 0.1)
    learned = replace(found, settings={"encoders_read": "as learned", "sigma_encoders": [1.0, 1.0]})
    assert not [name for name in named(learned, truth, truth) if name.startswith("encoder")]
    assert "rmse/encoders" in named(found, truth, truth)


def test_scores_without_truth_omit_figures_that_need_it():
    found, truth = made(np.zeros(2), 0.1)
    assert set(named(found, None, truth)) == {"free_energy", "log_evidence", "nis/effector", "used/effector"}
    stranger = Series(truth.t, truth.values, ("x", "y"), "rad", truth.source_ns)
    assert "rmse/joint" not in named(found, stranger)
    assert named(found, stranger, truth).keys() == named(found, None, truth).keys()
    assert truth_findings(found, truth) == ()
    assert "the truth is of x, y, the estimate of" in truth_findings(found, stranger)[0].text
    assert "no truth topic" in truth_findings(found, None)[0].text


def test_evidence_is_summed_for_methods_that_have_one():
    found, _ = made(np.zeros(2), 0.1)
    assert named(found, None)["log_evidence"].value == pytest.approx(-1.5 * 500)
    assert "log_evidence" not in named(replace(found, can=METHODS["predictive-coding"].can), None)


def test_tracks_are_scored_in_pixels_where_they_were_seen():
    found, _ = made(np.zeros(2), 0.1)
    t = np.arange(1000) * 0.005
    std = np.tile([3.0, 4.0], (1000, 1))
    place = Series(t, np.zeros((1000, 2)), ("u", "v"), "px", (t * 1e9).astype(np.int64), std)
    score = named(replace(found, predicted={"effector": place}), None)["rmse/innovation/effector"]
    assert (score.value, score.unit) == (pytest.approx(2.0 * np.sqrt(12.5)), "px")
