"""A log as factors: its knots, readings and images, the
noise that is assumed, and the columns of its border.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...types import Array
from ..measurements.records import Sighting
from .columns import Column, Path
from .condensing import (
    PairFactors,
    PassedSteps,
    Readings,
    compute_normalisation,
    condense_readings,
    place_readings,
)
from .elimination import System
from .encoder_error import JointNoise
from .images import ImageRows, Images, build_image_rows, correlate_model_errors, place_images

CHANGE = 0.5
"""Standard deviation of ln σ and ln τ of a run's encoder errors about those of the exploration,
and share of a joint's play by which that may differ from the exploration's.
"""


@dataclass(frozen=True)
class LastingPrior:
    """Mean and standard deviation of ln σ (rad) and of ln τ (s) of encoder errors before the log.

    known: whether the body has them from its exploration; then without evidence they are there,
    too.
    """

    error: tuple[float, float] = (float(np.log(5e-4)), 2.0)
    seconds: tuple[float, float] = (0.0, 1.5)
    known: bool = False


ANY_ERRORS = LastingPrior()
"""σ of 0.01 to 30 mrad and τ of 0.05 to 20 s, within two standard deviations."""


@dataclass(frozen=True, eq=False)
class Noise:
    """What is assumed of joints and encoders, and factors
    on the stated variance of each sense's images.

    groups (G,): standard deviation of each group of columns before the log · usual: noise about
    which that of readings and motion is expected; by default, this one · resting (M,) bool: joints
    that rest, whose errors are not looked for.
    """

    joints: JointNoise
    scales: tuple[float, ...]
    groups: tuple[float, ...] = ()
    prior: LastingPrior = ANY_ERRORS
    usual: JointNoise | None = None
    resting: Array | None = None

    def list_column_stds(self, columns: Sequence[Column]) -> Array:
        """Standard deviation (C,) of each column's size before the log."""
        return np.array(
            [one.std * (1.0 if one.group is None else self.groups[one.group]) for one in columns]
        )


@dataclass(frozen=True, eq=False)
class FactorProblem:
    """A log to be solved on K knots (K,) s.

    t (N,) s, values (N,M) rad, NaN where missing, relative (N,M): readings and their
    variances over the encoder's · believed (N,M), and of each sense's images (F,):
    shares that are not taken for outliers · start (M,) rad · settled (C,C): covariance of the
    columns' sizes where these are known · nearest: whether an image
    may be of a time before its knot as well, as a filter's may not.
    """

    knots: Array
    t: Array
    values: Array
    relative: Array
    start: Array
    sightings: tuple[Sighting, ...]
    columns: tuple[Column, ...] = ()
    nearest: bool = True
    believed: Array | None = None
    images_believed: tuple[Array, ...] | None = None
    settled: Array | None = None

    @cached_property
    def images(self) -> tuple[Images, ...]:
        """The images at their knots."""
        placed = [place_images(one, self.knots, self.nearest) for one in self.sightings]
        if self.images_believed is None:
            return tuple(placed)
        pairs = zip(placed, self.images_believed, strict=True)
        return tuple(replace(one, believed=share[one.frames]) for one, share in pairs)

    @property
    def model_rows(self) -> int:
        """Number U of rows of all senses, each with a model error among the states."""
        return sum(one.values.shape[1] for one in self.sightings)

    def with_columns(self, more: Iterable[Column]) -> "FactorProblem":
        """The problem with more columns after its own."""
        return replace(self, columns=(*self.columns, *more))

    def count_states(self, noise: Noise) -> int:
        """Length S of the state at a knot: each joint's, then the model errors."""
        return len(self.start) * noise.joints.state_count + self.model_rows

    def place_on_knots(self, path: Path) -> Readings:
        """The readings at and between the knots, with the change of each by the columns as further
        right-hand sides.
        """
        moved = (column.changes_readings(self.t, path) for column in self.columns)
        values = np.stack([self.values, *moved], axis=-1)
        believed = np.ones(self.values.shape) if self.believed is None else self.believed
        return place_readings(self.t, values, self.relative, believed, self.knots)


@dataclass(frozen=True, eq=False)
class Linearised:
    """A problem about a path: readings, rows of images (without
    their scale), correlation κ (K-1,U) of model errors.
    """

    problem: FactorProblem
    path: Path
    readings: Readings
    rows: tuple[ImageRows, ...]
    model_correlation: Array
    noise: Noise


def linearise_problem(problem: FactorProblem, path: Path, noise: Noise) -> Linearised:
    """The problem about a path of angles (K,M), rates (K,M) and links (K,M)."""
    rows = []
    size = problem.count_states(noise)
    first = size - problem.model_rows
    for images in problem.images:
        here = path.at_images(images)
        columns = build_image_columns(problem, images, here)
        rows.append(build_image_rows(images, here.links, noise.joints, *columns, first, size))
        first += images.values.shape[1]
    kappa = correlate_model_errors(problem.sightings, path.links)
    return Linearised(problem, path, problem.place_on_knots(path), tuple(rows), kappa, noise)


def build_image_columns(problem: FactorProblem, images: Images, seen: Path) -> tuple[Array, Array]:
    """What the columns move links by (F,M,C), as images show them along the path seen, and what
    they displace images by beside (F,D,C).
    """
    links = np.zeros((len(images.frames), len(problem.start), len(problem.columns)))
    displaced = np.zeros((*images.values.shape, len(problem.columns)))
    for c, column in enumerate(problem.columns):
        links[..., c] = column.moves_images(images, seen)
        displaced[..., c] = column.displaces_images(images, seen)
    return links, displaced


def build_system(linear: Linearised, passed: PassedSteps | None = None) -> System:
    """All factors of the linearised problem; passed: as of `condense_readings`."""
    problem = linear.problem
    pairs = condense_readings(linear.readings, linear.noise.joints, passed)
    system = System(
        *_collect_knot_factors(linear),
        *_collect_pair_factors(linear, pairs),
        np.array([column.mean for column in problem.columns]),
        linear.noise.list_column_stds(problem.columns) ** -2.0,
        pairs,
        problem.settled,
    )
    return system.subtract_means()


def _collect_knot_factors(linear: Linearised) -> tuple[Array, Array, Array, Array]:
    """info, right, square and logs at the knots, as of `System`: what is known before the log, the
    readings at knots, and the images.
    """
    problem = linear.problem
    joints = linear.noise.joints
    readings = linear.readings
    p = joints.state_count
    count = len(problem.knots)
    size = problem.count_states(linear.noise)
    right_sides = 1 + len(problem.columns)
    info = np.zeros((count, size, size))
    right = np.zeros((count, size, right_sides))
    square = np.zeros((count, right_sides, right_sides))
    logs = np.zeros(count)
    for j, (start, precision) in enumerate(zip(problem.start, joints.start_precision, strict=True)):
        own = slice(j * p, (j + 1) * p)
        info[0, own, own] += precision
        right[0, j * p, 0] += precision[0, 0] * start
        square[0, 0, 0] += precision[0, 0] * start**2
        logs[0] -= 0.5 * np.log(np.diag(precision)).sum()
    model_errors = np.arange(len(problem.start) * p, size)
    info[0, model_errors, model_errors] += 1.0

    def add_rows(
        at: Array, rows: Array, read: Array, var: Array, weight: Array, believed: Array
    ) -> None:
        """Add rows (F,D,S) on the states at knots, with right sides read (F,D,R)."""
        precision = (weight / var)[..., None]
        weighted = (rows * precision).swapaxes(1, 2)
        add_at_knots(info, at, weighted @ rows)
        add_at_knots(right, at, weighted @ read)
        add_at_knots(square, at, read.swapaxes(1, 2) @ (precision * read))
        var = var / np.where(weight > 0.0, weight, 1.0)
        add_at_knots(logs, at, compute_normalisation(var, believed).sum(axis=1))

    add_rows(
        np.arange(count),
        joints.place_rows_on_knots(joints.build_reading_rows(np.zeros(1)), size),
        readings.at_knot,
        joints.white,
        readings.knot_weight,
        readings.knot_believed,
    )
    for images, rows, scale in zip(problem.images, linear.rows, linear.noise.scales, strict=True):
        share = images.believed[:, None]
        add_rows(images.knots, rows.slopes, rows.right, scale * rows.var, share, share)
    return info, right, square, logs


def _collect_pair_factors(
    linear: Linearised, pairs: PairFactors
) -> tuple[Array, Array, Array, Array]:
    """info, right, square and logs from each knot to the next, as of `System`: the readings between
    them, condensed to pairs, and how model errors last.
    """
    p = linear.noise.joints.state_count
    count = len(linear.problem.knots) - 1
    size = linear.problem.count_states(linear.noise)
    info = np.zeros((count, 2 * size, 2 * size))
    right = np.zeros((count, 2 * size, pairs.right.shape[1]))
    for j in range(len(linear.problem.start)):
        own = np.r_[j * p : (j + 1) * p, size + j * p : size + (j + 1) * p]
        info[:, own[:, None], own] = np.moveaxis(pairs.info[..., j], -1, 0)
        right[:, own] = np.moveaxis(pairs.right[..., j], -1, 0)
    # u₁ = κ u₀ + √(1 − κ²) ν
    kappa = linear.model_correlation
    fresh = 1.0 / (1.0 - np.square(kappa))
    first = np.arange(size - linear.problem.model_rows, size)
    second = size + first
    info[:, first, first] = np.square(kappa) * fresh
    info[:, second, second] = fresh
    info[:, first, second] = -kappa * fresh
    info[:, second, first] = -kappa * fresh
    logs = pairs.logs.sum(axis=1) - 0.5 * np.log(fresh).sum(axis=1)
    return info, right, np.moveaxis(pairs.square.sum(axis=-1), -1, 0), logs


def add_at_knots(total: Array, at: Array, parts: Array) -> None:
    """Add parts (F,…) to the total (K,…) at their knots (F,), which ascend: of
    several at one knot one after another, many times faster than `np.add.at`.
    """
    while len(at):
        is_next = np.diff(at, prepend=-1) > 0
        total[at[is_next]] += parts[is_next]
        at = at[~is_next]
        parts = parts[~is_next]
