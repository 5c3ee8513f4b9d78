"""Errors and NEES while all encoders are silent, and from their first reading after that on, over drawn logs."""

from dataclasses import replace

import numpy as np

from bodylog.sim.scenarios import SCENARIOS
from tests.estimation.conftest import Explored, draw
from tests.estimation.spoilt_logs import muted
from tests.validation import error_bars, figures, logs

SINCE, WITHIN, COUNT = 6.0, 2.0, 40
"""s: when encoders fall silent at the earliest, and how much later at most, as a reach lasts; logs a row: NEES of ten
differ by a half from those of ten others."""
SILENCES = {"sines": (1.0, 2.0, 5.0, 10.0), "reaches": (2.0, 5.0), "babble": (2.0, 5.0)}


def table():
    """A row for each motion, length of the silence and method."""
    head = ("silent for", "method", "in the silence: RMSE, rad; NEES of pan, lift, elbow; within 2 σ",
            "median NEES of a log", "afterwards: RMSE, mrad; NEES", "worst log, mrad")  # fmt: skip
    return figures.table(head, [row for name, each in SILENCES.items() for s in each for row in rows(name, s)])


def rows(name, silence):
    """Of one motion and length."""
    begins = SINCE + np.random.default_rng(0).uniform(0.0, WITHIN, COUNT)
    pairs = [silenced(*KINDS[name](seed, silence), begin, silence) for seed, begin in enumerate(begins)]
    for method in error_bars.METHODS:
        runs = [figures.found(log, body, method, rate=25.0) for log, body in pairs]
        inside = [run.within(begin + 1e-6, begin + silence) for run, begin in zip(runs, begins, strict=True)]
        after = [run.within(begin + silence) for run, begin in zip(runs, begins, strict=True)]
        cover = 100.0 * np.mean([run.coverage for run in inside])
        cells = (
            f"{figures.rms([run.rmse for run in inside]):.2g}; {figures.mean_nees(inside)}; {cover:.0f} %",
            f"{np.median([run.nees.mean() for run in inside]):.2f}",
            f"{figures.mrad(after)}; {np.mean([run.nees for run in after]):.2f}",
            f"{1e3 * max(run.rmse for run in after):.3g}",
        )
        yield (f"{name}, {silence:g} s ({COUNT})", f"`{method}`", *cells)


def silenced(log, body, begin, silence):
    """The log without encoders for `silence` s, and the body."""
    features = muted(log.features, begin, begin + silence, log.features.joints.names)
    return logs.ObservedLog(features, log.truth), body


def sines(seed, silence):
    """Sines, the model known, and where it was explored."""
    world = draw(seed, duration=SINCE + WITHIN + silence + 4.0, model=Explored())
    return logs.of(world), world.body


def simulated(scenario):
    """A scenario's log, in view throughout, and the body learned from an exploration."""

    def in_view(request):
        return replace(SCENARIOS[scenario].plan(request), covered=None)

    def made(seed, silence):
        return logs.drawn(scenario, 1000 + seed, SINCE + WITHIN + silence + 4.0, plan=in_view), logs.learned(seed)

    return made


KINDS = {"sines": sines, "reaches": simulated("reach"), "babble": simulated("babble")}
