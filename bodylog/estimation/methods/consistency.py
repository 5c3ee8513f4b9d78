"""Checks of every estimate without ground truth.

A number that is not finite is an error that names joint or sense, and time. Readings far from their
predictions are warnings.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from ...body_model import HELD, BodyModel
from ...errors import EvidenceError
from ...settings import EstimationSettings
from ...types import Array, Estimate, Features, Finding
from ...wording import list_in_words
from ..faults.threshold import SIGNIFICANT_SIGMA
from ..inference.tangents import OFFSET_STD
from ..measurements.long_arrays import MIN_READINGS

NOISY_STD_RAD = 0.1
"""rad: an encoder with more noise than this, 5.7°, gets a warning: servos of hobby arms err by 2°
under load, and readings of two robots by turns differ by more."""


def require_finite_estimate(found: Estimate) -> Estimate:
    """The same estimate; EvidenceError where any of its
    numbers is not finite, or a variance is below 0.
    """
    for what, t, numbers in _list_checked_numbers(found):
        good = np.asarray(np.isfinite(numbers).all(axis=tuple(range(1, numbers.ndim))))
        if not good.all():
            at = float(t[good.argmin()])
            bad = len(good) - np.count_nonzero(good)
            raise _make_contradiction_error(
                f"{what} at {at:.3f} s is not a number by {found.method} ({bad} of {len(good)}):"
            )
    return found


@contextmanager
def report_numerical_errors(method: str) -> Iterator[None]:
    """EvidenceError if numerical errors prevent an estimate."""
    try:
        yield
    except np.linalg.LinAlgError as problem:
        raise _make_contradiction_error(f"no estimate by {method}: {problem};") from None


def _make_contradiction_error(what: str) -> EvidenceError:
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


def check_consistency(
    found: Estimate, settings: EstimationSettings, unit: str, rad_per_unit: float, moved: str
) -> Iterator[Finding]:
    """Yield a warning for each sense whose residuals
    exceed its error bars, and for each very noisy encoder.

    unit: of the joints' readings · rad_per_unit: its size · moved: as `describe_moved_joints` says.
    """
    learned = found.settings.get("encoder", found.settings.get("sigma_encoders"))
    is_learned = settings.precision == "auto" and settings.preset != "paper"
    if is_learned and isinstance(learned, list):
        for name, variance in zip(found.joints.names, learned, strict=False):
            if variance * rad_per_unit**2 > NOISY_STD_RAD**2:
                text = (
                    f"encoders: {name} has noise of {variance**0.5:.2g} {unit}; do two nodes "
                    "publish on its topic?"
                )
                yield Finding("warning", text)
    for sense, errors in found.errors.items():
        off = np.abs(errors.values[np.isfinite(errors.values)]) > SIGNIFICANT_SIGMA
        # of true errors with one peak, no more are beyond (Vysochanskij, Petunin)
        most = 4.0 / (9.0 * SIGNIFICANT_SIGMA**2)
        if len(off) > MIN_READINGS and off.mean() > most:
            yield Finding(
                "warning",
                f"{sense}: {off.mean():.0%} of its readings are more than {SIGNIFICANT_SIGMA:g} "
                "standard deviations from what was "
                "expected (0.3 % where error bars are true): "
                f"{_advise_on_inconsistency(found, settings, sense, moved)}",
            )


def describe_moved_joints(features: Features, body: BodyModel) -> str:
    """In words, which joints that the body is not learned over stand elsewhere than they stood
    then; "" if none does.
    """
    joints = features.joints
    if joints is None:
        return ""
    moved = list[str]()
    for name, (low, high) in body.provenance.get(HELD, {}).items():
        read = joints.values[:, joints.names.index(name)] if name in joints.names else np.zeros(0)
        if not np.isfinite(read).any():
            continue
        stands = float(np.nanmedian(read))
        if not low - OFFSET_STD <= stands <= high + OFFSET_STD:
            stood = min((low, high), key=lambda bound: abs(stands - bound))
            moved.append(f"{name} stands at {stands:.4g} {joints.unit}, and not at {stood:.4g}")
    return list_in_words(moved) if moved else ""


def _advise_on_inconsistency(
    found: Estimate, settings: EstimationSettings, sense: str, moved: str
) -> str:
    """Likely cause, and what to type."""
    if not found.can.moves:
        return (
            f"{found.method} holds the arm still and detects no faulty encoder; type --method "
            "filter"
        )
    if moved and sense != "encoders":
        return f"{moved} as while the body was learned; fit a body that is learned over it"
    if settings.precision != "auto":
        return f"noise differs from that of --precision {settings.precision}; type --precision auto"
    if settings.bias == "off":
        return "an encoder may have an offset; type --bias auto"
    if sense == "encoders" and len(found.errors[sense].values) <= MIN_READINGS:
        return "readings are too few to learn their noise from"
    if sense == "encoders":
        return (
            "encoders or images are wrong for a while; see when with bodylog report, or type "
            "--without vision"
        )
    return (
        "outliers, or the camera moved since exploration; see with bodylog report, or type "
        f"--without {sense}"
    )
