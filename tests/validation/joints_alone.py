"""Encoders alone: one banded solve of the whole log beside sweeps over white acceleration."""

from dataclasses import replace

import pytest

from bodylog.estimation.methods import whole_log
from tests.estimation.conftest import draw
from tests.estimation.test_least import white
from tests.validation import error_bars, figures, logs

COUNT = 5


def table():
    """A row for each kind of log; RMSE and NEES of three joints by method and way of solving."""
    kinds = [(f"{name} ({COUNT})", [each(seed) for seed in range(COUNT)]) for name, each in KINDS.items()]
    kinds += [(name, [error_bars.recorded(file)]) for name, file in error_bars.RECORDED.items()]
    columns = [f"`{method}`: {way}" for method in error_bars.METHODS for way in ("sweeps", "banded")]
    rows = [(name, *(cell(pairs, *how) for how in WAYS)) for name, pairs in kinds]
    return figures.table(("log: RMSE, mrad; NEES", *columns), rows)


WAYS = [(method, banded) for method in error_bars.METHODS for banded in (False, True)]


def cell(pairs, method, banded):
    """RMSE and NEES of one way."""
    with pytest.MonkeyPatch.context() as patch:
        if not banded:
            patch.setattr(whole_log, "possible", lambda *_: False)
        runs = [figures.found(log, body, method, senses=("encoders",)) for log, body in pairs]
    return f"{figures.mrad(runs)}; {figures.joined(sum(run.nees for run in runs) / len(runs))}"


def sines(seed):
    """Sines of 20 s."""
    world = draw(seed)
    return logs.of(world), world.body


def white_acceleration(seed):
    """Motion of white acceleration, 30 s."""
    world = logs.with_motion(draw, white, seed, duration=30.0)
    return logs.of(world), world.body


def simulated(scenario, seconds):
    """The simulator's motion; the body gives names of joints alone."""

    def made(seed):
        log = logs.drawn(scenario, seed, seconds)
        return log, replace(logs.learned(0), provenance={})

    return made


KINDS = {"sines": sines, "babble of 40 s": simulated("babble", 40.0), "reaches of 10 s": simulated("reach", 10.0),
         "white acceleration": white_acceleration}  # fmt: skip
