"""What is done to each episode of a dataset that is corrected: delays to take away, frames that
repeat, or a reason to leave it out."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..choices import EXCLUDED
from ..errors import InputError, UsageError
from ..io import episodes
from ..recording.cameras import camera_name_of_source
from ..settings import Settings
from .camera_checks import LATE_S, REPEATED_SHARE
from .judgement import DatasetJudgement, Row

ACCUSED, UNUSABLE = EXCLUDED
SIGNIFICANT_SIGMA = 2.0
_SOUND = (0, 4)
"""Exit codes of rows of which nothing is lost; 4 is a broken bound."""


@dataclass(frozen=True)
class CameraDelay:
    """A camera's delay against the joints (s) that is taken away, with its standard error; whether
    it is the episode's own, or that of all."""

    seconds: float
    std_s: float
    own: bool = False


@dataclass(frozen=True)
class Remedy:
    """What is done to episode `number`: `excluded` says why it is left out, "" if it is not ·
    delays {feature of a camera: CameraDelay} · repeating: features of cameras whose frames repeat.
    """

    number: int
    excluded: str = ""
    delays: Mapping[str, CameraDelay] = field(default_factory=dict)
    repeating: tuple[str, ...] = ()


def choose_remedies(
    judged: DatasetJudgement, settings: Settings, exclude: str
) -> tuple[Path, tuple[Remedy, ...]]:
    """The dataset's folder and the remedy of each episode, in order; UsageError for other logs than
    the episodes of one LeRobot folder."""
    folder = _only_folder(judged.rows)
    copies = dict(_copies(judged))
    found = []
    for row in judged.rows:
        number = episodes.split_episode_name(Path(row["log"]))[1]
        assert number is not None
        why = _reason(row, judged, copies, exclude)
        if why:
            found.append(Remedy(number, why))
            continue
        features = camera_features(Path(row["log"]), settings)
        delays = {
            feature: delay
            for camera, feature in features.items()
            if (delay := _delay(row["name"], camera, judged)) is not None
        }
        repeating = [feature for camera, feature in features.items() if _repeats(camera, judged)]
        found.append(Remedy(number, "", delays, tuple(repeating)))
    return folder, tuple(sorted(found, key=lambda one: one.number))


def _only_folder(rows: Sequence[Row]) -> Path:
    from ..logs.datasets import kinds

    bases = {episodes.split_episode_name(Path(row["log"])) for row in rows}
    folders = {base for base, number in bases if number is not None}
    named = all(number is not None for _, number in bases)
    if len(folders) == 1 and named and kinds.is_episode_dataset(folder := next(iter(folders))):
        return folder
    some = next(iter(rows))["log"] if rows else "nothing"
    raise UsageError(
        f"{some}: fix corrects the episodes of one LeRobot folder; "
        "for other logs type: bodylog convert LOG... -o DATASET --to lerobot"
    )


def camera_features(log: Path, settings: Settings) -> dict[str, str]:
    """The dataset's feature of each camera of an episode, by the camera's name; InputError for a
    log that cannot be read."""
    from ..logs.datasets.episode_log import FEATURE, EpisodeLog
    from ..logs.formats import open_log

    with open_log(log, False, settings.input) as opened:
        if not isinstance(opened, EpisodeLog):
            raise InputError(f"{log}: is no episode of a dataset")
        cameras = opened.cameras.values()
        return {camera_name_of_source(one.topic): one.metadata[FEATURE] for one in cameras}


def _copies(judged: DatasetJudgement) -> Iterator[tuple[str, str]]:
    """Episodes that are equal to an earlier one in every number, with that one's name."""
    first: dict[str, str] = {}
    for row in judged.rows:
        digest = judged.evidence.get(row["name"], {}).get("digest")
        if digest in first:
            yield row["name"], first[digest]
        elif digest:
            first[digest] = row["name"]


def _reason(row: Row, judged: DatasetJudgement, copies: Mapping[str, str], exclude: str) -> str:
    """Why an episode is left out; "" if it is kept."""
    if row["exit_code"] not in _SOUND or row["name"] not in judged.evidence:
        lost = [text for severity, text in row["findings"] if severity == "lost"]
        error = (row["error"] or "").strip().splitlines()[-1:]
        return "; ".join([*error, *lost]) or str(row["status"])
    if exclude == UNUSABLE:
        return ""
    if row["name"] in copies:
        return f"equal to {copies[row['name']]} in every number"
    odd = [one for one in judged.outliers if one.episode == row["name"]]
    return "; ".join(one.text for one in odd if not _is_camera_delay_alone(one.figures))


def _is_camera_delay_alone(figures: Sequence[str]) -> bool:
    """Whether an episode stands out in delays of cameras alone: these are corrected."""
    return all(one.startswith("delay/") and one != "delay/action" for one in figures)


def _delay(name: str, camera: str, judged: DatasetJudgement) -> CameraDelay | None:
    """The delay of a camera in an episode: its own where that stands out, else that of all, where
    it is significant."""
    figure = f"delay/{camera}"
    odd = {f for one in judged.outliers if one.episode == name for f in one.figures}
    own = judged.evidence[name]["figures"].get(figure)
    if figure in odd and own is not None and own[1] is not None:
        return CameraDelay(own[0], own[1], True)
    pooled = judged.pooled.get(figure)
    if pooled is None or abs(pooled.mean) < max(LATE_S, SIGNIFICANT_SIGMA * pooled.std):
        return None
    return CameraDelay(pooled.mean, pooled.std)


def _repeats(camera: str, judged: DatasetJudgement) -> bool:
    """Whether frames of a camera repeat in most episodes."""
    scores = {one.name: one.value for one in judged.scores}
    return scores.get(f"repeated/{camera}", 0.0) >= REPEATED_SHARE
