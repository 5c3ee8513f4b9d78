"""Output for people: figures, the HTML page, a viewer's layout, candidates for features."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .annotating import read_back
from .annotating.written_messages import topic_of_role
from .body_model import BodyModel
from .checks import log_context, require_distinct_paths
from .errors import EvidenceError, FormatError, LogError
from .features.defaults import toml_line
from .findings.faults import fault_warnings
from .findings.result import NO_SCORES, Scores, estimate_result
from .findings.scoring import score_estimate
from .io.atomic_files import ensure_dir, is_archive
from .io.outputs import Output
from .io.remote import errors_about
from .io.temporary import create_scratch_folder
from .logs.decode.columns import read_topic_columns
from .logs.formats import open_log
from .logs.mcap.records import is_mcap
from .logs.protocol import Progress
from .logs.topics import PREFIX
from .pipeline import Result, diagnose_log, ingest, observe, requested_folders
from .recording import recording
from .report.viewers import image_overlay
from .report.viewers.image_overlay import OverlayPicture
from .settings import Settings, hand_colour, settings_as_values
from .sources import CharucoSource, group_of
from .types import Array, Estimate, Features, Finding, Recording

if TYPE_CHECKING:
    from .perception import Candidate
    from .perception.tracking.candidates import FeatureSurvey
    from .report.figures.reprojection import JointZero, ReprojectionSheet
    from .report.viewers.rerun_recording import RerunCamera


def draw_log_or_body(
    source: Path, out: Path, settings: Settings, progress: Progress | None = None
) -> Result:
    """Draw a body model (.npz), or any log: joints,
    pixels, skin, events and trajectories over time.
    """
    from .report.figures import figures

    require_distinct_paths([source], [Output(out)], settings)
    if is_archive(source):
        from .body import storage

        learned = storage.load_body(source)
        with log_context(source):
            from .body.kinematic.placements import image_sizes

        figures.body_figure(learned, out, *_reprojection_sheets(learned), image_sizes(learned))
        return Result(out)
    read, features = observe(source, settings, progress, guess=True)
    with log_context(source):
        figures.recording_figure(read, features, out)
    health = {**read.facts.health, **features.health}
    return Result(
        out,
        NO_SCORES,
        health,
        (*read.facts.findings, *features.findings),
        settings_as_values(settings),
    )


def _reprojection_sheets(
    learned: BodyModel,
) -> "tuple[tuple[ReprojectionSheet, ...], tuple[JointZero, ...]]":
    """Reprojection sheets of a body learned with a URDF, and the joints' zeros."""
    from .body.kinematic.model import KinematicGP
    from .body.kinematic.offsets import learned_zeros as told
    from .body.kinematic.offsets import offsets_as_values as values
    from .body.kinematic.placements import image_sizes
    from .report.figures import reprojection

    senses = {
        name: sense for name, sense in learned.senses.items() if isinstance(sense, KinematicGP)
    }
    if not senses:
        return (), ()
    parts = dict[str, list[Array]]()
    for name, sense in senses.items():
        alone = sense.kinematics(sense.samples)
        both = sense.means(sense.samples)[0]
        rows = np.concatenate([sense.targets, alone, both], axis=1)
        parts.setdefault(group_of(name), []).append(rows)
    drawn = reprojection.merge_rows(parts, image_sizes(learned))
    return drawn, reprojection.parse_zeros(values(told(learned)))


def write_report(
    log: Path,
    out: Path,
    settings: Settings,
    figures: Path | None = None,
    progress: Progress | None = None,
) -> Result:
    """Write one HTML page about an annotated log; with `figures`, also image files in that folder.

    `progress` is called after reading, after drawing
    the images, after the page and after the figures.
    """
    from .report.figures import pose_numbers, reprojection, surface_sheet
    from .report.page import page

    require_distinct_paths([log], [Output(out), *requested_folders("--figures", figures)], settings)
    done = progress or _ignore_progress
    read, features = observe(log, settings)
    found = read_back.read_estimate(log, read.start_ns)
    done(1)
    surface = surface_sheet.surface_pictures(read, found)
    # a log without a marker has nothing else to show in its images
    plain = found.predicted or not surface
    sheets = reprojection.build_sheets(features, found, image_overlay.measure_images(read))
    if read.signals.poses and sheets:
        times = min(sheet.magnified for sheet in sheets)
        shown = image_overlay.draw_pose_pictures(read, features, found, times)
    else:
        shown = image_overlay.draw_pictures(read, features, found) if plain else ()
    done(1)
    findings = (*read.facts.findings, *fault_warnings(found.faults))
    result = estimate_result(out, found, read, found.used, findings)
    metadata = read_back.read_metadata(log)
    if read.signals.poses:
        read, features, found = pose_numbers.number_poses(read, features, found)
    page.write_report_page(
        out,
        found,
        features,
        read,
        result.scores,
        shown,
        metadata,
        result.verdict,
        result.headline,
        surface,
        sheets,
    )
    done(1)
    if figures is not None:
        _write_report_figures(figures, read, features, found, shown, sheets)
        if surface:
            legend = surface_sheet.LEGEND
            image_overlay.overlay_sheet(surface, figures / "surface.png", legend=legend)
        done(1)
    return result


def write_viewer_layout(log: Path, out: Path, settings: Settings) -> Result:
    """Write a viewer's layout for an annotated log."""
    from .report.viewers import foxglove as viewer

    require_distinct_paths([log], [Output(out)], settings)
    read = recording.read_recording(log, settings, settings.input.strict)
    found = read_back.read_estimate(log, read.start_ns)
    viewer.write_foxglove_layout(
        out,
        topic_of_role(read, "camera"),
        found,
        {name: _camera_topic(read, name) for name in read.cameras.views},
    )
    return Result(out)


def show_in_rerun(
    log: Path, out: Path | None, settings: Settings, progress: Progress | None = None
) -> Result:
    """A log as a Rerun recording with measurements and
    estimate over its images; without `out`, in a window.

    `progress` is called when the log is readable for Rerun, converted, drawn over, and merged.
    """
    from .report.viewers import rerun_process

    if out is not None:
        require_distinct_paths([log], [Output(out)], settings)
    rerun_process.require_rerun()
    with create_scratch_folder() as folder:
        recorded = folder / "log.rrd" if out is None else out
        source, lost = _as_mcap(log, folder / "log.mcap", settings)
        done = progress or _ignore_progress
        done(1)
        try:
            result = _write_rerun_recording(log, source, recorded, settings, done)
        except LogError as refused:
            source, lost = _ingest_refused_log(log, folder / "tidy.mcap", settings, refused)
            result = _write_rerun_recording(log, source, recorded, settings, done)
        if out is None:
            rerun_process.open_window(recorded)
    return replace(result, output=out, findings=(*lost, *result.findings))


def _ignore_progress(_: int) -> None:
    """No progress is shown."""


def _write_rerun_recording(
    log: Path, source: Path, out: Path, settings: Settings, done: Progress
) -> Result:
    """The Rerun recording of `source`, a readable copy of `log`."""
    from .report.viewers import rerun_process, rerun_recording

    read = recording.read_recording(source, settings, settings.input.strict)
    found, findings = _read_estimate(log, source, read)
    cameras = _rerun_cameras(source, read)
    drawn = partial(
        rerun_recording.write_companion,
        cameras=cameras,
        features=read.signals.features,
        estimate=found,
        truth=read.signals.truth,
    )
    with errors_about(source, str(log)):
        unshown = rerun_process.merge_recording(
            source, out, f"{log.name} {read.start_ns}", drawn, done
        )
    findings = (*read.facts.findings, *findings, *_unshown_findings(log, unshown, cameras))
    scores = NO_SCORES if found is None else Scores(score_estimate(found, read))
    return Result(out, scores, findings=findings)


def _ingest_refused_log(
    log: Path, out: Path, settings: Settings, refused: LogError
) -> tuple[Path, tuple[Finding, ...]]:
    """`ingest` a log that Rerun `refused`; raise that error
    where the result is empty, or an estimate is lost.
    """
    with open_log(log, settings.input.strict, settings.input) as opened:
        ours = any(topic.name.startswith(PREFIX) for topic in opened.topics)
    with suppress(LogError):
        if not ours:
            lost = ingest(log, out, settings).findings
            text = (
                f"{str(refused).partition('; type: ')[0]}; its joints, skin and images alone are "
                "shown"
            )
            return out, (*lost, Finding("warning", text))
    raise refused


def _unshown_findings(
    log: Path, unshown: Mapping[str, str], cameras: "Mapping[str, RerunCamera]"
) -> list[Finding]:
    """Warnings about entities that Rerun cannot show and that no camera replaces."""
    brought = {camera.entity for camera in cameras.values() if camera.frames is not None}
    left = {entity: why for entity, why in unshown.items() if entity not in brought}
    return [
        Finding("warning", f"{log}: {name}: left out, Rerun cannot show it: {why}")
        for name, why in left.items()
    ]


def _as_mcap(log: Path, out: Path, settings: Settings) -> tuple[Path, tuple[Finding, ...]]:
    """A log that Rerun reads whole: the log itself if sound,
    else `out`: its sound part, or the result of ingest.
    """
    with open_log(log, settings.input.strict, settings.input) as opened:
        kind = opened.format
        findings = opened.findings
    if kind != "mcap":
        return out, ingest(log, out, settings).findings
    if is_mcap(log) and all(finding.severity == "info" for finding in findings):
        return log, ()
    return out, diagnose_log(log, out).findings


def _read_estimate(
    log: Path, source: Path, read: Recording
) -> tuple[Estimate | None, tuple[Finding, ...]]:
    """The estimate in a log, or None and a finding that says how to get one."""
    if any(topic.name == f"{PREFIX}joint_covariance" for topic in read.facts.topics):
        return read_back.read_estimate(source, read.start_ns), ()
    return None, (
        Finding(
            "info", f"no estimate in it; type: bodylog estimate {log} --body body.npz -o out.mcap"
        ),
    )


def _rerun_cameras(log: Path, read: Recording) -> "dict[str, RerunCamera]":
    """Cameras by name, "" the first; videos beside the log are left out."""
    from .report.viewers.rerun_recording import RerunCamera

    frames = {"": read.cameras.frames, **read.cameras.views}
    topics = {name: _camera_topic(read, name) for name in frames}
    return {
        name: RerunCamera(topic, _frame_id(log, topic), frames[name])
        for name, topic in topics.items()
        if topic
    }


def _camera_topic(read: Recording, camera: str) -> str:
    """The image topic of a camera, by its name; "" for a video."""
    return topic_of_role(read, f"camera/{camera}".strip("/")) or ""


def _frame_id(log: Path, topic: str) -> str:
    """The frame_id of a topic's first message, in its header
    or, as protobuf has it, beside it; "" without one.
    """
    with open_log(log) as opened:
        # two publishers may declare two schemas
        of = next(one for one in opened.topics if one.name == topic)
        for field in ("header.frame_id", "frame_id"):
            with suppress(FormatError, LogError, IndexError):  # no such field, or no message
                return str(np.ravel(read_topic_columns(opened, of, (field,)).column(field))[0])
    return ""


@dataclass(frozen=True, eq=False)
class FeatureCandidates:
    """Candidates for features in a log, the likeliest on the
    arm first, as plain values; number of images searched.
    """

    candidates: list[dict[str, Any]]
    images: int
    findings: tuple[Finding, ...]


def find_feature_candidates(
    log: Path,
    out: Path | None,
    settings: Settings,
    effector: tuple[float, float] | None,
    body: Path | None = None,
) -> FeatureCandidates:
    """Tags and colours in a log, and the share of motion
    that the joints explain; `out`: a contact sheet (PNG).

    Where [features] names the robot's own surface, or `body` has one: the corners on its links.
    """
    from .perception import survey_features
    from .report.figures import contact_sheet
    from .surface import body as surface_body

    if out is not None:
        require_distinct_paths([log], [Output(out)], settings)
    read = recording.read_recording(log, settings, settings.input.strict)
    if body is not None or surface_body.is_asked(settings):
        return _find_surface(log, read, out, settings, body)
    with log_context(log):
        found = survey_features(
            read, hand_colour(settings, read.signals.skin is not None), effector
        )
        if not found.candidates:
            raise EvidenceError(
                f"no tag and no colour in {found.count} images; mount a printed tag: "
                "docs/recording.md"
            )
    boards, rest = _with_boards(found)
    offered = [*boards, *((_candidate_as_values(one, one is found.arm), one.track) for one in rest)]
    rows = [row for row, _ in offered]
    if out is not None:
        marks = [
            contact_sheet.Mark(_candidate_caption(row), row["arm"], track) for row, track in offered
        ]
        image_overlay.write_png(contact_sheet.draw_contact_sheet(found.images, marks), out)
    return FeatureCandidates(rows, found.count, read.facts.findings)


def _find_surface(
    log: Path, read: Recording, out: Path | None, settings: Settings, body: Path | None
) -> FeatureCandidates:
    """The corners on a robot's links, of each camera a row; `out`: their tracks, by link."""
    from .report.figures import surface_sheet
    from .surface.calibration import camera_film
    from .surface.findings import linked_cameras
    from .surface.tracks import describe_foreign, trails_as_views

    rows = list[dict[str, Any]]()
    findings = list[Finding]()
    pictures: list[OverlayPicture] = []
    count = 0
    for camera, linked in linked_cameras(log, read, settings, body):
        links, images, row = linked.summarise()
        count = max(count, images)
        rows.append({"name": f"surface of {camera}", **row})
        text = describe_foreign(camera, linked.foreign_share)
        findings.append(Finding("info", f"{text}; corners on {', '.join(links)}"))
        if out is None:
            continue
        views = [surface_sheet.SurfaceView(*one) for one in trails_as_views(linked)]
        film = camera_film(log, read, camera)
        for t, image in surface_sheet.pick_images(film, [one.t for one in views]).items():
            drawn = surface_sheet.draw_surface(image, next(one for one in views if one.t == t))
            pictures.append(image_overlay.OverlayPicture(t, drawn, f"{camera} · {t:.2f} s"))
    if out is not None:
        legend = "tracks of corners: a colour for each link | grey: foreign, left out"
        image_overlay.overlay_sheet(pictures, out, legend=legend)
    return FeatureCandidates(rows, count, (*read.facts.findings, *findings))


def _with_boards(
    found: "FeatureSurvey",
) -> "tuple[list[tuple[dict[str, Any], Array]], list[Candidate]]":
    """Each board as plain values with the track of its
    marker seen most often, and the candidates on no board.
    """
    rest = list(found.candidates)
    boards = list[tuple[dict[str, Any], Array]]()
    for board in found.boards:
        members = [one for one in rest if board.holds(one.source)]
        rest = [one for one in rest if not board.holds(one.source)]
        best = max(members, key=lambda one: (one is found.arm, one.seen))
        counts = f"{board.shape.columns}x{board.shape.rows}"
        row = _candidate_as_values(best, best is found.arm)
        if not row["arm"] and best.why.startswith("seen in"):
            row["why_not"] = (
                f"seen in {best.seen * found.count:.0f} of {found.count} images, 4 are "
                "enough with a URDF"
            )
        source = CharucoSource(counts, 0.0, 0.0, board.dictionary)
        measure = (
            f"measure square and marker, in m; a marker is {board.shape.marker:.2f} of a square"
        )
        row["name"] = f"board {counts} ({board.dictionary})"
        row["kind"] = "board"
        row["line"] = f"{toml_line('board', source)}  # {measure}"
        boards.append((row, best.track))
    return boards, rest


def _candidate_as_values(one: "Candidate", arm: bool) -> dict[str, Any]:
    """A candidate as plain values."""
    line = toml_line("effector", one.source)
    share = {"seen": one.seen, "strays_px": one.strays, "explained": one.explained}
    return {
        "name": one.name,
        "kind": one.kind,
        **share,
        "arm": arm,
        "why_not": one.why or None,
        "line": line,
    }


def _candidate_caption(row: Mapping[str, Any]) -> str:
    explained = "" if row["explained"] is None else f", joints explain {row['explained']:.0%}"
    text = f"{row['name']}: in {row['seen']:.0%} of the images{explained}"
    also = "also moves as the joints do" if row["why_not"] is None else row["why_not"]
    return f"{text}; the arm's: {row['line']}" if row["arm"] else f"{text}; {also}"


def _write_report_figures(
    folder: Path,
    read: Recording,
    features: Features,
    found: Estimate,
    shown: Sequence[OverlayPicture],
    sheets: "Sequence[ReprojectionSheet]",
) -> None:
    from .report.figures import figures, reprojection

    ensure_dir(folder)
    for suffix in (".png", ".svg"):
        figures.recording_figure(read, features, folder / f"recording{suffix}")
        figures.estimate_figure(
            found, read.signals.truth, read.signals.joints, folder / f"estimate{suffix}"
        )
    zeros = reprojection.parse_zeros(found.settings.get("offsets"))
    if sheets:
        for suffix in (".png", ".svg"):
            figures.reprojection_figure(sheets, zeros, folder / f"reprojection{suffix}")
    if shown:
        legend = None
        if read.signals.poses and sheets:
            times = min(sheet.magnified for sheet in sheets)
            legend = f"green dot: measured | yellow arrow: to the calibration's, {times:g} x"
        hand = features.hand is not None
        image_overlay.overlay_sheet(shown, folder / "overlay.png", hand, legend)
