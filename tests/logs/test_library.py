"""The library: tables, messages and images of any log; and logs written from arrays."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bodylog.logs as logs
from bodylog.errors import BodylogError, ConfigError, FormatError, UsageError
from bodylog.logs.decode.definitions import PRIMITIVES, TEXTS
from tests.logs.writing import T0, Stream, cdr, define, header, write

FIXTURES = Path(__file__).parents[2] / "fixtures" / "containers"
SHARED = Path(__file__).parents[2].parent / "shared" / "logs"
COOKBOOK = (Path(__file__).parents[2] / "docs" / "logs.md").read_text()
JOINTS = "sensor_msgs/msg/JointState"


def joints(path: Path, count: int = 20, lengths: tuple[int, ...] = (2,)) -> Path:
    """An MCAP of joint states whose number of joints cycles through `lengths`, in descending log time."""
    messages = []
    for k in range(count):
        n = lengths[k % len(lengths)]
        fields = {"header": header(T0 + k), "name": [f"j{i}" for i in range(n)], "position": np.arange(n) + float(k)}
        messages.append((T0 + 10 * k, cdr(JOINTS, **fields, velocity=np.zeros(0), effort=np.zeros(0))))
    return write(path, [Stream("/joint_states", JOINTS, define(JOINTS), messages[::-1])], in_order=False)


def test_table_decodes_fields_in_order_of_log_time(tmp_path):
    with logs.open(joints(tmp_path / "a.mcap")) as log:
        table = log["/joint_states"]
        np.testing.assert_array_equal(table.position[:, 0], np.arange(20.0))
        np.testing.assert_array_equal(table.header.stamp, T0 + np.arange(20))
        np.testing.assert_array_equal(table["header.stamp"], table.header.stamp)
        np.testing.assert_array_equal(table.log_ns, T0 + 10 * np.arange(20))
        assert table.name[0].tolist() == ["j0", "j1"] and table.header.frame_id.shape == (20,)
        assert len(table) == 20 and table.rejected == {}


def test_table_pads_arrays_of_several_lengths(tmp_path):
    with logs.open(joints(tmp_path / "a.mcap", lengths=(1, 3))) as log:
        assert np.isnan(log["/joint_states"].position).sum() == 20


def test_table_pads_texts_of_several_counts(tmp_path):
    with logs.open(joints(tmp_path / "a.mcap", lengths=(1, 2))) as log:
        assert log["/joint_states"].name[:2].tolist() == [["j0", ""], ["j0", "j1"]]


def test_table_rows_are_messages_in_which_every_field_decodes(tmp_path):
    none = {"velocity": np.zeros(0), "effort": np.zeros(0)}
    payloads = [cdr(JOINTS, header=header(T0 + k), name=["a"], position=np.array([1.0]), **none) for k in range(9)]
    payloads[4] = payloads[4][:30]
    messages = [(T0 + k, payload) for k, payload in enumerate(payloads)]
    path = write(tmp_path / "a.mcap", [Stream("/j", JOINTS, define(JOINTS), messages)])
    with logs.open(path) as log:
        table = log["/j"]
        assert len(table.log_ns) == 9
        assert len(table.position) == len(table.log_ns) == len(table) == 8
        assert table.rejected == {"malformed": 1}
        assert len(list(log.messages())) == 8 and log.rejected == {"/j": 1}


def test_open_log_lists_names_for_an_unknown_one(tmp_path):
    with logs.open(joints(tmp_path / "a.mcap")) as log:
        with pytest.raises(ConfigError, match=r"no topic '/joint_state'; did you mean /joint_states\?"):
            log["/joint_state"]
        with pytest.raises(AttributeError, match=r"no field 'positon'; did you mean position\?"):
            _ = log["/joint_states"].positon
        with pytest.raises(ConfigError, match="no field 'positon'; it has header, name, position"):
            log["/joint_states"]["positon"]


def test_read_takes_several_topics_in_one_pass(tmp_path, robot):
    tables = logs.read(robot / "reach.mcap", {"/joint_states": ["position"], "/truth/joint_states": ["position"]})
    with logs.open(robot / "reach.mcap") as log:
        for name, table in tables.items():
            np.testing.assert_array_equal(table.position, log[name].position)


def test_frames_are_images(robot):
    with logs.open(robot / "reach.mcap") as log:
        frame = next(log.frames("/camera/image/compressed"))
    assert frame.image.shape == (120, 160, 3)


def test_url_gives_the_same_arrays(robot):
    pytest.importorskip("fsspec")
    url, path = (robot / "reach.mcap").as_uri(), robot / "reach.mcap"
    wanted = {"/joint_states": ["position", "header.stamp"]}
    there, here = (logs.read(place, wanted)["/joint_states"] for place in (url, path))
    np.testing.assert_array_equal(there.position, here.position)


def test_table_is_the_same_in_every_container(arm):
    tables = [logs.open(arm / name)[topic] for name, topic in
              (("reach.bag", "/tomm/right_arm/joint_states"), ("reach_rosbag2", "/lbr/joint_states"))]  # fmt: skip
    np.testing.assert_array_equal(*(table.position for table in tables))
    np.testing.assert_array_equal(*(table.header.stamp for table in tables))


def _leaf(message: Any, path: str) -> Any:
    for name in path.split("."):
        message = getattr(message, name)
    if hasattr(message, "nanosec"):
        return message.sec * 10**9 + message.nanosec
    return message


def _plain_paths(log: Any, name: str) -> list[str]:
    return [path for path in log[name].fields if "[" not in path]


RECORDED = "cruise-automation__rosbag.js dantheman3333__frost geocamxyz__rosbags-rs mikeferguson__robot_calibration"


@pytest.mark.parametrize("name", RECORDED.split())
def test_table_of_recorded_logs_equals_rosbags(name):
    """Each message of small topics, each field outside arrays of messages."""
    if not (SHARED / name).is_dir():
        pytest.skip(f"{SHARED / name} is not here")
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    compared = 0
    for path in sorted(p for p in (SHARED / name).rglob("*") if p.suffix in (".mcap", ".bag", ".db3")):
        try:
            AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)).__enter__().close()
            log = logs.open(path)
        except Exception:  # one of the two cannot read it: nothing to compare
            continue
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader, log:
            for topic in {t.name for t in log.topics if t.messages <= 2000}:
                compared += _compared(reader, log, topic)
    assert compared > 20


def _compared(reader: Any, log: Any, topic: str) -> int:
    connections = [c for c in reader.connections if c.topic == topic]
    try:
        messages = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(connections)]
        fields = _plain_paths(log, topic)
    except Exception:  # rosbags does not know the type, or the log holds no definition
        return 0
    table, count = log[topic], 0
    for field in fields:
        if field.split(".")[-1] == "seq":  # rosbags omits ROS 1's sequence numbers
            continue
        try:
            expected = [_leaf(message, field) for message in messages]
        except AttributeError:
            continue
        found = table[field]
        if len(found) != len(messages):
            assert table.rejected, (topic, field)
            continue
        for one, other in zip(found, expected, strict=True):
            assert _same(one, other), (topic, field)
        count += 1
    return count


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, bytes):
        return one == bytes(other)
    if np.asarray(other).dtype.kind in "US":
        return np.array_equal(np.asarray(one)[: len(other)], np.asarray(other)) if np.ndim(other) else one == other
    one, other = (np.asarray(x, np.int64) & 0xFF if np.asarray(other).dtype == np.int8 else np.asarray(x)
                  for x in (one, other))  # fmt: skip
    return np.array_equal(one[: len(other)] if np.ndim(other) else one, other, equal_nan=one.dtype.kind == "f")


def test_convert_keeps_what_is_asked_for(tmp_path):
    path = joints(tmp_path / "a.mcap")
    logs.convert(path, tmp_path / "b.mcap", start=50e-9, end=99e-9)
    np.testing.assert_array_equal(logs.open(tmp_path / "b.mcap")["/joint_states"].log_ns, T0 + 10 * np.arange(5, 10))
    with pytest.raises(UsageError, match="no topic '/x'; the topics are /joint_states"):
        logs.convert(path, tmp_path / "c.mcap", topics=["/x"])
    with pytest.raises(UsageError, match="is also an input"):
        logs.convert(path, path)
    assert not (tmp_path / "c.mcap").exists()


VALUES: dict[str, Any] = {
    "header.stamp": T0 + np.arange(6), "header.frame_id": ["a", "b", "a", "b", "", "é"], "name": ["x", "y"],
    "position": np.arange(12.0).reshape(6, 2), "velocity": [[1.0], [1.0, 2.0], [], [3.0], [4.0], [5.0]],
}  # fmt: skip


def test_writer_fields_are_read_by_us_and_by_rosbags(tmp_path):
    from rosbags.highlevel import AnyReader

    path = tmp_path / "w.mcap"
    t = T0 + 10 * np.arange(6)
    with logs.Writer(path) as out:
        out.write("/joint_states", JOINTS, t[:3], {k: v if k == "name" else v[:3] for k, v in VALUES.items()})
        out.write("/joint_states", JOINTS, t[3:], {k: v if k == "name" else v[3:] for k, v in VALUES.items()})
        out.write("/load", "my_msgs/msg/Load", t, {"n": 7, "raw": [b"a" * k for k in range(6)]}, "int32 n\nuint8[] raw")
    with AnyReader([path]) as reader:
        found = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()]
    states = [m for m in found if m.__msgtype__ == JOINTS]
    assert [m.header.frame_id for m in states] == VALUES["header.frame_id"]
    assert [m.velocity.tolist() for m in states] == VALUES["velocity"]
    with logs.open(path) as log:
        np.testing.assert_array_equal(log["/joint_states"].position, VALUES["position"])
        np.testing.assert_array_equal(log["/joint_states"].log_ns, t)
        assert log["/load"].raw.tolist() == [b"a" * k for k in range(6)] and (log["/load"].n == 7).all()
        assert not log.findings and not logs.examine(path)


@pytest.mark.parametrize(("fields", "problem"), [
    ({"positon": 1}, "no field 'positon'"), ({"position": np.zeros((5, 2))}, "has 5 values for 6 messages"),
    ({"position": np.zeros((6, 2, 2))}, "has shape"), ({"header.stamp": np.zeros((6, 2), int)}, "has shape"),
])  # fmt: skip
def test_writer_refuses_bad_fields_and_leaves_no_file(tmp_path, fields, problem):
    with pytest.raises(ConfigError, match=problem), logs.Writer(tmp_path / "w.mcap") as out:
        out.write("/joint_states", JOINTS, T0 + np.arange(6), fields)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", sorted(set(PRIMITIVES) | TEXTS - {"wstring"}))
def test_writer_writes_every_kind_of_field(tmp_path, kind):
    values = np.array([0, 1, 1]) if kind in PRIMITIVES else ["a", "", "ü"]
    with logs.Writer(tmp_path / "w.mcap") as out:
        fields = {"v": values, "w": [[v] for v in values]}
        out.write("/x", "my/msg/X", T0 + np.arange(3), fields, f"{kind} v\n{kind}[] w")
    table = logs.open(tmp_path / "w.mcap")["/x"]
    assert table.v.tolist() == list(values)
    assert [v[0] for v in table.w] == list(values)


def test_writer_refuses_unknown_definitions_in_one_line(tmp_path):
    with pytest.raises(ConfigError, match="not a standard type"), logs.Writer(tmp_path / "w.mcap") as out:
        out.write("/x", "my/msg/X", np.arange(3), {})
    with pytest.raises(UsageError, match="inside a with"):
        logs.Writer(tmp_path / "w.mcap").write("/x", JOINTS, np.arange(3), {})
    with pytest.raises((FormatError, BodylogError)):
        logs.open(tmp_path / "none.mcap")


def test_import_loads_no_opencv_or_scipy():
    code = "import sys, bodylog.logs as logs\nlogs.open(sys.argv[1])['/joint_states'].position\nprint(*sys.modules)"
    path = next(FIXTURES.glob("zstd.mcap"))
    done = subprocess.run([sys.executable, "-c", code.replace("['/joint_states'].position", ""), path],
                          capture_output=True, text=True, check=True)  # fmt: skip
    assert not {"cv2", "scipy", "rosbags", "click", "pyarrow", "h5py", "av"} & set(done.stdout.split())


@pytest.fixture(scope="module")
def kitchen(tmp_path_factory, robot) -> Path:
    """A folder with the logs that the recipes name."""
    folder = tmp_path_factory.mktemp("kitchen")
    shutil.copy(robot / "reach.mcap", folder / "run.mcap")
    shutil.copy(FIXTURES / "lz4.bag", folder / "other.bag")
    shutil.copy(FIXTURES / "cut_in_chunk.mcap", folder / "cut.mcap")
    return folder


RECIPES = re.findall(r"### (.*?)\n\n```python\n(.*?)```", COOKBOOK, re.DOTALL)


def test_recipes_run_in_page_order(kitchen):
    for package in ("pandas", "pyarrow", "av"):
        pytest.importorskip(package)
    code = "\n".join(recipe for _, recipe in RECIPES)
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], cwd=kitchen, capture_output=True, text=True,
                          env={**os.environ})  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert len(RECIPES) == 11
    assert re.search(r"^lerobot v3.0 \((\d+), \d+\) \1$", done.stdout, re.MULTILINE)
    assert {"run.avi", "part.mcap", "both.mcap", "renamed.mcap", "other.mcap", "sound.mcap", "new.mcap"} <= {
        path.name for path in kitchen.iterdir()
    }
    assert "changed: ['header.frame_id']" in done.stdout
    assert not logs.examine(kitchen / "both.mcap")


def test_to_pandas_names_a_missing_package(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with (
        logs.open(joints(tmp_path / "a.mcap")) as log,
        pytest.raises(UsageError, match=r"needs pandas; type: pip install 'bodylog\[pandas\]'"),
    ):
        log["/joint_states"].to_pandas()
