"""Readings that are wrong for a moment: images of something else, encoders that glitch, and garbage at the start."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.estimation.inference.leave_one_out import SmoothedWithResiduals, predict_left_out
from bodylog.estimation.methods import smoother
from tests.estimation.conftest import draw
from tests.validation import figures, logs

COUNT, LENGTH = 6, 16.0
"""Logs a row, and their length, s."""


def images(share, size, run=1):
    """A share of a log's images moved by offsets of `size` px, each for `run` images."""

    def spoil(log, rng):
        tracks = {}
        for name, track in log.features.tracks.items():
            begins, n = np.flatnonzero(rng.random(len(track.t)) < share / run), len(track.t)
            moved = np.zeros(track.values.shape)
            for begin, offset in zip(
                begins, size * rng.standard_normal((len(begins), 2)), strict=True
            ):
                moved[begin : min(begin + run, n)] = offset
            tracks[name] = replace(track, values=track.values + moved)
        return replace(log, features=replace(log.features, tracks=tracks))

    return spoil


def encoders(change):
    """Encoders' values (N,M) changed by `change`, in place."""

    def spoil(log, rng):
        values = log.features.joints.values.copy()
        change(values, rng)
        return replace(
            log, features=replace(log.features, joints=replace(log.features.joints, values=values))
        )

    return spoil


def glitches(values, rng):
    """Half a radian off in 0.2 % of the readings."""
    values += np.where(rng.random(values.shape) < 0.002, rng.choice([-0.5, 0.5], values.shape), 0.0)


def zeros(values, rng):
    """No reading yet in the first 20."""
    values[:20] = 0.0


def wrong_start(values, rng):
    """The first three readings of one joint half a radian off."""
    values[:3, rng.integers(3)] += 0.5


KINDS = {
    "sound": lambda log, rng: log,
    "5 % of the images off by 8 px": images(0.05, 8.0),
    "5 % off by 50 px": images(0.05, 50.0),
    "5 % off by 15 px, six in a row": images(0.05, 15.0, 6),
    "0.2 % of the encoders' readings off by 0.5 rad": encoders(glitches),
    "encoders read 0 in the first 20 readings": encoders(zeros),
    "one encoder off by 0.5 rad in its first three": encoders(wrong_start),
}


def table():
    """A row for each kind of log and of wrong readings."""
    head = ("log", "wrong readings", "`filter`, mrad", "its NEES of pan, lift, elbow", "`smoother`, mrad", "its NEES",
            "with the filter's gate alone, mrad", "its NEES")  # fmt: skip
    drawn = [
        (logs.of(world), world.body)
        for world in (draw(seed, duration=LENGTH) for seed in range(COUNT))
    ]
    reaches = [
        (logs.drawn("reach", seed, LENGTH, 2), logs.learned(seed + 1, 2)) for seed in range(COUNT)
    ]
    both = {"sines": drawn, "reaches, two cameras": reaches}
    return figures.table(
        head, [row(name, those, kind) for name, those in both.items() for kind in KINDS]
    )


def row(name, those, kind):
    """Errors from 2 s on over all logs, by each method."""
    spoilt = [
        (KINDS[kind](log, np.random.default_rng(seed)), body)
        for seed, (log, body) in enumerate(those)
    ]
    cells = (name, kind)
    for method, gated in (("filter", False), ("smoother", False), ("smoother", True)):
        with pytest.MonkeyPatch.context() as patch:
            if gated:
                patch.setattr(
                    smoother,
                    "remove_outliers",
                    lambda problem, smooth: SmoothedWithResiduals(
                        **vars(smooth), left_out=predict_left_out(problem, smooth)
                    ),
                )
            runs = [figures.found(log, body, method=method).within(2.0) for log, body in spoilt]
        cells += (figures.mrad(runs), figures.mean_nees(runs))
    return cells
