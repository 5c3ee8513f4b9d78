"""Errors and NEES of logs whose images are stamped 50 ms late, beside the same logs with true stamps."""

from dataclasses import replace

from tests.estimation.spoilt_logs import delayed
from tests.validation import error_bars, figures

LATE = 0.05
"""s."""
KINDS = {
    "reaches of 10 s, one camera": lambda: error_bars.reaches(1, 10),
    "reaches, two cameras": lambda: error_bars.reaches(2, 6),
    "babble of 40 s, two cameras": lambda: error_bars.babble(2, 4),
    "recorded exploration": lambda: [error_bars.recorded("explore.mcap")],
    "recorded reach, 20 s": lambda: [error_bars.recorded("reach.mcap")],
}


def table():
    """A row for each kind of log and method: true stamps, late ones corrected, late ones left."""
    columns = ("true stamps", "50 ms late", "50 ms late, `--delay off`")
    head = ("log", "method", *(f"{column}: RMSE, mrad; NEES of pan, lift, elbow" for column in columns))
    return figures.table(head, [row for name, each in KINDS.items() for row in of_kind(name, list(each()))])


def of_kind(name, pairs):
    """The rows of one kind of log."""
    late = [(replace(log, features=delayed(log.features, LATE)), body) for log, body in pairs]
    for method in error_bars.METHODS:
        cells = []
        for some, delay in ((pairs, "auto"), (late, "auto"), (late, "off")):
            runs = [figures.found(log, body, method, delay) for log, body in some]
            cells.append(f"{figures.mrad(runs)}; {figures.mean_nees(runs)}")
        yield (f"{name} ({len(pairs)})" if len(pairs) > 1 else name, f"`{method}`", *cells)
