"""One instant of encoder readings in plain floats, which is faster than numpy for few joints.

The same equations as `instant.Motion.move` and `instant.hear` without tracks; a state is a list z (K) and rows p (K,K).
"""

import math
from collections.abc import Sequence

from .conditioning import GATE

Rows = list[list[float]]
"""A covariance (K,K), row by row."""
_LOG = math.log(2.0 * math.pi)


def moved(
    z: Sequence[float], p: Rows, dt: float, process: Sequence[float], drift: Sequence[float]
) -> tuple[list[float], Rows]:  # fmt: skip
    """z (K) and p (K,K) after dt (s), with white acceleration process (M) and offset random walks drift (M or none)."""
    m = len(process)
    z = [a + dt * b for a, b in zip(z[:m], z[m:])] + list(z[m:])  # noqa: B905
    angles = [[a + dt * b for a, b in zip(*pair)] for pair in zip(p, p[m : 2 * m])]  # noqa: B905
    mirrored = zip(*[row[m:] for row in angles], strict=True)
    rest = [[*left, *row[m:]] for left, row in zip(mirrored, p[m:], strict=True)]
    rows = [[a + dt * b for a, b in zip(row[:m], row[m:])] + row[m:] for row in angles] + rest  # noqa: B905
    for i, q in enumerate(process):
        spread = q * dt
        half = 0.5 * dt * spread
        low, high = rows[i], rows[m + i]
        low[i] += dt * half * (2.0 / 3.0)
        low[m + i] += half
        high[i] += half
        high[m + i] += spread
    for i, walk in enumerate(drift, 2 * m):
        rows[i][i] += walk * dt
    return z, rows


def condition(
    z: list[float], p: Rows, readings: Sequence[float], var: Sequence[float]
) -> tuple[list[float], Rows, float, list[float]]:
    """z (K) and p (K,K) given encoder readings (M) rad, NaN where silent, of variances var (M); nats, innovations (M).

    Innovations are in standard deviations. The prior's gate makes the result independent of the order. ArithmeticError
    where a variance is not above 0.
    """
    m, offsets, nats = len(readings), len(z) > 2 * len(readings), 0.0
    d, noise = [math.nan] * m, list(var)
    for j, reading in enumerate(readings):
        if reading == reading:
            s, nu = p[j][j] + var[j], reading - z[j]
            if offsets:
                s, nu = s + p[2 * m + j][2 * m + j] + 2.0 * p[j][2 * m + j], nu - z[2 * m + j]
            d[j] = nu / math.sqrt(s) if s > 0.0 else math.inf
            if (over := d[j] * d[j] / (GATE * GATE)) > 1.0:
                noise[j] += s * (over * over - 1.0)
    for j, reading in enumerate(readings):
        if reading == reading:
            ph, nu = p[j], reading - z[j]
            if offsets:
                ph, nu = [a + b for a, b in zip(ph, p[2 * m + j], strict=True)], nu - z[2 * m + j]
            s = ph[j] + noise[j] + (ph[2 * m + j] if offsets else 0.0)
            if not s > 0.0:
                raise ArithmeticError(f"encoder {j + 1} has the predicted variance {s:.3g} rad²")
            weight = 1.0 / s
            pull = nu * weight
            z = [a + pull * b for a, b in zip(z, ph)]  # noqa: B905
            p = [[a - gain * b for a, b in zip(row, ph)] for row, gain in zip(p, [weight * b for b in ph])]  # noqa: B905
            nats += nu * pull + math.log(s) + _LOG
    return z, p, 0.5 * nats, d


def even(p: Rows) -> None:
    """Make p (K,K) symmetric, in place, before rounding errors grow."""
    for i, row in enumerate(p):
        for k in range(i):
            row[k] = p[k][i] = 0.5 * (row[k] + p[k][i])
