"""Faults named in healthy logs: arms that rest, move slowly, swing and reach, read in 13 ways, four seeds each."""

from bodylog.estimation import estimate_from_features
from bodylog.settings import EstimationSettings
from tests.estimation.resting import MOTIONS, READ, Drawn, drawn
from tests.validation import figures

SEEDS = (100, 101, 102, 103)
SENSES = {"with a camera": None, "encoders alone": ("encoders",)}


def table():
    """A row for each motion: logs in which a fault is named, of all."""
    rows = [(moves, *(f"{accused(moves, senses)} of {len(READ) * len(SEEDS)}" for senses in SENSES.values()))
            for moves in MOTIONS]  # fmt: skip
    return figures.table(("motion", *(f"faults named, {name}" for name in SENSES)), rows)


def accused(moves, senses):
    """Logs of this motion in which a fault is named."""
    worlds = (drawn(seed, Drawn(moves, **how)) for how in READ for seed in SEEDS)
    return sum(
        bool(
            estimate_from_features(
                world.features, world.body, EstimationSettings(senses=senses)
            ).faults
        )
        for world in worlds
    )
