"""Inputs that the pipeline rejects: an output that
is an input, logs without features, unknown names.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from .body_model import BodyModel
from .errors import ConfigError, EvidenceError, InputError, LogError, ModelError
from .io.atomic_files import require_regular
from .io.outputs import Output, guard_outputs
from .settings import ColourSettings, Settings
from .sources import TableSource, feature_of, group_of
from .types import Features, Finding, Health, Recording
from .wording import UNUSABLE_URDF, list_in_words


def require_distinct_paths(
    read: Sequence[Path], write: Iterable[Output], settings: Settings | None = None
) -> None:
    """UsageError when an output is an input, or a video that
    the settings name; LogError when an input is a pipe.
    """
    beside = () if settings is None else tuple(named_files(read, settings))
    for one in read:
        require_regular(one)
    guard_outputs([*read, *beside], write)


def named_files(logs: Iterable[Path], settings: Settings) -> Iterator[Path]:
    """Files read along with the logs: videos and tables that settings name, images of poses."""
    from .logs.datasets.tables import table_beside
    from .logs.tables.pose_log import image_files
    from .recording.cameras import is_video_source

    videos = [name for name in settings.topics.cameras if is_video_source("camera", name)]
    tables = (
        source.table for source in settings.features.values() if isinstance(source, TableSource)
    )
    logs = tuple(logs)
    for name in (*videos, *tables):
        yield from (Path(name), *(log.parent / name for log in logs))
    films = (path for name in videos for path in (Path(name), *(log.parent / name for log in logs)))
    yield from (table for film in films if (table := table_beside(film)) is not None)
    for log in logs:
        yield from image_files(log)


def require_features(log: Path, features: Features) -> None:
    """LogError when there is nothing to extract."""
    if not features.tracks and not features.touches:
        raise LogError(
            f"{log}: neither camera nor skin gave anything to extract; type: bodylog info {log}"
        )


def require_trainable(log: Path, found: Features, settings: Settings) -> None:
    """LogError when a body cannot be learned from a log: no
    joints, or a configured reference or feature is missing.
    """
    if found.joints is None or not len(found.joints.t):
        raise LogError(f"{log}: no joint readings to learn from; type: bodylog info {log}")
    if found.reference is None and (topic := settings.topics.reference):
        raise LogError(
            f'{log}: [topics] reference = "{topic}", but it has no such topic; type: bodylog '
            f"info {log}"
        )
    needed = {"effector", *settings.features} - {"hand"}
    require_tracks(
        log, {n: h for n, h in found.health.items() if feature_of(n) in needed}, found, settings
    )


def require_sights(logs: Sequence[Path], observed: Sequence[tuple[Recording, Features]]) -> None:
    """EvidenceError where no log has images or tracks: what the first one has, and what to add."""
    if any(found.tracks or read.cameras.frames is not None for read, found in observed):
        return
    read, found = observed[0]
    with log_context(logs[0], read.facts.findings, len(logs) - 1):
        what = f"no images and no tracks in it, only {_describe_joints(found)}"
        # of a table: which columns lack others
        warnings = [one.text for one in read.facts.findings if one.severity == "warning"]
        odd = [text.removeprefix(f"{logs[0]}: ") for text in warnings if found.poses]
        what = "; ".join([*odd, what])
        learned_from = "a body is learned from joints and what a camera sees of the arm"
        raise EvidenceError(f"{what}; {learned_from}{_sights_to_add(logs[0], read)}")


def _describe_joints(found: Features) -> str:
    assert found.joints is not None
    names = found.joints.names
    times = found.joints.t
    length = f"in {len(times)} poses" if found.poses else f"for {times[-1] - times[0]:.1f} s"
    return f"{len(names)} joint{'s' * (len(names) != 1)} ({list_in_words(names)}) {length}"


def _sights_to_add(log: Path, read: Recording) -> str:
    """What to add to a log without images; "" where what it lost says so."""
    from .logs.images.messages import PACKETS, is_packets
    from .recording.topic_tracks import find_point_topic

    if loss_note(log, read.facts.findings):
        return ""
    if read.signals.poses:
        return (
            ": add columns NAME_u and NAME_v (px) of a marker, NAME_x, NAME_y and NAME_z (m) of a "
            "point in space, or of names of image files beside the table"
        )
    if packed := next((topic.name for topic in read.facts.topics if is_packets(topic)), None):
        return f"; {packed} holds {PACKETS}"
    if point := find_point_topic(read.facts.topics):
        named = f"[features] effector = {{ topic = {json.dumps(point)} }}"
        return f"; if {point} is the marker's place, name it in robot.toml: {named}"
    film = '[topics] camera = "file.mp4"'
    alone = f"for the joints alone, type: bodylog estimate {log} -o out.mcap"
    return f": record a camera's topic too, or name a video beside the log, {film}; {alone}"


def select_features_to_learn(features: Sequence[Features], settings: Settings) -> list[Features]:
    """The features without the tracks named in [fit]
    without; ConfigError for a name without a track.
    """
    left = set(settings.fit.without)
    tracks = sorted({name for one in features for name in one.tracks})
    names = {*tracks, *map(group_of, tracks), *map(feature_of, tracks)}
    if unknown := sorted(left - names):
        raise ConfigError(
            f"[fit] without: found {unknown[0]!r}, possible: "
            f"{', '.join(tracks) or 'none, no track'}"
        )
    dropped = {name for name in tracks if {name, group_of(name), feature_of(name)} & left}
    return [
        replace(
            one,
            tracks={name: track for name, track in one.tracks.items() if name not in dropped},
            boards={
                name: board for name, board in one.boards.items() if not dropped & set(board[0])
            },
        )
        for one in features
    ]


def require_tracks(
    log: Path,
    used_of: Mapping[str, Health],
    features: Features,
    settings: Settings,
    instead: str = "",
) -> None:
    """EvidenceError if a feature that robot.toml names, or whose camera it names, is never seen."""
    configured = {"effector": settings.colours.effector != ColourSettings().effector}
    configured |= dict.fromkeys(settings.colours.markers, True)
    configured |= dict.fromkeys(settings.features, True)
    some = {group_of(name) for name, used in used_of.items() if used.used}
    for name, used in used_of.items():
        explicit = configured.get(name.split("/")[-1], configured.get(feature_of(name)))
        if (
            explicit is not None
            and group_of(name) not in some
            and (explicit or settings.topics.cameras)
        ):
            seen = (
                f"{name}: nothing usable in {used.seen} pictures of the camera or feature that "
                "robot.toml names"
            )
            about = (f"{name}: ", f"{feature_of(name)}: ")
            reason = next(
                (finding.text for finding in features.findings if finding.text.startswith(about)),
                seen,
            )
            raise EvidenceError(f"{log}: {reason}{instead.format(name)}")


def require_same_camera(
    log: Path, learned: Iterable[str], read: Recording, features: Features
) -> tuple[Finding, ...]:
    """ModelError when the log's first camera is not the body's first although the log has that one.

    A finding when it has another name; () when the cameras of body or log are unknown.
    """
    from .recording.cameras import camera_name_of_source

    known, here = (
        [str(topic) for topic in topics] for topics in (learned, features.cameras.values())
    )
    if not known or not here or camera_name_of_source(known[0]) == camera_name_of_source(here[0]):
        return ()
    text = f"camera: {here[0]} comes first here, {known[0]} where the body was learned"
    there = {
        camera_name_of_source(name)
        for name in (*here, *(topic.name for topic in read.facts.topics))
    }
    if camera_name_of_source(known[0]) in there or camera_name_of_source(here[0]) in map(
        camera_name_of_source, known
    ):
        advice = json.dumps(known if len(known) > 1 else known[0])
        raise ModelError(
            f"{log}: {text}; type: [topics] camera = {advice}, for the log as it was recorded"
        )
    return (Finding("info", text),)


def require_same_size(
    log: Path, learned: BodyModel, features: Features, settings: Settings
) -> None:
    """ModelError when the images used are not as wide as those the body was learned from."""
    from .estimation.measurements.gather import choose_senses

    size = features.picture_size
    width = learned.provenance.get("image_width")
    visual = [name for name in features.tracks if name in learned.senses and "/" not in name]
    if (
        size
        and width
        and size[0] != round(width)
        and choose_senses(visual, learned, settings.estimate).intersection(visual)
    ):
        raise ModelError(
            f"{log}: camera: images are {size[0]} px wide, {width:g} px where the body was "
            "learned; fit a body from "
            f"a log of {size[0]} px, or go on with the rest: --without vision,touch"
        )


@contextmanager
def log_context(log: Path, findings: Iterable[Finding] = (), others: int = 0) -> Iterator[None]:
    """Prefix input errors in a `with` with the log
    (and the number of others), and append its losses.
    """
    try:
        yield
    except InputError as problem:
        logs = f"{log} and {others} more" if others else f"{log}"
        raise type(problem)(f"{logs}: {problem}{loss_note(log, findings)}") from problem


class SparedLogs:
    """Logs of a dataset that teach nothing: each a finding where they may be left out, as long as
    another one is left."""

    def __init__(self, may_be_left_out: bool) -> None:
        """`may_be_left_out`: else a log's error is raised."""
        self._may_be_left_out = may_be_left_out
        self._problems = list[InputError]()

    @property
    def findings(self) -> tuple[Finding, ...]:
        """A warning for each log that is left out."""
        return tuple(Finding("warning", f"{one}; it is left out") for one in self._problems)

    @contextmanager
    def leave_out_unusable(self) -> Iterator[None]:
        """Take down the input error of a log, where it may be left out."""
        try:
            yield
        except InputError as problem:
            if not self._may_be_left_out:
                raise
            self._problems.append(problem)

    def require_any(self, left: Sequence[Path]) -> Sequence[Path]:
        """The logs that are left; the first one's error where none is."""
        if not left:
            raise self._problems[0]
        return left


def loss_note(log: Path, findings: Iterable[Finding]) -> str:
    """A log's losses, unusable messages and unusable
    URDF, for the end of an error that they may explain.
    """
    causes = ("no usable message", UNUSABLE_URDF)
    texts = (
        f.text for f in findings if f.severity == "lost" or any(cause in f.text for cause in causes)
    )
    return "".join(f"; {text.removeprefix(f'{log}: ')}" for text in texts)
