from dataclasses import replace

import numpy as np
import pytest

from bodylog.annotating.estimate_metadata import describe_estimate
from bodylog.annotating.messages import from_estimate, from_features
from bodylog.annotating.read_back import FAULT_DOUBTS, read_estimate, read_features, read_metadata
from bodylog.errors import FormatError, LogError
from bodylog.logs.formats import open_log
from tests.annotating.annotated_logs import annotate_log, write_annotations
from tests.logs.written import START, found, source


def log_of(path, features, estimate):
    outgoing = from_features(features, START) + from_estimate(estimate, features, START)
    write_annotations(outgoing, {"version": "1", **describe_estimate(estimate)}, path)
    return path


def same(ours, theirs):
    assert (ours.names, ours.unit) == (theirs.names, theirs.unit)
    assert np.array_equal(ours.values, theirs.values, equal_nan=True)
    assert np.array_equal(ours.source_ns, theirs.source_ns) and np.allclose(ours.t, theirs.t, atol=1e-9, rtol=0)


@pytest.mark.parametrize("seed", range(3))
def test_read_estimate_returns_what_was_written(tmp_path, seed):
    features, estimate = found(seed)
    again = read_estimate(log_of(tmp_path / "log.mcap", features, estimate), START)
    for name in ("joints", "rate", "bias"):
        same(getattr(again, name), getattr(estimate, name))
    for sense, errors in estimate.errors.items():
        same(again.errors[sense], errors)
    assert np.array_equal(again.cov, estimate.cov) and np.array_equal(again.free_energy, estimate.free_energy)
    same(again.predicted["effector"], estimate.predicted["effector"])
    assert np.allclose(again.predicted["effector"].std, estimate.predicted["effector"].std)
    assert np.allclose(again.predicted_cov["effector"], estimate.predicted_cov["effector"])
    same(again.kinematic["effector"], estimate.kinematic["effector"])
    ours, theirs = again.effector, estimate.effector
    assert ours.frame == theirs.frame and np.allclose(ours.t, theirs.t, atol=1e-9, rtol=0)
    assert np.array_equal(ours.place, theirs.place) and np.array_equal(ours.cov, theirs.cov)
    assert np.allclose(ours.turn, theirs.turn, atol=1e-15) and np.array_equal(ours.source_ns, theirs.source_ns)
    for name in ("method", "used", "settings", "faults", "findings"):
        assert getattr(again, name) == getattr(estimate, name)


def test_points_in_space_are_in_metres_in_the_log_and_in_mm_when_read(tmp_path):
    features, estimate = found(0)
    seen, expected = features.tracks["effector"], estimate.predicted["effector"]
    draw = np.random.default_rng(3)

    def in_space(series):
        size = (len(series.t), 3)
        return replace(series, values=draw.normal(0, 500, size), std=draw.uniform(0.1, 1, size), names=("x", "y", "z"), unit="mm")

    root = draw.normal(0, 1, (len(expected.t), 3, 3))
    point, belief = in_space(seen), in_space(expected)
    features = replace(features, tracks={**features.tracks, "tracker/ball": point})
    cov = root @ root.transpose(0, 2, 1)
    belief = replace(belief, std=np.sqrt(np.einsum("ndd->nd", cov)))
    estimate = replace(
        estimate,
        predicted={**estimate.predicted, "tracker/ball": belief},
        predicted_cov={**estimate.predicted_cov, "tracker/ball": cov},
        kinematic={"tracker/ball": replace(belief, std=None)},
    )
    path = log_of(tmp_path / "log.mcap", features, estimate)
    with open_log(path) as log:
        again = read_features(log, START).tracks["tracker/ball"]
        assert not any(topic.name.startswith("/bodylog/annotations/tracker") for topic in log.topics)
    back = read_estimate(path, START)
    pairs = ((again, point), (back.predicted["tracker/ball"], belief), (back.kinematic["tracker/ball"], belief))
    for theirs, ours in pairs:
        assert (theirs.names, theirs.unit) == (ours.names, ours.unit)
        np.testing.assert_allclose(theirs.values, ours.values, rtol=1e-12)
    np.testing.assert_allclose(again.std, point.std, rtol=1e-12)
    np.testing.assert_allclose(back.predicted_cov["tracker/ball"], cov, rtol=1e-9, atol=1e-9)


def test_read_estimate_reads_faults_without_std(tmp_path, monkeypatch):
    from bodylog.annotating import messages
    from bodylog.logs.encode import schemas

    text = schemas._PARTS["bodylog_msgs/Fault"]
    monkeypatch.setitem(schemas._PARTS, "bodylog_msgs/Fault", text.partition("float64 std\n")[0])
    plain = messages.cdr.serialise_messages
    monkeypatch.setattr(messages.cdr, "serialise_messages", lambda count, fields: plain(count, _without_fault_scores(fields)))
    features, estimate = found()
    path = log_of(tmp_path / "log.mcap", features, estimate)
    monkeypatch.undo()
    again = read_estimate(path, START)
    unknown = dict.fromkeys(FAULT_DOUBTS)
    assert again.faults == tuple(replace(fault, **unknown) for fault in estimate.faults)


def test_a_fault_of_an_unknown_kind_is_refused(tmp_path):
    features, estimate = found()
    strange = replace(estimate.faults[0], kind="melted")
    path = log_of(tmp_path / "log.mcap", features, replace(estimate, faults=(strange,)))
    with pytest.raises(LogError, match="/bodylog/faults: sense and kind encoders melted; possible: encoders drifting, "):
        read_estimate(path, START)


def _without_fault_scores(fields):
    score_count = len(FAULT_DOUBTS)
    kinds = [kind for kind, _ in fields[-score_count - 2 :]]
    return fields[:-score_count] if kinds == ["float64", "string", *["float64"] * score_count] else fields


@pytest.mark.parametrize("seed", range(3))
def test_read_features_returns_what_was_written(tmp_path, seed):
    features, estimate = found(seed)
    with open_log(log_of(tmp_path / "log.mcap", features, estimate)) as log:
        again = read_features(log, START)
    assert again.joints is None and set(again.tracks) == set(features.tracks)
    for name, track in features.tracks.items():
        same(again.tracks[name], track)
        assert np.array_equal(again.tracks[name].std, track.std)
    assert again.touches == features.touches and again.cameras == features.cameras
    pairs = [(s.touch, s.weight, s.delay) for s in features.synchrony]
    assert np.array_equal([(s.touch, s.weight, s.delay) for s in again.synchrony], pairs, equal_nan=True)
    assert again.strokes == features.strokes
    assert [s.stroke for s in again.synchrony] == [s.stroke for s in features.synchrony] == [None, 0, 2, 3]


@pytest.mark.parametrize(("old", "new"), [(b"float64[] data", b"float64  9data"), (b"Header header", b"Header headEr")])
def test_read_back_names_the_log_of_a_damaged_definition(tmp_path, old, new):
    features, estimate = found()
    outgoing = [replace(o, definition=o.definition.replace(old, new)) for o in from_features(features, START)]
    write_annotations(outgoing, describe_estimate(estimate), tmp_path / "log.mcap")
    with open_log(tmp_path / "log.mcap") as log, pytest.raises(FormatError, match=r"log\.mcap: .*bodylog_msgs"):
        read_features(log, START)


def test_read_features_keeps_synchrony_of_simultaneous_touches(tmp_path):
    features, _ = found()
    touches = tuple(replace(touch, onset=1.0, offset=1.5) for touch in features.touches)
    write_annotations(from_features(replace(features, touches=touches), START), {}, tmp_path / "log.mcap")
    with open_log(tmp_path / "log.mcap") as log:
        again = read_features(log, START)
    assert [(s.touch, s.weight) for s in again.synchrony] == [(i, 0.2 * i) for i in range(4)]


@pytest.mark.parametrize("touches", [None, ()])
def test_read_features_distinguishes_no_skin_from_no_touch(tmp_path, touches):
    features, _ = found()
    write_annotations(from_features(replace(features, touches=touches, synchrony=()), START), {}, tmp_path / "log.mcap")
    with open_log(tmp_path / "log.mcap") as log:
        assert read_features(log, START).touches == touches


def test_read_features_keeps_unknown_std_unknown(tmp_path):
    features, estimate = found()
    tracks = {"hand": replace(features.hand, std=None)}
    bare = replace(estimate, bias=None, faults=(), predicted={}, predicted_cov={}, errors={}, findings=())
    path = log_of(tmp_path / "log.mcap", replace(features, tracks=tracks), bare)
    again = read_estimate(path, START)
    assert (again.bias, again.faults, again.predicted, again.errors) == (None, (), {}, {})
    with open_log(path) as log:
        assert read_features(log, START).tracks["hand"].std is None


def test_read_metadata_returns_what_was_written(tmp_path):
    write_annotations([], {"version": "1", "settings": '{"a": 1}'}, tmp_path / "log.mcap")
    assert read_metadata(tmp_path / "log.mcap") == {"version": "1", "settings": '{"a": 1}'}


def test_read_estimate_advises_what_to_type(tmp_path):
    log = source(tmp_path / "log.mcap")
    for read in (read_metadata, read_estimate):
        with pytest.raises(LogError, match=r"log.mcap: no estimate in it, .* bodylog estimate .*log.mcap --body"):
            read(log)
    with open_log(log) as opened:
        assert read_features(opened, START) is None


def test_read_estimate_refuses_features_alone(tmp_path):
    features, _ = found()
    annotate_log(source(tmp_path / "in.mcap"), from_features(features, START), {}, tmp_path / "out.mcap")
    with pytest.raises(LogError, match="no /bodylog/ topics of an estimate"):
        read_estimate(tmp_path / "out.mcap", START)


@pytest.mark.parametrize("lacking", ["joint_covariance", "free_energy"])
def test_read_estimate_refuses_inconsistent_topics(tmp_path, lacking):
    features, estimate = found()
    outgoing = from_estimate(estimate, features, START)
    broken = [
        replace(o, log_ns=o.log_ns[1:], offset=o.offset[1:], length=o.length[1:]) if o.topic.endswith(lacking) else o
        for o in outgoing
    ]
    write_annotations(broken, {}, tmp_path / "log.mcap")
    with pytest.raises(LogError, match=f"/bodylog/{lacking} does not go with /bodylog/joint_states"):
        read_estimate(tmp_path / "log.mcap", START)


@pytest.mark.parametrize("file", ["reach.bag", "reach_rosbag2"])
def test_read_metadata_refuses_other_containers(arm, file):
    with pytest.raises(LogError, match="no estimate in it"):
        read_metadata(arm / file)


DAMAGE = [{"used": '{"touch": {"sen": 1}}'}, {"findings": "["}, {"resolved": "3"}, {"used": "[]"}]


@pytest.mark.parametrize("damage", DAMAGE)
def test_read_metadata_reports_damage(tmp_path, damage):
    features, estimate = found()
    write_annotations(from_estimate(estimate, features, START), {**describe_estimate(estimate), **damage}, tmp_path / "log.mcap")
    with pytest.raises(LogError, match=r"the metadata record bodylog is damaged \(.*\); type: bodylog estimate"):
        read_estimate(tmp_path / "log.mcap", START)
