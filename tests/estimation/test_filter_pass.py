"""The compiled filter and its backward passes, against full matrices, one instant after the other."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag, expm

from bodylog.estimation.inference import solution
from bodylog.estimation.inference.filter_pass import (
    FLAT_COST_NATS,
    GATE_SIGMA,
    FilterDynamics,
    FilterReadings,
    TraceDetail,
    filter_readings,
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


def moved(readings, dynamics, i):
    dt = readings.dt[i]
    more = np.ones(JOINTS) if readings.process_factor is None else readings.process_factor[i]
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


def measured(readings, dynamics, i, z, p):
    """Rows h, readings and gated noise of all that is read at an instant, and the cost of outliers."""
    h, y, noise, cost, m = [], [], [], 0.0, JOINTS
    rows = np.eye(m, len(z)) + (0.0 if dynamics.drift is None else np.eye(m, len(z), dynamics.order * m))
    for j, reading in enumerate(readings.encoders[i]):
        if np.isfinite(reading):
            own, var = rows[j : j + 1], readings.encoder_var[i, j : j + 1]
            prior = dynamics.is_prior is not None and dynamics.is_prior[j]
            var, more = (var, 0.0) if prior else inflated(reading - own @ z, own @ p @ own.T, var)
            h, y, noise, cost = [*h, own], [*y, [reading]], [*noise, var], cost + more
    for seen, jac, var in zip(readings.y[i], readings.jac[i], readings.var[i], strict=True):
        present = np.isfinite(seen)
        if present.any():
            own = np.pad(jac[present], ((0, 0), (0, len(z) - m)))
            var, more = inflated(seen[present] - own @ z, own @ p @ own.T, var[present])
            h, y, noise, cost = [*h, own], [*y, seen[present]], [*noise, var], cost + more
    return (np.concatenate(part) if part else np.zeros(0) for part in (h, y, noise)), cost


def filtered(readings, dynamics, z, p):
    """Means, covariances, predicted covariances, moves and nats."""
    found, z, p = [], z.copy(), p.copy()
    for i in range(len(readings.dt)):
        move, noise = moved(readings, dynamics, i)
        before, z, p = z, move @ z, move @ p @ move.T + noise
        for j in () if readings.reset is None else np.flatnonzero(readings.reset[i]):
            states, reading = [state * JOINTS + j for state in range(dynamics.order)], readings.encoders[i, j]
            z[states], p[states], p[:, states], move[states] = 0.0, 0.0, 0.0, 0.0
            p[states, states] = np.square(START_STD[: dynamics.order])
            offset = 0.0 if dynamics.drift is None else z[dynamics.order * JOINTS + j]
            z[j] = reading - offset if np.isfinite(reading) else before[j]
        prior = z.copy(), p.copy()
        (h, y, var), nats = measured(readings, dynamics, i, z, p)
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


CASES = [(order, drift, tracks) for order in (2, 3) for drift in (False, True) for tracks in (0, 1, 2)]


@pytest.fixture(params=CASES, ids=str)
def drawn(request, monkeypatch):
    """Readings, some absent, some wrong, over several blocks: (readings, dynamics, z, p)."""
    monkeypatch.setattr("bodylog.estimation.inference.filter_pass.BLOCK_INSTANTS", 16)
    order, drift, tracks = request.param
    rng, length, rows = np.random.default_rng(order + 10 * tracks + drift), 150, 2 + tracks % 2
    walk = np.array([1e-4, 0.0, 1e-5]) if drift else None
    dynamics = FilterDynamics(rng.uniform(0.1, 1.0, JOINTS), walk, motion=WHITE_MOTIONS[order])
    y = rng.normal(0.0, 0.1, (length, tracks, rows))
    y[rng.random((*y.shape[:2], 1)).repeat(rows, axis=2) < 0.6] = np.nan
    encoders = rng.normal(0.0, 0.1, (length, JOINTS))
    encoders[rng.random(encoders.shape) < 0.3] = np.nan
    encoders[rng.random(encoders.shape) < 0.03] += 4.0
    y[rng.random(y.shape) < 0.02] += 5.0
    readings = FilterReadings(
        rng.uniform(0.001, 0.05, length), encoders, rng.uniform(1e-3, 1e-2, encoders.shape), y,
        rng.normal(0.0, 1.0, (length, tracks, rows, JOINTS)), rng.uniform(0.01, 0.1, y.shape),
    )  # fmt: skip
    root = rng.normal(0.0, 0.3, (dynamics.size, dynamics.size))
    p = root @ root.T + 0.01 * np.eye(dynamics.size)
    return readings, dynamics, rng.normal(0.0, 0.1, dynamics.size), p


def compared(readings, dynamics, z, p):
    trace = filter_readings(readings, dynamics, z, p, TraceDetail.COVARIANCES)
    prior, prior_p, mean, cov, _, nats = filtered(readings, dynamics, z, p)
    np.testing.assert_allclose(trace.prior, prior[:, :JOINTS], atol=1e-9)
    np.testing.assert_allclose(trace.prior_cov, prior_p[:, :JOINTS, :JOINTS], atol=1e-9)
    np.testing.assert_allclose(trace.z, mean, atol=1e-9)
    np.testing.assert_allclose(trace.p, cov, atol=1e-9)
    if dynamics.is_prior is None:  # its readings do not count
        np.testing.assert_allclose(trace.nats, nats, rtol=1e-8, atol=1e-8)
    outputs = np.r_[:JOINTS, dynamics.order * JOINTS : dynamics.size]
    np.testing.assert_allclose(trace.cov, cov[:, outputs][:, :, outputs], atol=1e-9)
    np.testing.assert_allclose(trace.end_p, cov[-1], atol=1e-9)


def changed(readings):
    """The readings with process noise that changes, and joints that restart."""
    rng, shape = np.random.default_rng(1), readings.encoders.shape
    return replace(readings, process_factor=rng.uniform(0.5, 2.0, shape), reset=rng.random(shape) < 0.03)


def test_scan_is_the_kalman_filter_with_a_gate(drawn):
    compared(*drawn)


def test_scan_knows_changing_noise_and_restarts(drawn):
    readings, dynamics, z, p = drawn
    compared(changed(readings), replace(dynamics, is_prior=np.array([False, True, False])), z, p)


@pytest.mark.parametrize("alter", [lambda readings: readings, changed], ids=["plain", "restarts"])
def test_backward_passes_are_rauch_tung_striebels(drawn, alter):
    readings, dynamics, z, p = drawn
    readings = alter(readings)
    x, spread = smoothed(*filtered(readings, dynamics, z, p)[:5])
    whole = filter_readings(readings, dynamics, z, p, TraceDetail.COVARIANCES)
    found, _ = solution.smooth_states(readings, whole, dynamics)
    np.testing.assert_allclose(found, x, atol=1e-7)
    # with what is kept of a log of any length
    trace = filter_readings(readings, dynamics, z, p, TraceDetail.MEANS)
    outputs = np.r_[:JOINTS, dynamics.order * JOINTS : dynamics.size]
    np.testing.assert_allclose(solution.smooth_states(readings, trace, dynamics)[0], found[:, outputs], atol=1e-12)
    states, cov = solution.smooth_with_covariances(readings, trace, dynamics)
    rows = np.eye(JOINTS, dynamics.size)
    if dynamics.drift is not None:
        rows = np.concatenate([rows, rows + np.eye(JOINTS, dynamics.size, dynamics.order * JOINTS)])
    np.testing.assert_allclose(states, x, atol=1e-7)
    np.testing.assert_allclose(cov, rows @ spread @ rows.T, atol=1e-8)


def test_a_trace_is_overwritten(drawn):
    readings, dynamics, z, p = drawn
    trace = filter_readings(readings, dynamics, z + 0.3, 2.0 * p, TraceDetail.MEANS)
    again = filter_readings(readings, dynamics, z, p, TraceDetail.MEANS, trace)
    fresh = filter_readings(readings, dynamics, z, p, TraceDetail.MEANS)
    assert again is trace
    for name in ("prior", "prior_cov", "z", "cov", "end_p", "nats", "encoder_d", "p", "information", "marks"):
        np.testing.assert_array_equal(getattr(again, name), getattr(fresh, name))
