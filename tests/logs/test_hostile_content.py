"""Sound containers with hostile content that once ended in a traceback, or took gigabytes or hours."""

import json
import os
import sqlite3
from contextlib import closing, suppress
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard

from bodylog.errors import FormatError, LogError
from bodylog.logs.decode import definitions
from bodylog.logs.diagnostics import Diagnostics
from bodylog.logs.formats import open_log, payload_views
from bodylog.logs.images.messages import make_image_decoder
from bodylog.logs.limits import Input
from bodylog.logs.rosbag2.folder import metadata_of
from bodylog.logs.storage import compression, packed_files
from bodylog.recording import recording
from bodylog.settings import Settings
from bodylog.types import Topic
from fixtures import by_hand
from tests.work import at_most

from . import writing

CONTAINERS = Path(__file__).parents[2] / "fixtures" / "containers"
T0 = writing.T0
KIND = "std_msgs/msg/Float64"
JSON_JOINTS = "sensor_msgs/msg/JointState"


def _joints(path, times, make=None):
    """An MCAP of JSON joint states."""
    make = make or (lambda k: {"name": ["a", "b"], "position": [0.1 * k, 0.2]})
    messages = [(t, json.dumps(make(k)).encode()) for k, t in enumerate(times)]
    return writing.write(path, [writing.Stream("/joint_states", JSON_JOINTS, b"{}", messages, "json", "jsonschema")])


@pytest.mark.parametrize("odd", [2**62 + 1, 2**63 - 1, 2**63, 2**64 - 1])
def test_open_ignores_impossible_log_times(tmp_path, odd):
    path = _joints(tmp_path / "x.mcap", [T0 + k * 10**7 for k in range(30)] + [odd])
    read = recording.read_recording(path, Settings())
    assert len(read.signals.joints.t) == 30 and read.signals.joints.t[-1] == pytest.approx(0.29)
    assert read.facts.health["/joint_states"].rejected == {"time years away": 1}
    assert any("log times such as" in finding.text for finding in read.facts.findings)


def test_open_reads_a_database_with_negative_times(tmp_path):
    by_hand.db3(tmp_path / "x.db3", [("/a", t, b"\0\1\0\0" + bytes(8)) for t in (-(2**63), -5, T0)], KIND, None)
    with open_log(tmp_path / "x.db3") as log:
        assert (log.start_ns, log.end_ns) == (T0, T0)
        assert [t for batch in log.batches() for t in batch.log_ns.tolist()] == [0, 0, T0]


@pytest.mark.parametrize("stamp", ["1e999", "-1e999", "9" * 401, "9" * 5000, "null", '"x"', "[[[]]]"])
def test_read_rejects_only_messages_with_invalid_stamps(tmp_path, stamp):
    messages = [
        (T0 + k * 10**7, b'{"header": {"stamp": {"sec": %d, "nanosec": %d}}, "name": ["a"], "position": [%d]}'
         % (T0 // 10**9, k * 10**7, k)) for k in range(30)
    ]  # fmt: skip
    odd = b'{"header": {"stamp": {"sec": %s, "nanosec": 0}}, "name": ["a"], "position": [1]}' % stamp.encode()
    schema = b'{"properties": {"header": {}}}'
    stream = writing.Stream("/joint_states", JSON_JOINTS, schema, [*messages, (T0 + 10**9, odd)], "json", "jsonschema")
    read = recording.read_recording(writing.write(tmp_path / "x.mcap", [stream]), Settings())
    assert len(read.signals.joints.t) == 30 and sum(read.facts.health["/joint_states"].rejected.values()) == 1


@pytest.mark.parametrize(
    "position", ["[" * 900 + "1" + "]" * 900, "[" + "9" * 401 + ", 1]", '["x", "y"]', "[1e999, 1]", "{}"]
)
def test_read_counts_invalid_positions(tmp_path, position):
    times = [T0 + k * 10**7 for k in range(31)]
    marked = _joints(tmp_path / "y.mcap", times, lambda k: {"name": ["a", "b"], "position": "@" if k == 30 else [k, 1]})
    with open_log(marked) as log:
        messages = [
            (t, bytes(p)) for batch in log.batches() for t, p in zip(batch.log_ns, payload_views(batch), strict=True)
        ]
    messages = [(int(t), p.replace(b'"@"', position.encode())) for t, p in messages]
    stream = writing.Stream("/joint_states", JSON_JOINTS, b"{}", messages, "json", "jsonschema")
    read = recording.read_recording(writing.write(tmp_path / "x.mcap", [stream]), Settings())
    rejected = sum(read.facts.health["/joint_states"].rejected.values())
    assert len(read.signals.joints.t) == 31 - rejected
    assert np.isfinite(read.signals.joints.values[:30]).all() and np.nanmax(np.abs(read.signals.joints.values)) <= 30


def test_ingest_writes_names_with_lone_surrogates(tmp_path, run_cli):
    times = [T0 + k * 10**7 for k in range(30)]
    path = _joints(tmp_path / "x.mcap", times, lambda k: {"name": ["\ud800"], "position": [k]})
    assert run_cli("ingest", path, "-o", tmp_path / "out.mcap") == 0
    assert recording.read_recording(tmp_path / "out.mcap", Settings()).signals.joints.names == ("\\ud800",)


def _raw(**fields):
    return json.dumps({"height": 4, "width": 4, "encoding": "mono8", "step": 4, "data": ""} | fields).encode()


@pytest.mark.parametrize("field", ["height", "width", "step"])
@pytest.mark.parametrize("value", ["1e999", "-1", "9" * 401, "{}", "null", "NaN", "true", '"4"'])
def test_decoder_refuses_invalid_image_sizes(field, value):
    topic = Topic(0, "/cam", "foxglove.RawImage", "json", b"{}", "jsonschema", 1)
    payload = _raw(**{field: "@"}).replace(b'"@"', value.encode())
    with pytest.raises(FormatError, match="/cam: "):
        make_image_decoder(topic)(payload, 1)


@pytest.mark.parametrize("encoding", ["yuv422", "uyvy", "yuyv", "yuv422_yuy2", "nv12", "bayer_rggb8", "bayer_gbrg16"])
@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 3), (3, 1), (3, 5), (2, 2)])
def test_decoder_converts_or_refuses_odd_and_tiny_images(encoding, height, width):
    import base64

    topic = Topic(0, "/cam", "foxglove.RawImage", "json", b"{}", "jsonschema", 1)
    data = base64.b64encode(bytes(100)).decode()
    try:
        image = make_image_decoder(topic)(_raw(height=height, width=width, encoding=encoding, step=0, data=data), 1)
    except FormatError as problem:
        assert str(problem).startswith("/cam: ") and "\n" not in str(problem)
    else:
        assert image.shape == (height, width, 3)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_decoder_refuses_large_images_before_allocation(suffix):
    payload = writing.compressed(T0, np.zeros((600, 2000), np.uint8), suffix, suffix[1:])
    kind = "sensor_msgs/msg/CompressedImage"
    topic = Topic(0, "/cam", kind, "cdr", writing.define(kind), "ros2msg", 1)
    assert make_image_decoder(topic, 1.2)(payload, 1).shape == (600, 2000, 3)
    with pytest.raises(FormatError, match=r"2000 x 600 pixels, more than 1.1 million; .*max_image_mpx = 2"):
        make_image_decoder(topic, 1.1)(payload, 1)


_ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT {} FROM n"
_STATEMENTS = {
    "messages is a view": [
        "DROP TABLE messages",
        f"CREATE VIEW messages AS {_ENDLESS.format('i AS id, 1 AS topic_id, i AS timestamp, 1 AS data')}",
    ],
    "topics is a view": [
        "DROP TABLE topics",
        f"CREATE VIEW topics AS {_ENDLESS.format('i AS id, 1 AS name, 2 AS type, 3 AS serialization_format')}",
    ],
    "messages is a virtual table": [
        "DROP TABLE messages",
        "CREATE VIRTUAL TABLE messages USING fts4(topic_id, timestamp, data)",
    ],
    "messages.data is computed": [
        "DROP TABLE messages",
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data AS (zeroblob(1000000)))",
    ],
}  # fmt: skip


@pytest.mark.parametrize("what", _STATEMENTS)
def test_open_refuses_databases_with_computed_rows(tmp_path, what):
    path = tmp_path / "x.db3"
    by_hand.db3(path, [("/a", T0, b"\0\1\0\0" + bytes(8))], KIND, None)
    with closing(sqlite3.connect(path)) as store, store:
        for statement in _STATEMENTS[what]:
            store.execute(statement)
    with pytest.raises(LogError, match=what):
        open_log(path)


def test_rows_end_a_query_on_a_signal(tmp_path, monkeypatch):
    """A refusal by the progress handler is an interrupt, not damage to read past."""
    from bodylog.logs.rosbag2 import sqlite3 as sqlite

    monkeypatch.setattr(sqlite, "_AGAIN", 0.0)
    by_hand.db3(tmp_path / "x.db3", [("/a", T0 + k, b"\0\1\0\0" + bytes(8)) for k in range(5000)], KIND, None)
    monkeypatch.setattr(sqlite, "_STEPS", 100)
    with sqlite.Db3Log(tmp_path / "x.db3") as log:
        log._store.set_progress_handler(lambda: 1, 100)
        with pytest.raises(KeyboardInterrupt):
            list(log.batches())


@pytest.mark.parametrize("depth", [5, 20, 400])
def test_parse_refuses_nested_idl_quickly(depth):
    _refused(f"struct X {{ {'sequence<' * depth}double{'>' * depth} data; }};", "brackets in one another")


@pytest.mark.parametrize("count", [301, 3000])
def test_parse_refuses_idl_of_many_dimensions_quickly(count):
    _refused(f"struct X {{ double data{'[2]' * count}; }};", "array sizes and operators")


def test_parse_refuses_long_idl_expressions_quickly():
    _refused(f"const long A = {'1 + ' * 5000}1; struct X {{ double data; }};", "array sizes and operators")
    _refused(f"@unit({chr(34) * 9000}) struct X {{ double data; }};", "quotes")


def _refused(inner, why):
    with at_most(calls=50_000), pytest.raises(FormatError, match=why):
        definitions.parse_definition(f"module m {{ module msg {{ {inner} }}; }};".encode(), "m/msg/X", "ros2idl")


def test_parse_reads_rosidl_output():
    text = """module m { module msg {
      typedef double double__36[36];
      @verbatim (language="comment", text="one (1)" "\\n" "two >>>>>> [[[")
      struct X { double__36 cov; sequence<string<5>, 3> names; @verbatim (language="comment", text="x") double a[4]; };
    }; };"""
    found = definitions.parse_definition(text.encode(), "m/msg/X", "ros2idl")
    assert [(field.name, field.size) for field in found.types["m/msg/X"]] == [("cov", 36), ("names", -1), ("a", 4)]


def test_parse_refuses_long_definitions():
    with pytest.raises(FormatError, match="at most 1048576 are read"):
        definitions.parse_definition(b"float64 x\n" * 200_000, "m/msg/X", "ros2msg")


def _packed_messages(path, sizes):
    packer = zstandard.ZstdCompressor()
    messages = [("/a", T0 + k, packer.compress(b"\0\1\0\0" + bytes(size))) for k, size in enumerate(sizes)]
    by_hand.db3(path, messages, KIND, None)
    return path


def test_decompress_messages_limits_memory(tmp_path):
    path = _packed_messages(tmp_path / "x.db3", [9 << 20] * 6 + [100] * 50)
    with open_log(path) as log:
        found = [batch.data.size for batch in log.batches()]
        assert sum(found) == 6 * ((9 << 20) + 4) + 50 * 104 and max(found) < 30 << 20
        assert not log.findings


def test_open_reports_messages_beyond_the_limit(tmp_path):
    path = _packed_messages(tmp_path / "x.db3", [100, 3_000_000, 100])
    with open_log(path, limits=Input(max_message_mb=2)) as log:
        assert sum(len(batch.log_ns) for batch in log.batches()) == 2
        assert "[input] max_message_mb = 4" in log.findings[-1].text and log.findings[-1].severity == "lost"


def test_open_refuses_logs_beyond_the_limit(tmp_path):
    path = _packed_messages(tmp_path / "x.db3", [30_000_000] * 3)
    with open_log(path, limits=Input(max_unpacked_gb=0.05)) as log, pytest.raises(LogError, match="gb = 1"):
        list(log.batches())
    with open_log(path, limits=Input(max_unpacked_gb=0.2)) as log:
        assert sum(len(batch.log_ns) for batch in log.batches()) == 3


def test_open_reports_chunks_beyond_the_limit(tmp_path):
    path = _joints(tmp_path / "x.mcap", [T0, T0 + 1], lambda k: {"name": [], "x": "0" * 3_000_000})
    with open_log(path, limits=Input(max_message_mb=2)) as log:
        assert not list(log.batches()) and "[input] max_message_mb = " in log.findings[-1].text


PACK = {"zst": zstandard.ZstdCompressor().compress, "lz4": lz4.frame.compress}


def _packed(path, data):
    path.write_bytes(PACK[path.suffix[1:]](data))
    return path


@pytest.mark.parametrize("form", PACK)
@pytest.mark.parametrize("name", ["none.mcap", "lz4.bag", "humble.db3"])
def test_open_unpacks_whole_files(name, form, tmp_path, monkeypatch):
    monkeypatch.setattr(packed_files, "_PIECE", 1 << 10)
    data = (CONTAINERS / name).read_bytes()
    whole, frames, cut, damaged = (tmp_path / f"{k}.{form}" for k in ("whole", "frames", "cut", "damaged"))
    packed = PACK[form](data)
    whole.write_bytes(packed)
    frames.write_bytes(PACK[form](data[:999]) + PACK[form](data[999:]))
    cut.write_bytes(packed[: len(packed) - 9])
    damaged.write_bytes(packed[:4] + b"\xff" * 60)
    with open_log(CONTAINERS / name) as log:
        held = [one.log_ns.tolist() for one in log.batches()]
    for path in (whole, frames):
        with open_log(path) as log:
            assert [one.log_ns.tolist() for one in log.batches()] == held
    with pytest.raises(LogError, match="is damaged"):
        open_log(damaged)
    with suppress(LogError), open_log(cut) as log:
        assert sum(len(one.log_ns) for one in log.batches()) <= sum(map(len, held))


@pytest.mark.parametrize("form", PACK)
def test_unpack_file_checks_the_first_bytes(form, tmp_path, monkeypatch):
    path = _packed(tmp_path / f"x.mcap.{form}", b"no log" + bytes(20_000_000))
    monkeypatch.setattr(packed_files, "_PIECE", 1 << 10)
    with pytest.raises(LogError, match=r"not a log: it begins with b'no log"):
        open_log(path, limits=Input(max_unpacked_gb=1e-3))  # otherwise refused for its size


@pytest.mark.parametrize("form", PACK)
def test_unpack_file_refuses_logs_beyond_the_limit(form, tmp_path, monkeypatch):
    monkeypatch.setattr(compression, "_RATIO", 100)  # what lz4 cannot exceed
    path = _packed(tmp_path / f"x.mcap.{form}", b"\x89MCAP0\r\n" + bytes(30_000_000))
    with pytest.raises(LogError, match=r"more than 0.01 GB.*max_unpacked_gb = 1"):
        open_log(path, limits=Input(max_unpacked_gb=0.01))


@pytest.mark.parametrize("listed", ["5", "2.5", "[5, null]", "{a: 1}", "true", "[[x.db3]]", "x.db3"])
def test_members_ignore_invalid_metadata_with_a_warning(tmp_path, listed):
    by_hand.db3(tmp_path / "x.db3", [("/a", T0, b"\0\1\0\0" + bytes(8))], KIND, None)
    (tmp_path / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  relative_file_paths: {listed}\n")
    with open_log(tmp_path) as log:
        assert sum(len(batch.log_ns) for batch in log.batches()) == 1
        assert any("relative_file_paths is" in finding.text for finding in log.findings)


def test_metadata_of_refuses_aliases(tmp_path):
    lines = ["a: &a [x,x,x,x,x,x,x,x]"]
    lines += [f"{b}: &{b} [{','.join(8 * ['*' + a])}]" for a, b in zip("abcdefgh", "bcdefghi", strict=True)]
    lines += ["rosbag2_bagfile_information: {relative_file_paths: *i}"]
    (tmp_path / "metadata.yaml").write_text("\n".join(lines))
    diagnostics = Diagnostics(tmp_path)
    assert metadata_of(tmp_path, diagnostics) == {} and "not readable (ValueError)" in diagnostics.findings[0].text


@pytest.mark.parametrize("folder", [False, True])
def test_commands_handle_names_that_are_not_utf_8(tmp_path, run_cli, folder):
    log = os.fsencode(tmp_path) + b"/\xff\xfe.db3"
    times = [T0 + k * 10**7 for k in range(30)]
    messages = [("/joint_states", t, writing.joint_state(t, ["a"], [0.1 * k])) for k, t in enumerate(times)]
    by_hand.db3(tmp_path / "y.db3", messages, JSON_JOINTS, None)
    if folder:
        log = os.fsencode(tmp_path) + b"/\xff"
        os.mkdir(log)
        os.rename(tmp_path / "y.db3", log + b"/\xfe.db3")
    else:
        os.rename(tmp_path / "y.db3", log)
    for command in (("info",), ("doctor",), ("ingest", "-o", tmp_path / "i.mcap")):
        assert run_cli(command[0], os.fsdecode(log), *command[1:]) == 0


def test_read_uses_most_of_times_decades_apart(tmp_path):
    times = [T0 + k * 10**7 for k in range(30)] + [2 * T0 + k * 10**7 for k in range(20)]
    read = recording.read_recording(_joints(tmp_path / "x.mcap", times), Settings())
    assert len(read.signals.joints.t) == 30 and read.facts.health["/joint_states"].rejected == {"time years away": 20}
