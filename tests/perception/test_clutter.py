"""The arm's ball among larger things of its colour that stand or move by themselves, in drawn films."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bodylog.perception import observe_recording
from bodylog.perception.colours import blob_measurement, clutter, colour_tracker, overlap
from bodylog.perception.tracking import joint_motion
from bodylog.recording import recording
from bodylog.settings import Settings, TopicSettings
from bodylog.types import Array, Recording, Series
from tests.changed_recordings import change_recording
from tests.perception import scenes
from tests.perception.scenes import Disc
from tests.seeds import first_of

RADIUS = 7.0


def _joints(rng: np.random.Generator, t: Array) -> Array:
    """Two joints (n,2) rad that explore."""
    rates, phases = rng.uniform(0.5, 2.2, (3, 2)), rng.uniform(0, 6.28, (3, 2))
    return np.asarray(np.sin(rates * t[:, None, None] + phases).sum(axis=1) / 2)


def _film(seed: int, count: int = 200, delay: float = 0.0) -> tuple[Recording, Array, Array]:
    """A ball on an arm of two joints, a larger one that stands, a largest one that wanders: where and if it is seen."""
    rng = np.random.default_rng(seed)
    wall, t = scenes.wall(rng, contrast=3.0), np.arange(count) / 10.0
    dense = np.arange(-100, 10 * count + 100) / 100.0
    angles = _joints(rng, dense)
    place = np.column_stack([
        160 + 80 * np.sin(0.9 * angles[:, 0]) + 25 * np.cos(angles.sum(axis=1)),
        120 + 60 * np.sin(0.7 * angles[:, 1]) + 20 * np.sin(angles.sum(axis=1)),
    ])  # fmt: skip
    uv = np.column_stack([np.interp(t, dense, column) for column in place.T])
    sleeve = np.array([160, 120]) + [90, 70] * np.sin(rng.uniform(0.3, 0.9, 2) * t[:, None] + rng.uniform(0, 6, 2))
    pictures = []
    for own, other in zip(uv.tolist(), sleeve.tolist(), strict=True):
        discs = [Disc(60.0, 200.0, 12.0), Disc(*own, RADIUS), Disc(*other, 16.0)]
        pictures.append(scenes.jpeg(scenes.draw(wall, discs, rng)))
    readings = angles + rng.normal(0, 0.003, angles.shape)
    joints = Series(dense - delay, readings, ("a", "b"), "rad", (dense * 1e9).astype(np.int64))
    hidden = np.hypot(*(uv - sleeve).T) < 16.0 + RADIUS
    return change_recording(scenes.recording(scenes.frames(t, pictures)), joints=joints), uv, ~hidden


@pytest.mark.parametrize(("seed", "delay"), first_of(1, [(1, 0.1), (0, 0.0), (2, -0.1)]))
def test_observe_follows_only_the_ball_of_the_arm(seed: int, delay: float) -> None:
    film, uv, clear = _film(seed, delay=delay)
    track = observe_recording(film, Settings()).effector
    assert track is not None
    off = np.hypot(*(track.values - uv).T)
    assert np.isfinite(off[clear]).mean() > 0.97
    assert np.nanmedian(off) < 0.3 and np.nanmax(off) < 4.0


def test_observe_without_joints_follows_the_largest() -> None:
    film, uv, _ = _film(0)
    track = observe_recording(change_recording(film, joints=None), Settings()).effector
    assert track is not None and np.nanmedian(np.hypot(*(track.values - uv).T)) > 20


def test_single_blob_track_does_not_depend_on_joints() -> None:
    film, uv, _ = _film(0, 60)
    rng = np.random.default_rng(0)
    wall = scenes.wall(rng)
    pictures = [scenes.jpeg(scenes.draw(wall, [Disc(*own, RADIUS)], rng)) for own in uv.tolist()]
    frames = scenes.frames(np.arange(60) / 10.0, pictures)
    look, tracks = colour_tracker.search_colours, colour_tracker.colour_tracks
    one, other = (tracks(look(frames, {"effector": "green"}), frames, {"effector": "green"}, joints)
                  for joints in (film.signals.joints, None))  # fmt: skip
    assert one[0]["effector"].values.tobytes() == other[0]["effector"].values.tobytes()


def test_joints_explain_only_the_ball() -> None:
    film, uv, _ = _film(3)
    t = np.arange(200) / 10.0
    q = joint_motion.moving_postures(film.signals.joints, t)
    other = 100 + 50 * np.column_stack([np.sin(1.3 * t), np.cos(0.4 * t)])
    assert joint_motion.explained_share(q, uv, 320.0) > 0.9
    assert joint_motion.explained_share(q, other, 320.0) < 0.2
    assert joint_motion.camera_delay_s(film.signals.joints, t, uv, 320.0) == 0.0
    later = np.column_stack([np.interp(t - 0.1, t, column) for column in uv.T])
    assert joint_motion.camera_delay_s(film.signals.joints, t[5:], later[5:], 320.0) == pytest.approx(0.1)


@pytest.mark.parametrize("side", [(14.0, 6.0), (-12.0, 9.0)])
def test_outline_fits_a_ball_touching_its_own_colour(side: tuple[float, float]) -> None:
    rng = np.random.default_rng(0)
    wall = scenes.wall(rng)
    discs = [Disc(150.0 + side[0], 110.0 + side[1], 10.0), Disc(150.3, 110.6, 10.0, shade=0.5)]
    image = scenes.draw(wall, discs, rng).astype(np.float32)
    found = overlap.fit_outline(image, np.array([151.5, 109.5]), 10.0, 3.0)
    assert found is not None and np.hypot(found.u - 150.3, found.v - 110.6) < 0.4
    assert overlap.fit_outline(image, np.array([60.0, 60.0]), 10.0, 3.0) is None


@pytest.mark.parametrize("name", [pytest.param("ball_explore", marks=pytest.mark.soak), "ball_offset"])
def test_ball_is_found_among_clutter_of_its_colour(worlds: Path, name: str) -> None:
    settings = replace(Settings(), topics=TopicSettings(joints="/arm/joint_states"))
    track = observe_recording(recording.read_recording(worlds / name, settings), settings).effector
    with np.load(worlds / f"{name}.truth.npz") as truth:
        uv, seen = truth["uv"], truth["seen"].astype(bool)
    assert track is not None
    off = np.hypot(*(track.values - uv).T)
    assert np.isfinite(off[seen]).mean() >= 0.99
    assert np.nanmedian(off[seen]) <= 0.5 and np.nanmax(off) < 5.0
    assert track.std is not None
    stated, true = (np.sqrt(np.nanmean(np.square(each[seen]), axis=0)) for each in (track.std, track.values - uv))
    assert (stated / true > 0.5).all() and (stated / true < 1.5).all()


def test_wheels_do_not_hide_that_a_thing_moves_with_the_arm():
    t = np.arange(0, 25, 0.1)
    arm = np.column_stack([0.5 * np.sin(0.9 * t), 0.4 * np.sin(1.3 * t + 1), 0.4 * np.sin(0.6 * t + 2)])
    wheels = np.column_stack([3.0 * t, 3.1 * t])
    y = np.column_stack([320 + 150 * np.sin(arm[:, 0] + arm[:, 1]), 240 + 150 * np.cos(arm[:, 2] - arm[:, 1])])
    names = ("a", "b", "c", "left", "right")
    joints = Series(t, np.column_stack([arm, wheels]), names, "rad", (t * 1e9).astype(np.int64))
    assert joint_motion.explained_share(joint_motion.moving_postures(joints, t), y, 640) > 0.8


def _candidates(count: int) -> tuple[Array, Array, Series]:
    """Times (N,) s, candidates (N,2,FIELDS): one that wanders and the arm's; and the joints."""
    rng = np.random.default_rng(5)
    t = np.arange(count) / 10.0
    angles = _joints(rng, t)
    column = 160 + 80 * np.sin(0.9 * angles[:, 0])
    arm = np.column_stack([column, 120 + 60 * np.sin(angles.sum(axis=1))])
    other = [160, 120] + [90, 70] * np.sin([0.7, 0.4] * t[:, None] + [1.0, 2.0])
    found = np.zeros((count, 2, blob_measurement.FIELDS))
    found[:, :, [blob_measurement.MASS, blob_measurement.STRENGTH]] = np.pi * RADIUS**2
    found[:, 0, :2] = other
    found[:, 1, :2] = arm + rng.normal(0, 0.1, arm.shape)
    return t, found, Series(t, angles, ("a", "b"), "rad", (t * 1e9).astype(np.int64))


@pytest.mark.parametrize("seen", [slice(0, 1200), slice(100, 170)])
def test_long_log_is_followed_from_one_start(seen: slice, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the parts on which starts are compared show the arm; else all is compared."""
    monkeypatch.setattr(clutter, "_COMPARED", 300)
    monkeypatch.setattr(clutter, "_STRETCH", 60)
    t, found, joints = _candidates(1200)
    unseen = np.ones(len(t), bool)
    unseen[seen] = False
    found[unseen] = np.nan
    followed: list[int] = []
    follow = clutter._follow_joints

    def noted(t: Array, *rest: Any) -> clutter.BlobChoice:
        followed.append(len(t))
        return follow(t, *rest)

    monkeypatch.setattr(clutter, "_follow_joints", noted)
    choice = clutter.choose_arm_blobs(t, found, joints, 320.0)
    assert choice is not None
    assert (choice.number[seen] == 1).mean() > 0.95
    assert (choice.number[unseen] == -1).all()
    if not unseen.any():
        assert followed.count(len(t)) == 1 and max(followed[:-1]) <= 300
