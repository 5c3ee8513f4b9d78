"""Scores of an estimate: its error against the
truth, whether its error bars are true, what it used.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ..motion import MAX_ORDER, MOTION_MODELS, PROCESS_UNITS, WHITE_ACCELERATION
from ..types import Array, Estimate, Score, Series

SAME_TIME_S = 1e-6
"""s: stamps closer than this are the same but for rounding."""


ENCODERS_READ_KEY = "encoders_read"
"""Setting of an estimate whose encoders read another function
of the angle: they are not compared with true angles.
"""


def score_angles(
    estimate: Estimate, truth: Series | None, joints: Series | None
) -> tuple[Score, ...]:
    """rmse/joint, nees, coverage_2sigma (with truth),
    rmse/encoders (with encoders), evidence and counts per sense.
    """
    found: list[Score] = []
    if truth is not None:
        names = [name for name in estimate.joints.names if name in truth.names]
        found += against_truth(estimate, truth, names) if names else []
        if joints is not None and ENCODERS_READ_KEY not in estimate.settings:
            found += encoder_scores(estimate, truth, joints, names)
    return (*found, *own_scores(estimate))


def against_truth(estimate: Estimate, truth: Series, names: list[str]) -> list[Score]:
    """Error, its ratio to the stated covariance, and
    how often it is within two standard deviations.
    """
    rows = overlaps_truth(estimate.joints.t, truth)
    columns = [estimate.joints.names.index(name) for name in names]
    if not rows.any():
        return []
    error = (estimate.joints.values[:, columns] - truth_at_times(truth, names, estimate.joints.t))[
        rows
    ]
    cov = estimate.cov[rows][:, columns][:, :, columns]
    var = np.einsum("nii->ni", cov)
    with np.errstate(divide="ignore", invalid="ignore"):  # an error bar of zero is infinitely wrong
        ratio = error**2 / var
    nees = _normalised_error(error, cov) / len(names)
    return [
        Score("rmse/joint", root_mean_square(error), "rad"),
        *(
            Score(f"rmse/joint/{name}", root_mean_square(error[:, i]), "rad")
            for i, name in enumerate(names)
        ),
        Score("nees/joint", float(nees.mean()), "1"),
        *(
            Score(f"nees/joint/{name}", float(ratio[:, i].mean()), "1")
            for i, name in enumerate(names)
        ),
        Score("coverage_2sigma/joint", float((ratio <= 4.0).mean() * 100.0), "%"),
    ]


def _normalised_error(error: Array, cov: Array) -> Array:
    """eᵀ P⁻¹ e (N,); infinite where a covariance has no inverse."""
    found = np.full(len(error), np.inf)
    sound = np.linalg.det(cov) != 0.0
    found[sound] = np.einsum(
        "ni,ni->n", error[sound], np.linalg.solve(cov[sound], error[sound][..., None])[..., 0]
    )
    return found


def encoder_scores(
    estimate: Estimate, truth: Series, joints: Series, names: list[str]
) -> list[Score]:
    """RMSE of the raw encoders over the estimate's time span."""
    names = [name for name in names if name in joints.names]
    span = (joints.t >= estimate.joints.t[0]) & (joints.t <= estimate.joints.t[-1])
    rows = span & overlaps_truth(joints.t, truth)
    if not names or not rows.any():
        return []
    error = (
        joints.values[:, [joints.names.index(name) for name in names]]
        - truth_at_times(truth, names, joints.t)
    )[rows]
    error = error[np.isfinite(error)]
    return [Score("rmse/encoders", root_mean_square(error), "rad")] if len(error) else []


def own_scores(estimate: Estimate) -> list[Score]:
    """Scores without truth: evidence, innovations in
    px and normalised, measurements used per sense.

    log_evidence is the log density of each measurement given those before: compare it between
    estimates of the same measurements.
    """
    found = (
        [Score("free_energy", float(np.mean(estimate.free_energy)), "nats")]
        if len(estimate.free_energy)
        else []
    )
    if estimate.can.density:
        found.append(Score("log_evidence", -float(np.sum(estimate.free_energy)), "nats"))
    found += track_scores(estimate)
    for sense, errors in sorted(estimate.errors.items()):
        finite = errors.values[np.isfinite(errors.values)]
        if len(finite):
            found.append(Score(f"nis/{sense}", float(np.mean(finite**2)), "1"))
    found += [
        Score(f"used/{sense}", float(health.used), "messages")
        for sense, health in sorted(estimate.used.items())
    ]
    return [*found, *precision_scores(estimate)]


def precision_scores(estimate: Estimate) -> list[Score]:
    """The noise that the estimate assumes: per joint of encoder
    and motion, and the factor on each track's variance.
    """
    names = estimate.joints.names
    settings = estimate.settings
    found = [
        Score(f"std/encoders/{n}", v**0.5, "rad")
        for n, v in _each_named_variance(names, settings.get("encoder"))
    ]
    if ENCODERS_READ_KEY not in settings:
        found += [
            Score(f"std/encoders/{n}", v**0.5, "rad")
            for n, v in _each_named_variance(names, settings.get("sigma_encoders"))
        ]
    motion = MOTION_MODELS.get(str(settings.get("motion")), MOTION_MODELS[WHITE_ACCELERATION])
    kind = "jerk" if motion.order == MAX_ORDER else "acceleration"
    unit = PROCESS_UNITS[motion.order]
    found += [
        Score(f"process_noise/{kind}/{n}", v, unit)
        for n, v in _each_named_variance(names, settings.get("process"))
    ]
    scale = settings.get("scale")
    factors = sorted(scale.items()) if isinstance(scale, Mapping) else ()
    return found + [
        Score(f"variance_factor/{n}", v, "1")
        for track, v in factors
        for n, v in _each_named_variance((track,), [v])
    ]


def _each_named_variance(names: Sequence[str], values: object) -> Iterator[tuple[str, float]]:
    """Each name with its variance, if `values` is a list of them."""
    if isinstance(values, list | tuple) and len(values) == len(names):
        yield from (
            (n, float(v))
            for n, v in zip(names, values, strict=True)
            if isinstance(v, int | float) and v >= 0
        )


def track_scores(estimate: Estimate) -> list[Score]:
    """RMSE (px or mm) of each track against its prediction before the measurement."""
    found = []
    for name, predicted in sorted(estimate.predicted.items()):
        errors = estimate.errors.get(name)
        if errors is None or predicted.std is None or not len(errors.t) or not len(predicted.t):
            continue
        rows = np.minimum(
            np.searchsorted(predicted.t, errors.t - SAME_TIME_S), len(predicted.t) - 1
        )
        pixels = errors.values * predicted.std[rows]
        error = root_mean_square(pixels[np.isfinite(pixels)])
        found.append(Score(f"rmse/innovation/{name}", error, predicted.unit))
    return found


def truth_at_times(truth: Series, names: list[str], t: Array) -> Array:
    """The truth (N,len(names)) rad, interpolated at times t (N,) s."""
    order = np.argsort(truth.t, kind="stable")
    columns = truth.values[order][:, [truth.names.index(name) for name in names]]
    return np.stack([np.interp(t, truth.t[order], column) for column in columns.T], axis=1)


def overlaps_truth(t: Array, truth: Series) -> Array:
    """Which times (N,) lie within the truth's span."""
    if not len(truth.t):
        return np.zeros(len(t), bool)
    inside: Array = (t >= truth.t.min() - SAME_TIME_S) & (t <= truth.t.max() + SAME_TIME_S)
    return inside


def root_mean_square(error: Array) -> float:
    """The root of the mean square of all elements, in their unit."""
    return float(np.sqrt(np.mean(error**2)))
