"""Every method with every subset of the senses on one log, with and without truth."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

from .body import storage
from .body.kinematic.model import can_show_changes
from .body_model import BodyModel
from .checks import log_context, loss_note, require_same_camera, require_same_size
from .errors import EvidenceError, InputError, UsageError
from .estimation import METHODS
from .estimation.measurements.gather import choose_senses, gather_measurements
from .evaluation.heldout import score_withheld_frames, withhold_frames
from .features.defaults import features_of_body
from .findings.faults import fault_warnings
from .findings.log_estimate import infer, infer_with_changes
from .findings.scoring import score_estimate
from .logs.protocol import Progress
from .pipeline import observe
from .settings import EstimationSettings, Settings
from .types import FaultKind, Features, Finding, Recording, Score
from .wording import list_in_words


@dataclass(frozen=True, eq=False)
class ComparisonRow:
    """One line of a comparison: method, senses, scores, CPU time (s), warnings."""

    method: str
    senses: tuple[str, ...]
    scores: tuple[Score, ...]
    seconds: float
    findings: tuple[Finding, ...] = ()


def compare_methods(
    log: Path,
    body: Path,
    settings: Settings,
    progress: Progress | None = None,
    done: Callable[[ComparisonRow], None] | None = None,
    full: bool = False,
) -> tuple[list[ComparisonRow], tuple[Finding, ...]]:
    """Run every method with the encoders and each subset of the log's other senses.

    Each also predicts withheld images. full: subsets
    without the encoders too · `done` gets each row at once.

    A refused run is a warning, and an error if all are
    refused; EvidenceError if no sense has readings.
    """
    learned = storage.load_body(body)
    if learned.surface is not None and not learned.senses:
        raise UsageError(
            f"{body}: a body of the robot's surface has no sense to compare; type: bodylog "
            f"estimate {log}"
        )
    settings = features_of_body(learned, settings)
    read, features = observe(log, settings, progress)
    cameras = require_same_camera(log, learned.provenance.get("cameras", ()), read, features)
    require_same_size(log, learned, features, settings)
    with log_context(log, read.facts.findings):
        combined, silent = list_sense_subsets(features, learned, settings.estimate)
    if not combined:
        why = f"no sense of {body} has readings in it; type: bodylog info {log}"
        raise EvidenceError(f"{log}: {why}{loss_note(log, read.facts.findings)}")
    learned, moved = find_body_of_log(features, learned, settings)
    rows: list[ComparisonRow] = []
    refused: dict[str, InputError | UsageError] = {}
    kept = combined if full else select_usual_subsets(combined)
    for asked in _list_run_settings(settings, kept, silent):
        try:
            rows.append(_run_one_method(features, learned, asked, read))
        except (InputError, UsageError) as problem:
            refused[_run_label(asked.estimate.method, asked.estimate.senses or ())] = problem
            continue
        if done is not None:
            done(rows[-1])
    if refused and not rows:
        with log_context(log, read.facts.findings):
            raise next(iter(refused.values()))
    return rows, (
        *read.facts.findings,
        *features.findings,
        *cameras,
        *moved,
        *_label_findings(rows, refused),
        *_skipped_findings(combined, kept),
    )


def find_body_of_log(
    features: Features, learned: BodyModel, settings: Settings
) -> tuple[BodyModel, tuple[Finding, ...]]:
    """The body with cameras and markers where they are in this log, by images that are not
    withheld, and a remark on those that moved; as learned, with a remark, where no estimate tells.
    """
    if not can_show_changes(learned):
        return learned, ()
    usual = replace(settings, estimate=replace(settings.estimate, method=EstimationSettings.method))
    try:
        found, moved = infer_with_changes(withhold_frames(features)[0], learned, usual)
    except (InputError, UsageError) as problem:
        text = f"no camera or marker that moved since the body was learned is looked for: {problem}"
        return learned, (Finding("warning", text),)
    if moved is learned:
        return learned, ()
    names = list_in_words([f.name for f in found.faults if f.kind == FaultKind.MOVED])
    text = f"{names}: moved since the body was learned; each row is by where it is in this log"
    return moved, (Finding("warning", text),)


def select_usual_subsets(combined: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """The subsets with encoders, where the log has any:
    without them, each run searches for the arm for seconds.
    """
    return [senses for senses in combined if "encoders" in senses] or combined


def _skipped_findings(
    combined: Sequence[tuple[str, ...]], kept: Sequence[tuple[str, ...]]
) -> list[Finding]:
    left = [",".join(senses) for senses in combined if senses not in kept]
    return (
        [Finding("info", f"without encoders not run: {'; '.join(left)}; add --all")] if left else []
    )


def list_sense_subsets(
    features: Features, body: BodyModel, settings: EstimationSettings
) -> tuple[list[tuple[str, ...]], tuple[str, ...]]:
    """Every non-empty subset of the senses that are allowed and have readings, all of them first.

    Also the excluded joints and tracks. UsageError if the settings name an unknown one.
    """
    used = gather_measurements(features, body, settings).used
    felt = features.touches and features.synchrony and features.hand is not None
    present = {
        "encoders": used["encoders"].used > 0,
        "vision": any(one.used for name, one in used.items() if name not in ("encoders", "touch")),
        "touch": "touch" in used and felt,
    }
    here = [name for name, there in present.items() if there]
    rows = [some for size in range(len(here), 0, -1) for some in combinations(here, size)]
    visual = [name for name in features.tracks if name in body.senses]
    wanted = choose_senses(visual, body, settings)
    return rows, tuple(name for name in (*body.joints, *visual) if name not in wanted)


def _list_run_settings(
    settings: Settings, combined: Sequence[tuple[str, ...]], silent: tuple[str, ...]
) -> Iterator[Settings]:
    """Every method with every subset of the senses that it can use, as settings."""
    for method in METHODS:
        for senses in combined:
            if METHODS[method].senses.issuperset(senses):
                asked = replace(settings.estimate, method=method, senses=senses, without=silent)
                yield replace(settings, estimate=asked)


def _run_one_method(
    features: Features, learned: BodyModel, settings: Settings, read: Recording
) -> ComparisonRow:
    fewer, withheld = withhold_frames(features)
    # first, so that the timed run finds everything imported and in memory
    heldout = score_withheld_frames(infer(fewer, learned, settings), withheld, learned)
    started = time.process_time()
    found = infer(features, learned, settings)
    seconds = time.process_time() - started
    warnings = (*(f for f in found.findings if f.severity != "info"), *fault_warnings(found.faults))
    asked = settings.estimate
    return ComparisonRow(
        asked.method,
        asked.senses or (),
        (*score_estimate(found, read), *heldout),
        seconds,
        warnings,
    )


def _label_findings(
    rows: Sequence[ComparisonRow], refused: Mapping[str, Exception]
) -> list[Finding]:
    """The rows' findings, each once, with the labels of its rows."""
    labels_of: dict[Finding, list[str]] = {}
    for row in rows:
        for finding in row.findings:
            labels_of.setdefault(finding, []).append(_run_label(row.method, row.senses))
    for label, problem in refused.items():
        labels_of.setdefault(Finding("warning", str(problem)), []).append(label)
    return [
        Finding(finding.severity, f"{'; '.join(labels)}: {finding.text}")
        for finding, labels in labels_of.items()
    ]


def _run_label(method: str, senses: Sequence[str]) -> str:
    return f"{method} {','.join(senses)}"
