"""How true a learned body's error bars are: squared error over stated variance on held-out parts and other motions."""

import numpy as np

from tests.body.conftest import run
from tests.body.standard_residuals import standardise_residuals
from tests.validation import figures

ENCODERS, COUNT = (0.0005, 0.02), 20
"""rad; explorations of 40 s a column."""


def table():
    """Rows by what is predicted, columns by the encoders' noise."""
    runs = {std: [standardise_residuals(run, std, seed) for seed in range(COUNT)] for std in ENCODERS}
    rows = []
    for name in runs[ENCODERS[0]][0]:
        ratios = [np.array([np.mean(one[name]) for one in runs[std]]) for std in ENCODERS]
        cover = [100.0 * np.mean([np.mean(one[name] < 4.0) for one in runs[std]]) for std in ENCODERS]
        spread = (f"{r.mean():.2f}, {r.std(ddof=1):.2f} ({r.min():.2f} to {r.max():.2f})" for r in ratios)
        rows += [(name, *spread), ("within two deviations", *(f"{one:.1f} %" for one in cover))]
    return figures.table(("squared error over stated variance", *(f"encoders of {s:g} rad" for s in ENCODERS)), rows)
