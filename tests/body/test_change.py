"""Changes since a body was learned: joint zeros, camera and marker, by evidence."""

from dataclasses import fields, replace

import numpy as np
import pytest

from bodylog import body
from bodylog.body.kinematic import change
from bodylog.body.kinematic.change_problem import PAYLOAD, pose_problem
from bodylog.body.kinematic.change_system import ChangeFit, Sinking, fit_parts
from bodylog.body.kinematic.model import KinematicGP, can_show_changes
from bodylog.findings import log_estimate as change_findings
from bodylog.findings.faults import fault_warnings
from bodylog.settings import EstimationSettings, Settings
from bodylog.sim.hardware import Hardware, encoder_noise
from bodylog.types import Fault, FaultKind
from tests.body.changed_arms import DEGREE, explored, explored_without_urdf, run
from tests.kinematics.robots import JOINTS
from tests.seeds import first_of, seeds
from tests.validation.pushed_cameras import push


def find_changes(*given):
    return change.find_changes(*given).changes


@pytest.fixture(scope="module")
def known():
    return explored()


@pytest.fixture(scope="module")
def on_axes():
    return explored_without_urdf()


def test_change_is_absent_in_a_sound_log(known):
    for seed in (50, 51):
        assert find_changes(run(seed), known) == ()


@pytest.mark.parametrize(("joint", "degrees"), [("pan", 1.0), ("lift", -2.0), ("elbow", 5.0)])
def test_change_detects_a_moved_zero_with_its_size(known, joint, degrees):
    (one,) = find_changes(run(offset={joint: degrees * DEGREE}), known)
    assert (one.kind, one.name, one.since, one.alternatives) == ("joint", joint, None, ())
    assert abs(one.value[0] - degrees * DEGREE) < 3 * one.std[0] < 0.5 * DEGREE and one.nats > change.CHANGE_NATS


def test_change_detects_a_slipped_gear_with_its_time(known):
    (one,) = find_changes(run(offset={"lift": 2 * DEGREE}, since=6.0), known)
    assert one.name == "lift" and abs(one.since - 6.0) < 0.3 and abs(one.value[0] - 2 * DEGREE) < 3 * one.std[0]


def test_change_names_two_faulty_joints_with_their_sizes(known):
    found = find_changes(run(offset={"lift": 2 * DEGREE, "elbow": -3 * DEGREE}), known)
    assert {one.name: round(float(np.degrees(one.value[0]))) for one in found} == {"lift": 2, "elbow": -3}


def test_change_of_a_pushed_camera_names_no_joint(known):
    (one,) = find_changes(run(camera=np.array([0.01, 0.0, 0.0, 0.0, 0.03, 0.01])), known)
    assert (one.kind, one.name) == ("camera", "camera") and abs(one.value[4] - 0.03) < 3 * one.std[4]


def test_false_sightings_do_not_count(known):
    features = run(offset={"elbow": 2 * DEGREE})
    track = features.tracks["effector"]
    wrong = track.values.copy()
    wrong[::15] += 80.0
    (one,) = find_changes(replace(features, tracks={"effector": replace(track, values=wrong)}), known)
    assert one.name == "elbow" and abs(one.value[0] - 2 * DEGREE) < 3 * one.std[0]


@pytest.mark.parametrize("seed", first_of(1, [53, 54, 55]))
def test_errors_of_encoders_that_last_are_no_change_and_hide_none(known, seed):
    hardware = Hardware(correlated=4e-3, correlation_s=2.0)
    lasting = dict.fromkeys(known.joints, (hardware.correlated, hardware.correlation_s))

    def err(features):
        joints = features.joints
        off = encoder_noise(hardware, 0.0, joints.values.shape, 100.0, np.random.default_rng(seed))
        return replace(features, joints=replace(joints, values=joints.values + off))

    sound = err(run(seed, encoder=2e-3))
    assert find_changes(sound, known) and not find_changes(sound, known, lasting)
    (one,) = find_changes(err(run(seed, encoder=2e-3, offset={"lift": 3 * DEGREE})), known, lasting)
    assert one.name == "lift" and abs(one.value[0] - 3 * DEGREE) < 3 * one.std[0]


def test_change_needs_the_joints_axes_and_sightings(known):
    features = run(offset={"elbow": 2 * DEGREE})
    plain = replace(known, senses={"effector": body.learn_body([run(3, 10.0)], Settings(), {}).model.senses["effector"]})
    assert not can_show_changes(plain) and find_changes(features, plain) == ()
    assert find_changes(replace(features, tracks={}), known) == ()
    few = replace(features, joints=replace(features.joints, names=("a", "b", "c", "d")))
    assert find_changes(few, known) == ()


def _estimate(features, known, **settings):
    from bodylog import pipeline

    chosen = Settings(estimate=EstimationSettings(**settings))
    found = pipeline.infer(features, known, chosen)
    return found, change_findings.infer_with_changes(features, known, chosen)[0]


def test_change_findings_name_a_change_once_with_its_std(known):
    found, estimated = _estimate(run(offset={"elbow": 3 * DEGREE}), known)
    assert [fault.kind for fault in found.faults] == ["drifting"]
    (fault,) = estimated.faults
    assert (fault.sense, fault.name, fault.kind) == ("encoders", "elbow", "offset")
    assert abs(fault.size + 3 * DEGREE) < 3 * fault.std
    (text,) = fault_warnings(estimated.faults)
    assert f"± {fault.std:.2g} rad (" in text.text and text.text.endswith("°); relative to the body")
    assert any(f.text.startswith("elbow: reads -") and "nats likelier" in f.text for f in estimated.findings)


@pytest.mark.soak
def test_change_leaves_a_slip_to_the_filters_fault(known):
    found, estimated = _estimate(run(offset={"lift": 3 * DEGREE}, since=6.0), known)
    assert estimated.faults == found.faults and len(found.faults) == 1


@pytest.mark.soak
def test_change_findings_attribute_no_pushed_camera_to_joints(known):
    features = run(duration=14.0)
    track = features.tracks["effector"]
    pushed = replace(track, values=track.values + 12.0 * (track.t >= 7.0)[:, None])
    features = replace(features, tracks={"effector": pushed})
    assert find_changes(features, known)
    _, estimated = _estimate(features, known)
    assert [(fault.name, fault.kind) for fault in estimated.faults] == [("camera", FaultKind.DISPLACED)]


PUSHES = np.array([[0.01, 0.0, 0.0, 0.0, 0.03, 0.01], [0.0, -0.02, 0.01, 0.02, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, -0.02, 0.03]])


@pytest.mark.parametrize("seed", seeds(1, 3))
@pytest.mark.parametrize("learned", ["on_axes", "known"])
@pytest.mark.soak
def test_angles_after_a_pushed_camera_are_as_good_as_without(request, learned, seed):
    """By the camera where it is now: an encoder's offset or a load would take up a part of the push."""
    known = request.getfixturevalue(learned)
    truth = run(60 + seed, encoder=0.0).joints
    errors = []
    for camera, faults in ((None, []), (PUSHES[seed], [("camera", FaultKind.MOVED)])):
        found, _ = change_findings.infer_with_changes(run(60 + seed, camera=camera), known, Settings())
        assert [(fault.name, fault.kind) for fault in found.faults] == faults
        off = found.joints.values - np.column_stack([np.interp(found.joints.t, truth.t, column) for column in truth.values.T])
        errors.append(float(np.sqrt(np.square(off).mean())))
        assert 0.3 < float((off**2 / np.einsum("nii->ni", found.cov)).mean()) < 2.0
    assert errors[1] < 1.2 * errors[0]


def _see_two_markers(seed, camera=None, **of):
    """The marker, and another one half as far from the camera."""
    near = np.array([0.0, 0.0, 0.9])
    features, other = (run(seed, camera=camera, marker=marker, **of) for marker in (0.0, near))
    return replace(features, tracks={**features.tracks, "tip": other.tracks["effector"]})


@pytest.mark.soak
def test_markers_without_a_urdf_have_lengths_of_their_own():
    """Each has its distance as unit, so a camera's displacement is another number for each."""
    learned = explored_without_urdf(_see_two_markers(3, duration=16.0, encoder=0.003))
    push = np.array([0.02, 0.03, -0.02, 0.0, 0.0, 0.0])
    truth = run(60, encoder=0.0).joints
    found, moved = change_findings.infer_with_changes(_see_two_markers(60, push), learned, Settings())
    assert {fault.kind for fault in found.faults} == {FaultKind.MOVED}
    off = found.joints.values - np.column_stack([np.interp(found.joints.t, truth.t, column) for column in truth.values.T])
    assert 0.3 < float((off**2 / np.einsum("nii->ni", found.cov)).mean()) < 2.0
    far, near = (moved.senses[name].chain.place[2] - learned.senses[name].chain.place[2] for name in ("effector", "tip"))
    assert near / far > 1.5


@pytest.mark.soak
def test_no_camera_is_moved_that_a_track_without_axes_sees(on_axes):
    """Its Gaussian process cannot follow, and would hold the angles where they were."""
    features = run(60, camera=PUSHES[0])
    plain = body.learn_body([run(3, 16.0, 0.003)], Settings(), {}).model.senses["effector"]
    seen = replace(features, tracks={**features.tracks, "hand": features.tracks["effector"]})
    assert find_changes(features, on_axes)
    assert not find_changes(seen, replace(on_axes, senses={**on_axes.senses, "hand": plain}))
    elsewhere = replace(features, tracks={**features.tracks, "side/hand": features.tracks["effector"]})
    assert find_changes(elsewhere, replace(on_axes, senses={**on_axes.senses, "side/hand": plain}))


@pytest.mark.parametrize("size", [0.01, 0.03])
@pytest.mark.parametrize("seed", first_of(1, [50, 60]))
def test_a_weight_at_the_hand_is_no_moved_camera_on_found_axes(on_axes, seed, size):
    """No image tells which way is down: a load may pull the hand in any direction."""
    features = run(seed, encoder=1e-3)
    model = on_axes.senses["effector"]
    down = np.array([0.2, 0.9, 0.4])
    levers = model.hands[0].measure_levers(features.joints.values)[..., :3]
    sunk = -size * levers @ down / np.abs(levers).max()
    laden = replace(features, joints=replace(features.joints, values=features.joints.values - sunk))
    changes = find_changes(laden, on_axes)
    assert all(PAYLOAD in one.alternatives for one in changes)


class Weighed(KinematicGP):
    """A model that tells how far the hand rises with each joint."""

    still_joints = ()

    @property
    def hands(self):
        return (self,)

    def measure_levers(self, x):
        zero = np.zeros(len(x))
        return np.column_stack([zero, np.cos(x[:, 1]), 0.5 * np.cos(x[:, 1] + x[:, 2]), zero])[..., None]


@pytest.mark.parametrize("lever", [0.0, 1e-17])
def test_an_arm_with_upright_axes_carries_no_load(known, lever):
    class Upright(Weighed):
        def measure_levers(self, x):
            return np.full((*x.shape, 1), lever)

    plain = known.senses["effector"]
    model = Upright(**{field.name: getattr(plain, field.name) for field in fields(plain)})
    problem = pose_problem(run(), replace(known, senses={"effector": model}))
    assert not any(part.kind == "load" for part in problem.parts)


@pytest.mark.parametrize("size", [0.006, 0.03])
@pytest.mark.parametrize("seed", first_of(1, [50, 60, 61]))
def test_a_weight_at_the_hand_is_no_change_and_hides_none(known, seed, size):
    """Joints that sink beyond what they read look like a camera that has moved, and one takes up a part of the other."""
    plain = known.senses["effector"]
    model = Weighed(**{field.name: getattr(plain, field.name) for field in fields(plain)})
    weighed = replace(known, senses={"effector": model})

    def laden(features):
        sunk = -size * model.measure_levers(features.joints.values)[..., 0]
        return replace(features, joints=replace(features.joints, values=features.joints.values - sunk))

    push = PUSHES[0]
    still, pushed = (laden(run(seed, encoder=1e-3, camera=camera)) for camera in (None, push))
    assert bool(find_changes(still, known)) == (size > 0.01) and not find_changes(still, weighed)
    found = change.find_changes(pushed, weighed)
    (one,) = found.changes
    assert one.name == "camera"
    now = found.body.senses["effector"]
    camera = now.rig.of_camera(0).start + np.arange(6)
    off = now.theta[camera] - plain.theta[camera] - push
    assert np.abs(off / np.sqrt(np.square(now.root[camera]).sum(axis=1))).max() < 4.0


@pytest.mark.parametrize("seed", range(3))
def test_sinking_has_the_derivatives_of_differences(seed):
    draw = np.random.default_rng(seed)
    n, joints, ways, still, outputs = 5, 4, 3, 2, 2
    shapes = ((n, joints, ways), (n, joints, ways), (n, still, ways), (n, outputs, still))
    sinking = Sinking(*(draw.normal(size=shape) for shape in shapes))
    unknowns = draw.normal(size=ways + 2 * joints + still)
    rows = np.array([0, 2, 3])
    for found in (sinking.bend_joints, sinking.show_still_joints):
        columns = found(rows, unknowns)[1]
        for k, step in enumerate(1e-6 * np.eye(len(unknowns))):
            slope = (found(rows, unknowns + step)[0] - found(rows, unknowns - step)[0]) / 2e-6
            np.testing.assert_allclose(columns[..., k], slope, atol=1e-8)


@pytest.mark.parametrize(("gain", "allowed"), [(10.0, True), (3.0, False), (-5.0, False)])
def test_a_load_is_allowed_for_beside_a_pose_where_it_wins_by_a_margin(known, monkeypatch, gain, allowed):
    plain = known.senses["effector"]
    model = Weighed(**{field.name: getattr(plain, field.name) for field in fields(plain)})
    problem = pose_problem(run(), replace(known, senses={"effector": model}))
    camera = next(part for part in problem.parts if part.kind == "camera")
    unknowns = np.zeros(len(problem.std)), np.eye(len(problem.std))
    monkeypatch.setattr(change, "fit_parts", lambda *_: ChangeFit(*unknowns, 100.0 + gain))
    found = change._Search(problem, (camera,), ChangeFit(*unknowns, 100.0), {})
    parts, fit = change._allow_for_load(found)
    assert [part.kind for part in parts] == (["camera", "load"] if allowed else ["camera"])
    assert fit.evidence == (100.0 + gain if allowed else 100.0)


def test_markers_that_other_still_joints_carry_share_one_load(known):
    """One on the hand, which the wrist carries, and one that nothing tells the levers of."""

    class Carried(Weighed):
        still_joints = ("roll",)

        def show_still_joints(self, x):
            return np.ones((len(x), 2, 1)), np.ones((len(x), 1, 1))

    plain = known.senses["effector"]
    model = Carried(**{field.name: getattr(plain, field.name) for field in fields(plain)})
    features = run(52)
    both = replace(features, tracks={"effector": features.tracks["effector"], "hand": features.tracks["effector"]})
    problem = pose_problem(both, replace(known, senses={"effector": plain, "hand": model}))
    assert [track.sinkings[0].shown.any() for track in problem.tracks] == [False, True]
    load = next(part for part in problem.parts if part.kind == "load")
    # the pull, joints and links, and the one that stood still
    assert load.place.stop - load.place.start == 1 + 2 * len(known.joints) + 1
    assert np.isfinite(fit_parts(problem, (load,)).evidence)


@pytest.mark.parametrize("seed", [53, 54, 55])
def test_changes_that_explain_about_as_much_are_doubt(known, seed):
    """In a second and a half a marker may have moved instead of the wrist; ten seconds show that the pan is off."""
    short = change.find_changes(run(seed, encoder=0.003, duration=1.5, offset={"wrist": 4 * DEGREE}), known)
    assert short.changes[0].alternatives and np.sqrt(short.doubt[3, 3]) > 3e-3
    long = change.find_changes(run(seed, encoder=0.003, offset={"pan": 4 * DEGREE}), known)
    assert not long.changes[0].alternatives and np.sqrt(np.diag(long.doubt)).max() < 1e-3


@pytest.mark.parametrize(("nats", "doubted"), [(4.0, True), (-15.0, False)])
def test_a_load_beside_a_moved_camera_is_doubt_where_it_explains_as_much(on_axes, monkeypatch, nats, doubted):
    problem = pose_problem(run(), on_axes)
    of = {part.kind: part for part in problem.parts if np.isinf(part.onset)}
    size = len(problem.std)
    std = problem.std[of["load"].place]

    def fit(_, parts, begin=None):
        unknowns = np.zeros(size)
        unknowns[of["load"].place] = 0.01 * (of["load"] in parts)
        evidence = {("camera",): 100.0, ("camera", "load"): 100.0 + nats}.get(tuple(part.kind for part in parts), 0.0)
        return ChangeFit(unknowns, 1e-12 * np.eye(size), evidence)

    monkeypatch.setattr(change, "fit_parts", fit)
    found = change._Search(problem, (of["camera"],), fit(problem, (of["camera"],)), {})
    doubt = change._weigh_explanations(found, on_axes.joints, (found.parts, found.fit))
    assert (np.sqrt(np.diag(doubt)).max() > 1e-3) == doubted
    hand = problem.tracks[0].sinkings[of["load"].hand]
    bends = hand.bend_joints(problem.kept[0], np.full(len(std), 0.01))[0]
    odds = np.exp(nats - change.CHANGE_MARGIN_NATS)
    # what was found, three widths of the camera alone, and three of each hand's load beside it, one of which bends here
    assert np.allclose(np.diag(doubt), np.square(bends).max(axis=0) * odds / (4 + 6 * odds), rtol=1e-3)


@pytest.mark.parametrize("degrees", [0.3, 0.2])
@pytest.mark.soak
def test_small_pushes_are_not_taken_for_something_else(on_axes, degrees):
    """Priors as wide as 2° and 20 mm cost more nats than what tells such a push from a load or an offset."""
    draw = np.random.default_rng(11)
    pushed = [run(70 + k, encoder=1e-3, camera=push(draw, degrees, 0.01 * degrees)) for k in range(8)]
    named = [(one[0].name, *one[0].alternatives) for one in (find_changes(log, on_axes) for log in pushed) if one]
    assert all("camera" in names for names in named) and sum(names[0] == "camera" for names in named) >= 4


def test_a_marker_before_two_cameras_moves_in_the_axes_of_each(on_axes):
    """Without a URDF nothing tells how one camera's axes lie in the other's."""
    features = run(60)
    both = replace(features, tracks={**features.tracks, "side/effector": features.tracks["effector"]})
    model = on_axes.senses["effector"]
    problem = pose_problem(both, replace(on_axes, senses={"effector": model, "side/effector": model}))
    poses = {part.thing for part in problem.parts if part.is_pose}
    assert poses == {("camera", "camera"), ("camera", "camera side"), ("marker", "effector"), ("marker", "side/effector")}


def test_a_track_that_a_log_lacks_holds_no_camera(on_axes):
    plain = body.learn_body([run(3, 16.0, 0.003)], Settings(), {}).model.senses["effector"]
    assert find_changes(run(60, camera=PUSHES[0]), replace(on_axes, senses={**on_axes.senses, "tip": plain}))


@pytest.mark.parametrize(
    ("both", "alone", "parts", "alternatives"),
    [
        (100.0, 100.0, ["elbow"], ()),  # a joint that moves no image adds nothing to the other
        (103.0, 60.0, ["elbow"], ("lift", "wrist")),
        (110.0, 60.0, ["lift", "wrist"], ()),
        (90.0, 60.0, ["elbow"], ()),
    ],
)
def test_a_pair_of_joints_needs_both_and_wins_or_is_named_beside_one(known, monkeypatch, both, alone, parts, alternatives):
    """The nats of the elbow are 100, those of lift and wrist together and of each alone as given."""
    problem = pose_problem(run(), known)
    of = {part.name: part for part in problem.parts if part.kind == "joint" and np.isinf(part.onset)}
    nats = {("elbow",): 100.0, ("lift", "wrist"): both, ("lift",): alone, ("wrist",): alone}

    def fit(_, chosen, begin=None):
        size = len(problem.std)
        return ChangeFit(np.zeros(size), np.eye(size), nats.get(tuple(part.name for part in chosen), -np.inf))

    monkeypatch.setattr(change, "fit_parts", fit)
    monkeypatch.setattr(change, "linearise_sightings", lambda *_: None)
    monkeypatch.setattr(change, "linear_evidence", lambda _, problem, chosen: fit(problem, chosen).evidence)
    found = change._Search(problem, (of["elbow"],), fit(problem, (of["elbow"],)), {("joint", "elbow"): ()})
    preferred = change._prefer_joint_pair(found, problem)
    assert [part.name for part in preferred.parts] == parts
    assert all(tuple(name for _, name in others) == alternatives for others in preferred.alternatives.values())


def test_bias_off_reports_no_offset(known):
    found, estimated = _estimate(run(offset={"elbow": 3 * DEGREE}), known, bias="off")
    assert estimated.faults == found.faults == ()


def test_sizes_that_differ_are_both_reported(known):
    found, _ = _estimate(run(), known)
    (one,) = find_changes(run(offset={"elbow": 3 * DEGREE}), known)
    other = replace(found, faults=(Fault("encoders", "elbow", FaultKind.DRIFTING, 0.1, 0.2, "rad"),))
    faults, findings = change_findings.merge_changes_and_faults([one], other)
    assert [fault.kind for fault in faults] == ["offset"]
    assert any("by the filter its offset is 0.2 rad" in finding.text for finding in findings)


def test_ambiguous_changes_are_named_together(known):
    found, _ = _estimate(run(), known)
    (one,) = find_changes(run(offset={"elbow": 3 * DEGREE}), known)
    (fault,), _ = change_findings.merge_changes_and_faults([replace(one, alternatives=("camera",))], found)
    assert fault.name == "elbow or camera" and fault.size != fault.size and fault.std is None


def test_lengths_that_no_image_tells_are_shares(on_axes):
    (camera,) = find_changes(run(60, camera=PUSHES[0]), on_axes)
    assert "% of the marker's distance and turned by 1." in change_findings._describe_change(camera)
    marker = replace(camera, kind="marker", name="effector", turn=None)
    fault = change_findings._change_as_fault(marker, 0.0)
    assert not fault.sized
    (warning,) = fault_warnings((fault,))
    assert warning.text == "vision effector: moved since 0.000 s; relative to the body"


@pytest.mark.soak
def test_change_has_true_error_bars_over_many_draws():
    draw, within, count, false = np.random.default_rng(7), 0, 0, 0
    for seed in range(10):
        one = explored(seed)
        false += sum(bool(find_changes(run(1000 + 10 * seed + k), one)) for k in range(2))
        for k in range(4):
            joint, size = JOINTS[draw.integers(4)], draw.uniform(1, 5) * draw.choice([-1, 1]) * DEGREE
            found = [c for c in find_changes(run(2000 + 10 * seed + k, offset={joint: size}), one) if c.name == joint]
            count += len(found)
            within += sum(abs(c.value[0] - size) < 2 * c.std[0] for c in found)
    assert false == 0 and count >= 38 and within >= 0.9 * count
