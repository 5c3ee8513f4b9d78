import pytest

from bodylog.batch.manifest import load_manifest
from bodylog.errors import ConfigError
from bodylog.settings import Settings

TWO = """
[[group]]
name = "left arm"
train = ["explore.bag"]
logs = ["runs/*.mcap"]
methods = ["filter", "smoother"]
fail_if = ["rmse/joint>0.02"]
settings = {skin = {threshold = 0.5}}

[[group]]
body = "body.npz"
logs = ["other"]
"""


def _manifest(tmp_path, text):
    path = tmp_path / "batch.toml"
    path.write_text(text)
    return path


def test_manifest_has_a_group_per_method_with_relative_paths(tmp_path):
    filtered, smoother, other = load_manifest(_manifest(tmp_path, TWO), Settings())
    assert (filtered.name, smoother.name, other.name) == ("left_arm-filter", "left_arm-smoother", "group2")
    assert smoother.settings.estimate.method == "smoother" and smoother.settings.skin.threshold == 0.5
    assert filtered.train == (tmp_path / "explore.bag",) and filtered.logs == (str(tmp_path / "runs/*.mcap"),)
    assert filtered.bounds == ("rmse/joint>0.02",) and other.body == tmp_path / "body.npz"


@pytest.mark.parametrize(
    ("content", "text"),
    [
        ("[[group]]\nlog = ['a']", "did you mean logs"),
        ("[[group]]\nlogs = 'a'", r"logs is 'a'; possible: \[log, …\]"),
        ("[[group]]\nlogs = [1]", r"possible: \[log, …\]"),
        ("[[group]]\nbody = 'b'", "group 1 has no logs; it must have logs"),
        ("[[group]]\nlogs = []", "logs is empty; type, for example"),
        ("[groups]\nlogs = ['a']", r"\[\[group\]\]"),
        ("[[group]]\nname = 'a'\nlogs = ['a']\n[[group]]\nname = 'a'\nlogs = ['b']", "have the same name"),
        ("[[group]]\nlogs = ['a']\nsettings = {skin = {treshold = 1}}", "did you mean threshold"),
        ("[[group]]\nlogs = ['']", r"possible: \[log, …\]"),
        ("[[group]]\nlogs = ['a']\ntrain = ['b', '']", r"possible: \[log, …\]"),
        ("[[group]]\nlogs = ['a']\nbody = ''", "body is ''; possible: file"),
        ("[[group]]\nlogs = ['a']\nmethods = ['kalmann']", "possible: .any of filter, .*, …"),
        ("group = [3]", "must be a"),
        ("[[group]]\nname = 'junit.XML'\nlogs = ['a']", "or reserved"),
        ("[[group]]\nname = 'a'\nlogs = ['a']\n[[group]]\nname = 'A'\nlogs = ['b']", "have the same name"),
        ("[[group", "cannot be read as TOML"),
        ("group = " + "[" * 100_000, "cannot be read as TOML"),
    ],
)
def test_unsound_manifest_is_rejected(tmp_path, content, text):
    with pytest.raises(ConfigError, match=text):
        load_manifest(_manifest(tmp_path, content), Settings())


def test_groups_have_separate_folders(tmp_path, robot, run_cli):
    text = f"""
[[group]]
name = "arm"
body = "{robot / "body.npz"}"
logs = ["{robot / "reach.mcap"}"]
methods = ["filter", "kalman"]
"""
    assert run_cli("batch", _manifest(tmp_path, text), "-o", tmp_path / "out") == 0
    assert (tmp_path / "out" / "arm-kalman" / "reach.mcap" / "report.html").exists()
    assert len((tmp_path / "out" / "results.jsonl").read_text().splitlines()) == 2


def test_manifest_keeps_urls(tmp_path):
    (group,) = load_manifest(_manifest(tmp_path, "[[group]]\nlogs = ['s3://bucket/a.mcap']"), Settings())
    assert group.logs == ("s3://bucket/a.mcap",)
