"""The stages in order, each taking files and leaving files: reads as a table of contents."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from .annotating.written_messages import (
    estimate_messages,
    feature_messages,
    provenance_of_logs,
    topic_of_role,
)
from .checks import (
    SparedLogs,
    log_context,
    require_distinct_paths,
    require_features,
    require_same_camera,
    require_same_size,
    require_sights,
    require_trainable,
    select_features_to_learn,
)
from .errors import EvidenceError, InputError, ModelError, UsageError
from .features import defaults as default_features
from .features.observation import observe as observe
from .findings import verdict
from .findings.faults import fault_warnings, sighting_findings, truth_findings
from .findings.joints_only import read_joints_alone
from .findings.log_estimate import LogWithBody, estimate_log
from .findings.log_estimate import infer as infer
from .findings.result import NO_SCORES, Scores, estimate_result
from .findings.result import Result as Result
from .findings.scoring import merged_health, score_learned_body, with_truth_beside_log
from .io.atomic_files import hash_files
from .io.outputs import Output
from .io.temporary import create_scratch_folder
from .io.text_paths import with_text_paths
from .logs.limits import LIMITS
from .logs.protocol import Progress
from .robot.encoder_body import body_of_encoders
from .settings import Settings, settings_as_values
from .types import SURFACE_CHANGES, Finding, Recording

DEFAULTS = Settings()


@with_text_paths
def record(scenario: str, out: Path, **options: Any) -> Result:
    """Simulate a scenario into an ordinary log;
    UsageError names the scenarios and options possible.
    """
    from . import sim

    sim.record_scenario(scenario, out, **options)
    return Result(out)


@with_text_paths
def extract(
    log: Path,
    out: Path,
    settings: Settings = DEFAULTS,
    progress: Progress | None = None,
    tables: Path | None = None,
) -> Result:
    """Write the log's signals with tracks, touches and
    synchrony, without its pictures; `tables`: a folder for CSV.
    """
    from .annotating import annotate
    from .recording import tables as export

    require_distinct_paths([log], [Output(out), *requested_folders("--csv", tables)], settings)
    with annotate.open_annotation(log, out, whole=False, limits=settings.input) as written:
        read, features = observe(log, settings, progress, guess=True)
        require_features(log, features)
        roles = [
            role
            for role in read.facts.roles
            if role.partition("/")[0] in ("joints", "truth", "skin")
        ]
        kept = [topic for role in roles if (topic := topic_of_role(read, role)) is not None]
        lost = written.add(feature_messages(read, features), only=kept)
        written.about(provenance_of_logs([(log, written.digest())], read.facts.settings))
    if tables is not None:
        export.export_features(features, tables)
    health = {**read.facts.health, **features.health}
    found = (*read.facts.findings, *features.findings, *sighting_findings(features), *lost)
    return Result(out, NO_SCORES, health, found, settings_as_values(read.facts.settings))


@with_text_paths
def fit(
    logs: Sequence[Path],
    out: Path,
    settings: Settings = DEFAULTS,
    progress: Progress | None = None,
    update: Path | None = None,
    test: Sequence[Path] = (),
    leave_out: bool = False,
) -> Result:
    """Learn a body model from exploration logs and
    write it as .npz; `update` is one to learn on from.

    It is scored on the logs to `test` it with, which it does not learn from. `leave_out`: a log
    that teaches nothing is a finding, as long as another one does.
    """
    from .annotating.background_copy import Copy
    from .body import storage
    from .delays import camera_delay
    from .robot import calibration
    from .robot import model as robot_model
    from .surface import body as surface_body

    asked = settings
    bodies = () if update is None else (update,)
    require_distinct_paths(
        [*logs, *test, *bodies, *robot_model.urdf_files(settings)], [Output(out)], settings
    )
    known = None if update is None else storage.load_body(update)
    if known is not None and known.surface is not None:
        raise UsageError(
            f"{update}: a body of the robot's surface is not learned on; "
            "fit all logs together again"
        )
    settings = settings if known is None else default_features.features_of_body(known, settings)
    otherwise = robot_model.check_urdf(logs, settings)
    surface_asked = surface_body.is_asked(settings)
    if surface_asked:
        if known is not None:
            raise UsageError(
                f"{update}: the robot's surface is not learned on; fit all logs together again"
            )
        markers = surface_body.without_surface(settings)
        if default_features.has_no_features(markers):
            return _fit_surface(logs, out, settings, test, leave_out)
        settings = markers
        asked = settings
    if otherwise is not None and default_features.has_no_features(settings):
        return _fit_surface(logs, out, settings, test, leave_out, otherwise)
    if otherwise is not None:
        raise ModelError(f"{otherwise}; rename them in the URDF")
    digests = []
    observed = []
    camera_findings = list[Finding]()
    spared = SparedLogs(leave_out)
    for log in logs:
        with spared.leave_out_unusable(), Copy(log) as read_too:
            read, found = observe(log, settings, progress, guess=True)
            if leave_out:
                require_trainable(log, found, settings)
            observed.append((read, found))
            digests.append((log, read_too.digest()))
            settings = default_features.features_of_log(read, settings)
    given = logs
    logs = spared.require_any([log for log, _ in digests])
    features = select_features_to_learn([found for _, found in observed], settings)
    cameras = features[0].cameras.values() if known is None else known.provenance.get("cameras", ())
    for log, (read, found) in zip(logs, observed, strict=True):
        require_trainable(log, found, settings)
        camera_findings += require_same_camera(log, cameras, read, found)
    if known is None:
        require_sights(logs, observed)
    origin = provenance_of_logs(digests, settings) | (
        {} if update is None else {"update_sha256": hash_files(update)}
    )
    findings = [
        f
        for read, found in observed
        for f in (*read.facts.findings, *found.findings, *sighting_findings(found))
    ]
    robot, unfit = robot_model.find_robot(logs, features, settings)
    features, not_joints = robot_model.joints_of_urdf(features, robot)
    settings = robot_model.with_coordinates(settings, robot)
    may_fall_back = known is None and robot is not None and not any(f.poses for f in features)
    may_fall_back &= default_features.has_no_features(asked)
    try:
        with log_context(logs[0], [*findings, *unfit], len(logs) - 1):
            learned = camera_delay.learn_with_delays(features, settings, origin, known, robot)
    except EvidenceError as problem:
        if not may_fall_back:
            raise
        try:
            return _fit_surface(given, out, asked, test, leave_out, str(problem))
        except InputError as also:
            raise EvidenceError(f"{problem}; nor by the robot's own surface: {also}") from also
    loose = surface_body.describe_loose_marker(learned.scores) if may_fall_back else None
    if loose is not None:
        try:
            return _fit_surface(given, out, asked, test, leave_out, loose)
        except (InputError, UsageError) as problem:
            misjudges = f"{loose}; other postures may be misjudged"
            why_not = f"by the robot's own surface: {problem}"
            findings.append(Finding("warning", f"{misjudges}; {why_not}"))
    learned = replace(learned, model=robot_model.with_robot_chain(learned.model, robot, features))
    if surface_asked:
        recordings = [(log, read) for log, (read, _) in zip(logs, observed, strict=True)]
        learned = surface_body.add_surface(learned, recordings, settings)
    tested, more = score_learned_body(
        learned.model, [(log, *observe(log, settings, progress)) for log in test]
    )
    storage.save(learned.model, out)
    findings = [
        *spared.findings,
        *findings,
        *camera_findings,
        *unfit,
        *not_joints,
        *learned.findings,
        *learned.faint,
        *more,
    ]
    scores = (*learned.scores, *tested)
    placed = calibration.summarise_placements(learned.model)
    others = robot_model.list_joints_not_learned(learned.model, features)
    text = verdict.verdict_of_body(learned.model.joints, scores, placed, others)
    health = merged_health(observed)
    return Result(
        out, Scores(scores), health, tuple(findings), settings_as_values(settings), verdict=text
    )


def _fit_surface(
    logs: Sequence[Path],
    out: Path,
    settings: Settings,
    test: Sequence[Path],
    leave_out: bool,
    why: str | None = None,
) -> Result:
    """Learn a body by the robot's own surface and write
    it; `why`: the reason why there is no other body.
    """
    from .annotating.background_copy import Copy
    from .body import storage
    from .recording import recording
    from .robot import calibration
    from .surface import body as surface_body

    if test:
        raise UsageError(
            "--test: a body of the robot's surface predicts no track; type: bodylog "
            "estimate LOG --body"
        )
    digests = []
    read = list[tuple[Path, Recording]]()
    spared = SparedLogs(leave_out)
    for log in logs:
        with spared.leave_out_unusable(), Copy(log) as read_too:
            read.append((log, recording.read_recording(log, settings, settings.input.strict)))
            digests.append((log, read_too.digest()))
    spared.require_any([log for log, _ in digests])
    learned = surface_body.learn_surface_body(
        read, settings, provenance_of_logs(digests, settings), leave_out
    )
    storage.save(learned.model, out)
    urdf_warnings = (
        ()
        if why is None
        else (Finding("warning", f"{why}; so it is learned by the robot's own surface"),)
    )
    findings = (
        *urdf_warnings,
        *spared.findings,
        *(finding for _, one in read for finding in one.facts.findings),
        *learned.findings,
    )
    placed = calibration.summarise_placements(learned.model)
    text = verdict.verdict_of_body(learned.model.joints, learned.scores, placed)
    by = "by the robot's own surface, without a marker"
    return Result(
        out, Scores(learned.scores), {}, findings, settings_as_values(settings), verdict=(by, *text)
    )


@with_text_paths
def estimate(
    log: Path,
    body: Path | None = None,
    out: Path | None = None,
    settings: Settings = DEFAULTS,
    progress: Progress | None = None,
) -> Result:
    """Replay a log against a learned body and write it back
    with the estimate in it; without one, its joints alone.

    Without `out`, nothing is left behind but the result.
    """
    if out is None:
        with create_scratch_folder() as folder:
            return replace(
                estimate(log, body, folder / "estimate.mcap", settings, progress), output=None
            )
    from . import estimation
    from .annotating import annotate, estimate_metadata, pose_topics
    from .body import storage
    from .robot import model as robot_model

    require_distinct_paths(
        [log, *(robot_model.urdf_files(settings) if body is None else [body])],
        [Output(out)],
        settings,
    )
    typed = settings
    known = None if body is None else storage.load_body(body)
    if known is not None:
        settings = default_features.features_of_body(known, settings)
        estimation.check_estimation_settings(known, settings.estimate)
    with annotate.open_annotation(log, out, limits=settings.input) as written:
        by_joints = known is None or (known.surface is not None and not known.senses)
        read, features = (
            read_joints_alone(log, settings, known)
            if by_joints
            else observe(log, settings, progress)
        )
        learned = body_of_encoders(read, settings) if known is None else known
        cameras = require_same_camera(log, learned.provenance.get("cameras", ()), read, features)
        require_same_size(log, learned, features, settings)
        given = LogWithBody(log, read, features, learned, settings, typed)
        if learned.surface is None:
            found = estimate_log(given)
        else:
            from .surface.estimate import estimate_by_surface

            found = estimate_by_surface(given)
        lost = written.add(estimate_messages(read, features, found))
        read = pose_topics.with_true_poses(log, found, read)
        origin = provenance_of_logs([(log, written.digest())], read.facts.settings)
        written.about(
            origin
            | ({} if body is None else {"body_sha256": hash_files(body)})
            | estimate_metadata.describe_estimate(found)
        )
    findings = (
        *read.facts.findings,
        *features.findings,
        *cameras,
        *found.findings,
        *fault_warnings(found.faults),
        *lost,
    )
    health = {**read.facts.health, **features.health, **found.used}
    return estimate_result(out, found, read, health, findings)


@with_text_paths
def evaluate(log: Path, settings: Settings = DEFAULTS, truth: Path | None = None) -> Result:
    """Score the estimate an annotated log carries; `truth`:
    a table, arrays or a log that has the true angles.
    """
    from .annotating import pose_topics, read_back
    from .recording import recording

    read = recording.read_recording(log, settings, settings.input.strict)
    found = read_back.read_estimate(log, read.start_ns)
    read = pose_topics.with_true_poses(log, found, read)
    if truth is not None:
        read = with_truth_beside_log(truth, found, read, settings)
    findings = (
        *read.facts.findings,
        *fault_warnings(found.faults),
        *truth_findings(found, read.signals.truth),
    )
    return estimate_result(log, found, read, found.used, findings)


@with_text_paths
def ingest(
    log: Path,
    out: Path,
    settings: Settings = DEFAULTS,
    tables: Mapping[str, Path] | None = None,
    progress: Progress | None = None,
    **window: float | None,
) -> Result:
    """Write any log as one tidy MCAP with its roles named;
    `tables`: folders for its signals by form (csv, parquet).
    """
    from .recording import recording, tidy
    from .recording import tables as export

    tables = tables or {}
    require_distinct_paths(
        [log],
        [Output(out), *(Output(folder, f"--{form}", True) for form, folder in tables.items())],
        settings,
    )
    for form in tables:
        export.choose_table_writer(form)  # refused before the log is read
    findings = tuple(tidy.write_tidy_log(log, out, settings, progress=progress, **window))
    for form, folder in tables.items():
        export.export_signals(recording.read_recording(out, Settings()), folder, form)
    return Result(out, findings=findings)


@with_text_paths
def convert(
    logs: Sequence[Path],
    out: Path,
    settings: Settings = DEFAULTS,
    form: str = "mcap",
    how: str = "lossless",
    topics: Sequence[str] | None = None,
    task: str | None = None,
    progress: Progress | None = None,
    **window: float | None,
) -> Result:
    """Write logs in another form: one as a chunked MCAP,
    or several as the episodes of a LeRobot dataset.

    form: mcap, lerobot or lerobot-2.1 · how: a dataset's videos, lossless,
    h264 or av1 · topics: only these, of an MCAP · task: what the robot
    does, of a dataset · window: start, end (s since the log's start).
    """
    from .logs.conversion import extract as conversion
    from .recording import lerobot_writer

    require_distinct_paths(logs, [Output(out)], settings)
    if form not in ("mcap", *lerobot_writer.FORMS):
        raise UsageError(f"--to {form}: possible are mcap, {', '.join(lerobot_writer.FORMS)}")
    if form != "mcap":
        return Result(
            out,
            findings=lerobot_writer.write_lerobot(
                logs, out, settings, form, how, task, progress, **window
            ),
        )
    if len(logs) != 1:
        raise UsageError(
            f"{len(logs)} logs: an MCAP is made of one; a dataset of several, with --to lerobot"
        )
    return Result(
        out, findings=conversion.convert_to_mcap(logs[0], out, topics, progress=progress, **window)
    )


@with_text_paths
def diagnose_log(
    log: Path,
    repair: Path | None = None,
    settings: Settings | None = None,
    progress: Progress | None = None,
    body: Path | None = None,
) -> Result:
    """What is wrong with a log, with settings its camera
    delays too (see delay_findings); `repair`: a sound copy.
    """
    from .body import storage
    from .delays import findings as delay_findings
    from .logs.conversion import examination as logs_doctor
    from .surface import findings as surface_findings

    limits = LIMITS if settings is None else settings.input
    require_distinct_paths(
        [log, *(() if body is None else [body])],
        [] if repair is None else [Output(repair, "--repair")],
    )
    known = None if body is None else storage.load_body(body)
    findings = logs_doctor.examine_log_file(log, limits.strict, limits, progress)
    late = (
        delay_findings.ExaminedDelays()
        if settings is None
        else surface_findings.examine_delays(log, known, settings)
    )
    if repair is not None:
        logs_doctor.rewrite_sound_messages(log, repair, limits)
    return Result(
        repair,
        Scores(late.scores),
        findings=(*findings, *late.findings),
        settings={SURFACE_CHANGES: late.changes} if late.changes else {},
        faults=late.faults,
    )


@with_text_paths
def diagnose_together(results: Sequence[Result], body: Path) -> Result | None:
    """What logs tell together that `diagnose_log` judged by a body of the robot's surface: a
    fault that all have in common. None where fewer than two of them show the arm.
    """
    from .body import storage
    from .surface import findings as surface_findings

    changes = [one.settings[SURFACE_CHANGES] for one in results if SURFACE_CHANGES in one.settings]
    if len(changes) < 2:
        return None
    findings, faults = surface_findings.examine_together(changes, storage.load_body(body))
    return Result(None, findings=findings, faults=faults)


def requested_folders(option: str, *paths: Path | None) -> tuple[Output, ...]:
    """Folders to write into, without those that are not asked for."""
    return tuple(Output(path, option, True) for path in paths if path is not None)


def count_declared_messages(log: Path) -> int:
    """Messages a log declares."""
    from .logs.formats import open_log

    with open_log(log) as opened:
        return sum(topic.messages for topic in opened.topics)
