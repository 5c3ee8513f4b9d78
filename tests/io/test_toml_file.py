"""TOML files: ordinary ones are read, hostile ones refused in a line before they cost time or memory."""

import os
import resource
import subprocess
import sys

import pytest

from bodylog.errors import ConfigError
from bodylog.io import atomic_files, toml_file
from tests.work import at_most

BOMBS = {
    "dotted": "a." * 500_000 + "a = 1",
    "spaced": "a . " * 250_000 + "a = 1",
    "quoted": '"".' * 300_000 + "a = 1",
    "table": "[" + "a." * 500_000 + "a]",
    "inline": "x = {" + "a." * 500_000 + "a = 1}",
    "nested": "x = " + "[" * 500_000,
    "nested soundly": "x = " + "[" * 200 + "]" * 200,
    "tables": "x = " + "{a = " * 100_000,
    "digits": "x = " + "9" * 1_000_000,
    "hexadecimal": "x = 0x" + "f" * 1_000_000,
    "beyond 64 bits": f"x = {2**63}",
    "nothing": 'x = "a\\u0000b"',
    "key of nothing": '"a\\u0000b" = 1',
    "strings without end": 'x = "' + '\\"' * 100_000,
    "bytes": "\ud800",
    "too long": "#" * (toml_file.MOST_BYTES + 1),
}


@pytest.mark.parametrize("name", BOMBS)
def test_read_refuses_bombs_in_one_line(tmp_path, name):
    path = tmp_path / "robot.toml"
    path.write_bytes(BOMBS[name].encode(errors="surrogatepass"))
    with at_most(calls=5_000_000), pytest.raises(ConfigError, match=r"^.*robot\.toml: [^\n]{1,300}$"):
        toml_file.read_toml(path)


def test_read_reads_ordinary_files(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text("""
    [colours.markers."a.b"]   # ...................................... and 1.2.3.4.5.6
    low = [1, 2, 3]
    [topics]
    joints = '/a.b.c.d'
    camera = "side.\\"avi"
    rate = 1.5e3
    [estimate.start.x]
    y.z = 1
    """)
    found = toml_file.read_toml(path)
    assert found["topics"]["joints"] == "/a.b.c.d" and found["estimate"]["start"]["x"]["y"] == {"z": 1}


def test_longest_key_counts_parts():
    for content, parts in (("a = 1", 1), ("a.b = 1.5", 2), ('a . "b.c" . d', 3), ("a b.c", 2), (". . .", 0)):
        assert toml_file._longest_key(content) == parts, content


def test_read_refuses_a_pipe_without_a_writer(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "robot.toml")
    monkeypatch.setattr(atomic_files, "PATIENCE", 0.2)
    with pytest.raises(ConfigError, match="did not come to its end"):
        toml_file.read_toml(tmp_path / "robot.toml")


MANIFESTS = ("pipe", "/dev/zero", "/dev/full", "folder", "bomb")


@pytest.mark.parametrize("name", MANIFESTS)
def test_read_refuses_an_endless_manifest_in_one_line(tmp_path, name):
    """In a separate process, with little memory and patience."""
    (tmp_path / "folder").mkdir()
    (tmp_path / "bomb").write_text(BOMBS["dotted"])
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "batch.toml").symlink_to(tmp_path / name)
    patience = "from bodylog.io import atomic_files; atomic_files.PATIENCE = 0.5"
    script = f"import sys; {patience}; import bodylog_cli; bodylog_cli.main()"
    typed = [sys.executable, "-c", script, "batch", tmp_path / "batch.toml", "-o", tmp_path / "out"]

    def little():
        resource.setrlimit(resource.RLIMIT_AS, (1 << 30, 1 << 30))

    done = subprocess.run(typed, capture_output=True, text=True, timeout=30, preexec_fn=little)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and str(tmp_path / "batch.toml") in done.stderr
    assert not (tmp_path / "out").exists()
