"""Joints under white acceleration that stay in view."""

import numpy as np


def white(t, rng, speed):
    """Angles (N,3) under white acceleration of 0.05 rad²/s³, about a bent arm it does not leave far behind."""
    order, fine = np.argsort(t, kind="stable"), 0.002
    grid = np.arange(0.0, t.max() + fine, fine)
    rates = np.cumsum(rng.normal(0.0, np.sqrt(0.05 * fine), (len(grid), 3)), axis=0)
    # a spring far slower than smoothing cuts off keeps it in view
    rate = np.zeros_like(rates)
    x = np.zeros_like(rates)
    for k in range(1, len(grid)):
        rate[k] = rate[k - 1] + rates[k] - rates[k - 1] - fine * (0.5 * rate[k - 1] + 0.3 * x[k - 1])
        x[k] = x[k - 1] + fine * rate[k]
    out = np.empty((len(t), 3))
    for j in range(3):
        out[order, j] = np.interp(t[order], grid, x[:, j])
    return np.array([-0.9, -0.9, 1.0]) + out
