import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bodylog.annotating.messages import from_joints, from_skin
from bodylog.logs.encode.schemas import WRITTEN, ros2msg_definition
from bodylog.logs.topics import escape_topic_name, unescape_topic_name
from bodylog.types import Series
from tests.logs.written import JOINTS, LATE, START, found, outgoing


def decoded(message):
    """Every message of one topic decoded by rosbags with our definition, checked to equal rosbags' own bytes."""
    store = get_typestore(Stores.EMPTY)
    types = get_types_from_msg(message.definition.decode(), message.type)
    store.register({name: fields for name, fields in types.items() if not name.startswith("builtin")})
    out = []
    for start, size in zip(message.offset, message.length, strict=True):
        raw = message.data[start : start + size].tobytes()
        out.append(store.deserialize_cdr(raw, message.type))
        assert bytes(store.serialize_cdr(out[-1], message.type)) == raw
    return out


def stamp_ns(time):
    return time.sec * 10**9 + time.nanosec


@pytest.fixture(scope="module", params=[0, 1, 2])
def written(request):
    features, estimate = found(request.param)
    return features, estimate, {message.topic: message for message in outgoing(request.param)}


def test_messages_equal_rosbags_byte_for_byte(written):
    for message in written[2].values():
        assert len(decoded(message)) == len(message.log_ns)


def test_messages_have_the_causing_log_times(written):
    features, estimate, messages = written
    for topic, cause in [("track/hand", features.hand), ("joint_states", estimate.joints)]:
        message = messages[f"/bodylog/{topic}"]
        assert np.array_equal(message.log_ns, cause.source_ns)
        stamps = [stamp_ns(m.header.stamp) for m in decoded(message)]
        assert np.array_equal(stamps, cause.source_ns - LATE)


def test_messages_ascend_in_log_time():
    late = Series(np.array([0.0, 1.0, 2.0]), np.eye(3), JOINTS, "rad", START + np.array([30, 10, 20]))
    message = from_joints("/j", late, START)
    assert message.log_ns.tolist() == [START + 10, START + 20, START + 30]
    assert [m.position.argmax() for m in decoded(message)] == [1, 2, 0]


def test_from_features_writes_seen_points_and_whole_tracks(written):
    features, _, messages = written
    seen = np.isfinite(features.effector.values).all(1)
    points = decoded(messages["/bodylog/effector"])
    assert 0 < seen.sum() < len(seen) and len(points) == seen.sum()
    assert np.array_equal([(p.point.x, p.point.y) for p in points], features.effector.values[seen])
    rows = np.array([m.data for m in decoded(messages["/bodylog/track/effector"])])
    assert np.array_equal(rows, np.hstack([features.effector.values, features.effector.std]), equal_nan=True)


def test_from_features_orders_cells_and_keeps_durations(written):
    for touch, message in zip(written[0].touches, decoded(written[2]["/bodylog/touch"]), strict=True):
        assert message.cells[0] == touch.strongest and sorted(message.cells) == sorted({*touch.cells, touch.strongest})
        assert stamp_ns(message.duration) == 250_000_000


def test_from_estimate_aligns_covariances_with_the_belief(written):
    _, estimate, messages = written
    covariance = decoded(messages["/bodylog/joint_covariance"])
    assert np.array_equal([m.data.reshape(3, 3) for m in covariance], estimate.cov)
    assert np.array_equal([m.data for m in decoded(messages["/bodylog/free_energy"])], estimate.free_energy)
    errors = decoded(messages["/bodylog/prediction_error/effector"])
    assert np.array_equal([m.data for m in errors], estimate.errors["effector"].values)


def test_annotations_show_points_and_the_two_sigma_ellipse(written):
    features, estimate, messages = written
    shown = decoded(messages["/bodylog/annotations"])
    assert len(shown) == len(features.hand.t)
    cov, mean = estimate.predicted_cov["effector"], estimate.predicted["effector"].values
    for i, message in enumerate(shown):
        seen = [t.values[i] for t in features.tracks.values() if np.isfinite(t.values[i]).all()]
        centres = [(c.position.x, c.position.y) for c in message.circles]
        assert np.array_equal(centres, [*seen, mean[i]])
        (loop,) = message.points
        offsets = np.array([(p.x, p.y) for p in loop.points]) - mean[i]
        distance = np.einsum("ni,ij,nj->n", offsets, np.linalg.inv(cov[i]), offsets)
        assert loop.type == 2 and np.allclose(distance, 4.0)


def test_from_estimate_stamps_faults_at_their_onset(written):
    faults = decoded(written[2]["/bodylog/faults"])
    assert [(f.sense, f.name, f.kind, f.size, f.unit) for f in faults] == [
        ("encoders", "elbow", "drifting", 0.25, "rad"),
        ("vision", "effector", "displaced", 9.0, "px"),
        ("vision", "board", "moved", 0.003, "m"),
    ]
    assert [stamp_ns(f.header.stamp) - START for f in faults[:2]] == [1_500_000_000, 2_000_000_000]


def test_from_skin_writes_a_header():
    values = np.array([[0.25, 0.5], [0.75, 1.0]])
    cells = Series(np.array([0.0, 0.01]), values, ("0", "1"), "0..1", START + np.arange(2))
    messages = decoded(from_skin("/skin", cells, START))
    assert [m.data.tolist() for m in messages] == [[0.25, 0.5], [0.75, 1.0]]
    assert stamp_ns(messages[1].header.stamp) == START + 10_000_000


def test_schemas_are_complete():
    for kind in WRITTEN:
        types = get_types_from_msg(ros2msg_definition(kind).decode(), kind)
        named = {d[1] if d[0] == 2 else d[1][0][1] for _, fields in types.values() for _, d in fields if d[0] >= 2}
        assert {name for name in named if isinstance(name, str)} <= set(types)
        assert "builtin_interfaces/msg/Time" in types


@given(st.text(max_size=20))
def test_escape_round_trips_names(name):
    assert unescape_topic_name(escape_topic_name(name)) == name
    for part in escape_topic_name(name).split("/") if name else ():
        assert part and all(c.isascii() and (c.isalnum() or c == "_") for c in part)
        assert not part[0].isdigit()


def test_escape_keeps_plain_names():
    assert escape_topic_name("end_effector2") == "end_effector2" and escape_topic_name("elbow-dot 1") == "elbow_x2d_dot_x20_1"
