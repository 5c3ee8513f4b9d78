"""The last check of every estimate: a number that is not finite is an error with joint, sense and time."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from ...errors import EvidenceError
from ...types import Array, Estimate
from ..measurements.long_arrays import seen


def finite(found: Estimate) -> Estimate:
    """The same estimate; EvidenceError where any of its numbers is not finite, or a variance is below 0."""
    for what, t, good in _numbers(found):
        if not good.all():
            at, bad = float(t[good.argmin()]), len(good) - np.count_nonzero(good)
            raise _contradiction(f"{what} at {at:.3f} s is not a number by {found.method} ({bad} of {len(good)}):")
    return found


@contextmanager
def solvable(method: str) -> Iterator[None]:
    """EvidenceError if numerical errors prevent an estimate."""
    try:
        yield
    except np.linalg.LinAlgError as problem:
        raise _contradiction(f"no estimate by {method}: {problem};") from None


def _contradiction(what: str) -> EvidenceError:
    advice = "type --method kalman, or --without a sense"
    return EvidenceError(f"{what} the readings may contradict each other or the body; {advice}")


def _numbers(found: Estimate) -> Iterator[tuple[str, Array, Array]]:
    """Arrays to check, their times (N,) s, and where (N,) they are numbers."""
    t, var = found.joints.t, np.einsum("nii->ni", found.cov)
    for j, name in enumerate(found.joints.names):
        yield f"the angle of {name}", t, np.isfinite(found.joints.values[:, j])
        yield f"the rate of {name}", t, np.isfinite(found.rate.values[:, j])
        yield f"the variance of {name}", t, seen(found.cov[:, j]) & (var[:, j] >= 0.0)
        if found.bias is not None:
            yield f"the encoder offset of {name}", t, np.isfinite(found.bias.values[:, j])
    yield "the free energy", t, np.isfinite(found.free_energy)
    for name, track in found.predicted.items():
        yield f"the place predicted of {name}", track.t, seen(track.values)
        cov = found.predicted_cov[name]
        yield f"the covariance predicted of {name}", track.t, seen(cov.reshape(len(cov), cov.shape[1] ** 2))
