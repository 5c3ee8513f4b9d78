"""Colours proposed from drawn films."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.errors import FormatError, LogError
from bodylog.perception.palette import propose
from bodylog.types import Array, Recording, Series
from tests.perception import scenes
from tests.perception.scenes import Disc

T = np.arange(60) / 20.0
ANGLES = np.column_stack([np.sin(1.7 * T), np.cos(1.3 * T)])


def _film() -> Recording:
    """A green disc that moves with the joints, a red one that moves without them, a yellow one that stays."""
    rng = np.random.default_rng(0)
    wall = scenes.wall(rng, contrast=3.0)
    film = []
    for moment, (a, b) in zip(T, ANGLES, strict=True):
        red = Disc(160.0 + 90.0 * np.sin(5.0 * moment + 1), 40.0, 7.0, scenes.RED)
        film.append([Disc(160.0 + 60.0 * a, 130.0 + 40.0 * b, 6.0), red, Disc(30.0, 210.0, 9.0, scenes.YELLOW)])
    pictures = [scenes.jpeg(scenes.draw(wall, discs, rng)) for discs in film]
    joints = Series(T, ANGLES, ("a", "b"), "rad", (T * 1e9).astype(np.int64))
    return replace(scenes.recording(scenes.frames(T, pictures)), joints=joints)


def test_the_blob_that_moves_with_the_joints_comes_first() -> None:
    proposals, sheet = propose(_film())
    assert proposals[0].name == "green"
    assert {proposal.name for proposal in proposals} == {"green", "red", "yellow"}
    assert proposals[0].joints > 0.95 and proposals[0].seen > 0.95
    assert sheet.shape == (480, 960, 3) and (sheet == 255).all(axis=2).any()


def test_where_the_effector_is_said_to_be_decides() -> None:
    proposals, _ = propose(_film(), effector_uv=(30.0, 210.0))
    assert proposals[0].name == "yellow"


def test_no_pictures_is_an_error_that_names_the_log() -> None:
    with pytest.raises(LogError, match="no pictures to take colours from; type: bodylog info"):
        propose(scenes.recording())


def test_pictures_that_cannot_be_decoded_are_an_error_that_says_why() -> None:
    def broken(_: int) -> Array:
        raise FormatError("/camera: not a JPEG")

    film = _film()
    assert film.frames is not None
    frames = [replace(frame, decode=broken) for frame in film.frames()]
    with pytest.raises(LogError, match="no picture can be decoded: /camera: not a JPEG; type: bodylog info"):
        propose(replace(film, frames=lambda: iter(frames)))


def test_readings_that_are_none_do_not_count_against_the_others() -> None:
    film, values = _film(), np.column_stack([ANGLES, np.full(len(T), np.nan)])
    values[20:, 0] = np.nan
    assert film.joints is not None
    proposals, _ = propose(replace(film, joints=replace(film.joints, values=values, names=("a", "b", "c"))))
    assert proposals[0].name == "green"
    nothing = replace(film.joints, values=np.full_like(values, np.nan), names=("a", "b", "c"))
    assert not any(one.joints for one in propose(replace(film, joints=nothing))[0])


def test_pictures_of_two_sizes_and_damaged_ones_are_shown_as_far_as_they_go() -> None:
    film = _film()
    assert film.frames is not None
    frames = list(film.frames())

    def damaged(_k: int) -> np.ndarray:
        raise FormatError("cut off")

    odd = [replace(f, decode=damaged) if i % 7 == 3 else f for i, f in enumerate(frames)]
    odd[30:] = [replace(f, decode=lambda k, f=f: f.decode(2 * k)) for f in odd[30:]]
    proposals, sheet = propose(replace(film, frames=lambda: iter(odd)))
    assert "green" in {one.name for one in proposals} and sheet.shape == (480, 960, 3)
    with pytest.raises(LogError, match="no picture can be decoded: cut off"):
        propose(replace(film, frames=lambda: iter([replace(f, decode=damaged) for f in frames])))
