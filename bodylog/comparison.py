"""Every method with every subset of the senses on one log, with and without truth."""

import time
from dataclasses import dataclass, replace
from pathlib import Path

from .errors import InputError, UsageError
from .pipeline import Progress, infer, judge, observe
from .settings import Settings
from .types import BodyModel, Features, Finding, Recording, Score


@dataclass(frozen=True, eq=False)
class Row:
    """One line of a comparison: what ran on which senses, how good it was, how long it took (s)."""

    method: str
    senses: tuple[str, ...]
    scores: tuple[Score, ...]
    seconds: float


def compare(
    log: Path, body: Path, settings: Settings, progress: Progress | None = None
) -> tuple[list[Row], tuple[Finding, ...]]:
    """Every method with every subset of the senses the log has; each is also asked for pictures withheld from it.

    What a method refuses is a remark, and an error where all refuse.
    """
    from . import estimation
    from .body import model
    from .estimation import choices

    learned = model.load(body)
    read, features = observe(log, settings, progress)
    subsets = choices.subsets(features, learned)
    runs = [(m, senses) for m in estimation.METHODS for senses in subsets if choices.usable(m, senses)]
    rows: list[Row] = []
    refused: dict[str, InputError | UsageError] = {}
    for method, senses in runs:
        try:
            rows.append(_row(method, senses, features, learned, settings, read))
        except (InputError, UsageError) as problem:
            refused[f"{method} {','.join(senses)}"] = problem
    if refused and not rows:
        raise next(iter(refused.values()))
    remarks = (Finding("warning", f"{what}: {problem}") for what, problem in refused.items())
    return rows, (*read.findings, *features.findings, *remarks)


def _row(
    method: str, senses: tuple[str, ...], features: Features, learned: BodyModel, settings: Settings, read: Recording
) -> Row:
    from .evaluation.heldout import held_out, withhold

    started = time.perf_counter()
    chosen = replace(settings, estimate=replace(settings.estimate, method=method, senses=senses, without=()))
    found = infer(features, learned, chosen)
    seconds = time.perf_counter() - started
    fewer, withheld = withhold(features)
    foretold = held_out(infer(fewer, learned, chosen), withheld, learned)
    return Row(method, senses, (*judge(found, read), *foretold), seconds)
