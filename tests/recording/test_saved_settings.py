"""Settings of an earlier run in a log's metadata: used for unset values, if they fit."""

import json
from dataclasses import replace

import pytest

from bodylog.annotating.messages import from_features, from_joints
from bodylog.recording.facts import describe_log
from bodylog.recording.recording import read_recording
from bodylog.settings import BodySettings, Settings, TimeSettings, TopicSettings
from tests.annotating.annotated_logs import annotate_log
from tests.logs.written import START, found, source

JOINTS = "/joint_states"


def annotated(folder, saved):
    features, _ = found()
    outgoing = [from_joints(JOINTS, features.joints, START), *from_features(features, START)]
    about = {"settings": saved if isinstance(saved, str) else json.dumps(saved)}
    annotate_log(source(folder / "in.mcap"), outgoing, about, folder / "out.mcap")
    return folder / "out.mcap"


def test_restore_settings_fills_defaults(tmp_path):
    saved = {"topics": {"joints": JOINTS, "skin": None}, "body": {"unit": "deg"}, "time": {"joints": "log"}}
    log = annotated(tmp_path, saved)
    restored = read_recording(log, Settings()).facts.settings
    assert restored == Settings(topics=TopicSettings(joints=JOINTS), body=BodySettings(unit="deg"), time=TimeSettings(joints="log"))
    asked = Settings(topics=TopicSettings(joints="/joints_of_mine"), time=TimeSettings(joints="header"))
    assert describe_log(log, asked)["findings"][-1]["text"].startswith('[topics] joints = "/joints_of_mine", but there is no')
    again = read_recording(log, replace(asked, topics=TopicSettings())).facts.settings
    assert again == replace(restored, time=asked.time)


@pytest.mark.parametrize(
    "saved",
    [
        "{",
        "[]",
        "null",
        {"topics": []},
        {"topics": {"joints": "/gone", "camera": ["/a", "/gone"]}},
        {"topics": {"joints": 7, "camera": [7], "skin": [], "colour": JOINTS}},
        {"topics": {"joints": [JOINTS, 7]}, "body": {"unit": ["deg"], "joints": "elbow"}, "time": {"joints": {}}},
    ],
)
def test_restore_settings_ignores_values_that_do_not_fit(tmp_path, saved):
    assert read_recording(annotated(tmp_path, saved), Settings()).facts.settings == Settings()
