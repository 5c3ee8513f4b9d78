"""Features proposed from drawn films."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.errors import FormatError, LogError
from bodylog.perception.tracking.candidates import survey_features
from bodylog.report.figures.contact_sheet import Mark, draw_contact_sheet
from bodylog.sources import TagSource
from bodylog.types import Array
from tests.changed_recordings import change_recording
from tests.perception import scenes
from tests.perception.films import ANGLES, T, film


def test_survey_ranks_the_arms_blob_first() -> None:
    found = survey_features(film(), "red")
    first = found.candidates[0]
    assert first is found.arm and first.name == "green" and first.explained > 0.9 and first.seen > 0.95
    why = {one.name: one.why for one in found.candidates}
    assert why["yellow"] == "it stands still while the joints move" and why["red"] == "the hand's colour"
    assert "does not move as the joints do" in {one.name: one.why for one in survey_features(film(), "blue").candidates}["red"]
    assert len(found.images) == 6 and found.count == len(T)


def test_survey_ranks_the_arms_tag_before_colours() -> None:
    found = survey_features(film(tag=7), "red")
    assert found.arm is not None and found.arm.source == TagSource(7, "apriltag_36h11")
    assert found.candidates[1].name == "green" and not found.candidates[1].why


def test_survey_puts_candidates_at_the_given_effector_first() -> None:
    assert survey_features(film(), "red", effector_uv=(30.0, 210.0)).candidates[0].name == "yellow"


def test_survey_without_images_is_an_error_naming_the_log() -> None:
    with pytest.raises(LogError, match="no pictures to look for features in; type: bodylog info"):
        survey_features(scenes.recording(), "red")


def test_pictures_that_cannot_be_decoded_are_an_error_that_says_why() -> None:
    def broken(_: int) -> Array:
        raise FormatError("/camera: not a JPEG")

    whole = film()
    assert whole.cameras.frames is not None
    frames = [replace(frame, decode=broken) for frame in whole.cameras.frames()]
    with pytest.raises(LogError, match="no picture can be decoded: /camera: not a JPEG; type: bodylog info"):
        survey_features(change_recording(whole, frames=lambda: iter(frames)), "red")


def test_readings_that_are_none_do_not_count_against_the_others() -> None:
    whole, values = film(), np.column_stack([ANGLES, np.full(len(T), np.nan)])
    values[20:, 0] = np.nan
    assert whole.signals.joints is not None
    some = replace(whole.signals.joints, values=values, names=("a", "b", "c"))
    assert survey_features(change_recording(whole, joints=some), "red").candidates[0].name == "green"
    nothing = replace(whole.signals.joints, values=np.full_like(values, np.nan), names=("a", "b", "c"))
    seen = survey_features(change_recording(whole, joints=nothing), "red")
    assert all(one.why and one.explained is None for one in seen.candidates)


def test_pictures_of_two_sizes_and_damaged_ones_are_looked_at_as_far_as_they_go() -> None:
    whole = film()
    assert whole.cameras.frames is not None
    frames = list(whole.cameras.frames())

    def damaged(_k: int) -> np.ndarray:
        raise FormatError("cut off")

    odd = [replace(f, decode=damaged) if i % 7 == 3 else f for i, f in enumerate(frames)]
    odd[30:] = [replace(f, decode=lambda k, f=f: f.decode(2 * k)) for f in odd[30:]]
    found = survey_features(change_recording(whole, frames=lambda: iter(odd)), "red")
    assert "green" in {one.name for one in found.candidates}
    marks = [Mark(one.name, not one.why, one.track) for one in found.candidates]
    assert draw_contact_sheet(found.images, marks).shape[1] == 3 * 480
    with pytest.raises(LogError, match="no picture can be decoded: cut off"):
        survey_features(change_recording(whole, frames=lambda: iter([replace(f, decode=damaged) for f in frames])), "red")
