"""The verdict: what a person reads first."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.fault_kinds import FORMS
from bodylog.findings.verdict import verdict_of_batch, verdict_of_body, verdict_of_estimate
from bodylog.types import Capabilities, Fault, FaultKind, Health, Score
from tests.report.records import JOINTS, estimate

SOUND = estimate(faults=())
TRUTH = (Score("rmse/joint", 0.0072, "rad"), Score("rmse/encoders", 0.0196, "rad"))
TRUTH = (*TRUTH, Score("coverage_2sigma/joint", 95.9, "%"))


def test_verdict_of_a_sound_log_names_no_fault_and_its_error() -> None:
    assert verdict_of_estimate(SOUND, TRUTH) == (
        f"no fault found in {len(JOINTS)} encoders and effector",
        "error (RMSE) 0.0072 rad (0.413°), raw encoders 0.0196 rad (1.12°); 2σ covers 95.9 % of the truth",
    )


def test_verdict_without_truth_gives_typical_error_bars() -> None:
    typical = 2.0 * np.sqrt(np.median(np.einsum("nii->ni", SOUND.cov)))
    bar = f"± {typical:.3g} rad ({np.degrees(typical):.3g}°)"
    assert verdict_of_estimate(SOUND, ())[-1] == f"no truth to compare with; typical 2σ error bar {bar}"


@pytest.mark.parametrize(
    ("fault", "text"),
    [
        (
            Fault("encoders", JOINTS[0], FaultKind.DRIFTING, 8.8, 0.302, "rad"),
            "encoder drifts since 8.8 s, by 0.302 rad (17.3°)",
        ),
        (
            Fault("encoders", JOINTS[0], FaultKind.DRIFTING, 0.2, -0.1, "rad"),
            "encoder is off from the start, by -0.1 rad (-5.73°)",
        ),
        (Fault("encoders", JOINTS[0], FaultKind.JUMPING, 5.0, 0.2, "rad"), "encoder jumps by 0.2 rad (11.5°) at 5.0 s"),
        (
            Fault("encoders", JOINTS[0], FaultKind.JUMPING, 0.0, 0.2, "rad", until=0.5),
            "encoder is off by 0.2 rad (11.5°) 0.0 to 0.5 s",
        ),
        (Fault("encoders", JOINTS[0], FaultKind.FROZEN, 5.0, 0.0, "rad"), "encoder is frozen since 5.0 s"),
        (Fault("encoders", JOINTS[0], FaultKind.DEAD, 5.0, 0.0, "rad"), "encoder is silent since 5.0 s"),
        (
            Fault("encoders", JOINTS[0], FaultKind.OFFSET, 0.0, 0.1, "rad", 0.01),
            "encoder is off by 0.1 ± 0.01 rad (5.73 ± 0.57°) since 0.0 s",
        ),
        (Fault("encoders", JOINTS[0], FaultKind.GLITCH, 1.0, 2.0, "rad"), "encoder is off by 2 rad (115°) for a moment at 1.0 s"),
        (
            Fault("encoders", JOINTS[0], FaultKind.GLITCH, 0.0, 0.5, "rad", until=0.02),
            "encoder is off by 0.5 rad (28.6°) for a moment at 0.0 s",
        ),
    ],
)
def test_verdict_names_a_fault_first(fault: Fault, text: str) -> None:
    lines = verdict_of_estimate(replace(SOUND, faults=(fault,)), TRUTH)
    assert lines[0] == f"{fault.name}: {text}"
    assert lines[1] == f"no fault found in {len(JOINTS) - 1} encoders and effector"


def test_verdict_clears_no_encoder_that_is_left_out() -> None:
    errors = SOUND.errors["encoders"]
    values = errors.values.copy()
    values[:, 0] = np.nan
    unread = replace(SOUND, errors={**SOUND.errors, "encoders": replace(errors, values=values)})
    (line, *_) = verdict_of_estimate(unread, TRUTH)
    assert line == f"no fault found in {len(JOINTS) - 1} encoders and effector"


def test_a_moved_board_has_the_displacement_of_its_centre_and_its_turn() -> None:
    moved = Fault("vision", "board", FaultKind.MOVED, 0.0, 0.0031, "m", 0.0003, 0.0367, 0.001)
    lines = verdict_of_estimate(replace(SOUND, faults=(moved,)), TRUTH)
    displacement = "board: its centre moved since the body was learned, by 3.1 ± 0.3 mm"
    assert lines[0] == f"{displacement} and turned by 0.0367 ± 0.001 rad (2.1 ± 0.057°)"


def test_words_of_a_fault_stand_in_one_table(monkeypatch: pytest.MonkeyPatch) -> None:
    kind = ("encoders", FaultKind.FROZEN)
    monkeypatch.setitem(FORMS, kind, FORMS[kind]._replace(words="encoder sleeps {since}"))
    fault = Fault("encoders", JOINTS[0], FaultKind.FROZEN, 5.0, 0.0, "rad")
    assert verdict_of_estimate(replace(SOUND, faults=(fault,)), ())[0] == f"{JOINTS[0]}: encoder sleeps since 5.0 s"


def test_verdict_admits_ambiguity_between_two_joints() -> None:
    either = " or ".join(JOINTS[:2])
    fault = Fault("encoders", either, FaultKind.DRIFTING, 8.8, float("nan"), "rad")
    lines = verdict_of_estimate(replace(SOUND, faults=(fault,)), ())
    assert lines[0] == f"{either}: encoder drifts since 8.8 s (the log cannot tell which)"
    assert lines[1].startswith(f"no fault found in {len(JOINTS) - 2} encoder")


def test_verdict_excludes_tracks_of_a_faulty_camera() -> None:
    moved = Fault("vision", "camera", FaultKind.DISPLACED, 4.0, 12.0, "px", 1.0)
    lines = verdict_of_estimate(replace(SOUND, faults=(moved,)), ())
    assert lines[:2] == (
        "camera: camera moved since 4.0 s, by 12 ± 1 px in the image", f"no fault found in {len(JOINTS)} encoders"
    )  # fmt: skip


def test_verdict_stays_short_with_many_faults() -> None:
    many = tuple(Fault("encoders", f"j{k}", FaultKind.FROZEN, 1.0, 0.0, "rad") for k in range(9))
    lines = verdict_of_estimate(replace(SOUND, faults=many), TRUTH)
    assert len(lines) == 6 and lines[3] == "6 more faults: j3, j4, j5, j6, j7, j8"


def test_a_fourth_fault_is_reported_as_the_others() -> None:
    four = tuple(Fault("encoders", f"j{k}", FaultKind.FROZEN, 1.0, 0.0, "rad") for k in range(4))
    assert verdict_of_estimate(replace(SOUND, faults=four), TRUTH)[3] == "j3: encoder is frozen since 1.0 s"


def test_delays_are_stated_unless_they_are_tiny() -> None:
    settings = {**SOUND.settings, "delay": {"camera": 0.062, "side": -0.005, "third": 2e-4}}
    lines = verdict_of_estimate(replace(SOUND, settings=settings), ())
    assert lines[:2] == ("camera: timestamps are 62 ms late; corrected", "side: timestamps are 5 ms early; corrected")
    assert not any("third" in line for line in lines)


def test_verdict_omits_unchecked_faults_from_sound_senses() -> None:
    blind = replace(SOUND, used={"encoders": Health(10, 10), "effector": Health(5, 0)})
    assert verdict_of_estimate(blind, ())[0].endswith("encoders; without images, an encoder offset cannot be found")
    simple = replace(SOUND, method="kalman", can=Capabilities(repairs=False))
    assert verdict_of_estimate(simple, ())[0].endswith("; kalman does not look for encoder offsets")


def test_body_verdict_states_holdout_error_and_sure_offsets() -> None:
    scores = (
        Score("rmse/held_out/tip", 0.39, "px"), Score("nis/held_out/tip", 1.3, "1"),
        Score("offset/pan", 0.035, "rad"), Score("std/offset/pan", 0.002, "rad"),
        Score("offset/lift", 0.001, "rad"), Score("std/offset/lift", 0.002, "rad"),
    )  # fmt: skip
    assert verdict_of_body(("pan", "lift"), scores) == (
        "learned over 2 joints: pan, lift",
        "tip: error 0.39 px on held-out parts of the log; its error bars are 12 % too narrow (NIS 1.30)",
        "pan: zero is off by +0.035 ± 0.002 rad (+2.01 ± 0.11°)",
    )
    rail = (Score("offset/rail", 0.004, "m"), Score("std/offset/rail", 0.001, "m"))
    assert verdict_of_body(("rail",), rail, ("board in hand: 1.0 ± 0.1 mm",)) == (
        "learned over 1 joint: rail",
        "board in hand: 1.0 ± 0.1 mm",
        "rail: zero is off by +4 ± 1 mm",
    )


@pytest.mark.parametrize(
    ("nis", "text"),
    [
        (0.77, "its error bars are 14 % too wide (NIS 0.77)"),
        (1.05, "its error bars are true to 5 % (NIS 1.05)"),
        (4.0, "its error bars are 50 % too narrow (NIS 4.00)"),
    ],
)
def test_body_verdict_says_how_far_error_bars_are_from_the_errors(nis: float, text: str) -> None:
    scores = Score("rmse/held_out/tip", 0.39, "px"), Score("nis/held_out/tip", nis, "1")
    assert verdict_of_body(("pan",), scores)[1].endswith(f"; {text}")


def test_body_verdict_names_all_joints_and_those_not_learned() -> None:
    names = tuple(f"j{k}" for k in range(8))
    (line,) = verdict_of_body(names, (), others=("gripper",))
    assert line == f"learned over 8 joints: {', '.join(names)}; not over gripper; -v says why"


def test_batch_verdict_counts_outcomes_and_names_the_worst() -> None:
    ended = (("a", "passed", {"rmse/joint": 0.01}), ("b", "passed", {"rmse/joint": 0.03}), ("c", "unusable", {}))
    assert verdict_of_batch([{"name": name, "status": status, "scores": scores} for name, status, scores in ended]) == (
        "3 logs: 2 passed, 1 unusable",
        "error (RMSE): median 0.02 rad (1.15°), largest 0.03 rad (1.72°) in b",
    )


def test_verdict_by_the_surface_says_which_offsets_it_would_not_find() -> None:
    settings = {"least_offsets": {JOINTS[0]: {"value": 0.1, "unit": "rad"}, JOINTS[1]: None}}
    (line,) = [text for text in verdict_of_estimate(replace(SOUND, settings=settings), ()) if "no fault found" in text]
    assert line.endswith(
        "; error bars hold no offset: "
        f"smaller offsets than {JOINTS[0]} 0.1 rad (5.73°) would not be found; of {JOINTS[1]} none would be found"
    )
