"""The sources of [features]: from TOML to records and back, and what is refused."""

import json
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from bodylog.config import load_settings, merge_settings, settings_as_toml
from bodylog.errors import ConfigError
from bodylog.settings import ColourSettings, Settings, list_configured_sources, settings_as_values
from bodylog.sources import (
    DICTIONARIES,
    CharucoSource,
    ColourSource,
    PointSource,
    TableSource,
    TagSource,
    TopicSource,
    board_points,
    feature_of,
    group_of,
    track_names,
)

GIVEN = """
[features]
effector = "green"
glove = {low = [150, 90, 50], high = [9, 255, 255]}
wrist = { tag = 7, dictionary = "apriltag_36h11", size = 0.04, corners = true }
board = { charuco = "10x14", square = 0.07, marker = 0.04, dictionary = "DICT_4X4_1000" }
elbow = { topic = "/detections", path = ".detections[:]{id==3}.centre" }
finger = { table = "tracks.csv", columns = ["finger_u", "finger_v"] }
tip = { point = [412.0, 233], at = 1.5 }
"""
FEATURES = {
    "effector": ColourSource("green"),
    "glove": ColourSource({"low": (150, 90, 50), "high": (9, 255, 255)}),
    "wrist": TagSource(7, "apriltag_36h11", 0.04, True),
    "board": CharucoSource("10x14", 0.07, 0.04, "4x4_1000"),
    "elbow": TopicSource("/detections", ".detections[:]{id==3}.centre"),
    "finger": TableSource("tracks.csv", ("finger_u", "finger_v")),
    "tip": PointSource((412.0, 233.0), 1.5),
}


def test_sources_of_each_kind_round_trip_through_toml(tmp_path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(GIVEN)
    settings = load_settings(path)
    assert settings.features == FEATURES
    path.write_text(settings_as_toml(settings))
    assert load_settings(path).features == FEATURES
    assert (
        merge_settings(
            Settings(), json.loads(json.dumps(settings_as_values(settings))), "log"
        ).features
        == FEATURES
    )


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ("grene", r"features.it is 'grene'; possible: blue, .*yellow, or \{low"),
        ({"low": [0, 0, 0]}, "features.it is .*it must be {low"),
        ({"tag": 7, "point": [1, 2]}, "has tag and point; it must have exactly one of colour, tag"),
        ({"size": 0.1}, "has only size; it must have exactly one of"),
        (
            {"tag": 7, "dictionnary": "4x4_50"},
            "features.it.dictionnary; did you mean dictionary\\? possible: tag, di",
        ),
        ({"tag": -1}, "features.it.tag is -1; possible: whole number from 0"),
        ({"tag": True}, "features.it.tag is True"),
        ({"tag": 587}, "features.it.tag is 587; apriltag_36h11 has tags from 0 to 586"),
        (
            {"tag": 7, "dictionary": "36h11"},
            "dictionary is '36h11'; possible: 4x4_50, .*apriltag_36h11",
        ),
        ({"tag": 7, "size": 0}, "size is 0; possible: number from 1e-06 to 100 m"),
        (
            {"charuco": "10x14", "square": 0.07},
            "has no marker; it must have charuco, square, marker",
        ),
        (
            {"charuco": "10x14", "square": 0.04, "marker": 0.07},
            "marker is 0.07 m; it must be less than square",
        ),
        (
            {"charuco": "10", "square": 0.07, "marker": 0.04},
            "charuco is '10'; possible: columns and rows",
        ),
        ({"charuco": "10x14", "square": 0.07, "marker": 0.04}, "needs 70 markers; 4x4_50 has 50"),
        ({"point": [1.0, float("nan")]}, "point is .*possible: \\[u, v\\] in px"),
        ({"table": "a.csv", "columns": ["u"]}, "columns is .*two or more columns"),
        ({"topic": ""}, "topic is ''; possible: topic"),
        (7, "features.it is 7; possible: a colour's name, or a table"),
    ],
)
def test_invalid_source_is_refused_with_the_possible_values(value, text) -> None:
    with pytest.raises(ConfigError, match=text) as caught:
        merge_settings(Settings(), {"features": {"it": value}}, "robot.toml")
    assert re.match(
        r"robot.toml: (unknown key )?features.it", str(caught.value)
    ) and "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["", "a/b", "a.b", "encoders", "touch"])
def test_reserved_feature_name_is_refused(name) -> None:
    with pytest.raises(ConfigError, match="\\[features\\] names"):
        merge_settings(Settings(), {"features": {name: "green"}}, "robot.toml")


def test_feature_replaces_colour_and_default_effector() -> None:
    assert list(list_configured_sources(Settings())) == ["effector", "hand"]
    tagged = Settings(features={"wrist": TagSource(7)})
    assert list_configured_sources(tagged) == {"hand": ColourSource("red"), "wrist": TagSource(7)}
    blue = replace(
        tagged, colours=ColourSettings(effector="blue", markers={"elbow": "cyan", "wrist": "red"})
    )
    assert list_configured_sources(blue)["effector"] == ColourSource(
        "blue"
    ) and list_configured_sources(blue)["wrist"] == TagSource(7)
    assert list_configured_sources(Settings(features={"effector": TagSource(1)}))[
        "effector"
    ] == TagSource(1)


def test_dictionaries_of_opencv_all_have_a_name() -> None:
    there = {name.upper() for name in dir(cv2.aruco) if name.startswith("DICT_")}
    ours = {
        f"DICT_{'ARUCO_' if name.startswith('mip') else ''}{name.upper()}" for name in DICTIONARIES
    }
    assert ours == there
    for name, count in DICTIONARIES.items():
        spelled = next(n for n in dir(cv2.aruco) if n.upper().removeprefix("DICT_").removeprefix("ARUCO_M")
                       == name.upper().removeprefix("M"))  # fmt: skip
        assert (
            len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, spelled)).bytesList) == count
        ), name


def test_board_gives_a_track_per_corner() -> None:
    board = CharucoSource("4x3", 0.1, 0.07)
    assert track_names("side/board", board) == tuple(f"side/board.{k}" for k in range(6))
    expected = cv2.aruco.CharucoBoard(
        (4, 3), 0.1, 0.07, cv2.aruco.getPredefinedDictionary(0)
    ).getChessboardCorners()
    np.testing.assert_allclose(board_points(board), expected, atol=1e-6)
    assert (
        board_points(TagSource(3)) is None
        and len(board_points(TagSource(3, size=0.1, corners=True))) == 4
    )
    assert (
        feature_of("side/board.3") == feature_of("board") == "board"
        and group_of("side/board.3") == "side/board"
    )
