"""Scores of an estimate, truth in a file beside the log, and everything that --fail-if may name."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ..body_model import BodyModel
from ..checks import log_context, require_same_camera
from ..errors import InputError, LogError
from ..settings import Settings, TopicSettings
from ..types import Array, Estimate, Features, Finding, Health, Poses, Recording, Score, Series
from .faults import sighting_findings


def score_estimate(found: Estimate, read: Recording) -> tuple[Score, ...]:
    """Figures of merit; those against truth only where the recording carries it."""
    from ..evaluation.figures import list_delays
    from ..evaluation.scores import score_angles

    found_scores = (
        *score_angles(found, read.signals.truth, read.signals.joints),
        *list_delays(found),
    )
    if found.effector is None or read.signals.truth_pose is None:
        return found_scores
    from ..evaluation import poses

    return (*found_scores, *poses.score_poses(found.effector, read.signals.truth_pose))


def with_truth_beside_log(
    path: Path, found: Estimate, read: Recording, settings: Settings
) -> Recording:
    """The recording with the truth in a file beside it;
    InputError where that says nothing about the estimate.
    """
    if (poses := _poses_beside(path, read)) is not None:
        signals = replace(read.signals, truth_pose=poses)
        return _comparable_poses(path, found, replace(read, signals=signals))
    truth = _read_truth_beside_log(path, read, settings)
    read = replace(read, signals=replace(read.signals, truth=truth))
    _require_comparable_truth(path, found, read)
    return read


def _poses_beside(path: Path, read: Recording) -> Poses | None:
    """The effector's true poses in a table beside the log; None where it is no such table."""
    from ..evaluation import truth

    return truth.load_poses(path, read.start_ns)


def _comparable_poses(path: Path, found: Estimate, read: Recording) -> Recording:
    """The recording; InputError where true poses have no estimate beside them."""
    truth = read.signals.truth_pose
    assert truth is not None
    if found.effector is None:
        advice = "type: bodylog fit LOG --urdf ROBOT.urdf, and estimate again"
        raise InputError(f"{path}: has x, y, z, but the estimate has no pose; {advice}")
    _require_shared_time(path, truth.t, found.joints.t)
    return read


def _read_truth_beside_log(path: Path, read: Recording, settings: Settings) -> Series:
    """The true angles in a file beside the log, t in s since the recording's start."""
    from ..evaluation import truth
    from ..recording import recording

    if path.suffix in (".csv", ".npz"):
        return truth.load_truth(path, read.start_ns, read.signals.joints)
    # the names of topics are those of the log that was estimated
    other = recording.read_recording(
        path, Settings(topics=TopicSettings(truth=settings.topics.truth)), settings.input.strict
    )
    angles = other.signals.truth if other.signals.truth is not None else other.signals.joints
    if angles is None:
        raise LogError(f"{path}: neither truth nor joints in it; type: bodylog info {path}")
    return replace(angles, t=angles.t + (other.start_ns - read.start_ns) / 1e9)


def list_bounded_figures(found: Estimate, scores: tuple[Score, ...]) -> tuple[Score, ...]:
    """Everything that --fail-if may name: the scores, faults, delays and shares used."""
    from ..evaluation.figures import list_figures

    return (*scores, *list_figures(found))


def _require_comparable_truth(path: Path, found: Estimate, read: Recording) -> None:
    """InputError where truth from a file beside the log is
    of other joints, or of another time, than the estimate.
    """
    truth = read.signals.truth
    assert truth is not None
    if not set(truth.names) & set(found.joints.names):
        names = (
            f"its columns are {', '.join(truth.names)}, possible: {', '.join(found.joints.names)}"
        )
        raise InputError(f"{path}: {names}; name the columns as the joints")
    _require_shared_time(path, truth.t, found.joints.t)


def _require_shared_time(path: Path, truth_t: Array, t: Array) -> None:
    """InputError where a truth's times (N,) s lie beside those of the estimate, t (M,) s."""
    if not len(t) or truth_t[0] > t[-1] or truth_t[-1] < t[0]:
        span = (
            f"it is from {truth_t[0]:.3f} to {truth_t[-1]:.3f} s, the estimate from {t[0]:.3f} "
            f"to {t[-1]:.3f} s"
        )
        raise InputError(
            f"{path}: {span} after the log's first joint reading; give times since that one, "
            "or 1970"
        )


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
        correction.shift_features(found, correction.read_learned_delays(learned))
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
