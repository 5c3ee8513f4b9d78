"""Pooled readings against the same readings used one by one."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.estimation import estimate
from bodylog.estimation.inference import knot_problem as knot_problem
from bodylog.estimation.inference import pooling
from bodylog.estimation.inference.filter_records import Dynamics, KnotReadings, Readings
from bodylog.estimation.inference.folds import Fold
from bodylog.estimation.inference.scan import scan
from bodylog.settings import Estimation
from tests.seeds import seeds


def single(t, readings, var, lines):
    """All instants in one stretch."""
    y, jac, noise = lines
    dt = np.diff(t, prepend=t[0])
    return Readings(*(np.ascontiguousarray(part[..., None]) for part in (dt, readings, var, y, jac, noise)))


CASES = [(seed, drift, order) for seed in range(3) for drift in (False, True) for order in (2, 3)]


@pytest.fixture(params=CASES)
def irregular(request):
    """Irregular times, joints silent now and then, pictures at some: (t, readings, var, lines, pictures, dynamics)."""
    seed, drift, order = request.param
    rng, count, m = np.random.default_rng(seed), 120, 3
    t = np.cumsum(rng.uniform(0.0005, 0.02, count))
    readings = 0.02 * rng.standard_normal((count, m)) + np.sin(t)[:, None]
    readings[rng.random((count, m)) < 0.2] = np.nan
    readings[40:60, 1] = np.nan
    pictures = np.sort(rng.choice(count, 25, replace=False))
    y, jac, noise = np.full((count, 1, 2), np.nan), np.zeros((count, 1, 2, m)), np.ones((count, 1, 2))
    jac[pictures] = rng.normal(0, 100, (25, 1, 2, m))
    y[pictures] = np.einsum("ftdm,m->ftd", jac[pictures], np.ones(m)) * np.sin(t[pictures])[:, None, None]
    readings[pictures[:12]] = np.nan
    var = np.where(np.arange(count)[:, None] % 7 == 0, 4e-3, 1e-3) * np.ones(m)
    walk = np.array([1e-4, 0.0, 1e-5]) if drift else None
    return t, readings, var, (y, jac, noise), pictures, Dynamics(np.array([0.3, 0.1, 0.5]), walk, order=order)


def test_scan_of_blocks_equals_scan_of_their_readings(irregular):
    t, readings, var, lines, pictures, dynamics = irregular
    k = dynamics.size
    z, p = np.zeros((k, 1)), 0.5 * np.eye(k)[:, :, None]
    one_by_one = scan(single(t, readings, var, lines), dynamics, z, p)
    wanted = np.zeros(len(t), bool)
    wanted[pictures] = True
    events = pooling.kept(wanted)
    fold = Fold(len(events), len(events), 1)
    between = pooling.pooled(pooling.blocks(t, readings, var, events, wanted), dynamics, fold)
    few = single(
        t[events], np.where(wanted[:, None], readings, np.nan)[events], var[events], [p[events] for p in lines]
    )
    few_readings = KnotReadings(few.dt, few.encoders, few.encoder_var, few.y, few.jac, few.var, between)
    assert np.nanmax(np.abs(one_by_one.encoder_d)) < 5.0  # else the gate would close
    together = scan(few_readings, dynamics, z, p)
    np.testing.assert_allclose(together.z[..., 0], one_by_one.z[events, :, 0], atol=1e-10, rtol=0)
    np.testing.assert_allclose(together.p[..., 0], one_by_one.p[events, :, :, 0], atol=1e-10, rtol=0)
    seen = wanted[events]
    before, expected = together.prior_cov[seen, ..., 0], one_by_one.prior_cov[events[seen], ..., 0]
    np.testing.assert_allclose(before, expected, atol=1e-10, rtol=0)
    np.testing.assert_allclose(np.cumsum(together.nats), np.cumsum(one_by_one.nats)[events], atol=1e-8, rtol=1e-11)


def test_blocks_move_as_many_times_as_much_as_their_instants(irregular):
    t, readings, var, lines, pictures, dynamics = irregular
    wanted = np.zeros(len(t), bool)
    wanted[pictures] = True
    events = pooling.kept(wanted)
    # as many times between two pictures, one of which ends each block
    more = np.exp(np.random.default_rng(1).normal(0, 1, (len(t), 3)))[np.searchsorted(pictures, np.arange(len(t)))]
    z, p = np.zeros((dynamics.size, 1)), 0.5 * np.eye(dynamics.size)[:, :, None]
    one_by_one = scan(replace(single(t, readings, var, lines), more=more[..., None]), dynamics, z, p)
    fold = Fold(len(events), len(events), 1)
    between = pooling.pooled(pooling.blocks(t, readings, var, events, wanted), dynamics, fold, more[events])
    few = single(
        t[events], np.where(wanted[:, None], readings, np.nan)[events], var[events], [p[events] for p in lines]
    )
    together = scan(
        KnotReadings(few.dt, few.encoders, few.encoder_var, few.y, few.jac, few.var, between), dynamics, z, p
    )
    np.testing.assert_allclose(together.z[..., 0], one_by_one.z[events, :, 0], atol=1e-10, rtol=0)
    np.testing.assert_allclose(together.p[..., 0], one_by_one.p[events, :, :, 0], atol=1e-10, rtol=0)


def test_candidates_lie_side_by_side(irregular):
    t, readings, var, _, pictures, dynamics = irregular
    wanted = np.zeros(len(t), bool)
    wanted[pictures] = True
    events = pooling.kept(wanted)
    few_readings, fold = pooling.blocks(t, readings, var, events, wanted), Fold(len(events), 20, -(-len(events) // 20))
    both = np.array([[0.3, 0.4], [0.1, 0.1], [0.5, 0.2]])
    together = pooling.pooled(few_readings, replace(dynamics, process=both), fold)
    for index, process in enumerate(both.T):
        alone = pooling.pooled(few_readings, replace(dynamics, process=process), fold)
        for name in ("y", "var", "lean", "move", "shift", "noise", "nats"):
            np.testing.assert_array_equal(getattr(together, name)[..., index::2], getattr(alone, name))


@pytest.mark.parametrize("method", ["laplace", "smoother", "ekf"])
@pytest.mark.parametrize("seed", seeds(1, 2))
def test_pooling_changes_nothing(world, monkeypatch, method, seed):
    drawn = world(seed, duration=4.0, encoder_hz=500.0, camera_hz=30.0, blunder=0.05)
    joints, rng = drawn.features.joints, np.random.default_rng(seed)
    values, t = joints.values.copy(), joints.t + rng.uniform(0, 0.0015, len(joints.t))
    values[::17, 1] = np.nan
    values[500:620, 0] = np.nan
    values[300::400, 2] += 0.4  # spikes
    values[900:1100, 0] += 0.3  # a lie the gate holds off
    features = replace(drawn.features, joints=replace(joints, t=t, values=values))
    settings = Estimation(method=method, precision="model", bias="off")
    pooled = estimate(features, drawn.body, settings)
    monkeypatch.setattr(pooling, "MOST", 0)
    monkeypatch.setattr(knot_problem, "kept", lambda wanted: np.arange(len(wanted)))
    single = estimate(features, drawn.body, settings)
    assert np.nanmax(np.abs(single.errors["encoders"].values)) > 5.0
    np.testing.assert_allclose(pooled.joints.values, single.joints.values, atol=1e-8, rtol=0)
    np.testing.assert_allclose(pooled.cov, single.cov, atol=1e-10, rtol=0)
    np.testing.assert_allclose(pooled.free_energy, single.free_energy, atol=1e-5, rtol=0)
    for sense in ("encoders", "effector"):
        np.testing.assert_allclose(pooled.errors[sense].values, single.errors[sense].values, atol=3e-6, rtol=0)


def test_pooling_excludes_a_spike_and_keeps_the_maximum():
    rng = np.random.default_rng(0)
    readings = np.sin(np.arange(400) / 50)[:, None] + rng.normal(0, 0.01, (400, 1))
    readings[123] += 0.1
    assert pooling.outlier_candidates(readings)[123] and pooling.outlier_candidates(readings).mean() < 0.05
    events = pooling.kept(pooling.outlier_candidates(readings))
    assert 123 in events and events[-1] == 399
    assert np.diff(events).max() <= pooling.MOST + 1
