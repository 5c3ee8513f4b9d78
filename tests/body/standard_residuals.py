"""Residuals over their stated variance: of what was held out, and of another motion."""

from collections.abc import Callable

from bodylog.body.data.pairs import has_moved, pair_sightings, smooth_all_joints
from bodylog.body.senses.track import learn_track
from bodylog.settings import FitSettings
from bodylog.types import Array


def standardise_residuals(explored: Callable, encoder: float, seed: int) -> dict[str, Array]:
    """Squared residuals (n,2) over their stated variance: of each tenth held out, and on another motion."""
    features, other = [explored(seed, encoder).features], explored(seed + 500, encoder)
    chosen = [joint for joint in smooth_all_joints(features, None) if has_moved(joint)]
    found = learn_track(pair_sightings(features, "effector", chosen, 1), chosen, FitSettings())
    value, _, spread = found.gp.predict(other.angles)
    stated = spread + found.gp.noise + found.floor.mean(axis=0)
    elsewhere = (other.features.effector.values - value) ** 2 / stated
    return {"tenths held out": found.residual**2 / found.variance, "another motion": elsewhere}
