import csv
import sys

import numpy as np
import pytest

from bodylog.errors import UsageError
from bodylog.recording.recording import read_recording
from bodylog.recording.tables import export_features, export_signals
from bodylog.recording.tidy import signals_by_role
from bodylog.settings import Settings
from bodylog.types import Features, Series, Stroke, Synchrony, Touch
from tests.changed_recordings import make_recording
from tests.logs.written import START


def recording(**streams):
    return make_recording(start_ns=START, duration_s=1.0, **streams)


def some(names=("a", "b"), count=5, seed=0):
    values = np.random.default_rng(seed).normal(size=(count, len(names))) * 10.0 ** np.arange(-3, len(names) - 3)
    values[2, 0] = np.nan
    return Series(np.arange(count) / 10, values, names, "rad", START + np.arange(count))


def table(path):
    with path.open(newline="", encoding="utf-8") as stream:
        head, *rows = csv.reader(stream)
    return head, rows


@pytest.mark.parametrize("seed", range(3))
def test_export_csv_reads_back_exactly(tmp_path, seed):
    series = some(seed=seed)
    (path,) = export_signals(recording(joints=series), tmp_path, "csv")
    head, rows = table(path)
    assert path.name == "joints.csv" and head == ["stamp_ns", "t", "a", "b"]
    numbers = np.array([[float(cell or "nan") for cell in row[1:]] for row in rows])
    assert np.array_equal(numbers, np.column_stack([series.t, series.values]), equal_nan=True)
    assert [int(row[0]) - START for row in rows] == [i * 100_000_000 for i in range(5)]


def test_export_keeps_awkward_names_distinct(tmp_path):
    (path,) = export_signals(recording(truth=some(("t", 'with "quotes", commas', "ü"))), tmp_path, "csv")
    assert table(path)[0] == ["stamp_ns", "t", "t_", 'with "quotes", commas', "ü"]


def test_export_parquet_reads_back_exactly(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
    series = some()
    (path,) = export_signals(recording(skin=series), tmp_path / "new folder", "parquet")
    found = parquet.read_table(path).to_pydict()
    assert list(found) == ["stamp_ns", "t", "a", "b"]
    assert np.array_equal(np.column_stack([found["a"], found["b"]]), series.values, equal_nan=True)


def test_export_names_a_missing_package(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(UsageError, match=r"pip install 'bodylog\[datasets\]'"):
        export_signals(recording(joints=some()), tmp_path, "parquet")
    assert not list(tmp_path.iterdir())


def test_export_refuses_an_unknown_format(tmp_path):
    with pytest.raises(UsageError, match="export as 'xls': possible are csv, parquet"):
        export_signals(recording(joints=some()), tmp_path, "xls")


def test_export_keeps_only_the_window(tmp_path, arm):
    read_back = read_recording(arm / "reach.bag", Settings())
    paths = export_signals(read_back, tmp_path, "csv", (1.0, 2.0))
    assert {path.name for path in paths} == {"joints.csv", "truth.csv", "skin.csv"}
    for path in paths:
        series = signals_by_role(read_back)[path.stem]
        times = [float(row[1]) for row in table(path)[1]]
        assert times == [t for t in series.t.tolist() if 1.0 <= t <= 2.0] and len(times) > 10


def features(touches):
    track = Series(np.arange(3) / 10, np.array([[1.5, 2.0], [np.nan] * 2, [3.0, 4.25]]), ("u", "v"), "px",
                   START + np.arange(3), np.array([[0.1, 0.2], [np.nan] * 2, [0.3, 0.4]]))  # fmt: skip
    strokes = (Stroke(1.05, 1.9, (3.0, 4.0), (5.0, 6.0)),)
    pairs = (Synchrony(0, 0, 0.05, 0.9), Synchrony(1, None, np.nan, 0.0)) if touches else ()
    return Features(None, {"effector": track, "../el bow": track}, touches, strokes, pairs, {})


def test_export_features_reads_back_exactly(tmp_path):
    touches = (Touch(1.0, 1.85, (4, 5), 0.93, 5, START), Touch(3.0, 3.25, (9,), 0.8, 9, START))
    paths = export_features(features(touches), tmp_path / "new")
    names = ["tracks_effector.csv", "tracks_..%2Fel%20bow.csv", "strokes.csv", "touches.csv", "synchrony.csv"]
    assert [path.name for path in paths] == names and {path.parent for path in paths} == {tmp_path / "new"}
    head, rows = table(paths[0])
    assert head == ["t", "u", "v", "std_u", "std_v"]
    assert rows == [["0.0", "1.5", "2.0", "0.1", "0.2"], ["0.1", "", "", "", ""], ["0.2", "3.0", "4.25", "0.3", "0.4"]]
    assert table(paths[2])[1] == [["1.05", "1.9", "3.0", "4.0", "5.0", "6.0"]]
    assert table(paths[3]) == (["onset", "offset", "peak", "strongest", "cells"],
                               [["1.0", "1.85", "0.93", "5", "4 5"], ["3.0", "3.25", "0.8", "9", "9"]])  # fmt: skip
    assert table(paths[4])[1] == [["0", "0", "0.05", "0.9"], ["1", "", "", "0.0"]]


def test_export_features_without_skin_writes_no_touches(tmp_path):
    names = [path.name for path in export_features(features(None), tmp_path)]
    assert "strokes.csv" in names and "touches.csv" not in names and "synchrony.csv" not in names
