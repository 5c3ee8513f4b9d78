"""robot.toml over defaults, command line over robot.toml, and what is refused by name."""

from pathlib import Path

import pytest

from bodylog.config import load, toml
from bodylog.errors import ConfigError
from bodylog.settings import Settings


def _file(tmp_path, text):
    path = tmp_path / "robot.toml"
    path.write_text(text)
    return path


def test_defaults_when_nothing_is_given():
    assert load(None) == Settings()


def test_file_overrides_defaults_and_command_line_overrides_file(tmp_path):
    path = _file(tmp_path, '[estimate]\nmethod = "kalman"\nrate = 50\n[skin]\nthreshold = 0.5\n')
    settings = load(path, {"estimate": {"method": "smoother"}})
    assert (settings.estimate.method, settings.estimate.rate, settings.skin.threshold) == ("smoother", 50.0, 0.5)
    assert isinstance(settings.estimate.rate, float)


def test_cameras_are_one_or_many_and_printed_as_they_were_given(tmp_path):
    assert load(None).topics.cameras == ()
    assert load(_file(tmp_path, "[topics]\ncamera = '/a'\n")).topics.cameras == ("/a",)
    many = load(_file(tmp_path, "[topics]\ncamera = ['/a', '/b']\n"))
    assert many.topics.cameras == ("/a", "/b") and load(_file(tmp_path, toml(many))) == many


def test_colours_take_a_name_or_ranges_and_markers_a_table_of_them(tmp_path):
    text = '[colours]\neffector = {low = [50, 80, 80], high = [70, 255, 255]}\nmarkers = {elbow = "blue"}\n'
    colours = load(_file(tmp_path, text)).colours
    assert colours.effector == {"low": (50, 80, 80), "high": (70, 255, 255)}
    assert colours.markers == {"elbow": "blue"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[topic]\njoints = '/j'", "did you mean topics"),
        ("[body]\njoint = ['a']", "did you mean joints"),
        ("[body]\njoints = 3", "must be a list"),
        ("[topics]\ncamera = []", "topics.camera is \\[\\]; it must be a topic, or several different ones"),
        ("[topics]\ncamera = ['/a', '/a']", "several different ones"),
        ("[colours]\nshapes = {elbow = 'blue'}", "has a new name; type: \\[colours\\] markers"),
        ("[colours]\nmarkers = {'side/elbow' = 'blue'}", "names 'side/elbow'; a feature's name has no /"),
        ("[body]\njoints = [3]", "must be a list"),
        ("[body]\nunit = 'degrees'", "did you mean deg"),
        ("[colours]\nhand = 'puce'", "possible: blue"),
        ("[colours]\nhand = {low = [1, 2], high = [3, 4, 5]}", "must be"),
        ("[colours]\nhand = {low = [1, 2, 300], high = [3, 4, 5]}", "h 0..180"),
        ("[estimate]\nrate = true", "must be a finite number"),
        ("[estimate]\nrate = nan", "must be a finite number"),
        ("[synchrony]\nclock_offset = -inf", "must be a finite number or text"),
        ("[time]\ndelay = 'soon'", "must be auto, off or {camera = seconds}"),
        ("[time]\ndelay = {camera = 'late'}", "must be text or a table"),
        ("[time]\ndelay = {camera = nan}", "must be text or a table"),
        ("[fit]\nevery = 1.5", "must be a whole number"),
        ("[fit]\nevery = 0", "must be from 1 to 1e\\+09"),
        ("[fit]\nsamples = 1", "must be from 8"),
        ("[topics]\nstart = 1e308", "must be from -9e\\+09 to 9e\\+09"),
        ("[time]\ndelay = {camera = 1e9}", "must be at most 3600 s"),
        ("[fit]\nseed = -1", "must be from 0"),
        ("[skin]\nthreshold = 70", "must be from 0 to 1"),
        ("[skin]\ncolumns = 0", "must be from 1"),
        ("[body]\njoints = []", "must name joints, each once"),
        ("[body]\njoints = ['a', 'a']", "must name joints, each once"),
        ("skin = 3", "must be a table"),
        ("[skin", "cannot be read as TOML"),
        ("skin = " + "[" * 100_000, "cannot be read as TOML"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_line(tmp_path, text, said):
    with pytest.raises(ConfigError, match=said) as caught:
        load(_file(tmp_path, text))
    assert "robot.toml" in str(caught.value)


def test_absent_file_is_a_usage_error(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        load(tmp_path / "none.toml")


def test_a_file_without_end_is_refused():
    with pytest.raises(ConfigError, match="more than 4194304 bytes"):
        load(Path("/dev/zero"))


def test_printed_settings_read_back_as_they_were(tmp_path):
    given = '[body]\njoints = ["pan \\" lift", "b"]\n[colours]\nmarkers = {elbow = {low = [1,2,3], high = [4,5,6]}}\n'
    settings = load(_file(tmp_path, given))
    assert load(_file(tmp_path, toml(settings))) == settings


def test_the_papers_preset_is_the_papers_method(tmp_path):
    toml = tmp_path / "robot.toml"
    toml.write_text('[estimate]\npreset = "paper"\n')
    assert load(toml).estimate.method == "predictive-coding"
    assert load(None, {"estimate": {"preset": "paper"}}).estimate.method == "predictive-coding"
    assert load(toml, {"estimate": {"method": "kalman"}}).estimate.method == "kalman"
    assert load(None, {"estimate": {"preset": "paper", "method": "smoother"}}).estimate.method == "smoother"
    assert load(None, {"estimate": {"preset": "default"}}).estimate.method == "laplace"
