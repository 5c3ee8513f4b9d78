"""A log that does not fit the body: one sentence and exit 3; a log with a fault that a sensor may have fits."""

import json
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from bodylog.body import storage
from bodylog.body_model import HELD
from bodylog.estimation import estimate_from_features
from bodylog.findings import misfit
from bodylog.findings.log_estimate import infer_from_encoders
from bodylog.findings.misfit import find_misfit
from bodylog.settings import EstimationSettings, Settings
from bodylog.types import Array
from tests.estimation.conftest import JOINTS, Arm, World, draw
from tests.seeds import seeds


def with_readings(world: World, change) -> World:
    """The world with other encoder readings: change(t (N,), values (N,M), names) -> values."""
    joints = world.features.joints
    assert joints is not None
    values = change(joints.t, joints.values.copy(), joints.names)
    return replace(world, features=replace(world.features, joints=replace(joints, values=values)))


def with_track(world: World, change) -> World:
    """The world with another track: change(series) -> series."""
    tracks = {name: change(track) for name, track in world.features.tracks.items()}
    return replace(world, features=replace(world.features, tracks=tracks))


def swapped(one: str, other: str):
    """Two columns swapped."""

    def change(t, values, names):
        i, j = names.index(one), names.index(other)
        values[:, [i, j]] = values[:, [j, i]]
        return values

    return change


def flipped(joint: str):
    """The sign of one column flipped."""
    return lambda t, values, names: values * np.where(np.array(names) == joint, -1.0, 1.0)


def off_by(joint: str, offset):
    """One column off by offset(t) rad."""
    return lambda t, values, names: values + np.outer(offset(t), np.array(names) == joint)


def found(world: World) -> misfit.LogMisfit | None:
    return find_misfit(world.features, world.body, EstimationSettings())


READ = {
    **{f"{one} and {other} swapped": swapped(one, other) for one, other in combinations(JOINTS, 2)},
    **{f"sign of {joint} flipped": flipped(joint) for joint in JOINTS},
    "degrees, not rad": lambda t, values, names: np.rad2deg(values),
    "rad, not degrees": lambda t, values, names: np.deg2rad(values),
}


@pytest.mark.parametrize("seed", seeds(1, 6))
@pytest.mark.parametrize("words", READ)
def test_columns_read_wrongly_are_named(words, seed) -> None:
    wrong = found(with_readings(draw(seed, duration=12.0), READ[words]))
    assert wrong is not None and wrong.explanation is not None and words in wrong.explanation
    assert wrong.off_explained is not None and wrong.off_explained < 0.05 and wrong.nats > misfit.EVIDENCE_THRESHOLD_NATS


OFFSETS = {
    "0.05 rad": lambda t: np.full(len(t), 0.05),
    "-1.8 rad": lambda t: np.full(len(t), -1.8),
    "drift": lambda t: 0.06 * np.maximum(t - 4.0, 0.0),
    "step": lambda t: 0.2 * (t > 6.0),
}


@pytest.mark.parametrize("seed", seeds(1, 6))
@pytest.mark.parametrize("joint", JOINTS)
@pytest.mark.parametrize("offset", OFFSETS)
def test_log_with_one_wrong_encoder_fits(offset, joint, seed) -> None:
    assert found(with_readings(draw(seed, duration=12.0), off_by(joint, OFFSETS[offset]))) is None


@pytest.mark.parametrize("seed", seeds(1, 6))
def test_log_with_two_wrong_encoders_fits(seed) -> None:
    one = with_readings(draw(seed, duration=12.0), off_by("pan", lambda t: np.full(len(t), 0.3)))
    assert found(with_readings(one, off_by("elbow", lambda t: 0.5 * (t > 7.0)))) is None


@pytest.mark.parametrize("seed", seeds(1, 6))
def test_log_of_a_camera_that_moved_or_is_late_fits(seed) -> None:
    world = draw(seed, duration=12.0)
    assert found(with_track(world, lambda one: replace(one, values=one.values + np.array([40.0, -40.0])))) is None
    assert found(with_track(world, lambda one: replace(one, t=one.t + 0.3))) is None
    assert found(draw(seed, duration=12.0, blunder=0.3)) is None


@dataclass(frozen=True)
class Mirrored(Arm):
    """The same arm, seen from another side."""

    def place(self, x: Array) -> Array:
        u, v = np.moveaxis(super().place(x[..., ::-1]), -1, 0)
        return np.stack([320.0 - v, u], axis=-1)


def judged(world: World) -> misfit.LogMisfit | None:
    found = estimate_from_features(world.features, world.body, EstimationSettings())
    return misfit.from_many_faults(found, world.features, world.body, EstimationSettings(), "auto")


def still(seed: int, **offsets: float) -> World:
    """An arm that stands still, with encoders that are off from first to last."""
    world = draw(seed, duration=10.0, encoder_std=0.003, pixel_std=0.1, speed=0.0)
    for joint, size in offsets.items():
        world = with_readings(world, off_by(joint, lambda t, size=size: np.full(len(t), size)))
    return world


@pytest.mark.parametrize("seed", seeds(2, 10))
def test_an_arm_that_stands_still_with_one_encoder_off_fits(seed) -> None:
    assert judged(still(seed)) is None
    assert judged(still(seed, **{JOINTS[2]: 0.13})) is None


@pytest.mark.parametrize("seed", seeds(2, 10))
def test_images_of_an_arm_that_stands_still_leave_open_which_encoders_are_off(seed) -> None:
    """They are two numbers: any two of three encoders explain them."""
    wrong = judged(still(seed, **{JOINTS[0]: 0.12, JOINTS[1]: -0.1, JOINTS[2]: 0.13}))
    assert wrong is not None and wrong.is_open
    assert misfit.misfit_sentence(wrong).endswith("leave open which; record a log in which the arm moves")


@pytest.mark.parametrize("seed", seeds(1, 10))
def test_images_of_an_arm_that_moves_leave_no_encoder_open(seed) -> None:
    """Also where encoders are noisy, so that images determine one direction ten times worse than the others."""
    noisy = draw(seed, duration=20.0, encoder_std=0.02, speed=1.0)
    wrong = with_readings(noisy, off_by(JOINTS[0], lambda t: np.full(len(t), 0.12)))
    wrong = with_readings(wrong, off_by(JOINTS[2], lambda t: np.full(len(t), -0.1)))
    assert judged(wrong) is None
    log = misfit.select_sightings(wrong.features, wrong.body, EstimationSettings())
    assert log is not None and misfit.count_determined_offsets(log) == 3
    assert misfit.count_determined_offsets(misfit.hold_still(log)) == 2


def test_a_joint_that_stands_elsewhere_than_in_the_exploration_is_the_reason() -> None:
    world = still(1, **{JOINTS[0]: 0.12, JOINTS[1]: -0.1, JOINTS[2]: 0.13})
    joints = world.features.joints
    assert joints is not None
    more = replace(joints, values=np.column_stack([joints.values, np.full(len(joints.t), -1.3)]), names=(*joints.names, "wrist"))
    held = replace(world.body, provenance={HELD: {"wrist": (-1.57, -1.56)}})
    wrong = judged(replace(world, features=replace(world.features, joints=more), body=held))
    assert wrong is not None and wrong.advice == "fit a body that is learned over it"
    assert wrong.explanation == "because wrist stands at -1.3 rad, and not at -1.56 as while the body was learned"


@pytest.mark.parametrize("seed", seeds(1, 6))
def test_images_of_two_cameras_swapped_are_named(seed) -> None:
    first, side = draw(seed, duration=12.0), draw(seed, duration=12.0, model=Mirrored())
    one, other = first.features.tracks["effector"], side.features.tracks["effector"]
    body = replace(first.body, senses={"effector": Arm(), "side/effector": Mirrored()})
    right = replace(first.features, tracks={"effector": one, "side/effector": other})
    wrong = replace(first.features, tracks={"effector": other, "side/effector": one})
    assert find_misfit(right, body, EstimationSettings()) is None
    misread = find_misfit(wrong, body, EstimationSettings())
    assert misread is not None and misread.explanation == "the images of camera and side swapped"


@pytest.mark.parametrize("seed", seeds(1, 6))
def test_log_of_another_camera_is_named(seed) -> None:
    other = draw(seed, duration=20.0, encoder_std=0.002, model=Mirrored())
    wrong = find_misfit(other.features, draw(seed).body, EstimationSettings())
    assert wrong is not None and wrong.explanation is not None and "another camera" in wrong.explanation
    text = misfit.misfit_sentence(wrong)
    assert text.startswith("this log does not fit this body: ") and "more than 3 σ off" in text


def test_images_that_the_joints_do_not_explain_have_no_explanation() -> None:
    world, rng = draw(0), np.random.default_rng(1)
    walk = with_track(world, lambda one: replace(one, values=160.0 + np.cumsum(rng.normal(0, 9, one.values.shape), 0)))
    wrong = found(walk)
    assert wrong is not None and wrong.explanation is None and wrong.off > 0.9


def test_doubt_in_a_swapped_log_covers_the_truth() -> None:
    world = with_readings(draw(0), swapped("pan", "elbow"))
    wrong = found(world)
    assert wrong is not None
    alone = infer_from_encoders(world.features, world.body, Settings())
    estimate = misfit.with_doubt(alone, world.features, wrong)
    truth = np.stack([np.interp(estimate.joints.t, world.truth.t, one) for one in world.truth.values.T], axis=1)
    std = np.sqrt(np.einsum("nii->ni", estimate.cov))
    assert not estimate.faults and (np.abs(estimate.joints.values - truth) < 2.0 * std).mean() > 0.95
    assert (np.abs(alone.joints.values - truth) > 2.0 * np.sqrt(np.einsum("nii->ni", alone.cov))).mean() > 0.5


@pytest.fixture(scope="module")
def body_with_swapped_names(tmp_path_factory, arm_body: Path) -> Path:
    """The arm's body with the names of two joints exchanged: what swapped columns of a log are to it."""
    body, path = storage.load_body(arm_body), tmp_path_factory.mktemp("swapped") / "body.npz"
    assert body.joints == ("elbow_joint", "shoulder_lift_joint", "shoulder_pan_joint")
    storage.save(replace(body, joints=("elbow_joint", "shoulder_pan_joint", "shoulder_lift_joint")), path)
    return path


def test_estimate_of_a_log_that_does_not_fit_exits_with_3(
    tmp_path, capsys, run_cli, arm, body_with_swapped_names
) -> None:
    out = tmp_path / "out.mcap"
    typed = (arm / "reach.mcap", "--body", body_with_swapped_names, "-o", out)
    assert run_cli("estimate", *typed, "--json") == 3
    (result,) = json.loads(capsys.readouterr().out)["results"]
    (text,) = result["verdict"]
    assert text.startswith("this log does not fit this body") and result["faults"] == []
    assert "the columns of shoulder_pan_joint and shoulder_lift_joint swapped" in text
    assert any(one["severity"] == "lost" and one["text"] == text for one in result["findings"])
    assert run_cli("estimate", *typed) == 3
    printed = capsys.readouterr()
    assert printed.out.splitlines() == [text] and text not in printed.err
    assert run_cli("report", out, "-o", tmp_path / "report.html") == 0
    assert "does not fit this body" in (tmp_path / "report.html").read_text()


def test_estimate_in_the_wrong_unit_names_it(tmp_path, capsys, run_cli, arm, arm_body) -> None:
    config = tmp_path / "robot.toml"
    config.write_text('[body]\nunit = "deg"\n')
    out = tmp_path / "out.mcap"
    assert run_cli("estimate", arm / "reach.mcap", "--body", arm_body, "--config", config, "-o", out) == 3
    assert 'type [body] unit = "rad" in robot.toml' in capsys.readouterr().out


@pytest.mark.soak
@pytest.mark.parametrize("name", ["bare_pick", "bare_offset"])
def test_log_of_an_unmarked_arm_has_no_fault_with_a_size(tmp_path, capsys, run_cli, worlds, name) -> None:
    """The body follows a cap of the arm's colour; in the other logs it sees another cap of that colour."""
    body = tmp_path / "body.npz"
    assert run_cli("fit", worlds / "bare_explore", "--no-urdf", "-o", body) == 0
    capsys.readouterr()
    assert run_cli("estimate", worlds / name, "--body", body, "-o", tmp_path / "out.mcap", "--json") == 3
    (result,) = json.loads(capsys.readouterr().out)["results"]
    assert result["verdict"][0].startswith("this log does not fit this body") and not result["faults"]
