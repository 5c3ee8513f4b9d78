"""The headline: the figures that a person looks for first."""

from dataclasses import replace

import numpy as np

from bodylog.evaluation.figures import MEASURED_DELAYS, MISFIT
from bodylog.findings.headline import NAMES, headline_of_estimate
from bodylog.robot.effector_poses import CALIBRATED
from bodylog.types import Fault, FaultKind, Score
from tests.report.records import JOINTS, estimate

SOUND = estimate(faults=())


def _innovations(*errors: float) -> tuple[Score, ...]:
    return tuple(Score(f"rmse/innovation/tag{k}", error, "px") for k, error in enumerate(errors))


def test_a_sound_log_without_truth_has_four_figures() -> None:
    typical = 2.0 * np.sqrt(np.median(np.einsum("nii->ni", SOUND.cov)))
    assert headline_of_estimate(SOUND, _innovations(0.4321)) == {
        "faults": "none found",
        "error bar (2σ)": f"± {typical:.3g} rad ({np.degrees(typical):.3g}°)",
        "reprojection error (RMS)": "0.43 px (tag0)",
        "delay": "not measured",
    }


def test_the_error_stands_where_there_is_truth() -> None:
    found = headline_of_estimate(SOUND, (Score("rmse/joint", 0.0072, "rad"),))
    assert tuple(found) == (*NAMES[:4], "delay") and found["error (RMSE)"] == "0.0072 rad (0.413°)"
    assert found["reprojection error (RMS)"] == "–"


def test_faults_have_their_sizes_and_a_log_that_does_not_fit_has_none() -> None:
    drift = Fault("encoders", JOINTS[0], FaultKind.DRIFTING, 8.8, 0.302, "rad", 0.01)
    frozen = Fault("encoders", JOINTS[1], FaultKind.FROZEN, 5.0, 0.0, "rad")
    either = Fault("encoders", " or ".join(JOINTS[:2]), FaultKind.OFFSET, 5.0, float("nan"), "rad")
    shown = headline_of_estimate(replace(SOUND, faults=(drift, frozen, either)), ())["faults"]
    drifting = f"{JOINTS[0]} drifting by 0.302 ± 0.01 rad (17.3 ± 0.57°)"
    assert shown == f"{drifting}, {JOINTS[1]} frozen, {either.name} offset"
    settings = {**SOUND.settings, MISFIT: {"text": "98 % are off"}}
    shown = headline_of_estimate(replace(SOUND, faults=(drift,), settings=settings), ())["faults"]
    assert shown == "not given: the log does not fit the body"


def test_of_many_tracks_the_median_and_the_largest_stand() -> None:
    shown = headline_of_estimate(SOUND, _innovations(0.4, 0.5, 0.6, 0.5, 3.0))["reprojection error (RMS)"]
    assert shown == "0.5 px (median of 5 tracks), largest 3 px (tag4)"


def test_a_board_is_one_thing_in_px_and_mm_and_zeros_beyond_two_sigma_stand() -> None:
    zeros = {
        "lift": {"value": 0.02, "std": 0.005, "unit": "rad"},
        "elbow": {"value": 0.02, "std": 0.011, "unit": "rad"},
        "rail": {"value": -0.003, "std": 0.001, "unit": "m"},
        "pan": {"value": None, "std": 0.09, "unit": "rad"},
    }
    calibrated = {"board": {"mm_per_px": 0.5, "px": 2.0, "mm": 1.0}}
    settings = {"offsets": zeros, CALIBRATED: calibrated, "motion": "none"}
    scores = [Score(f"rmse/innovation/board.{k}", error, "px") for k, error in enumerate((0.3, 0.4, 0.5, 0.6))]
    shown = headline_of_estimate(replace(SOUND, settings=settings), scores)
    assert shown["reprojection error (RMS)"] == "0.46 px, 0.23 mm (board)"
    assert shown["error of the calibration alone"] == "2 px, 1 mm (board)"
    assert shown["zeros off by more than 2σ"] == "lift +1.15° ± 0.29°, rail -3.00 mm ± 1.00 mm"
    assert shown["delay"] == "none: the poses stand still"
    sound = {**settings, "offsets": {"elbow": zeros["elbow"]}}
    assert headline_of_estimate(replace(SOUND, settings=sound), ())["zeros off by more than 2σ"] == "none"


def test_a_delay_says_whether_it_is_corrected() -> None:
    both = {"seconds": 0.062, "std_error": 0.001, "evident": True, "doubt": ""}
    other = {
        "seconds": -0.004,
        "std_error": 0.002,
        "evident": True,
        "doubt": "the joints hardly move",
    }
    settings = {"delay": {"camera": 0.062}, MEASURED_DELAYS: {"camera": both, "left": other}}
    shown = headline_of_estimate(replace(SOUND, settings=settings), ())["delay"]
    assert shown == "62 ± 1 ms (camera, corrected), -4 ± 2 ms (left, not corrected)"
