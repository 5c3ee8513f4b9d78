"""The compiled filter and its backward pass, against full matrices, one instant after the other."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag, expm

from bodylog.estimation.inference import solution
from bodylog.estimation.inference.scan import (
    FLAT_COST_NATS,
    GATE_SIGMA,
    FilterDynamics,
    FilterReadings,
    TraceDetail,
    filter_stretches,
    restart_filter,
)
from bodylog.motion import START_STD
from tests.estimation.conftest import WHITE_MOTIONS

JOINTS = 3


def discretised(dynamics, dt, more, j):
    """Move and noise of one joint within dt, by Van Loan's matrix exponential."""
    order = dynamics.order
    a, q = np.eye(order, k=1), np.zeros((order, order))
    q[-1, -1] = dynamics.process[j] * more
    whole = expm(np.block([[-a, q], [np.zeros_like(a), a.T]]) * dt)
    move = whole[order:, order:].T
    return move, move @ whole[:order, order:]


def of_all(dynamics, parts, offsets):
    """Matrices (O,O) of each joint as one of the state, which holds all angles first."""
    order, m = dynamics.order, JOINTS
    place = [state * m + j for j in range(m) for state in range(order)]
    found = np.zeros((dynamics.size, dynamics.size))
    found[np.ix_(place, place)] = block_diag(*parts)
    if dynamics.drift is not None:
        found[order * m :, order * m :] = offsets
    return found


def moved(readings, dynamics, i, c):
    dt = readings.dt[i, c]
    more = np.ones(JOINTS) if readings.process_factor is None else readings.process_factor[i, :, c]
    moves, noises = zip(*(discretised(dynamics, dt, more[j], j) for j in range(JOINTS)), strict=True)
    walk = None if dynamics.drift is None else np.diag(dynamics.drift * dt)
    return of_all(dynamics, moves, np.eye(JOINTS)), of_all(dynamics, noises, walk)


def inflated(nu, s, noise):
    """Gated noise and the outlier's cost, for the innovation nu of noise-free covariance s."""
    total = s + np.diag(noise)
    over = nu @ np.linalg.solve(total, nu) / GATE_SIGMA**2
    if over <= 1.0:
        return noise, 0.0
    noise = noise + np.diag(total) * (over**2 - 1.0)
    wide = s + np.diag(noise)
    square, logs = nu @ np.linalg.solve(wide, nu), np.linalg.slogdet(wide)[1] - np.linalg.slogdet(total)[1]
    return noise, 0.5 * GATE_SIGMA**2 + FLAT_COST_NATS * (1.0 - 1.0 / over) - 0.5 * square - 0.5 * logs


def measured(readings, dynamics, i, c, z, p):
    """Rows h, readings and gated noise of all that is read at an instant, and the cost of outliers."""
    h, y, noise, cost, m = [], [], [], 0.0, JOINTS
    rows = np.eye(m, len(z)) + (0.0 if dynamics.drift is None else np.eye(m, len(z), dynamics.order * m))
    for j, reading in enumerate(readings.encoders[i, :, c]):
        if np.isfinite(reading):
            own, var = rows[j : j + 1], readings.encoder_var[i, j : j + 1, c]
            prior = dynamics.is_prior is not None and dynamics.is_prior[j]
            var, more = (var, 0.0) if prior else inflated(reading - own @ z, own @ p @ own.T, var)
            h, y, noise, cost = [*h, own], [*y, [reading]], [*noise, var], cost + more
    for seen, jac, var in zip(readings.y[i, ..., c], readings.jac[i, ..., c], readings.var[i, ..., c], strict=True):
        present = np.isfinite(seen)
        if present.any():
            own = np.pad(jac[present], ((0, 0), (0, len(z) - m)))
            var, more = inflated(seen[present] - own @ z, own @ p @ own.T, var[present])
            h, y, noise, cost = [*h, own], [*y, seen[present]], [*noise, var], cost + more
    return (np.concatenate(part) if part else np.zeros(0) for part in (h, y, noise)), cost


def filtered(readings, dynamics, z, p, c):
    """Means, covariances, predicted covariances, moves and nats of one stretch."""
    found, z, p = [], z[:, c].copy(), p[:, :, c].copy()
    for i in range(len(readings.dt)):
        move, noise = moved(readings, dynamics, i, c)
        before, z, p = z, move @ z, move @ p @ move.T + noise
        for j in () if readings.reset is None else np.flatnonzero(readings.reset[i, :, c]):
            states, reading = [state * JOINTS + j for state in range(dynamics.order)], readings.encoders[i, j, c]
            z[states], p[states], p[:, states], move[states] = 0.0, 0.0, 0.0, 0.0
            p[states, states] = np.square(START_STD[: dynamics.order])
            offset = 0.0 if dynamics.drift is None else z[dynamics.order * JOINTS + j]
            z[j] = reading - offset if np.isfinite(reading) else before[j]
        prior = z.copy(), p.copy()
        (h, y, var), nats = measured(readings, dynamics, i, c, z, p)
        if len(y):
            s, nu = h @ p @ h.T + np.diag(var), y - h @ z
            nats += 0.5 * (nu @ np.linalg.solve(s, nu) + np.linalg.slogdet(2.0 * np.pi * s)[1])
            gain = np.linalg.solve(s, h @ p).T
            z, p = z + gain @ nu, p - gain @ s @ gain.T
        found.append((*prior, z, p, move, nats))
    return [np.stack(part) for part in zip(*found, strict=True)]


def smoothed(prior, prior_p, z, p, move):
    """Rauch, Tung and Striebel's backward pass."""
    x, cov = [z[-1]], [p[-1]]
    for k in range(len(z) - 2, -1, -1):
        gain = np.linalg.solve(prior_p[k + 1], move[k + 1] @ p[k]).T
        x.append(z[k] + gain @ (x[-1] - prior[k + 1]))
        cov.append(p[k] + gain @ (cov[-1] - prior_p[k + 1]) @ gain.T)
    return np.stack(x[::-1]), np.stack(cov[::-1])


CASES = [(order, drift, tracks, count) for order in (2, 3) for drift in (False, True)
         for tracks, count in ((0, 1), (1, 8), (2, 11))]  # fmt: skip


@pytest.fixture(params=CASES, ids=str)
def drawn(request, monkeypatch):
    """Irregular stretches of readings, some absent, some wrong, over several blocks: (readings, dynamics, z, p)."""
    for module in ("scan", "solution"):
        monkeypatch.setattr(f"bodylog.estimation.inference.{module}.BLOCK_INSTANTS", 16)
    order, drift, tracks, c = request.param
    rng, length, rows = np.random.default_rng(order + 10 * tracks + drift), 40, 2 + tracks % 2
    walk = np.array([1e-4, 0.0, 1e-5]) if drift else None
    dynamics = FilterDynamics(rng.uniform(0.1, 1.0, JOINTS), walk, motion=WHITE_MOTIONS[order])
    y = rng.normal(0.0, 0.1, (length, tracks, rows, c))
    y[rng.random((*y.shape[:2], 1, c)).repeat(rows, axis=2) < 0.6] = np.nan
    encoders = rng.normal(0.0, 0.1, (length, JOINTS, c))
    encoders[rng.random(encoders.shape) < 0.3] = np.nan
    encoders[rng.random(encoders.shape) < 0.03] += 4.0
    y[rng.random(y.shape) < 0.02] += 5.0
    readings = FilterReadings(
        rng.uniform(0.001, 0.05, (length, c)), encoders, rng.uniform(1e-3, 1e-2, encoders.shape), y,
        rng.normal(0.0, 1.0, (length, tracks, rows, JOINTS, c)), rng.uniform(0.01, 0.1, y.shape),
    )  # fmt: skip
    root = rng.normal(0.0, 0.3, (dynamics.size, dynamics.size, c))
    p = np.einsum("abc,dbc->adc", root, root) + 0.01 * np.eye(dynamics.size)[..., None]
    return readings, dynamics, rng.normal(0.0, 0.1, (dynamics.size, c)), p


def compared(readings, dynamics, z, p):
    trace = filter_stretches(readings, dynamics, z, p, TraceDetail.COVARIANCES)
    for c in range(z.shape[1]):
        prior, prior_p, mean, cov, _, nats = filtered(readings, dynamics, z, p, c)
        np.testing.assert_allclose(trace.prior[..., c], prior[:, :JOINTS], atol=1e-9)
        np.testing.assert_allclose(trace.prior_cov[..., c], prior_p[:, :JOINTS, :JOINTS], atol=1e-9)
        np.testing.assert_allclose(trace.z[..., c], mean, atol=1e-9)
        np.testing.assert_allclose(trace.p[..., c], cov, atol=1e-9)
        if dynamics.is_prior is None:  # its readings do not count
            np.testing.assert_allclose(trace.nats[:, c], nats, rtol=1e-8, atol=1e-8)
        outputs = np.r_[:JOINTS, dynamics.order * JOINTS : dynamics.size]
        np.testing.assert_allclose(trace.cov[..., c], cov[:, outputs][:, :, outputs], atol=1e-9)
        np.testing.assert_allclose(trace.end_p[..., c], cov[-1], atol=1e-9)
    return trace


def test_scan_is_the_kalman_filter_with_a_gate(drawn):
    compared(*drawn)


def test_scan_knows_changing_noise_and_restarts(drawn):
    readings, dynamics, z, p = drawn
    rng, shape = np.random.default_rng(1), readings.encoders.shape
    changed = replace(readings, process_factor=rng.uniform(0.5, 2.0, shape), reset=rng.random(shape) < 0.03)
    compared(changed, replace(dynamics, is_prior=np.array([False, True, False])), z, p)


def test_backward_pass_is_rauch_tung_striebels(drawn):
    readings, dynamics, z, p = drawn
    trace, c = filter_stretches(readings, dynamics, z, p, TraceDetail.COVARIANCES), z.shape[1]
    ends = np.zeros_like(z)
    found, _ = solution.smooth_states(readings, trace, ends, dynamics)
    outputs = np.r_[:JOINTS, dynamics.order * JOINTS : dynamics.size]
    means, _ = solution.smooth_states(readings, filter_stretches(readings, dynamics, z, p, TraceDetail.MEANS), ends, dynamics)
    np.testing.assert_allclose(means, found[:, outputs], atol=1e-12)
    # each stretch alone: nothing follows it
    alone = [replace(readings, **{name: np.ascontiguousarray(getattr(readings, name)[..., k : k + 1])
                                  for name in ("dt", "encoders", "encoder_var", "y", "jac", "var")})
             for k in range(c)]  # fmt: skip
    rows = np.eye(JOINTS, dynamics.size)
    if dynamics.drift is not None:
        rows = np.concatenate([rows, rows + np.eye(JOINTS, dynamics.size, dynamics.order * JOINTS)])
    for k, own in enumerate(alone):
        prior, prior_p, mean, cov, move, _ = filtered(readings, dynamics, z, p, k)
        x, spread = smoothed(prior, prior_p, mean, cov, move)
        np.testing.assert_allclose(found[..., k], x, atol=1e-7)
        single = filter_stretches(own, dynamics, z[:, k : k + 1], p[..., k : k + 1], TraceDetail.MEANS)
        all_states, ours = solution.smooth_with_covariances(own, single, ends[:, :1], dynamics)
        np.testing.assert_allclose(all_states[..., 0], x, atol=1e-7)
        np.testing.assert_allclose(ours[..., 0], rows @ spread @ rows.T, atol=1e-8)


def test_stretches_that_follow_each_other_are_one(drawn):
    readings, dynamics, z, p = drawn
    c, names = z.shape[1], ("dt", "encoders", "encoder_var", "y", "jac", "var")
    whole = replace(readings, **{name: np.ascontiguousarray(np.concatenate(
        [getattr(readings, name)[..., k : k + 1] for k in range(c)])) for name in names})  # fmt: skip
    one = filter_stretches(whole, dynamics, z[:, :1], p[..., :1], TraceDetail.COVARIANCES)
    length = len(readings.dt)
    for k in range(1, c):
        z[:, k], p[..., k] = one.z[k * length - 1, :, 0], one.p[k * length - 1, ..., 0]
    trace, ends = filter_stretches(readings, dynamics, z, p, TraceDetail.MEANS), np.zeros_like(z)
    for _ in range(c):
        _, start = solution.smooth_states(readings, trace, ends, dynamics)
        ends = solution.hand_back_adjoints(start)
    x, cov = solution.smooth_with_covariances(readings, trace, ends, dynamics)
    one = filter_stretches(whole, dynamics, z[:, :1], p[..., :1], TraceDetail.MEANS)
    expected, expected_cov = solution.smooth_with_covariances(whole, one, np.zeros((dynamics.size, 1)), dynamics)
    np.testing.assert_allclose(np.concatenate(np.moveaxis(x, -1, 0)), expected[..., 0], atol=1e-9)
    np.testing.assert_allclose(np.concatenate(np.moveaxis(cov, -1, 0)), expected_cov[..., 0], atol=1e-9)


def test_restart_filters_until_the_start_is_forgotten(drawn):
    readings, dynamics, z, p = drawn
    fresh, trace = (filter_stretches(readings, dynamics, *start, TraceDetail.MEANS) for start in ((z, p), (z + 0.3, 2.0 * p)))
    restart_filter(readings, dynamics, z, p, trace)
    for name in ("prior", "prior_cov", "z", "cov", "end_p", "nats", "encoder_d", "p", "information"):
        np.testing.assert_array_equal(getattr(trace, name), getattr(fresh, name))
    second = fresh.blocks[1]
    trace.z[second], trace.end_p[:] = 0.0, 0.0
    restart_filter(readings, dynamics, z, p, trace)  # the first block ends as before
    assert not trace.z[second].any() and not trace.end_p.any()


def test_candidates_stand_side_by_side(drawn):
    readings, dynamics, z, p = drawn
    c, factors = z.shape[1], np.array([1.0, 3.0])
    processes = np.tile(dynamics.process[:, None] * factors, c)
    var = np.ascontiguousarray((readings.var[..., None] * factors).reshape(*readings.var.shape[:-1], 2 * c))
    both = np.repeat(z, 2, axis=-1), np.repeat(p, 2, axis=-1)
    together = filter_stretches(replace(readings, var=var), replace(dynamics, process=processes), *both)
    first = filter_stretches(replace(readings, var=var), replace(dynamics, process=processes), *both, every=2)
    np.testing.assert_array_equal(first.nats, together.nats)
    for k, factor in enumerate(factors):
        own = replace(dynamics, process=dynamics.process * factor)
        alone = filter_stretches(replace(readings, var=np.ascontiguousarray(var[..., k::2])), own, z, p)
        for name in ("prior", "prior_cov", "z", "cov", "end_p", "nats", "encoder_d"):
            np.testing.assert_array_equal(getattr(together, name)[..., k::2], getattr(alone, name))
            if k == 0 and name != "nats":
                np.testing.assert_array_equal(getattr(first, name), getattr(alone, name))
