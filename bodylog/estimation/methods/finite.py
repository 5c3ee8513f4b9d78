"""The last check of every estimate: a number that is
not finite is an error with joint, sense and time.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from ...errors import EvidenceError
from ...types import Array, Estimate


def require_finite_estimate(found: Estimate) -> Estimate:
    """The same estimate; EvidenceError where any of its
    numbers is not finite, or a variance is below 0.
    """
    for what, t, numbers in _list_checked_numbers(found):
        good = np.asarray(np.isfinite(numbers).all(axis=tuple(range(1, numbers.ndim))))
        if not good.all():
            at = float(t[good.argmin()])
            bad = len(good) - np.count_nonzero(good)
            raise _contradiction_error(
                f"{what} at {at:.3f} s is not a number by {found.method} ({bad} of {len(good)}):"
            )
    return found


@contextmanager
def report_numerical_errors(method: str) -> Iterator[None]:
    """EvidenceError if numerical errors prevent an estimate."""
    try:
        yield
    except np.linalg.LinAlgError as problem:
        raise _contradiction_error(f"no estimate by {method}: {problem};") from None


def _contradiction_error(what: str) -> EvidenceError:
    advice = "type --method kalman, or --without a sense"
    return EvidenceError(f"{what} the readings may contradict each other or the body; {advice}")


def _list_checked_numbers(found: Estimate) -> Iterator[tuple[str, Array, Array]]:
    """Numbers (N,…) to check, with their times (N,) s; NaN where a variance is below 0."""
    t = found.joints.t
    cov = np.where(np.einsum("nii->ni", found.cov)[..., None] < 0.0, np.nan, found.cov)
    of_joints = {"angle": found.joints.values, "rate": found.rate.values, "variance": cov}
    if found.bias is not None:
        of_joints["encoder offset"] = found.bias.values
    for j, name in enumerate(found.joints.names):
        yield from (
            (f"the {what} of {name}", t, numbers[:, j]) for what, numbers in of_joints.items()
        )
    yield "the free energy", t, found.free_energy
    for name, track in found.predicted.items():
        yield f"the place predicted of {name}", track.t, track.values
        yield f"the covariance predicted of {name}", track.t, found.predicted_cov[name]
