import pytest

from bodylog.batch.manifest import load
from bodylog.errors import ConfigError
from bodylog.settings import Settings

TWO = """
[[group]]
name = "left arm"
train = ["explore.bag"]
logs = ["runs/*.mcap"]
methods = ["laplace", "smoother"]
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


def test_a_group_per_method_with_paths_beside_the_manifest(tmp_path):
    laplace, smoother, other = load(_manifest(tmp_path, TWO), Settings())
    assert (laplace.name, smoother.name, other.name) == ("left_arm-laplace", "left_arm-smoother", "group2")
    assert smoother.settings.estimate.method == "smoother" and smoother.settings.skin.threshold == 0.5
    assert laplace.train == (tmp_path / "explore.bag",) and laplace.logs == (str(tmp_path / "runs/*.mcap"),)
    assert laplace.bounds == ("rmse/joint>0.02",) and other.body == tmp_path / "body.npz"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[[group]]\nlog = ['a']", "did you mean logs"),
        ("[[group]]\nlogs = 'a'", r"logs is 'a'; possible: \[log, …\]"),
        ("[[group]]\nlogs = [1]", r"possible: \[log, …\]"),
        ("[[group]]\nbody = 'b'", "logs is missing"),
        ("[groups]\nlogs = ['a']", r"\[\[group\]\]"),
        ("[[group]]\nname = 'a'\nlogs = ['a']\n[[group]]\nname = 'a'\nlogs = ['b']", "have the same name"),
        ("[[group]]\nlogs = ['a']\nsettings = {skin = {treshold = 1}}", "did you mean threshold"),
        ("[[group]]\nlogs = ['']", r"possible: \[log, …\]"),
        ("[[group]]\nlogs = ['a']\ntrain = ['b', '']", r"possible: \[log, …\]"),
        ("[[group]]\nlogs = ['a']\nbody = ''", "body is ''; possible: file"),
        ("[[group]]\nlogs = ['a']\nmethods = ['kalmann']", "possible: .any of laplace, .*, …"),
        ("group = [3]", "must be a"),
        ("[[group]]\nname = 'junit.XML'\nlogs = ['a']", "or taken"),
        ("[[group]]\nname = 'a'\nlogs = ['a']\n[[group]]\nname = 'A'\nlogs = ['b']", "have the same name"),
        ("[[group", "cannot be read as TOML"),
        ("group = " + "[" * 100_000, "cannot be read as TOML"),
    ],
)
def test_what_makes_no_sense_is_refused(tmp_path, text, said):
    with pytest.raises(ConfigError, match=said):
        load(_manifest(tmp_path, text), Settings())


def test_groups_run_into_folders_of_their_own(tmp_path, robot, run_cli):
    text = f"""
[[group]]
name = "arm"
body = "{robot / "body.npz"}"
logs = ["{robot / "reach.mcap"}"]
methods = ["laplace", "kalman"]
"""
    assert run_cli("batch", _manifest(tmp_path, text), "-o", tmp_path / "out") == 0
    assert (tmp_path / "out" / "arm-kalman" / "reach.mcap" / "report.html").exists()
    assert len((tmp_path / "out" / "results.jsonl").read_text().splitlines()) == 2


def test_logs_behind_urls_are_not_beside_the_manifest(tmp_path):
    (group,) = load(_manifest(tmp_path, "[[group]]\nlogs = ['s3://bucket/a.mcap']"), Settings())
    assert group.logs == ("s3://bucket/a.mcap",)
