"""The live filter, fed message by message, against the batch filter."""

import gc
import json
import re
import tracemalloc
from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from bodylog import body as learning
from bodylog.body_model import BodyModel
from bodylog.errors import LogError, ModelError, UsageError
from bodylog.estimation import estimate_from_features
from bodylog.estimation.inference.filter_pass import FilterDynamics
from bodylog.estimation.inference.sequential import FilterStep, Line, SequentialFilter
from bodylog.estimation.live import Belief, LiveEstimator
from bodylog.estimation.measurements import touch
from bodylog.estimation.noise.correlated_noise import ErrorCorrelation, LastFrame, PendingFrame
from bodylog.settings import EstimationSettings, Settings
from bodylog.types import Estimate, Features, Series
from tests.estimation.conftest import WHITE_MOTIONS, Explored, discretised
from tests.estimation.resting import Drawn
from tests.estimation.resting import drawn as draw_resting_arm
from tests.seeds import seeds

MODEL = EstimationSettings(precision="model", bias="off")
ANGLE, SPREAD, NATS = 1e-9, 1e-7, 1e-6
"""rad · relative to the standard deviations · nats: largest difference of live and batch filter."""
Message = tuple[float, str, object]


def messages_of(
    features: Features, body: BodyModel, late: Callable[[str], float] = lambda sense: 0.0
) -> list[Message]:
    """All readings as (time, sense, reading), in order of arrival when senses are `late` (s)."""
    messages: list[tuple[float, Message]] = []
    joints = features.joints
    if joints is not None:
        rows = [dict(zip(joints.names, row, strict=True)) for row in joints.values]
        messages += [
            (t + late("joints"), (t, "joints", row)) for t, row in zip(joints.t, rows, strict=True)
        ]
    for name, track in features.tracks.items():
        if name in body.senses:
            places = track.values if track.std is None else np.hstack([track.values, track.std])
            messages += [
                (t + late(name), (t, name, place)) for t, place in zip(track.t, places, strict=True)
            ]
    if features.touches:
        found, _ = touch.read_touch_sighting(features, body)
        places = np.hstack([found.values, np.sqrt(found.var)])
        messages += [
            (at + late("touch"), (at, "touch", place))
            for at, place in zip(found.t, places, strict=True)
        ]
    return [message for _, message in sorted(messages, key=lambda pair: pair[0])]


def step(live: LiveEstimator, messages: Iterable[Message]) -> list[Belief]:
    return [live.step(t, **{sense: reading}) for t, sense, reading in messages]  # type: ignore[arg-type]


def assert_same(beliefs: list[Belief], batch: Estimate) -> None:
    """The last belief of each output time, all nats and all errors equal the batch filter's."""
    last = {belief.t: belief for belief in beliefs}
    at = [k for k, t in enumerate(batch.joints.t) if t in last]
    assert len(at) > 0.95 * len(batch.joints.t)
    ours = [last[t] for t in batch.joints.t[at]]
    np.testing.assert_allclose([b.x for b in ours], batch.joints.values[at], atol=ANGLE, rtol=0)
    std = np.sqrt(np.einsum("nii->ni", batch.cov[at]))
    apart = (np.array([b.cov for b in ours]) - batch.cov[at]) / (std[:, :, None] * std[:, None])
    np.testing.assert_allclose(apart, 0.0, atol=SPREAD)
    if batch.bias is not None:
        np.testing.assert_allclose(
            [b.bias for b in ours], batch.bias.values[at], atol=ANGLE, rtol=0
        )
    end = max(batch.joints.t)
    assert sum(b.free_energy for b in beliefs if b.t <= end) == pytest.approx(
        batch.free_energy.sum(), abs=NATS
    )


def assert_same_errors(beliefs: list[Belief], messages: list[Message], batch: Estimate) -> None:
    for name, errors in batch.errors.items():
        sense = "joints" if name == "encoders" else name
        accepted = {
            m[0]: b.errors[name]
            for b, m in zip(beliefs, messages, strict=True)
            if m[1] == sense and b.errors
        }
        ours = [accepted[t] for t in errors.t]
        np.testing.assert_allclose(ours, errors.values, atol=SPREAD)


def check(features: Features, body: BodyModel, settings: EstimationSettings = MODEL) -> None:
    messages, batch = messages_of(features, body), estimate_from_features(features, body, settings)
    live = LiveEstimator(body, settings)
    beliefs = step(live, messages)
    assert_same(beliefs, batch)
    assert_same_errors(beliefs, messages, batch)
    counted = {name for name in live.used if name != "touch"}
    assert {n: live.used[n].seen for n in counted} == {n: batch.used[n].seen for n in counted}
    assert {n: live.used[n].used for n in counted} == {n: batch.used[n].used for n in counted}


def simultaneous(world, seed: int, **options: float) -> tuple[Features, BodyModel]:
    """Two cameras, with images at stamps of encoders."""
    drawn = world(seed, duration=5.0, camera_hz=12.5, **options)
    track, rng = drawn.features.tracks["effector"], np.random.default_rng(seed)
    track = replace(track, t=drawn.features.joints.t[::4][: len(track.t)])
    side = replace(track, values=track.values + rng.normal(0, 1.0, track.values.shape), std=None)
    body = replace(
        drawn.body,
        senses=dict.fromkeys(("effector", "side/effector"), drawn.body.senses["effector"]),
    )
    return replace(drawn.features, tracks={"effector": track, "side/effector": side}), body


@pytest.mark.parametrize("seed", seeds(2, 3))
@pytest.mark.parametrize("bias", ["off", "on"])
def test_estimator_equals_the_batch_filter(world, seed, bias):
    drawn = world(seed, duration=8.0, hidden=(1.0, 2.0), blunder=0.05)
    check(drawn.features, drawn.body, replace(MODEL, bias=bias))


@pytest.mark.parametrize(("count", "size"), [(2, 0.5), (4, 1.5)])
def test_estimator_recovers_from_mistaken_first_readings_as_the_batch(world, count, size):
    """They differ; the batch finds those that do not beforehand."""
    drawn = world(1, duration=5.0, encoder_std=0.002)
    joints = drawn.features.joints
    values = joints.values.copy()
    values[:count, 1] += size * (-1.0) ** np.arange(count)
    check(replace(drawn.features, joints=replace(joints, values=values)), drawn.body)


@pytest.mark.parametrize(("count", "size"), [(2, 0.5), (4, 3.0)])
def test_estimator_recovers_within_a_second_from_first_readings_that_agree(world, count, size):
    drawn = world(1, duration=5.0, encoder_std=0.002)
    joints = drawn.features.joints
    values = joints.values.copy()
    values[:count, 1] += size
    features = replace(drawn.features, joints=replace(joints, values=values))
    beliefs = step(LiveEstimator(drawn.body), messages_of(features, drawn.body))
    late = [belief for belief in beliefs if belief.t > joints.t[0] + 1.0]
    truth = np.array([[np.interp(belief.t, drawn.truth.t, y) for y in drawn.truth.values.T] for belief in late])
    assert np.sqrt(np.mean((np.array([belief.x for belief in late]) - truth) ** 2)) < 0.002


@pytest.mark.parametrize("names", [["pan", "lift", "elbow"], ["pan", "lift"]])
@pytest.mark.parametrize("seed", seeds(1, 3))
def test_estimator_recovers_a_lost_belief_as_the_batch(world, seed, names):
    drawn, end = world(seed, duration=10.0, blunder=0.02), 4.0 if len(names) == 3 else 8.0
    joints, track = drawn.features.joints, drawn.features.tracks["effector"]
    gone = np.outer((joints.t >= 3.0) & (joints.t < end), np.isin(joints.names, names))
    keep, values = ~gone.all(axis=1), np.where(gone, np.nan, joints.values)
    joints = replace(
        joints, t=joints.t[keep], values=values[keep], source_ns=joints.source_ns[keep]
    )
    elsewhere = ((track.t >= 3.0) & (track.t < end) & (len(names) == 3))[:, None]
    tracks = {"effector": replace(track, values=np.where(elsewhere, [250.0, 60.0], track.values))}
    features = replace(drawn.features, joints=joints, tracks=tracks)
    check(features, drawn.body)
    beliefs = step(LiveEstimator(drawn.body), messages_of(features, drawn.body))
    batch = estimate_from_features(features, drawn.body, MODEL)
    lost = [belief for belief in beliefs if belief.lost is not None]
    texts = [finding.text for finding in batch.findings if finding.text.startswith("belief: lost")]
    assert len(lost) == len(texts) and all(
        f"{b.t:.3f} s" in text for b, text in zip(lost, texts, strict=True)
    )
    assert lost or len(names) == 2


@pytest.mark.parametrize(
    "end", [5.0, *(pytest.param(end, marks=pytest.mark.soak) for end in (8.0, 20.0))]
)
@pytest.mark.parametrize("names", [["pan", "lift", "elbow"], ["elbow", "lift"]])
@pytest.mark.parametrize("seed", seeds(1, 4))
def test_joints_adrift_equal_the_batch(world, seed, names, end):
    drawn = world(seed, duration=9.0, encoder_hz=40.0, model=Explored(), blunder=0.02)
    joints = drawn.features.joints
    gone = np.outer((joints.t >= 3.0) & (joints.t < end), np.isin(joints.names, names))
    keep, values = ~gone.all(axis=1), np.where(gone, np.nan, joints.values)
    joints = replace(
        joints, t=joints.t[keep], values=values[keep], source_ns=joints.source_ns[keep]
    )
    check(replace(drawn.features, joints=joints), drawn.body)


@pytest.mark.parametrize("encoder_hz", [10.0, 400.0])
def test_frame_and_encoder_rates_may_differ(world, encoder_hz):
    drawn = world(0, duration=6.0, encoder_hz=encoder_hz)
    check(drawn.features, drawn.body, replace(MODEL, rate=None if encoder_hz < 100 else 100.0))


def test_variances_learned_from_a_log_are_used_live(world, white_acceleration):
    for seed, speed in ((0, 0.5), (1, 0.0)):
        drawn = world(seed, duration=6.0, speed=speed, blunder=0.05)
        batch = estimate_from_features(drawn.features, drawn.body, EstimationSettings(bias="off"))
        messages, settings = (
            messages_of(drawn.features, drawn.body),
            json.loads(json.dumps(batch.settings)),
        )
        assert_same(step(LiveEstimator(drawn.body, MODEL, learned=settings), messages), batch)
        assert (min(settings["stated"]) < 1.0) is (speed == 0.0)
    drawn = world(0, duration=6.0)
    one, whole = (
        estimate_from_features(drawn.features, drawn.body, EstimationSettings(m, bias="off"))
        for m in ("filter", "smoother")
    )
    beliefs = step(
        LiveEstimator(drawn.body, MODEL, learned=whole.settings),
        messages_of(drawn.features, drawn.body),
    )
    assert_same(beliefs, one)


def test_motion_learned_from_a_log_is_used_live(world):
    drawn = world(0, duration=12.0, blunder=0.02)
    batch, smooth = (
        estimate_from_features(drawn.features, drawn.body, EstimationSettings(m, bias="off"))
        for m in ("filter", "smoother")
    )
    assert batch.settings["motion"] == smooth.settings["motion"] == "white-jerk"
    messages = messages_of(drawn.features, drawn.body)
    for learned in (batch, smooth):
        settings = json.loads(json.dumps(learned.settings))
        assert_same(step(LiveEstimator(drawn.body, MODEL, learned=settings), messages), batch)
    late = messages_of(
        drawn.features, drawn.body, lambda sense: 0.06 if sense == "effector" else 0.0
    )
    last = step(LiveEstimator(drawn.body, MODEL, learned=batch.settings), late)[-1]
    np.testing.assert_allclose(last.x, batch.joints.values[-1], atol=1e-9, rtol=0)


def test_joints_whose_encoders_are_silent_move_as_fast_live_as_in_the_log():
    sound = draw_resting_arm(3, Drawn("reach", noise=1e-3))
    values = sound.features.joints.values.copy()
    values[400:600, 1] = np.nan
    features = replace(sound.features, joints=replace(sound.features.joints, values=values))
    batch = estimate_from_features(features, sound.body, EstimationSettings(bias="off"))
    settings = json.loads(json.dumps(batch.settings))
    assert max(settings["bursts"]) > 2.0
    messages = messages_of(features, sound.body)
    assert_same(step(LiveEstimator(sound.body, MODEL, learned=settings), messages), batch)


@pytest.mark.parametrize(
    "encoder", [None, "loud", [1.0], [1e-4, 1e-4, 0.0], [1e-4, 1e-4, float("nan")]]
)
def test_variances_that_are_not_the_bodys_are_refused(world, encoder):
    drawn = world(0, duration=1.0)
    settings = {"encoder": encoder, "process": [0.1] * 3, "stated": [1.0] * 3}
    with pytest.raises(
        UsageError, match=re.escape(f"learned: encoder is {encoder!r}, possible: 3 numbers above 0")
    ):
        LiveEstimator(drawn.body, MODEL, learned=settings)


@pytest.mark.parametrize("seed", seeds(1, 3))
def test_pixel_noise_without_a_stated_std_is_the_bodys(world, seed):
    drawn = world(seed, duration=5.0)
    track = drawn.features.tracks["effector"]
    std = np.where(np.random.default_rng(seed).random(track.values.shape) < 0.5, np.nan, track.std)
    for stated in (None, std, np.zeros_like(std)):
        check(replace(drawn.features, tracks={"effector": replace(track, std=stated)}), drawn.body)


def test_missing_joints_gaps_and_times_that_run_backwards(world):
    drawn = world(1, duration=10.0)
    joints, track = drawn.features.joints, drawn.features.tracks["effector"]
    values, t = joints.values.copy(), joints.t.copy()
    values[50:60] = np.nan
    values[70:150, 0] = np.nan
    keep = (t < 4.0) | (t > 5.5)
    t[100:110] = t[40:50]
    spoilt = Series(t[keep], values[keep], joints.names, joints.unit, joints.source_ns[keep])
    frames = track.t.copy()
    frames[40] = frames[39]
    check(
        replace(drawn.features, joints=spoilt, tracks={"effector": replace(track, t=frames)}),
        drawn.body,
    )


@pytest.mark.parametrize("seed", seeds(1, 3))
def test_simultaneous_senses_in_any_order_and_in_one_call(world, seed):
    features, body = simultaneous(world, seed, blunder=0.1)
    settings = replace(MODEL, start=(-0.9, -0.9, 1.0))
    messages, batch = messages_of(features, body), estimate_from_features(features, body, settings)
    order = np.random.default_rng(seed).permutation(len(messages))
    mixed = sorted((messages[k] for k in order), key=lambda message: message[0])
    assert [m[1] for m in mixed] != [m[1] for m in messages]
    assert_same(step(LiveEstimator(body, settings), mixed), batch)
    together: dict[float, dict[str, object]] = {}
    for t, sense, reading in mixed:
        together.setdefault(t, {})[sense] = reading
    live = LiveEstimator(body, settings)
    assert_same([live.step(t, **senses) for t, senses in together.items()], batch)  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", seeds(2, 3))
def test_late_images_are_applied_at_their_time(world, seed):
    features, body = simultaneous(world, seed, blunder=0.05)
    late, rng = {"effector": 0.08, "side/effector": 0.13}, np.random.default_rng(seed)
    messages = messages_of(
        features, body, lambda sense: late.get(sense, 0.0) * rng.uniform(0.9, 1.1)
    )
    assert any(one[0] > next_[0] for one, next_ in pairwise(messages))
    live, batch = LiveEstimator(body), estimate_from_features(features, body, MODEL)
    beliefs = step(live, messages)
    end = batch.joints.t[-1]
    assert beliefs[-1].t == end
    np.testing.assert_allclose(beliefs[-1].x, batch.joints.values[-1], atol=ANGLE, rtol=0)
    np.testing.assert_allclose(beliefs[-1].cov, batch.cov[-1], atol=1e-12)
    assert sum(b.free_energy for b in beliefs) == pytest.approx(batch.free_energy.sum(), abs=NATS)
    assert not any(health.rejected for health in live.used.values())


def test_too_late_readings_are_left_out_and_counted(world):
    drawn = world(0, duration=2.0)
    joints, track = drawn.features.joints, drawn.features.tracks["effector"]
    live = LiveEstimator(drawn.body, lag=0.1)
    for t, row in zip(joints.t, joints.values[:, [1, 2, 0]], strict=True):
        now = live.step(t, joints=row)
    after = live.step(1.0, joints=joints.values[0], effector=track.values[0])
    assert after.t == now.t and after.free_energy == 0.0 and after.errors == {}
    np.testing.assert_array_equal(after.x, now.x)
    assert live.used["encoders"].rejected == {"too late": 1}
    assert live.used["effector"].rejected == {"too late": 1}


@pytest.mark.parametrize("weight", [1.0, 0.01])
def test_touch_is_the_hands_place_and_its_spread(world, stroked, weight):
    features = stroked(world(0, duration=12.0, encoder_std=0.1), weight, (3.0, -2.0))
    check(features, world(0, encoder_std=0.1).body)


def explored(world) -> BodyModel:
    drawn = world(5, duration=20.0, encoder_std=0.003, pixel_std=0.2)
    return learning.learn_body([drawn.features], Settings(), {}).model


@pytest.mark.parametrize("senses", [("vision",), ("pan", "vision"), ("lift", "elbow", "vision")])
def test_estimator_runs_without_some_or_all_encoders(world, senses):
    drawn, body = world(7, duration=6.0), explored(world)
    body = replace(body, noise=replace(body.noise, encoder=(0.02**2,) * 3, process=(0.3,) * 3))
    order = [drawn.features.joints.names.index(name) for name in body.joints]
    start = tuple(drawn.features.joints.values[0, order])
    check(drawn.features, body, replace(MODEL, senses=senses, start=start))


def test_belief_is_available_at_any_time(world):
    drawn = world(2, duration=4.0)
    batch = estimate_from_features(drawn.features, drawn.body, replace(MODEL, rate=37.0))
    live, beliefs = LiveEstimator(drawn.body), []
    asked = [(t, "", None) for t in batch.joints.t]
    for t, sense, reading in sorted(
        [*messages_of(drawn.features, drawn.body), *asked], key=lambda message: message[0]
    ):
        beliefs.append(live.step(t, **({sense: reading} if sense else {})))  # type: ignore[arg-type]
    assert_same(beliefs, batch)


@pytest.mark.parametrize("steps", [6_000, pytest.param(100_000, marks=pytest.mark.soak)])
def test_estimator_uses_constant_memory(world, linear_model, steps):
    body = world(0, duration=1.0, model=linear_model).body
    live, x = LiveEstimator(body), np.array([-0.9, -0.9, 1.0])
    seen = linear_model.predict(x[None])[0][0]

    def run(first: int, last: int) -> int:
        for k in range(first, last):
            live.step(k / 500, joints=x, effector=seen if k % 16 == 0 else None)
        gc.collect()  # tuples kept for reuse would count as held
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    soon, late = run(0, 2_000), run(2_000, steps)
    tracemalloc.stop()
    assert late < soon + 200_000
    assert np.linalg.eigvalsh(live.step(1e5).cov).min() > 0


def test_unfit_readings_are_refused_in_one_line_and_change_nothing(world):
    drawn = world(0, duration=1.0)
    live, x = LiveEstimator(drawn.body), np.array([-0.9, -0.9, 1.0])
    before = live.step(0.0, joints=x)
    refused: list[tuple[type[Exception], str, dict[str, object]]] = [
        (UsageError, "t: nan found", {"t": np.nan}),
        (UsageError, "t: 'now' found", {"t": "now"}),
        (
            UsageError,
            r"joints: \[1.0, 2.0\] found, possible: one angle in rad for each of pan",
            {"joints": [1.0, 2.0]},
        ),
        (UsageError, "joints: .* found", {"joints": np.zeros((1, 3))}),
        (UsageError, "joints: .* found", {"joints": ["a", "b", "c"]}),
        (
            ModelError,
            "j1, j2 found, possible: pan, lift, elbow",
            {"joints": {"j1": 1.0, "j2": 2.0}},
        ),
        (
            UsageError,
            r"effector: .* found, possible: \(u, v\) or \(u, v, std_u, std_v\) in px",
            {"effector": 1.0},
        ),
        (UsageError, "effector: .* found", {"effector": (1.0, 2.0, 3.0)}),
        (UsageError, r"touch: .* possible: \(u, v, std_u, std_v\)", {"touch": (1.0, 2.0)}),
        (
            UsageError,
            "hand: the body has no such sense; it has effector, touch",
            {"hand": (1.0, 2.0)},
        ),
    ]
    for kind, text, given in refused:
        with pytest.raises(kind, match=text) as problem:
            live.step(**{"t": 1.0, **given})  # type: ignore[arg-type]
        assert "\n" not in str(problem.value)
    assert live.used["encoders"].seen == 1 and "effector" not in live.used
    np.testing.assert_array_equal(live.step(0.0).x, before.x)


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (EstimationSettings(), "precision: 'auto' needs the whole log; possible live: model"),
        (
            EstimationSettings(precision="model"),
            "bias: 'auto' needs the whole log; possible live: off or on",
        ),
        (replace(MODEL, method="smoother"), "method: 'smoother' needs the whole log"),
        (replace(MODEL, start=(1.0,)), "start: 1 angles given, the body has 3 joints"),
        (replace(MODEL, senses=("nose",)), "senses: 'nose' found, possible:"),
    ],
)
def test_settings_that_need_the_whole_log_are_refused(world, settings, text):
    with pytest.raises(UsageError, match=text):
        LiveEstimator(world(0, duration=1.0).body, settings)


def test_estimator_refuses_a_negative_lag(world):
    with pytest.raises(UsageError, match=r"lag: -1.0 found, a time of at least 0 s is possible"):
        LiveEstimator(world(0, duration=1.0).body, lag=-1.0)


def test_readings_before_all_joints_are_known_are_applied_then(world):
    drawn = world(0, duration=3.0)
    joints, track = drawn.features.joints, drawn.features.tracks["effector"]
    values = joints.values.copy()
    values[:3, 1] = np.nan
    features = replace(drawn.features, joints=replace(joints, t=joints.t + 0.1, values=values))
    live, beliefs = LiveEstimator(drawn.body), []
    for message in messages_of(features, drawn.body):
        try:
            beliefs += step(live, [message])
        except LogError as problem:
            assert (
                re.search("no reading of .*pan.* yet; pass every joint once", str(problem))
                and not beliefs
            )
    assert_same(beliefs, estimate_from_features(features, drawn.body, MODEL))
    assert live.used["effector"].used == len(track.t) and not live.used["encoders"].rejected
    late = LiveEstimator(drawn.body, lag=0.05)
    for t in (0.0, 0.02):
        with pytest.raises(LogError):
            late.step(t, effector=track.values[0])
    late.step(0.06, joints=joints.values[0])
    assert late.used["effector"].rejected == {"too late": 1}


def test_joints_in_two_halves_start_once_all_are_known(world):
    drawn = world(0, duration=1.0)
    robot = LiveEstimator(drawn.body)
    first, second, third = ({name: 0.1} for name in drawn.body.joints)
    for part in (first, second):
        with pytest.raises(LogError, match="no reading of"):
            robot.step(0.0, joints=part)
    belief = robot.step(0.01, joints=third)
    np.testing.assert_allclose(belief.x, 0.1, atol=1e-9)


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("offsets", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_step_equals_the_matrix_form(seed, offsets, order):
    rng, m, dt = np.random.default_rng(seed), 3, 0.013
    drift = np.array([1e-4, 0.0, 1e-5]) if offsets else None
    dynamics = FilterDynamics(rng.uniform(0.1, 1.0, m), drift, motion=WHITE_MOTIONS[order])
    k, more = dynamics.size, rng.uniform(1.0, 2.0, m)
    root = rng.normal(size=(k, k))
    z, p, var = rng.normal(size=k), root @ root.T / k, rng.uniform(1e-4, 1e-2, m)
    f, q = np.eye(k), np.zeros((k, k))
    f[: order * m, : order * m], q[: order * m, : order * m] = discretised(
        more * dynamics.process, dt, order
    )
    q[order * m :, order * m :] = np.diag([] if drift is None else drift * dt)
    step, begin = FilterStep(dynamics, 2, 2), (z, p)
    z, p = f @ z, f @ p @ f.T + q
    readings = np.where(rng.random(m) < 0.3, np.nan, z[:m] + rng.normal(size=m) * (1.0, 1.0, 90.0))
    lines = [
        Line(jac := rng.normal(size=(n, m)), jac @ z[:m], rng.uniform(0.1, 1.0, n), LastFrame())
        for n in (2, 1)
    ]
    found = step(*begin, dt, readings, var, lines, process_factor=more)
    np.testing.assert_allclose(found.x, z[:m], atol=1e-12)
    np.testing.assert_allclose(found.cov, p[:m, :m], atol=1e-12)
    h, seen = np.eye(m, k) + np.eye(m, k, order * m), np.isfinite(readings)
    s = np.einsum("ik,kl,il->i", h, p, h) + var
    d = (readings - h @ z) / np.sqrt(s)
    np.testing.assert_allclose(found.d, d, atol=1e-12)
    gated = var + s * np.fmax((d / 5.0) ** 4 - 1.0, 0.0)
    h = np.concatenate([h[seen], *(np.pad(line.jac, ((0, 0), (0, k - m))) for line in lines)])
    nu = np.concatenate([readings[seen], *(line.y for line in lines)]) - h @ z
    s = h @ p @ h.T + np.diag(np.concatenate([gated[seen], *(line.var for line in lines)]))
    gain = p @ h.T @ np.linalg.inv(s)
    np.testing.assert_allclose(found.z, z + gain @ nu, atol=1e-9)
    np.testing.assert_allclose(found.p, p - gain @ h @ p, atol=1e-9)
    nats = 0.5 * (nu @ np.linalg.inv(s) @ nu + np.linalg.slogdet(2.0 * np.pi * s)[1])
    # outliers cost more than by their inflated noise
    assert (
        found.nats > nats + 1.0
        if (np.abs(d) > 5.0).any()
        else found.nats == pytest.approx(nats, abs=1e-9)
    )


def test_step_that_rounding_broke_is_refused():
    step = FilterStep(FilterDynamics(np.full(2, 0.1)))
    with pytest.raises(np.linalg.LinAlgError, match="rounding leaves no number"):
        step(np.zeros(4), np.nan * np.eye(4), 0.01, [0.0, 0.0], [1e-4, 1e-4])


def test_search_that_is_satisfied_at_once_linearises_at_the_prior_mean(world):
    drawn, rng = world(0, duration=1.0), np.random.default_rng(0)
    dynamics, start = FilterDynamics(np.full(3, 0.3)), np.array([-0.9, -0.9, 1.0])
    like = ErrorCorrelation(dynamics.process, np.asarray(np.inf), 0.0)
    model = drawn.body.senses["effector"]
    seen = model.predict(start[None])[0][0] + rng.normal(0.0, 5.0, 2)
    frame = PendingFrame(model, 0.0, seen, np.ones(2), like, LastFrame())
    for rest, kept in ((np.inf, True), (1e-8, False)):
        steps = SequentialFilter(dynamics, None, rest)
        found = steps.filter_instant(steps.build_first_state(start), 0.0, [np.nan] * 3, [1e-4] * 3, {"effector": frame})
        assert (
            np.array_equal(found.point, start)
            == np.array_equal(found.seen["effector"].memory.point, start)
            == kept
        )
        assert np.abs(found.z[:3] - start).max() > 1e-3
