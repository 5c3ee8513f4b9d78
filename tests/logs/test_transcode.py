import hashlib
import shutil

import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bodylog.logs.topics import PREFIX
from tests.annotating.annotated_logs import annotate_log
from tests.logs.ros1_messages import KINDS, ros1_store, values

from .written import (
    START,
    UNSUITED,
    amount,
    by_pybag,
    by_rosbags,
    foreign,
    outgoing,
    source,
    streamed,
)


def bag(path, seed=0, count=30, damage=None):
    """A ROS 1 bag with three topics; `damage` changes (kind, payload)."""
    store, rng = ros1_store(), np.random.default_rng(seed)
    with BagWriter(path) as writer:
        connections = [writer.add_connection(f"/t{k}", kind, typestore=store) for k, kind in enumerate(KINDS)]
        for i in range(count):
            for kind, connection, message in zip(KINDS, connections, values(store, rng, i), strict=True):
                payload = bytes(store.serialize_ros1(message, kind))
                writer.write(connection, START + i * 10**7, damage(kind, payload) if damage else payload)
    return path


def plain(value):
    """A decoded message as plain values without sequence numbers."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, list):
        return [plain(item) for item in value]
    if hasattr(value, "__dict__"):
        return {name: plain(item) for name, item in vars(value).items() if name not in ("seq", "__msgtype__")}
    return value


def decoded(path):
    with AnyReader([path]) as reader:
        found = [(c.topic, t, plain(reader.deserialize(raw, c.msgtype))) for c, t, raw in reader.messages()]
    return sorted((message for message in found if not message[0].startswith(PREFIX)), key=lambda m: m[:2])


@pytest.fixture(scope="module")
def ours():
    return outgoing(0, 20, 10)


@pytest.mark.parametrize("seed", range(3))
def test_carry_converts_ros1_to_cdr(tmp_path, ours, seed):
    log = bag(tmp_path / "in.bag", seed)
    assert annotate_log(log, ours, {}, tmp_path / "out.mcap") == ()
    assert decoded(tmp_path / "out.mcap") == decoded(log)
    assert len(streamed(tmp_path / "out.mcap")) == 90 + amount(ours)
    assert len(by_pybag(tmp_path / "out.mcap")) == 90 + amount(ours)


def test_carry_equals_rosbags_conversion(tmp_path, ours):
    log = bag(tmp_path / "in.bag")
    annotate_log(log, ours, {}, tmp_path / "out.mcap")
    store = get_typestore(Stores.ROS2_HUMBLE)
    with AnyReader([log]) as reader:
        theirs = [bytes(store.ros1_to_cdr(raw, c.msgtype)) for c, _, raw in reader.messages() if c.topic != "/t2"]
    assert sorted(m[2] for m in by_rosbags(tmp_path / "out.mcap") if m[0] in ("/t0", "/t1")) == sorted(theirs)


def test_carry_keeps_a_bad_payload_as_ros1(tmp_path, ours):
    cut = []

    def damage(kind, raw):
        if kind == KINDS[0] and len(raw) > 120:
            cut.append(raw)
            return raw[:-1]
        return raw

    log = bag(tmp_path / "in.bag", damage=damage)
    (finding,) = annotate_log(log, ours, {}, tmp_path / "out.mcap")
    assert finding.severity == "warning"
    assert f"topic /t0: {len(cut)} of 30 messages contradict their definition; they stay ROS 1" in finding.text
    assert len(streamed(tmp_path / "out.mcap")) == 90 + amount(ours)
    with (tmp_path / "out.mcap").open("rb") as stream:
        kept = [(s.name, s.encoding) for s, c, _ in make_reader(stream).iter_messages() if c.message_encoding == "ros1"]
    assert kept == [("sensor_msgs/JointState", "ros1msg")] * len(cut) and cut


def by_rosbags_raw(path):
    with AnyReader([path]) as reader:
        return [(c.topic, t, raw) for c, t, raw in reader.messages()]


def bag_without_definitions(path, md5):
    raw = bag(path).read_bytes()
    with AnyReader([path]) as reader:
        texts = [c.msgdef.data for c in reader.connections]
    for text in texts:
        raw = raw.replace(b"message_definition=" + text.encode(), b"message_definition=" + b" " * len(text))
    if md5:
        for kind in KINDS:
            digest = ros1_store().generate_msgdef(kind)[1].encode()
            raw = raw.replace(b"md5sum=" + digest, b"md5sum=" + md5)
    path.write_bytes(raw)
    return path


def test_converter_finds_missing_definitions_by_checksum(tmp_path, ours):
    whole, log = bag(tmp_path / "whole.bag"), bag_without_definitions(tmp_path / "in.bag", None)
    (finding,) = annotate_log(log, ours, {}, tmp_path / "out.mcap")
    assert finding.text.startswith("topic /t2: has no definition of custom_msgs/msg/Skin; its messages stay ROS 1")
    annotate_log(whole, ours, {}, tmp_path / "whole.mcap")
    assert foreign(streamed(tmp_path / "out.mcap"))[:60] == foreign(streamed(tmp_path / "whole.mcap"))[:60]


def test_converter_refuses_a_checksum_mismatch(tmp_path, ours):
    wrong = hashlib.md5(b"another JointState").hexdigest().encode()
    findings = annotate_log(bag_without_definitions(tmp_path / "in.bag", wrong), ours, {}, tmp_path / "out.mcap")
    assert [f.text[:9] for f in findings] == ["topic /t0", "topic /t1", "topic /t2"]
    assert len(streamed(tmp_path / "out.mcap")) == 90 + amount(ours)


@pytest.mark.parametrize("log", ["reach.bag", "reach_rosbag2"])
def test_carry_keeps_values_and_times_of_the_arm(tmp_path, arm, ours, log):
    annotate_log(arm / log, ours, {}, tmp_path / "out.mcap")
    assert decoded(tmp_path / "out.mcap") == decoded(arm / log)
    annotate_log(arm / log, ours, {}, tmp_path / "again.mcap")
    assert (tmp_path / "out.mcap").read_bytes() == (tmp_path / "again.mcap").read_bytes()


def test_carry_keeps_cdr_byte_for_byte(tmp_path, arm, ours):
    annotate_log(arm / "reach_rosbag2", ours, {}, tmp_path / "out.mcap")
    theirs = [(topic, t, bytes(raw)) for topic, t, raw in by_rosbags_raw(arm / "reach_rosbag2")]
    assert foreign(by_rosbags(tmp_path / "out.mcap")) == sorted(theirs)


@pytest.mark.parametrize("how", UNSUITED)
def test_carry_keeps_attachments_of_compressed_mcaps(tmp_path, ours, how):
    plain = source(tmp_path / "in.mcap", **UNSUITED[how])
    packed = tmp_path / "in.mcap.zst"
    packed.write_bytes(zstandard.compress(plain.read_bytes()))
    annotate_log(packed, ours, {"a": "b"}, tmp_path / "out.mcap")
    annotate_log(plain, ours, {"a": "b"}, tmp_path / "plain.mcap")
    assert (tmp_path / "out.mcap").read_bytes() == (tmp_path / "plain.mcap").read_bytes()


def test_carry_merges_a_folder_of_mcaps(tmp_path, ours):
    (tmp_path / "bag").mkdir()
    parts = [source(tmp_path / "bag" / f"part_{i}.mcap", seed=i, count=50) for i in range(2)]
    annotate_log(tmp_path / "bag", ours, {}, tmp_path / "out.mcap")
    assert foreign(streamed(tmp_path / "out.mcap")) == sorted(m for part in parts for m in streamed(part))
    with (tmp_path / "out.mcap").open("rb") as stream:
        reader = make_reader(stream)
        assert len(list(reader.iter_attachments())) == 2
        assert sorted(m.name for m in reader.iter_metadata()) == ["bodylog", "operator", "operator"]


def test_carry_uses_constant_memory(tmp_path, ours):
    import tracemalloc

    peaks = []
    for count in (60, 400):
        log = source(tmp_path / "in.mcap", count=count, padding=250_000, **UNSUITED["unchunked"])
        assert log.stat().st_size > count * 250_000
        tracemalloc.start()
        annotate_log(log, ours, {}, tmp_path / "out.mcap")
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.1 * peaks[0] < 30_000_000


def test_carry_keeps_every_conformance_message(tmp_path, arm, ours):
    for log in sorted((arm.parent / "foxglove__mcap").rglob("*.mcap"))[::6]:
        annotate_log(shutil.copy(log, tmp_path / "in.mcap"), ours, {}, tmp_path / "out.mcap")
        assert foreign(streamed(tmp_path / "out.mcap")) == streamed(log), log


def test_carry_accepts_types_of_constants(tmp_path, ours):
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("uint8 A=1\n", "some_msgs/msg/Constants"))
    with BagWriter(tmp_path / "in.bag") as writer:
        connection = writer.add_connection("/constants", "some_msgs/msg/Constants", typestore=store)
        writer.write(connection, START, b"")
    raw = (tmp_path / "in.bag").read_bytes()
    (tmp_path / "in.bag").write_bytes(raw.replace(b"uint8 A=1\n", b"uint8 a=1\n"))
    assert annotate_log(tmp_path / "in.bag", ours, {}, tmp_path / "out.mcap") == ()
    assert len(by_rosbags(tmp_path / "out.mcap")) == 1 + amount(ours)
