"""Episodes of datasets by name and by --episode in every command, and ranges of them in batches."""

import json
from pathlib import Path

import numpy as np
import pytest
from bodylog_cli.commands import bodylog as group

import bodylog.logs as logs
from bodylog.batch import jobs

from ..logs.datasets import drawn

LOGS = {"log", "logs", "source"}
READERS = [name for name, command in group.commands.items() if LOGS & {param.name for param in command.params}]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory) -> Path:
    return drawn.v21(tmp_path_factory.mktemp("cli") / "set", [12, 9, 15])


@pytest.mark.parametrize("name", READERS)
def test_commands_that_read_a_log_take_an_episode(name):
    assert any(param.name == "episode" for param in group.commands[name].params)


def test_episode_is_the_same_by_name_and_by_option(dataset, run_cli, capsys):
    found = []
    for arguments in ((f"{dataset}#2",), (dataset, "--episode", 2)):
        assert run_cli("info", *arguments, "--json") == 0
        found.append(json.loads(capsys.readouterr().out)["results"][0])
    assert found[0] == found[1]
    one = found[0]["log"]
    assert one["path"] == f"{dataset}#2" and one["format"] == "lerobot v2.1" and one["unit"] == "rad"
    assert {topic["topic"]: topic["messages"] for topic in one["topics"]}["/joint_states"] == 15


@pytest.mark.parametrize("command", ["estimate", "convert", "ingest"])
def test_command_that_writes_a_log_takes_an_episode(dataset, run_cli, tmp_path, command):
    """Attachments are copied from files, and an episode's name is not a file."""
    assert run_cli(command, f"{dataset}#2", "-o", tmp_path / "run.mcap") == 0
    with logs.open(tmp_path / "run.mcap") as log:
        assert {topic.name: topic.messages for topic in log.topics}["/joint_states"] == 15


def test_episode_range_is_several_logs(dataset, run_cli, capsys):
    assert run_cli("info", dataset, "--episode", "0-2", "--json") == 0
    results = json.loads(capsys.readouterr().out)["results"]
    assert [one["input"] for one in results] == [f"{dataset}#{n}" for n in range(3)]
    assert run_cli("ingest", dataset, "--episode", "0-2", "-o", dataset.parent / "x.mcap") == 2
    assert "this command takes one episode" in capsys.readouterr().err
    assert run_cli("info", dataset, "--episode", "last") == 2
    assert "possible: a number or a range" in capsys.readouterr().err


def test_absent_episode_is_refused(dataset, run_cli, capsys):
    assert run_cli("info", dataset, "--episode", 7) == 65
    assert "no episode 7; possible: 0 to 2" in capsys.readouterr().err
    assert run_cli("info", dataset / "meta" / "info.json", "--episode", 0) == 65
    assert "has no episodes; leave out the #" in capsys.readouterr().err


def test_dataset_is_converted_and_read_back(dataset, run_cli, tmp_path, capsys):
    assert run_cli("ingest", dataset, "--episode", 1, "-o", tmp_path / "run.mcap") == 0
    assert run_cli("convert", tmp_path / "run.mcap", "-o", f"{tmp_path}/new/", "--to", "lerobot", "--json") == 0
    assert json.loads(capsys.readouterr().out)["results"][0]["output"] == str(tmp_path / "new")
    with logs.open(dataset, episode=1) as a, logs.open(tmp_path / "new") as b:
        np.testing.assert_array_equal(a["/joint_states"].position, b["/joint_states"].position)
    assert run_cli("convert", tmp_path / "new", "-o", tmp_path / "new.mcap", "--topics", "/joint_states") == 0
    with logs.open(tmp_path / "new.mcap") as log:
        assert [topic.name for topic in log.topics] == ["/joint_states"]
    assert run_cli("convert", tmp_path / "run.mcap", "-o", tmp_path / "new", "--to", "lerobot") == 2
    assert "already exists" in capsys.readouterr().err
    assert run_cli("convert", dataset, "-o", dataset / "new", "--to", "lerobot") == 2
    assert run_cli("doctor", tmp_path / "new") == 0


def test_damaged_episode_keeps_its_sound_part_and_exits_3(dataset, run_cli, tmp_path, capsys):
    import shutil

    folder = Path(shutil.copytree(dataset, tmp_path / "set"))
    video = folder / f"videos/chunk-000/{drawn.CAMERA}/episode_000000.mp4"
    video.write_bytes(video.read_bytes()[:900])
    assert run_cli("info", folder, "--episode", 0) == 3
    assert run_cli("info", folder, "--episode", 0, "--strict") == 65
    assert run_cli("ingest", folder, "--episode", 0, "-o", tmp_path / "run.mcap") == 3
    with logs.open(tmp_path / "run.mcap") as log:
        assert len(log["/joint_states"]) == 12
    capsys.readouterr()


def test_batch_treats_each_episode_as_a_log(dataset, tmp_path):
    assert jobs.name_logs([str(dataset)]) == {f"set_{n}": f"{dataset}#{n}" for n in range(3)}
    assert list(jobs.name_logs([f"{dataset}#1-2"]).values()) == [f"{dataset}#1", f"{dataset}#2"]
    drawn.robomimic(tmp_path / "demos.hdf5")
    drawn.aloha(tmp_path / "one.hdf5")
    found = sorted(jobs.name_logs([str(tmp_path)]).values())
    assert found == [f"{tmp_path}/demos.hdf5#{n}" for n in (0, 1, 3)] + [f"{tmp_path}/one.hdf5"]
