"""Errors and NEES of logs whose images are stamped 50 ms late, beside the same logs with true stamps."""

from dataclasses import replace

from tests.estimation.test_delay import delayed
from tests.validation import error_bars, figures, logs

LATE = 0.05
"""s."""
KINDS = {
    "reaches of 10 s, one camera": error_bars.reaches,
    "reaches, two cameras": lambda: error_bars.reaches(2),
    "babble of 40 s, two cameras": lambda: error_bars.babble(2),
    "recorded exploration": lambda: recorded("explore.mcap"),
    "recorded reach, 20 s": lambda: recorded("reach.mcap"),
}


def table():
    """A row for each kind of log and method: true stamps, late ones corrected, late ones left."""
    columns = ("true stamps", "50 ms late", "50 ms late, `--delay off`")
    head = ("log", "method", *(f"{column}: RMSE, mrad; NEES of pan, lift, elbow" for column in columns))
    rows = [row for name, each in KINDS.items() if (pairs := list(each())) for row in of_kind(name, pairs)]
    return figures.table(head, rows)


def of_kind(name, pairs):
    """The rows of one kind of log."""
    late = [(replace(log, features=delayed(log.features, LATE)), body) for log, body in pairs]
    for method in error_bars.METHODS:
        cells = []
        for some, delay in ((pairs, "auto"), (late, "auto"), (late, "off")):
            runs = [figures.found(log, body, method, delay) for log, body in some]
            cells.append(f"{figures.mrad(runs)}; {figures.mean_nees(runs)}")
        yield (f"{name} ({len(pairs)})" if len(pairs) > 1 else name, f"`{method}`", *cells)


def recorded(file):
    """A recorded log and its body, where they are at hand."""
    log = logs.recorded(file)
    return [(log, logs.recorded_body())] if log else []
