"""Bodies learned with a URDF: predictions, derivatives, files, and URDFs of other robots."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog import body
from bodylog.body import storage as files
from bodylog.body.gp.marginal_likelihood import Hyper, cholesky_with_jitter, independent_noise
from bodylog.body.gp.model import GP, se_kernel
from bodylog.body.kinematic.explicit import (
    ResidualRows,
    hold_out_blocks,
    residual_evidence,
    solve_linear_unknowns,
)
from bodylog.body.kinematic.learn import learn_kinematics
from bodylog.body.kinematic.model import KinematicGP
from bodylog.body_model import UNUSED_URDF
from bodylog.errors import ModelError
from bodylog.settings import Settings
from tests.body.kinematic_arms import DEGREE, OFFSETS, bend_places, features, given
from tests.kinematics import robots
from tests.kinematics.robots import ARM, JOINTS

STEP = 1e-6


@pytest.fixture(scope="module")
def plain():
    return body.learn_body([features()], Settings(), {})


@pytest.fixture(scope="module")
def learned(plain):
    return learn_kinematics([features()], Settings(), plain, given())


def _truth(q, bend=3.0):
    rig = robots.rig(known=False)
    return rig.see(rig.sights[0], robots.truth(rig, OFFSETS), q).image[:, 0] + bend_places(q, bend)


def test_kinematic_gp_predicts_better_than_a_plain_gp(plain, learned):
    q = robots.angles(300, seed=8)
    alone, both = plain.model.senses["effector"], learned.model.senses["effector"]
    assert isinstance(both, KinematicGP)
    errors = [model.predict(q)[0] - _truth(q) for model in (alone, both)]
    sizes = [np.sqrt(np.square(error).mean()) for error in errors]
    assert sizes[1] < 0.5 * sizes[0] and sizes[1] < 1.5
    standard = np.square(errors[1]) / both.predict(q)[2]
    assert 0.4 < standard.mean() < 1.6 and (standard < 4).mean() > 0.9


def test_kinematic_gp_extrapolates_by_kinematics_with_growing_error_bars(plain, learned):
    q = robots.angles(300, seed=8) * [2.0, 1.0, 1.0, 1.0]
    beyond = np.abs(q[:, 0]) > 0.8
    alone, both = plain.model.senses["effector"], learned.model.senses["effector"]
    errors = [
        np.sqrt(np.square(m.predict(q[beyond])[0] - _truth(q[beyond])).mean())
        for m in (alone, both)
    ]
    assert errors[1] < 0.3 * errors[0]
    spread = both.predict(q)[2]
    assert spread[beyond].mean() > 3 * spread[~beyond].mean()
    standard = np.square(both.predict(q[beyond])[0] - _truth(q[beyond])) / spread[beyond]
    assert (standard < 4).mean() > 0.85


def test_slopes_are_finite_differences_and_one_point_equals_many(learned):
    gp, x = learned.model.senses["effector"], robots.angles(6, seed=3)
    value, slope, spread = gp.predict(x)
    numeric = [(gp.predict(x + s)[0] - gp.predict(x - s)[0]) / (2 * STEP) for s in STEP * np.eye(4)]
    np.testing.assert_allclose(slope, np.stack(numeric, axis=-1), atol=1e-3)
    for k in range(6):
        for one, many in zip(gp.predict_one(x[k]), (value[k], slope[k], spread[k]), strict=True):
            np.testing.assert_allclose(one, many, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(gp.means(x)[0], value, atol=1e-9)
    np.testing.assert_allclose(
        gp.covariance(x)[0].diagonal(), (spread - gp.drift).mean(axis=1), rtol=0.05
    )


def test_zeros_are_found_and_unidentified_ones_are_named(learned):
    scores = {score.name: score.value for score in learned.scores}
    assert "offset/pan" not in scores and "offset/wrist" not in scores
    for name, true in OFFSETS.items():
        assert (
            abs(scores[f"offset/{name}"] - true) < 3 * scores[f"std/offset/{name}"] < 4.5 * DEGREE
        )
    text = [finding.text for finding in learned.findings]
    assert any("pan: its zero cannot be separated from camera's" in line for line in text)


def test_storage_keeps_the_kinematic_model_exactly(learned, tmp_path):
    files.save(learned.model, tmp_path / "body.npz")
    found, x = files.load_body(tmp_path / "body.npz"), robots.angles(5, seed=4)
    both = (one.senses["effector"].predict(x) for one in (found, learned.model))
    for one, other in zip(*both, strict=True):
        assert np.array_equal(one, other)
    files.save(found, tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "body.npz").read_bytes()


BROKEN = {
    "steps": lambda steps: np.where(np.arange(4) == 0, 7.0, steps),
    "doubt": lambda doubt: doubt[:-1],
    "root": lambda root: root * np.nan,
}


@pytest.mark.parametrize("field", BROKEN)
def test_storage_refuses_inconsistent_fields_by_name(learned, tmp_path, field, monkeypatch):
    from bodylog.body.kinematic import storage

    arrays = storage.kinematic_arrays
    monkeypatch.setattr(
        storage,
        "kinematic_arrays",
        lambda one: (a := arrays(one)) | {field: BROKEN[field](a[field])},
    )
    files.save(learned.model, tmp_path / "body.npz")
    with pytest.raises(ModelError, match="field effector"):
        files.load_body(tmp_path / "body.npz")


OTHERS = {
    "wrong axis": ARM.replace('<axis xyz="0.1 1 0"/>', '<axis xyz="1 0 0.1"/>'),
    "no lengths": ARM.replace("0 -0.05 0.4", "0 0 0").replace("0 0 0.35", "0 0 0").replace("0 0.1 0", "0 0 0")
    .replace("0 0 0.3\"", "0 0 0\"").replace("0 0.05 0.1", "0 0 0"),
    "millimetres": ARM.replace("0 -0.05 0.4", "0 -50 400"),
    "another joint": ARM.replace('name="lift"', 'name="shoulder"'),
    "a long arm": ARM.replace("0 -0.05 0.4", "0 -0.0625 0.5"),
}  # fmt: skip


@pytest.mark.parametrize("which", OTHERS)
def test_learn_names_and_ignores_another_robots_urdf(plain, which):
    found = learn_kinematics([features()], Settings(), plain, given(OTHERS[which]))
    assert found.model is plain.model
    answer = found.findings[-1]
    assert answer.severity == "warning" and answer.text.startswith("the URDF is not used: ")


def test_learn_names_a_chain_joint_without_readings(plain):
    lifted = ARM.replace('<link name="base"/>', '<link name="base"/><link name="rail"/>').replace(
        '<joint name="lift"',
        '<joint name="lifter" type="prismatic"><parent link="rail"/><child link="turret"/></joint><joint name="lift"',
    )
    lifted = lifted.replace('<child link="turret"/>\n', '<child link="rail"/>\n')
    found = learn_kinematics([features()], Settings(), plain, given(lifted))
    assert found.model is not plain.model
    text = "lifter: between camera and marker"
    assert any(f.severity == "warning" and f.text.startswith(text) for f in found.findings)


def test_learn_refuses_a_urdf_that_lacks_a_joint(plain):
    text = ARM
    for name in JOINTS:
        text = text.replace(f'name="{name}"', f'name="left_{name}"')
    with pytest.raises(ModelError, match=r"none of the joints that moved \(pan, lift"):
        learn_kinematics([features()], Settings(), plain, given(text))


def test_learn_finds_and_reports_a_slow_error():
    sizes = {}
    for drift in (0.0, 2.0):
        some = features(bend=0.0, drift=drift)
        found = learn_kinematics(
            [some], Settings(), body.learn_body([some], Settings(), {}), given()
        )
        sizes[drift] = {score.name: score.value for score in found.scores}["std/lasting/effector"]
    assert sizes[0.0] < 0.1 and 0.5 < sizes[2.0] < 4.0


def test_learn_without_a_urdf_keeps_the_tracks_and_knows_no_links(plain):
    found = body.with_kinematics([features()], Settings(), plain, None)
    assert set(found.model.senses) == set(plain.model.senses)
    assert not any(isinstance(sense, KinematicGP) for sense in found.model.senses.values())


def _rows(count=25, unknowns=3):
    draw = np.random.default_rng(2)
    x = draw.uniform(-1, 1, (count, 2))
    spread = independent_noise(np.full((count, 2), 0.1) * [1.0, 2.0])
    return ResidualRows(
        x, draw.normal(size=(count, 2)), draw.normal(size=(count, 2, unknowns)), spread
    )


def test_evidence_is_that_of_the_full_covariance_with_its_gradient():
    rows, kernel = _rows(), Hyper(np.array([0.7, 1.2]), 0.8, 0.2)
    value, gradient = residual_evidence(kernel.theta, rows)
    assert value == pytest.approx(_whole(rows, kernel)[0], rel=1e-6)
    steps = STEP * np.eye(4)
    numeric = [
        (
            residual_evidence(kernel.theta + s, rows)[0]
            - residual_evidence(kernel.theta - s, rows)[0]
        )
        / (2 * STEP)
        for s in steps
    ]
    np.testing.assert_allclose(gradient, numeric, rtol=1e-5)


def _whole(rows, kernel):
    """Evidence (nats) and covariance (2n,2n) in full matrices."""
    n, z = len(rows.x), rows.x / kernel.scales
    own = (
        se_kernel(z, z, kernel.amplitude) + np.diag(rows.spread.diagonal) + kernel.noise * np.eye(n)
    )
    design = rows.design.transpose(1, 0, 2).reshape(2 * n, -1)
    cov = np.kron(np.diag(rows.spread.share), own) + design @ design.T
    residual = rows.residual.T.reshape(-1)
    fit = (
        residual @ np.linalg.solve(cov, residual)
        + np.linalg.slogdet(cov)[1]
        + 2 * n * np.log(2 * np.pi)
    )
    return -0.5 * fit, cov


def test_held_out_residuals_are_predictions_by_the_others():
    rows, kernel = _rows(), Hyper(np.array([0.7, 1.2]), 0.8, 0.2)
    z = rows.x / kernel.scales
    chol = cholesky_with_jitter(se_kernel(z, z, kernel.amplitude), rows.spread, kernel.noise)
    blocks = np.arange(25) // 5
    residual, variance = hold_out_blocks(chol, rows, blocks)
    cov, y = _whole(rows, kernel)[1], rows.residual.T.reshape(-1)
    out = np.tile(blocks == 2, 2)
    gain = cov[np.ix_(out, ~out)] @ np.linalg.inv(cov[np.ix_(~out, ~out)])
    np.testing.assert_allclose(
        residual[blocks == 2].T.reshape(-1), y[out] - gain @ y[~out], rtol=1e-6
    )
    left = np.diag(cov[np.ix_(out, out)] - gain @ cov[np.ix_(~out, out)])
    np.testing.assert_allclose(variance[blocks == 2].T.reshape(-1), left, rtol=1e-6)
    assert solve_linear_unknowns(
        chol, replace(rows, residual=0 * rows.residual)
    ).mean == pytest.approx(np.zeros(3))


def test_plain_body_is_a_gp(plain):
    assert type(plain.model.senses["effector"]) is GP


def test_offsets_are_printed_and_written(learned, plain, tmp_path, run_cli, capsys):
    import json

    files.save(learned.model, tmp_path / "body.npz")
    files.save(plain.model, tmp_path / "plain.npz")
    (tmp_path / "arm.urdf").write_text(ARM)
    assert run_cli("offsets", tmp_path / "body.npz", "--json", "-o", tmp_path / "zeros.yaml") == 0
    answer = json.loads(capsys.readouterr().out)["results"][0]["offsets"]
    assert (
        answer["pan"]["value"] is None
        and not answer["pan"]["identifiable"]
        and answer["pan"]["confused_with"]
    )
    assert abs(answer["lift"]["value"] - OFFSETS["lift"]) < 3 * answer["lift"]["std"]
    lines = (tmp_path / "zeros.yaml").read_text().splitlines()
    assert lines[0] == "offsets:" and json.loads(lines[2].partition(": ")[2]) == answer["lift"]
    typed = ("offsets", tmp_path / "body.npz", "-o", tmp_path / "new.urdf")
    assert run_cli(*typed) == 2 and run_cli(*typed, "--urdf", tmp_path / "arm.urdf") == 0
    again = learn_kinematics(
        [features()], Settings(), plain, given((tmp_path / "new.urdf").read_text())
    )
    for score in again.scores:
        if score.name.startswith("offset/"):
            std = next(
                s.value
                for s in again.scores
                if s.name == score.name.replace("offset/", "std/offset/")
            )
            assert abs(score.value) < 2 * std
    assert run_cli("info", tmp_path / "body.npz") == 0
    printed = capsys.readouterr().out
    assert "effector (u, v): camera on base, marker on hand; " in printed
    assert "  offset pan: not identifiable: camera's turn" in printed
    assert "  offset lift: +" in printed and " rad)" in printed
    assert run_cli("plot", tmp_path / "body.npz", "-o", tmp_path / "body.png") == 0
    assert run_cli("plot", tmp_path / "plain.npz", "-o", tmp_path / "plain.png") == 0
    sizes = [
        int.from_bytes((tmp_path / name).read_bytes()[20:24]) for name in ("body.png", "plain.png")
    ]
    assert sizes[0] > 1.5 * sizes[1]  # the reprojection and the zeros are below
    capsys.readouterr()
    assert run_cli("offsets", tmp_path / "plain.npz") == 65
    assert "type: bodylog fit LOG --urdf" in capsys.readouterr().err
    known = replace(
        plain.model, provenance={UNUSED_URDF: "the URDF is not used: it is another robot's"}
    )
    files.save(known, tmp_path / "plain.npz")
    for command in ("offsets", "calibration"):
        assert run_cli(command, tmp_path / "plain.npz") == 65
        printed = capsys.readouterr().err
        assert (
            ", as the URDF is not used: it is another robot's\n" in printed
            and "fit LOG --urdf" not in printed
        )
