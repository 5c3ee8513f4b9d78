"""Motion with white acceleration beside motion of the order that evidence prefers, with a camera and without."""

from dataclasses import replace

import pytest

from bodylog.estimation.methods import filtering
from tests.estimation.conftest import draw
from tests.estimation.free_motion import white
from tests.validation import error_bars, figures, logs

COUNT = 5


def table():
    """A row for each kind of log; RMSE and NEES of three joints by method and motion, with and without its camera."""
    kinds = [(f"{name} ({COUNT})", [each(seed) for seed in range(COUNT)]) for name, each in KINDS.items()]
    kinds += [(name, [error_bars.recorded(file)]) for name, file in error_bars.RECORDED.items()]
    columns = [f"`{method}`: {way}" for method in error_bars.METHODS for way in ("white acceleration", "by evidence")]
    rows = [
        (f"{name}{', encoders alone' if senses else ''}", *(cell(pairs, senses, *how) for how in WAYS))
        for name, pairs in kinds for senses in (None, ("encoders",))
    ]  # fmt: skip
    return figures.table(("log: RMSE, mrad; NEES", *columns), rows)


WAYS = [(method, chosen) for method in error_bars.METHODS for chosen in (False, True)]


def cell(pairs, senses, method, chosen):
    """RMSE and NEES of one method, with the order of motion chosen or 2."""
    with pytest.MonkeyPatch.context() as patch:
        if not chosen:
            patch.setattr(filtering, "with_preferred_order", lambda problem: problem)
        runs = [figures.found(log, body, method, senses=senses) for log, body in pairs]
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
    """The simulator's motion before one camera, and a body learned from another exploration."""

    def made(seed):
        log = logs.drawn(scenario, seed, seconds)
        return log, replace(logs.learned(seed + COUNT), provenance={})

    return made


KINDS = {"sines": sines, "babble of 40 s": simulated("babble", 40.0), "reaches of 10 s": simulated("reach", 10.0),
         "white acceleration": white_acceleration}  # fmt: skip
