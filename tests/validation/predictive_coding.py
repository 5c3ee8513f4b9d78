"""NEES of predictive coding's error bars, the inverse of F's Hessian, by what is measured."""

import numpy as np

from tests.validation import error_bars, figures

COUNT = 3


def table():
    """A row for each kind of log."""
    head = ("log", "RMSE, mrad", "NEES of pan, lift, elbow: least to greatest of a log")
    return figures.table(head, [row(name, *kind) for name, kind in KINDS.items()])


def row(name, pairs, settings):
    """The figures of one kind."""
    runs = [figures.found(log, body, "predictive-coding", **settings) for log, body in pairs]
    low, high = (f"{float(f'{end([run.nees for run in runs]):.3g}'):,g}" for end in (np.min, np.max))
    return (f"{name} ({COUNT})", figures.mrad(runs), f"{low} to {high}")


KINDS = {
    "reaches of 10 s, one camera": (error_bars.reaches(1, COUNT), {}),
    "reaches of 10 s, two cameras": (error_bars.reaches(2, COUNT), {}),
    "reaches of 10 s, vision alone": (error_bars.reaches(1, COUNT), {"without": ("encoders",)}),
    "reaches of 30 s, pan's encoder drifting": (error_bars.drifting(COUNT), {}),
}
