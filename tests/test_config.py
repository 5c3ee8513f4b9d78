"""robot.toml over defaults, command line over robot.toml, and what is refused by name."""

from dataclasses import fields
from pathlib import Path

import pytest

from bodylog.config import load_settings, settings_as_toml
from bodylog.errors import ConfigError
from bodylog.io.toml_keys import declared_keys
from bodylog.settings import METHODS, Settings, settings_as_values
from docs.generate_settings import PAGE, page


def _file(tmp_path, text):
    path = tmp_path / "robot.toml"
    path.write_text(text)
    return path


def test_defaults_when_nothing_is_given():
    assert load_settings(None) == Settings()


def test_file_overrides_defaults_and_command_line_overrides_file(tmp_path):
    path = _file(tmp_path, '[estimate]\nmethod = "kalman"\nrate = 50\n[skin]\nthreshold = 0.5\n')
    settings = load_settings(path, {"estimate": {"method": "smoother"}})
    assert (settings.estimate.method, settings.estimate.rate, settings.skin.threshold) == ("smoother", 50.0, 0.5)
    assert isinstance(settings.estimate.rate, float)


def test_cameras_are_one_or_many_and_survive_printing(tmp_path):
    assert load_settings(None).topics.cameras == ()
    assert load_settings(_file(tmp_path, "[topics]\ncamera = '/a'\n")).topics.cameras == ("/a",)
    many = load_settings(_file(tmp_path, "[topics]\ncamera = ['/a', '/b']\n"))
    assert many.topics.cameras == ("/a", "/b") and load_settings(_file(tmp_path, settings_as_toml(many))) == many


def test_colours_are_names_or_hsv_ranges(tmp_path):
    text = '[colours]\neffector = {low = [50, 80, 80], high = [70, 255, 255]}\nmarkers = {elbow = "blue"}\n'
    colours = load_settings(_file(tmp_path, text)).colours
    assert colours.effector == {"low": (50, 80, 80), "high": (70, 255, 255)}
    assert colours.markers == {"elbow": "blue"}


@pytest.mark.parametrize(
    ("content", "text"),
    [
        ("[topic]\njoints = '/j'", "did you mean topics"),
        ("[body]\njoint = ['a']", "did you mean joints"),
        ("[body]\njoints = 3", r"joints is 3; possible: \[joint, …\] without repeats; leave it out for: the joints"),
        ("[topics]\ncamera = []", r"topics.camera is \[\]; possible: topic, or \[topic, …\] without repeats"),
        ("[topics]\ncamera = ['/a', '/a']", "without repeats"),
        ("[topics]\ncamera = ''", "topics.camera is ''; possible: topic"),
        ("[colours]\nmarkers = {'side/elbow' = 'blue'}", "names without /"),
        ("[colours]\nmarkers = {elbow = 'puce'}", "possible: {NAME = COLOUR}"),
        ("[body]\njoints = [3]", r"possible: \[joint, …\]"),
        ("[body]\nunit = 'degrees'", "possible: rad, deg, or counts of one turn.*did you mean deg"),
        ("[body]\nunit = '0 counts'", "possible: rad, deg, or counts"),
        ("[colours]\nhand = 'puce'", "possible: blue"),
        ("[colours]\nhand = {low = [1, 2], high = [3, 4, 5]}", 'possible: blue.*type: hand = "red"'),
        ("[colours]\nhand = {low = [1, 2, 300], high = [3, 4, 5]}", "h 0..180"),
        ("[estimate]\nmethod = 'smother'", "possible: filter, smoother, .*; did you mean smoother?"),
        ("[estimate]\nmethod = 'laplace'", "did you mean filter?"),
        ("[estimate]\nrate = true", "possible: number from 0.001 to 10000 Hz; leave it out for: the encoders' rate"),
        ("[estimate]\nrate = nan", "possible: number"),
        ("[synchrony]\nclock_offset = -inf", "possible: number from -9e\\+09 to 9e\\+09 s, or auto"),
        ("[synchrony]\nclock_offset = 'later'", "did you mean auto"),
        ("[time]\ndelay = 'soon'", "possible: auto, off, or {NAME = number from -3600 to 3600 s}"),
        ("[time]\ndelay = {camera = 'late'}", "possible: auto, off, or {NAME"),
        ("[time]\ndelay = {camera = nan}", "possible: auto, off, or {NAME"),
        ("[fit]\nevery = 1.5", "possible: whole number from 1 to 1e\\+09; type: every = 1"),
        ("[fit]\nevery = 0", "from 1 to 1e\\+09"),
        ("[fit]\nsamples = 1", "from 8"),
        ("[topics]\nstart = 1e308", "from -9e\\+09 to 9e\\+09"),
        ("[time]\ndelay = {camera = 1e9}", "to 3600 s"),
        ("[fit]\nseed = -1", "from 0"),
        ("[skin]\nthreshold = 70", "skin.threshold is 70; possible: number from 0 to 1; type: threshold = 0.7"),
        ("[skin]\ncolumns = 0", "from 1"),
        ("[body]\njoints = []", "without repeats"),
        ("[body]\njoints = ['a', 'a']", "without repeats"),
        ("skin = 3", "must be a table"),
        ("[skin", "cannot be read as TOML"),
        ("skin = " + "[" * 100_000, "cannot be read as TOML"),
    ],
)
def test_impossible_settings_are_rejected_in_one_line(tmp_path, content, text):
    with pytest.raises(ConfigError, match=text) as caught:
        load_settings(_file(tmp_path, content))
    assert "robot.toml" in str(caught.value)


def test_absent_file_is_a_usage_error(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        load_settings(tmp_path / "none.toml")


def test_endless_file_is_rejected():
    with pytest.raises(ConfigError, match="more than 4194304 bytes"):
        load_settings(Path("/dev/zero"))


def test_printed_settings_read_back_unchanged(tmp_path):
    given = '[body]\njoints = ["pan \\" lift", "b"]\n[colours]\nmarkers = {elbow = {low = [1,2,3], high = [4,5,6]}}\n'
    settings = load_settings(_file(tmp_path, given))
    assert load_settings(_file(tmp_path, settings_as_toml(settings))) == settings


def test_preset_paper_implies_predictive_coding(tmp_path):
    toml = tmp_path / "robot.toml"
    toml.write_text('[estimate]\npreset = "paper"\n')
    assert load_settings(toml).estimate.method == "predictive-coding"
    assert load_settings(None, {"estimate": {"preset": "paper"}}).estimate.method == "predictive-coding"
    assert load_settings(toml, {"estimate": {"method": "kalman"}}).estimate.method == "kalman"
    assert load_settings(None, {"estimate": {"preset": "paper", "method": "smoother"}}).estimate.method == "smoother"
    assert load_settings(None, {"estimate": {"preset": "default"}}).estimate.method == "filter"


SECTIONS = {f.name: type(getattr(Settings(), f.name)) for f in fields(Settings) if f.name != "features"}


@pytest.mark.parametrize("section", SECTIONS)
def test_settings_are_described_and_their_defaults_are_possible(section):
    for name, one in declared_keys(SECTIONS[section]).items():
        assert one.key.meaning.endswith(".") and len(one.key.meaning.split()) <= 12, name
        assert one.key.unset or one.default is not None, name
        assert load_settings(None, {section: {name: one.default}}) == Settings()


def test_methods_are_those_of_estimation():
    from bodylog import estimation

    assert tuple(estimation.METHODS) == METHODS


def test_printed_settings_name_every_key_below_its_meaning():
    lines = settings_as_toml(Settings()).splitlines()
    for section, values in settings_as_values(Settings()).items():
        for name in values:
            one = declared_keys(SECTIONS[section])[name]
            place = lines.index(f"# {one.key.meaning}", lines.index(f"[{section}]"))
            assert lines[place + 2].removeprefix("# ").startswith(f"{name} ="), name


def test_page_of_settings_is_what_they_declare():
    assert PAGE.read_text(encoding="utf-8") == page(), "type: make docs"
    assert all(f"`{name}`" in page() for values in settings_as_values(Settings()).values() for name in values)
