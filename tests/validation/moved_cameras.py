"""Cameras that are knocked amid a log: found or not, the size, and the estimate with and without putting it right."""

import numpy as np
import pytest

from bodylog.estimation.faults import screening
from tests.estimation.moved_cameras import MOVED, cameras, moved
from tests.estimation.resting import Drawn, drawn
from tests.validation import error_bars, figures, logs

SIZES, FOUND, JUDGED = (3.0, 5.0, 10.0, 30.0), 12, 5
"""px; logs for the share found, and for errors, of a cell."""
MOTIONS = {"reach": "reaches of 16 s", "sines": "sines of 16 s"}


def table():
    """A row for each motion, size and method."""
    head = ("log", "moved by, px", f"found, of {FOUND}", "size off by at most, px", "method",
            "RMSE, mrad: put back", "ignored", "had it not moved", "NEES, put back")  # fmt: skip
    return figures.table(head, [row for moves in MOTIONS for px in SIZES for row in rows(moves, px)])


def rows(moves, px):
    """Of one motion and size."""
    worlds = [drawn(100 + seed, Drawn(moves, noise=0.01)) for seed in range(FOUND)]
    faults = [cameras(moved(world.features, px, seed), world.body) for seed, world in enumerate(worlds)]
    right = [one[0] for one in faults if len(one) == 1 and abs(one[0].since - MOVED) < 0.5]
    named = f"{len(right)}", f"{max(abs(fault.size - px) for fault in right):.2f}" if right else "–"
    for method in error_bars.METHODS:
        back, ignored, still = [], [], []
        for seed, world in enumerate(worlds[:JUDGED]):
            log = logs.of(world)
            knocked = logs.ObservedLog(moved(log.features, px, seed), log.truth)
            back.append(figures.found(knocked, world.body, method))
            still.append(figures.found(log, world.body, method))
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(screening, "detect_moved_camera", lambda evidence, body: evidence)
                ignored.append(figures.found(knocked, world.body, method))
        cells = (*map(figures.mrad, (back, ignored, still)), f"{np.mean([run.nees for run in back]):.2f}")
        yield (MOTIONS[moves], f"{px:g}", *named, f"`{method}`", *cells)
