"""Learn one track: choose samples, drop false sightings, fit kernels, keep held-out residuals."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ...body_model import Noise
from ...settings import FitSettings
from ...types import TRACK_AXES, Array, Finding, Score
from ..data.pairs import Pairs, SmoothedJoint, correlate_angle_errors
from ..data.subsampling import choose_farthest_rows, choose_spaced_rows
from ..gp.cross_validation import held_out_residuals, leave_one_out_deviations
from ..gp.fit import FittedKernels, Samples, build_gp, fit_kernels
from ..gp.marginal_likelihood import ROTATION
from ..gp.model import GP, drop_negligible_rows
from ..paper_preset import SAMPLES, paper_kernels

_FALSE = 8.0
_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class TrackSense:
    """The model of one track · floor (k,D) of new samples, px² or
    mm² · residual (n,D) held out, expected variance (n,D).

    constant (n,D): held-out residual of the median as
    predictor, over the same blocks · used: its n sightings.
    """

    gp: GP
    floor: Array
    residual: Array
    variance: Array
    constant: Array
    used: Pairs
    whole: Pairs
    rejected: int
    rule: str


def learn_track(whole: Pairs, chosen: Sequence[SmoothedJoint], fit: FitSettings) -> TrackSense:
    """Learn one track by the preset of `fit`."""
    if fit.preset == "paper":
        part = whole.rows(choose_spaced_rows(len(whole.x), SAMPLES))
        data = Samples(part.x, part.y, np.zeros(part.y.shape))
        return _sense_with_kernels(
            data, paper_kernels(data), part, whole, 0, "as many as the paper's"
        )
    part = whole.rows(choose_farthest_rows(whole.x, fit.samples))
    kept = len(part.x)
    for _ in range(_ROUNDS):
        used = part
        data = Samples(
            part.x, part.y, part.floor, part.variance, correlate_angle_errors(part, chosen)
        )
        # outputs share a kernel where their noise is alike, which what lasts is not
        shared = not any(joint.lasting for joint in chosen)
        kernels = fit_kernels(data, ROTATION, shared, fit.seed)
        sound = _believable_rows(data, kernels)
        if sound.all():
            break
        part = part.rows(np.flatnonzero(sound))
    return _sense_with_kernels(
        data, kernels, used, whole, kept - len(data.x), "which cover the exploration best"
    )


def scores_of_track(
    name: str, found: TrackSense, joints: Sequence[str], noise: Noise
) -> Iterator[Score]:
    """Yield held-out error, share of frames used, noise and length scales of one track."""
    error = float(np.sqrt(np.mean(found.residual**2)))
    yield Score(f"rmse/held_out/{name}", error, found.gp.unit)
    yield Score(f"nis/held_out/{name}", float(np.mean(found.residual**2 / found.variance)), "1")
    yield Score(f"used_share/{name}", len(found.gp.samples) / max(found.whole.frames, 1), "1")
    for output, value in zip(found.gp.outputs, noise.senses[name], strict=True):
        yield Score(f"std/noise/{name}/{output}", float(np.sqrt(value)), found.gp.unit)
    for joint, scale in zip(joints, found.gp.scales[0], strict=True):
        yield Score(f"length_scale/{name}/{joint}", float(scale), "rad")


def track_findings(name: str, found: TrackSense) -> Iterator[Finding]:
    """Yield remarks on sightings left out of one track."""
    sightings = len(found.whole.x)
    used = len(found.gp.samples)
    if found.rejected:
        left = f"{found.rejected} sighting{'s' if found.rejected > 1 else ''} left out as false"
        text = f"{name}: {left}, more than {_FALSE:.0f} deviations off"
        yield Finding("warning", text)
    if used + found.rejected < sightings:
        yield Finding(
            "info", f"{name}: {used + found.rejected} of {sightings} sightings kept, {found.rule}"
        )


def _sense_with_kernels(
    data: Samples, found: FittedKernels, used: Pairs, whole: Pairs, rejected: int, rule: str
) -> TrackSense:
    block = used.block
    residual, variance = held_out_residuals(data, found, block)
    # samples of a body to update have negative blocks,
    # and their floor includes more than pixel noise
    floor = data.floor[block >= 0] if (block >= 0).any() else data.floor
    gp = drop_negligible_rows(build_gp(data, found, *TRACK_AXES[data.y.shape[1]]))
    constant = _residuals_from_constant(data.y, block)
    return TrackSense(gp, floor, residual, variance, constant, used, whole, rejected, rule)


def _residuals_from_constant(y: Array, block: Array) -> Array:
    """Residuals (n,D) of positions y (n,D) from the median of all other blocks."""
    residual = np.empty(y.shape)
    for label in np.unique(block):
        rows = block == label
        residual[rows] = y[rows] - np.median(y if rows.all() else y[~rows], axis=0)
    return residual


def _believable_rows(data: Samples, found: FittedKernels) -> Array:
    """Rows within _FALSE robust deviations; by
    medians, because false sightings inflate the noise.
    """
    size = np.abs(leave_one_out_deviations(data, found))
    return np.asarray((size < _FALSE * 1.4826 * np.median(size, axis=0)).all(axis=1))
