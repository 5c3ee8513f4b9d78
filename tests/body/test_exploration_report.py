import numpy as np
import pytest

from bodylog.body.data.pairs import smooth_all_joints
from bodylog.body.exploration_report import (
    exploration_scores,
    faint_findings,
    joint_influence,
    still_findings,
)
from bodylog.body.gp.fit import samples_without_noise, train_gp
from bodylog.body_model import Noise


def test_influence_is_the_rms_effect_of_each_input() -> None:
    draw = np.random.default_rng(0)
    x = draw.normal(0, [0.2, 0.1, 0.2], (80, 3))
    y = np.column_stack([100 * x[:, 0], 50 * x[:, 1]]) + draw.normal(0, 0.01, (80, 2))
    expected = x.std(axis=0) * [100.0, 50.0, 0.0]
    assert np.allclose(joint_influence(train_gp(samples_without_noise(x, y), ("u", "v"), "px")), expected, atol=0.1)


def test_joints_that_vision_does_not_observe_are_named(explored) -> None:
    run = explored(0, 0.003, 15.0)
    known = smooth_all_joints([run.features], None)
    x = run.angles.copy()
    x[:, 2] = np.random.default_rng(0).normal(0, 1e-3, len(x))
    y = np.column_stack([100 * x[:, 0], 80 * x[:, 1]]) + np.random.default_rng(1).normal(0, 0.3, (len(x), 2))
    gp, noise = train_gp(samples_without_noise(x, y), ("u", "v"), "px"), Noise((1e-5,) * 3, {"effector": (0.09, 0.09)}, (0.1,) * 3)
    texts = [*still_findings(known, known[:3]), *faint_findings(known[:3], {"effector": gp}, noise)]
    assert [(f.severity, f.text.split(":")[0]) for f in texts] == [("info", "wrist"), ("warning", "elbow")]
    values = {s.name: s for s in exploration_scores(known[:3], {"effector": gp}, noise)}
    assert values["range/pan"].unit == "rad" and values["influence/effector/pan"].value > 10
    ratio = values["std/model/effector"].value / 0.3
    assert values["std_over_noise/model/effector"].value == pytest.approx(ratio)


def test_a_board_gives_one_warning_for_a_joint_however_many_corners_it_has(explored) -> None:
    known = smooth_all_joints([explored(0, 0.003, 15.0).features], None)
    draw = np.random.default_rng(0)
    x = draw.normal(0, [0.2, 0.2, 1e-3], (80, 3))
    y = np.column_stack([100 * x[:, 0], 80 * x[:, 1]]) + draw.normal(0, 0.3, (80, 2))
    gp = train_gp(samples_without_noise(x, y), ("u", "v"), "px")
    corners = {f"board.{k}": gp for k in range(4)}
    noise = Noise((1e-5,) * 3, dict.fromkeys(corners, (0.09, 0.09)), (0.1,) * 3)
    (text,) = (one.text for one in faint_findings(known[:3], corners, noise))
    assert text.startswith("elbow: ") and ", board only " in text
    names = [one.name for one in exploration_scores(known[:3], corners, noise)]
    assert names.count("influence/board/pan") == 1 and "influence/board.0/pan" not in names
