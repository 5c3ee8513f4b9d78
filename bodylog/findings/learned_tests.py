"""A learned body on logs that it was not learned from, and the health of several logs together."""

from collections.abc import Sequence
from pathlib import Path

from ..body_model import BodyModel
from ..checks import log_context, require_same_camera
from ..types import Features, Finding, Health, Recording, Score
from .faults import sighting_findings


def score_learned_body(
    learned: BodyModel, observed: Sequence[tuple[Path, Recording, Features]]
) -> tuple[tuple[Score, ...], tuple[Finding, ...]]:
    """A body's scores on test logs, dated as it knows its
    cameras, and what was found in them; none without logs.
    """
    from ..body import log_scores
    from ..estimation.timing import correction

    if not observed:
        return (), ()
    findings = [
        f
        for _, read, found in observed
        for f in (*read.facts.findings, *found.findings, *sighting_findings(found))
    ]
    for log, read, found in observed:
        findings += require_same_camera(log, learned.provenance.get("cameras", ()), read, found)
    timely = [
        correction.shift_features(found, correction.learned_delays(learned))
        for _, _, found in observed
    ]
    with log_context(observed[0][0], findings, len(observed) - 1):
        scores, more = log_scores.score_body_on_tests(learned, timely)
    return scores, (*findings, *more)


def merged_health(observed: Sequence[tuple[Recording, Features]]) -> dict[str, Health]:
    """Health by topic or track; of several logs each key begins with its log's name."""
    of = {read.facts.name: {**read.facts.health, **found.health} for read, found in observed}
    if len(of) == 1:
        return next(iter(of.values()))
    return {f"{name}:{key}": health for name, found in of.items() for key, health in found.items()}
