"""Variances found by evidence, against the ones the readings were drawn with."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import factorial

from bodylog.estimation import estimate_from_features
from bodylog.estimation.measurements.records import Encoders
from bodylog.estimation.methods import filtering
from bodylog.estimation.noise import encoder_noise, evidence_search, quantisation
from bodylog.settings import EstimationSettings
from tests.estimation import conftest


def white(seed, noise, process, t):
    """Readings (N,) of a joint whose acceleration really is white."""
    rng = np.random.default_rng(seed)
    x = v = 0.0
    y = np.empty(len(t))
    for k, dt in enumerate(np.diff(t, prepend=t[0])):
        cov = process * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        dx, dv = rng.multivariate_normal([0, 0], cov)
        x, v = x + dt * v + dx, v + dv
        y[k] = x + rng.normal(0, np.sqrt(noise))
    return y


def likeliest(t, y):
    """Noise and process of one joint."""
    learned = learn(t, y)
    return learned.encoder[0], learned.process[0]


def learn(t, y, order=2):
    (joint,) = encoder_noise.average_joint_readings(Encoders(t, y[:, None], np.zeros(len(t), int)))
    return encoder_noise.learn_encoder_noise([joint], np.ones(1), np.ones(1), order)


@pytest.mark.parametrize(("noise", "process"), [(4e-4, 0.1), (1e-6, 0.1), (1e-4, 1e-3)])
@pytest.mark.parametrize("jitter", [0.0, 0.004])
def test_noise_and_motion_are_separated(noise, process, jitter):
    found = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        t = np.cumsum(0.02 + rng.uniform(-jitter, jitter, 3000))
        found.append(likeliest(t, white(seed, noise, process, t)))
    assert np.mean([f[0] for f in found]) == pytest.approx(noise, rel=0.1)
    assert np.exp(np.mean([np.log(f[1]) for f in found])) == pytest.approx(process, rel=0.35)


def test_bursts_differ_from_motion_that_lasts():
    t = np.arange(0.0, 60.0, 0.01)
    rng = np.random.default_rng(0)
    noise = rng.normal(0.0, 1e-3, len(t))
    lasting = white(0, 1e-6, 0.1, t)
    reaches = noise + 0.4 * np.clip(t - 20.0, 0.0, 1.0) - 0.4 * np.clip(t - 40.0, 0.0, 1.0)
    glitches = noise.copy()
    glitches[::500] += 3.0
    columns = np.stack([lasting, reaches, glitches, np.zeros(len(t))], axis=1)
    encoders = Encoders(t, columns, np.arange(len(t)))
    for order in (2, 3):
        factors = encoder_noise.measure_burst_factors(encoders, order)
        np.testing.assert_allclose(factors, [1.0, factors[1], 1.0, 1.0], rtol=0.2)
        assert factors[1] > 5.0
    few = Encoders(t[:1], columns[:1], np.zeros(1, int))
    assert (encoder_noise.measure_burst_factors(few, 2) == 1.0).all()
    # stamps a year apart take no room
    apart = Encoders(t + 3e7 * (t > 30.0), columns, np.arange(len(t)))
    assert encoder_noise.measure_burst_factors(apart, 2)[1] > 5.0


@pytest.mark.soak
def test_noise_and_motion_are_separated_at_1000_hz():
    t = np.arange(0.0, 20.0, 0.001)
    found = np.array([likeliest(t, white(seed, 4e-4, 0.01, t)) for seed in range(3)])
    assert found[:, 0].mean() == pytest.approx(4e-4, rel=0.05)
    np.testing.assert_allclose(np.exp(np.log(found[:, 1]).mean()), 0.01, rtol=0.4)
    t = t[:8000]
    y = white(0, 4e-4, 0.01, t)
    np.testing.assert_allclose(likeliest(t, y + 0.5 * (t > 4.0)), likeliest(t, y), rtol=0.3)


def test_process_variance_ignores_a_jump():
    t = np.arange(0.0, 30.0, 0.02)
    y = white(0, 1e-4, 0.05, t)
    plain = likeliest(t, y)
    jumped = likeliest(t, y + 0.5 * (t > 15.0))
    np.testing.assert_allclose(jumped, plain, rtol=0.3)


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("seed", range(3))
def test_process_variance_ignores_single_false_readings(order, seed):
    rng, t = np.random.default_rng(seed), np.arange(0.0, 20.0, 0.02)
    sound = np.sin(np.outer(t, [0.7, 1.1, 1.6])) * 0.3 + rng.normal(0.0, 0.02, (len(t), 3))
    false = sound.copy()
    false[rng.choice(len(t), 8, replace=False)] += rng.normal(0.0, 0.5, (8, 3))
    joints = [
        encoder_noise.average_joint_readings(Encoders(t, values, np.zeros(len(t), int)))
        for values in (sound, false)
    ]
    found = [
        encoder_noise.learn_encoder_noise(each, np.full(3, 1e-4), np.ones(3), order)
        for each in joints
    ]
    np.testing.assert_allclose(found[1].process, found[0].process, rtol=0.5)


def test_no_rounding_makes_a_variance_negative_at_uneven_times():
    """NumPy would warn of it."""
    rng = np.random.default_rng(0)
    t = np.sort(np.arange(0.0, 160.0, 0.01) + rng.uniform(0.0, 0.02, 16000))
    learn(t, rng.normal(0.0, 1e-3, len(t)), order=3)


@pytest.mark.parametrize("seed", range(3))
def test_noise_of_counted_readings_stays_where_a_drift_is_taken_out_of_them(seed):
    """Readings are no whole counts any more: what repeats would pass for a perfect motion."""
    count = math.tau / 4096
    t = np.arange(0.0, 16.0, 0.01)
    rng = np.random.default_rng(seed)
    sound = 0.3 * np.tanh(9.0 * np.sin(0.9 * t + seed)) + rng.normal(0.0, 2e-4, len(t))
    taken = 0.005 * np.maximum(t - 5.0, 0.0)
    counted = Encoders(t, np.round(sound[:, None] / count) * count, np.zeros(len(t), int))
    read = Encoders(t, np.round((sound + taken)[:, None] / count) * count, counted.source_ns)
    corrected = read.with_corrected_readings(read.values - taken[:, None])
    found = [
        encoder_noise.learn_encoder_noise(
            encoder_noise.average_joint_readings(each), np.full(1, 1e-6), np.ones(1), 3
        )
        for each in (corrected, counted)
    ]
    np.testing.assert_allclose(found[0].process, found[1].process, rtol=0.2)
    assert corrected.select_rows(slice(0, 900)).count_variance == pytest.approx(count**2 / 12)
    for one in (corrected, counted):
        assert not encoder_noise._find_breaks(t, one.values[:, 0]).any()


def test_encoder_noise_of_constant_joints_is_the_bodys():
    t = np.arange(0.0, 4.0, 0.02)
    values = np.stack([np.zeros_like(t), np.full_like(t, np.nan)], axis=1)
    given = np.array([1e-4, 1e-4]), np.array([0.2, 0.3])
    learned = encoder_noise.learn_encoder_noise(
        encoder_noise.average_joint_readings(Encoders(t, values, t.astype(np.int64))), *given
    )
    encoder, process = learned.encoder, learned.process
    # that all repeat one value is one error of it, not many
    np.testing.assert_allclose(encoder, given[0] * [t[-1] / quantisation.SHARED_ERROR_S, 1.0])
    np.testing.assert_array_equal(process, given[1])


@pytest.mark.parametrize("std", [0.003, 0.02])
def test_encoder_noise_is_learned_from_the_log(world, std):
    drawn = world(0, encoder_std=std)
    found = estimate_from_features(drawn.features, drawn.body, EstimationSettings())
    np.testing.assert_allclose(np.sqrt(found.settings["encoder"]), std, rtol=0.1)


def test_pixels_noisier_than_claimed_are_noticed(world):
    drawn = world(0, pixel_std=1.5)
    track = drawn.features.tracks["effector"]
    modest = replace(
        drawn.features, tracks={"effector": replace(track, std=np.full_like(track.values, 0.5))}
    )
    found = estimate_from_features(modest, drawn.body, EstimationSettings())
    assert 5.0 < found.settings["scale"]["effector"] < 14.0


def test_variances_of_body_and_paper_presets_are_used(world):
    drawn = world(0, duration=3.0)
    own = estimate_from_features(
        drawn.features, drawn.body, EstimationSettings(precision="model")
    ).settings
    assert own["encoder"] == pytest.approx([4e-4] * 3) and own["process"] == pytest.approx(
        [0.3] * 3
    )
    paper = estimate_from_features(
        drawn.features, drawn.body, EstimationSettings(precision="fixed")
    ).settings
    assert paper["encoder"] == [1.0] * 3


def test_process_variance_of_undetermined_joints_is_the_encoders(
    world, monkeypatch, white_acceleration
):
    monkeypatch.setattr(
        evidence_search, "find_least_error_process", lambda part, warned: (part.precision.process, 1.0)
    )
    blind = conftest.Linear(
        np.array([[300.0, 0.0, 0.0], [0.0, 250.0, 0.0]]), np.array([160.0, 120.0])
    )
    for seed in range(3):
        drawn = world(seed, model=blind, pixel_std=0.1)
        asked = (
            EstimationSettings(method="smoother"),
            EstimationSettings(without=("vision",)),
            EstimationSettings(),
        )
        beliefs = (
            estimate_from_features(drawn.features, drawn.body, settings) for settings in asked
        )
        together, alone, found = (np.array(belief.settings["process"]) for belief in beliefs)
        assert found[2] == pytest.approx(alone[2], rel=0.02)
        share = (found - together)[:2] / (alone - together)[:2]
        assert np.all(np.abs(share) < 0.1)


@pytest.mark.parametrize("method", ["filter", "smoother", "predictive-coding"])
@pytest.mark.parametrize(("count", "warned"), [(20, True), (40, False)])
def test_too_few_readings_to_learn_noise_from_give_a_warning(world, method, count, warned):
    drawn = world(0)
    joints, until = drawn.features.joints, drawn.features.joints.t[count - 1]
    few = replace(
        joints, t=joints.t[:count], values=joints.values[:count], source_ns=joints.source_ns[:count]
    )
    tracks = {name: _until(track, until) for name, track in drawn.features.tracks.items()}
    found = estimate_from_features(
        replace(drawn.features, joints=few, tracks=tracks),
        drawn.body,
        EstimationSettings(method=method),
    )
    warnings = [
        f.text
        for f in found.findings
        if f.severity == "warning" and "too few to learn their noise from" in f.text
    ]
    assert len(warnings) == warned and all(
        f"{name} {count}" in text for text in warnings for name in drawn.body.joints
    )


@pytest.mark.parametrize("method", ["filter", "smoother"])
@pytest.mark.parametrize("count", [20, 40])
def test_noise_far_above_the_bodys_is_learned_from_few_readings(world, method, count):
    found, raw, ratio = [], [], []
    for seed in range(6):
        drawn = world(seed, duration=2.0)
        body = replace(drawn.body, noise=replace(drawn.body.noise, encoder=(0.002**2,) * 3))
        joints = drawn.features.joints
        few = replace(
            joints,
            t=joints.t[:count],
            values=joints.values[:count],
            source_ns=joints.source_ns[:count],
        )
        tracks = {name: _until(track, few.t[-1]) for name, track in drawn.features.tracks.items()}
        estimated = estimate_from_features(
            replace(drawn.features, joints=few, tracks=tracks),
            body,
            EstimationSettings(method=method),
        )
        error = estimated.joints.values - drawn.truth.values[:count]
        columns = [joints.names.index(name) for name in body.joints]
        found.append(np.square(error).mean())
        raw.append(np.square(few.values[:, columns] - drawn.truth.values[:count]).mean())
        ratio.append((np.square(error) / np.einsum("nii->ni", estimated.cov)).mean())
        assert not any("--without" in finding.text for finding in estimated.findings)
    assert np.mean(found) < 0.5 * np.mean(raw)
    assert np.mean(ratio) < 3.0


def test_advice_on_few_readings_is_not_to_leave_out_vision(world):
    drawn = world(0, duration=0.3)
    body = replace(drawn.body, noise=replace(drawn.body.noise, encoder=(0.0002**2,) * 3))
    found = estimate_from_features(drawn.features, body, EstimationSettings(method="smoother"))
    (advice,) = [
        finding.text for finding in found.findings if "standard deviations" in finding.text
    ]
    assert "too few to learn their noise from" in advice and "without" not in advice


def _until(track, t):
    rows = track.t <= t
    std = None if track.std is None else track.std[rows]
    return replace(
        track, t=track.t[rows], values=track.values[rows], source_ns=track.source_ns[rows], std=std
    )


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("known", [None, 2e-4])
def test_evidence_is_that_of_a_kalman_filter(order, known):
    rng = np.random.default_rng(order)
    t = np.cumsum(rng.uniform(0.005, 0.02, 400))
    y = 0.1 * np.sin(t) + rng.normal(0.0, 0.01, 400)
    fresh = np.zeros(400, bool)
    fresh[[0, 150]] = True
    ratios = 10.0 ** np.arange(-1.0, 10.0)
    usual = 3e-4
    score, noise, _ = encoder_noise.compute_encoder_evidence(
        t, y, fresh, ratios, usual, order, known
    )
    dt = np.diff(t, prepend=t[0])
    left, vague = (
        np.arange(order)[::-1],
        np.diag(1e8 / np.median(dt[1:]) ** (2.0 * np.arange(order))),
    )
    for index, ratio in enumerate(ratios):
        squares = logs = count = 0.0
        since = -1
        x, p = np.zeros(order), vague
        for k in range(400):
            powers = dt[k] ** left / factorial(left)
            move = sum(np.eye(order, k=d) * powers[order - 1 - d] for d in range(order))
            grown = ratio * dt[k] * np.outer(powers, powers) / (np.add.outer(left, left) + 1.0)
            x, p, since = move @ x, move @ p @ move.T + grown, since + 1
            if fresh[k]:
                x, p, since = np.eye(order)[0] * y[k], vague, 0
            s, nu = p[0, 0] + 1.0, y[k] - x[0]
            if since >= encoder_noise.SKIPPED_READINGS:
                squares, logs, count = squares + nu * nu / s, logs + np.log(s), count + 1
            x, p = x + p[0] / s * nu, p - np.outer(p[0], p[0]) / s
        own = np.linspace(-1e-3, 1e-3, 3) + np.log(noise[index])
        nats = -0.5 * (
            count * own + squares * np.exp(-own) + logs + 0.5 * (own - np.log(usual)) ** 2
        )
        assert score[index] == pytest.approx(nats[1], abs=1e-3)
        assert known == pytest.approx(noise[index]) if known else nats.argmax() == 1


def test_joints_at_rest_have_the_least_process_variance():
    t, more = np.arange(0.0, 20.0, 0.01), []
    for seed in range(20):
        y = 0.3 + np.random.default_rng(seed).normal(0.0, 0.02, len(t))
        noise, process = likeliest(t, y)
        more.append(process > encoder_noise.compute_least_process(t, noise, 2))
    assert np.sum(more) <= 2  # with stretches of half the length 12 of them


@pytest.mark.parametrize("end", [2.0, 19.0])
def test_noise_is_tuned_on_readings_beside_images(world, monkeypatch, end):
    monkeypatch.setattr(evidence_search, "MAX_INSTANTS", 200)
    drawn = world(0, duration=20.0)
    track = drawn.features.tracks["effector"]
    features = replace(drawn.features, tracks={"effector": _until(track, end)})
    problem = filtering.build_filter_problem(features, drawn.body, EstimationSettings())
    part = evidence_search.cut_to_middle(problem)
    assert len(part.evidence.encoders.t) <= 200
    frames = part.evidence.sightings[0].t
    # no image is left out beside the readings that are kept
    kept = (track.t >= part.evidence.encoders.t[0]) & (
        track.t <= min(part.evidence.encoders.t[-1], end)
    )
    assert len(frames) >= kept.sum() > 10


@pytest.mark.parametrize("rows", [1, 5])
def test_averages_of_close_readings_carry_their_noise(world, rows):
    drawn = world(0, duration=6.0, encoder_hz=100.0 * rows)
    problem = filtering.build_filter_problem(drawn.features, drawn.body, EstimationSettings())
    few, all_of = (
        evidence_search.thin_encoder_readings(problem).evidence.encoders,
        problem.evidence.encoders,
    )
    assert len(few.t) == len(all_of.t) // rows
    if rows == 1:
        return
    np.testing.assert_allclose(few.relative_variance, 1.0 / rows)
    np.testing.assert_allclose(few.values[0], all_of.values[:rows].mean(axis=0))
    np.testing.assert_allclose(few.t[0], all_of.t[:rows].mean())


def _thinned(world, t, values):
    found = Encoders(t, values, (t * 1e9).astype(np.int64))
    drawn = world(0, duration=1.0)
    problem = filtering.build_filter_problem(drawn.features, drawn.body, EstimationSettings())
    return evidence_search.thin_encoder_readings(
        replace(problem, evidence=replace(problem.evidence, encoders=found))
    ).evidence.encoders


def test_a_missing_reading_does_not_keep_the_others_from_being_averaged(world):
    t = np.arange(0.0, 10.0, 0.002)
    values = np.stack([np.sin(t), np.cos(t), t], axis=1)
    whole = _thinned(world, t, values)
    assert len(whole.t) == 1000
    values[2501, 1] = np.nan
    one = _thinned(world, t, values)
    assert len(one.t) == 1000
    assert (np.diff(one.t) > 0.0).all()
    np.testing.assert_array_equal(one.relative_variance[np.isfinite(one.values)].min(), 0.2)
    np.testing.assert_allclose(one.values[:, 2], one.t, atol=1e-12)


def test_encoders_of_several_topics_are_averaged_apart(world):
    t = np.arange(0.0, 10.0, 0.001)
    values = np.stack([t, 2.0 * t, -t], axis=1)
    values[::2, 0], values[1::2, 1:] = np.nan, np.nan
    found = _thinned(world, t, values)
    assert len(found.t) == 2000
    assert np.isfinite(found.values).sum() == 3000
    np.testing.assert_allclose(
        found.values, np.where(np.isfinite(found.values), found.t[:, None] * [1, 2, -1], np.nan)
    )
