"""Damaged datasets are read as far as they are sound, or refused in one line; any byte may be wrong."""

import random
import shutil
from pathlib import Path

import pytest

from bodylog.errors import BodylogError
from bodylog.logs.conversion.examination import examine_log_file
from bodylog.recording import facts, recording
from bodylog.settings import Settings

from . import drawn

SOURCES = {
    "v21": lambda path: drawn.v21(path, [9, 7]),
    "v30": lambda path: drawn.v30(path, [9, 7]),
    "aloha.hdf5": lambda path: drawn.aloha(path, 9),
    "demos.hdf5": lambda path: drawn.robomimic(path, (0, 1), 9),
    "mixed": lambda path: drawn.mixed(path, 9),
}


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Path:
    """One dataset of each format."""
    folder = tmp_path_factory.mktemp("sound")
    for name, make in SOURCES.items():
        make(folder / name)
    return folder


def _spoilt(data: bytearray, rng: random.Random) -> bytearray:
    """Change, cut, zero, insert or repeat bytes."""
    at, many = rng.randrange(len(data) + 1), rng.randrange(1, 200)
    how = rng.randrange(6)
    if how < 2:
        for _ in range(rng.choice((1, 3, 20)) if data else 0):
            data[rng.randrange(len(data))] = rng.randrange(256)
        return data
    spoilt = (data[:at], data[:at] + bytes(many) + data[at + many :], data[:at] + rng.randbytes(many) + data[at:])
    return (*spoilt, data[:at] + data[max(0, at - many) :])[how - 2]


def _read_whole(path: Path) -> None:
    facts.describe_log(path, Settings())
    frames = recording.read_recording(path, Settings()).cameras.frames
    for frame in frames() if frames is not None else ():
        try:
            assert frame.image.ndim == 3
        except BodylogError:
            continue
    examine_log_file(path)


def _meet(sound: Path, place: Path, seeds: range) -> None:
    for seed in seeds:
        rng = random.Random(seed)
        name = rng.choice(list(SOURCES))
        path = place / f"{seed}" / name
        path.parent.mkdir()
        (shutil.copytree if (sound / name).is_dir() else shutil.copy)(sound / name, path)
        files = sorted(one for one in (path.rglob("*") if path.is_dir() else [path]) if one.is_file())
        file = rng.choice(files)
        file.write_bytes(_spoilt(bytearray(file.read_bytes()), rng))
        try:
            _read_whole(path)
        except BodylogError as refused:
            assert "\n" not in str(refused), f"seed {seed}: {file}"
        shutil.rmtree(path.parent)


def test_open_survives_damage_anywhere(sound, tmp_path):
    _meet(sound, tmp_path, range(60))


@pytest.mark.soak
def test_open_survives_much_damage_anywhere(sound, tmp_path):
    _meet(sound, tmp_path, range(1000, 6000))
