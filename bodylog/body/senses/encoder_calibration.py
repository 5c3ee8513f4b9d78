"""Encoder functions from a reference: one polynomial
for each joint of readings over true angles.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ...body_model import ForwardModel, Noise
from ...errors import ConfigError, EvidenceError
from ...types import Array, Features, Finding, Score
from ..data.pairs import SmoothedJoint
from .encoder_function import Polynomial

_DEGREE = 6
_BLOCKS = 10
_FEWEST = 200
_STILL = 1e-3
_RIDGE = 1e-12
"""Of the mean information: 1e4 times what rounding leaves of it."""


@dataclass(frozen=True, eq=False)
class CalibratedEncoders:
    """Encoders calibrated by a reference: their model
    by sense name, noise with theirs, scores, remarks.
    """

    noise: Noise
    model: Mapping[str, ForwardModel] = field(default_factory=dict)
    scores: tuple[Score, ...] = ()
    findings: tuple[Finding, ...] = ()


def learn_encoder_functions(
    features: Sequence[Features], chosen: Sequence[SmoothedJoint], noise: Noise
) -> CalibratedEncoders:
    """Learn the encoder functions of the chosen joints
    from the references; nothing without a reference.

    ConfigError for a missing encoder. Without a model if all encoders read the angles themselves.
    """
    if not any(found.reference is not None for found in features):
        return CalibratedEncoders(noise)
    curves, errors, counts = zip(
        *(_fit_polynomial(*_readings_over_truth(features, joint)) for joint in chosen), strict=True
    )
    variance = [max(float(error), 1e-12) for error in errors]
    sure = tuple(v * (2.0 / n) ** 0.5 for v, n in zip(variance, counts, strict=True))
    read = replace(noise, encoder=tuple(variance), std_error={**noise.std_error, "encoder": sure})
    names = tuple(joint.name for joint in chosen)
    scores = tuple(
        Score(f"rmse/held_out_encoders/{n}", v**0.5, "rad")
        for n, v in zip(names, variance, strict=True)
    )
    formulas = ", ".join(f"{n} {_polynomial_text(c)}" for n, c in zip(names, curves, strict=True))
    if all(curve.tolist() == [0.0, 1.0] for curve in curves):
        return CalibratedEncoders(
            read,
            {},
            scores,
            (Finding("info", "encoders: by the reference they read the angles themselves"),),
        )
    width = max(len(curve) for curve in curves)
    model = Polynomial(
        names, np.array([np.pad(curve, (0, width - len(curve))) for curve in curves])
    )
    finding = Finding("info", f"encoders: by the reference they read {formulas}")
    return CalibratedEncoders(read, {"encoders": model}, scores, (finding,))


def _readings_over_truth(
    features: Sequence[Features], joint: SmoothedJoint
) -> tuple[Array, Array, Array]:
    """True angles (N,) rad, readings (N,) and blocks of time (N,) of one joint over all logs."""
    parts = []
    for log, found in enumerate(features):
        names = () if found.joints is None else found.joints.names
        if found.joints is None or joint.name not in names:
            have = ", ".join(names)
            raise ConfigError(
                f"[topics] reference: its joint {joint.name!r} has no encoder; possible: {have}"
            )
        x = joint.angles[log].at(found.joints.t)[0]
        y = found.joints.values[:, names.index(joint.name)]
        sound = np.isfinite(x) & np.isfinite(y)
        block = np.arange(sound.sum()) * _BLOCKS // max(int(sound.sum()), 1)
        parts.append((x[sound], y[sound], block + log * _BLOCKS))
    x, y, block = (np.concatenate(column) for column in zip(*parts, strict=True))
    if len(x) < _FEWEST:
        raise EvidenceError(
            f"{joint.name}: {len(x)} readings during the reference, at least {_FEWEST} are needed"
        )
    return x, y, block


def _fit_polynomial(x: Array, y: Array, block: Array) -> tuple[Array, float, int]:
    """Coefficients (K,) of the simplest polynomial near the
    best held-out error, that squared error, and the readings.

    The angle itself is the simplest. Sums over each block suffice to fit every degree without it.
    """
    from numpy.polynomial import Chebyshev
    from numpy.polynomial import Polynomial as Power

    low = float(x.min())
    high = float(x.max())
    base = np.polynomial.chebyshev.chebvander((2 * x - low - high) / (high - low), _DEGREE)
    rows = [block == b for b in np.unique(block)]
    gram = np.array([base[r].T @ base[r] for r in rows])
    moment = np.array([base[r].T @ y[r] for r in rows])
    count = np.array([r.sum() for r in rows])
    errors = [np.array([np.square(y[r] - x[r]).sum() for r in rows]) / count]
    for k in range(2, _DEGREE + 2):
        g = gram[:, :k, :k]
        m = moment[:, :k]
        others = g.sum(axis=0) - g
        # the others may stand where no polynomial of this degree is determined
        others += _RIDGE * np.trace(others, axis1=1, axis2=2)[:, None, None] * np.eye(k)
        c = np.linalg.solve(others, (m.sum(axis=0) - m)[:, :, None])[:, :, 0]
        held_out = [
            np.square(y[r] - base[r, :k] @ own).sum() for r, own in zip(rows, c, strict=True)
        ]
        errors.append(np.array(held_out) / count)
    chosen = _simplest_degree(np.array(errors))
    error = max(float(np.average(errors[chosen], weights=count)), 0.0)
    if not chosen or high - low < _STILL:
        return np.array([0.0, 1.0]), error, len(x)
    k = chosen + 1
    best = np.linalg.solve(gram[:, :k, :k].sum(axis=0), moment[:, :k].sum(axis=0))
    return np.asarray(Chebyshev(best, (low, high)).convert(kind=Power).coef), error, len(x)


def _simplest_degree(errors: Array) -> int:
    """The first row of squared errors (rows, blocks)
    whose ratio to the best is 1 within a standard error.

    Ratios, since a block outside the others' range has large errors for every degree.
    """
    logs = np.log(np.maximum(errors, 1e-24))
    apart = logs - logs[logs.mean(axis=1).argmin()]
    spread = apart.std(axis=1, ddof=1) / np.sqrt(apart.shape[1])
    return int((apart.mean(axis=1) <= spread).argmax())


def _polynomial_text(curve: Array) -> str:
    """A polynomial as text."""
    if curve.tolist() == [0.0, 1.0]:
        return "x"
    terms = (
        f"{c:+.4g}" + ("" if k == 0 else " x" if k == 1 else f" x^{k}") for k, c in enumerate(curve)
    )
    return " ".join(terms).removeprefix("+")
