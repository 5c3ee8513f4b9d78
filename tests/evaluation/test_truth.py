"""Truth kept beside a log, in tables and arrays, at times of any origin."""

import numpy as np
import pytest

from bodylog.errors import InputError
from bodylog.evaluation.truth import load_truth
from bodylog.types import Series

START = 1_700_000_000_123_456_789
T = np.arange(50) / 10.0
Q = np.stack([np.sin(T), np.cos(T)], axis=1)
READ = Series(T, Q[:, ::-1] + 0.01, ("pan", "lift"), "rad", np.zeros(50, np.int64))


def table(path, name, times):
    rows = [f"{t},{a},{b}" for t, (a, b) in zip(times, Q.tolist(), strict=True)]
    path.write_text("\n".join([f"{name},lift,pan", *rows, ""]))
    return load_truth(path, START, READ)


@pytest.mark.parametrize(
    ("name", "times"),
    [
        ("t", T.tolist()),
        ("time", [START / 1e9 + t for t in T]),
        ("stamp_ns", [START + round(t * 1e9) for t in T]),
        ("timestamp", [(START + round(t * 1e9)) / 1e6 for t in T]),
    ],
)
def test_load_accepts_tables_of_any_time_origin(tmp_path, name, times):
    found = table(tmp_path / "truth.csv", name, times)
    assert found.names == ("lift", "pan")
    np.testing.assert_allclose(found.t, T, atol=2e-3 if name == "timestamp" else 1e-6)
    np.testing.assert_allclose(found.values, Q)


@pytest.mark.parametrize(("key", "later"), [("start", 0), ("T0", 2_000_000_000)])
def test_arrays_are_dated_by_their_start(tmp_path, key, later):
    np.savez(tmp_path / "a.npz", t=T, q=Q, names=np.array(["lift", "pan"]), **{key: START + later})
    found = load_truth(tmp_path / "a.npz", START, READ)
    assert found.names == ("lift", "pan")
    np.testing.assert_allclose(found.t, T + later / 1e9, atol=1e-6)


def test_columns_without_names_are_named_by_the_readings_they_follow(tmp_path):
    np.savez(tmp_path / "a.npz", t=T, q=Q)
    assert load_truth(tmp_path / "a.npz", START, READ).names == ("lift", "pan")
    np.savez(tmp_path / "b.npz", t=T, q=Q.mean(axis=1, keepdims=True) + np.array([-0.2, 0.2]))
    with pytest.raises(InputError, match="add an array names"):
        load_truth(tmp_path / "b.npz", START, READ)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "0 lines"),
        ("a,b\n1,2\n", "found a, b; one of t, time"),
        ("t,pan\n0,1\n1\n", "line 3 has 1 columns"),
        ("t,pan\nx,1\n", "could not convert"),
        ("t,pan\nnan,1\n", "not with numbers"),
    ],
)
def test_load_refuses_invalid_truth_with_the_possible_forms(tmp_path, text, why):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(InputError, match=why) as refused:
        load_truth(tmp_path / "a.csv", START, READ)
    assert "possible: a .csv with a column t" in str(refused.value) and "\n" not in str(refused.value)


def test_arrays_of_objects_and_truncated_archives_are_refused(tmp_path):
    np.savez(tmp_path / "a.npz", t=T, q=Q.astype(object))
    (tmp_path / "b.npz").write_bytes((tmp_path / "a.npz").read_bytes()[:200])
    for name in "ab":
        with pytest.raises(InputError, match="no truth can be read"):
            load_truth(tmp_path / f"{name}.npz", START, READ)
