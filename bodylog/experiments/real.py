"""Other people's measurements of real robots: learned
and withheld poses, the published figure and ours.

The folder is the user's (docs/real.md says where to
get the measurements). Each part in it is judged.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

import numpy as np

from .. import pipeline
from ..errors import BodylogError, UsageError
from ..io.temporary import create_scratch_folder
from ..score_names import split_score_name
from ..settings import Settings
from ..sources import CharucoSource
from .claims import Bound, Claim
from .judging import judge_comparison
from .lab import Lab
from .records import Experiment, ExperimentReadings, TextTable, Trial, figure_column

NAO_COLUMNS = ("published_u", "published_v")
MOTOMAN_TRACKER_COLUMNS = ("leica_x", "leica_y", "leica_z")
"""What a laser tracker measured beside the images, which are judged alone."""
BOARD = CharucoSource("10x14", 0.07, 0.04, "4x4_1000", True)
"""The Panda's."""
MIN_TRACK_SIGHTINGS = 35
"""Withheld sightings that a Motoman's track needs to be counted."""


@dataclass(frozen=True)
class RealRobot:
    """One robot's part: its files, the published
    figure, and the setup's shared and differing parts.
    """

    files: tuple[str, ...]
    run: Callable[[Path, Path], dict[str, float]]
    text: str
    measured: str
    unit: str
    published: float
    shared: str
    differences: str


def measure_nao(data: Path, work: Path) -> dict[str, float]:
    """Learned from 250 poses, judged on 500: RMS distance
    (px) with the URDF, without it, and as published.
    """
    folder = data / "nao"
    found = {}
    for name in ("left_train.csv", "left_test.csv"):
        _write_without_columns(folder / name, work / name, NAO_COLUMNS)
    for key, urdf in (("ours", str(folder / "nao.urdf")), ("ours, process alone", None)):
        scores = _fit_and_score(
            work / "left_train.csv", work / "left_test.csv", work / "nao.npz", urdf
        )
        found[key] = _find_track_score(scores, "rmse/test/")
        found[f"{key}, median"] = _find_track_score(scores, "median_error/test/")
        found[f"{key}, within 2 σ in %"] = _find_track_score(scores, "coverage_2sigma/test/")
    table = np.genfromtxt(folder / "left_test.csv", delimiter=",", names=True)
    off = np.hypot(
        table["marker_u"] - table["published_u"], table["marker_v"] - table["published_v"]
    )
    return found | {
        "published": float(np.sqrt(np.nanmean(off**2))),
        "published, median": float(np.nanmedian(off)),
    }


def measure_motoman(data: Path, work: Path) -> dict[str, float]:
    """Every third of 216 poses withheld: RMS error
    (px) per axis over the tracks that are seen often.
    """
    images = work / "motoman.csv"
    table = data / "motoman" / "leica_left_hand_6x6x6.csv"
    _write_without_columns(table, images, MOTOMAN_TRACKER_COLUMNS)
    head, *rows = images.read_text(encoding="utf-8").splitlines()
    for name, part in {
        "train": [r for k, r in enumerate(rows) if k % 3 != 2],
        "test": rows[2::3],
    }.items():
        (work / f"motoman_{name}.csv").write_text("\n".join([head, *part]) + "\n", encoding="utf-8")
    scores = _fit_and_score(
        work / "motoman_train.csv", work / "motoman_test.csv", work / "motoman.npz", None
    )
    seen = {
        split_score_name(name)[1]: value
        for name, value in scores.items()
        if split_score_name(name)[0] == "sightings/test"
    }
    often = [name for name, value in seen.items() if value >= MIN_TRACK_SIGHTINGS]
    axes = [
        float(np.sqrt(np.mean([scores[f"rmse/test_{axis}/{name}"] ** 2 for name in often])))
        for axis in "uv"
    ]
    return {
        "ours": float(np.mean(axes)),
        "ours, u": axes[0],
        "ours, v": axes[1],
        "tracks": float(len(often)),
    }


def measure_panda(data: Path, work: Path) -> dict[str, float]:
    """Every fifth of 43 images withheld: RMS error (px) of the board's corners."""
    folder = data / "panda" / "real_new"
    head, *rows = (folder / "poses.csv").read_text(encoding="utf-8").splitlines()
    parts = {"train": [r for k, r in enumerate(rows) if k % 5 != 4], "test": rows[4::5]}
    for name, part in parts.items():
        for row in part:
            image = row.split(",")[0]
            (work / image).write_bytes((folder / image).read_bytes())
        (work / f"panda_{name}.csv").write_text("\n".join([head, *part]) + "\n", encoding="utf-8")
    settings = replace(Settings(), features={"board": BOARD})
    train = work / "panda_train.csv"
    test = work / "panda_test.csv"
    scores = _fit_and_score(
        train, test, work / "panda.npz", str(data / "panda" / "panda.urdf"), settings
    )
    axes = [scores[f"rmse/test_{axis}/board"] for axis in "uv"]
    return {
        "ours": float(np.sqrt(np.mean(np.square(axes)))),
        "ours, u": axes[0],
        "ours, v": axes[1],
    }


def _fit_and_score(
    train: Path, test: Path, out: Path, urdf: str | None, settings: Settings | None = None
) -> dict[str, float]:
    chosen = settings or Settings()
    chosen = replace(chosen, kinematics=replace(chosen.kinematics, urdf=urdf)) if urdf else chosen
    result = pipeline.fit([train], out, chosen, test=[test])
    return {score.name: score.value for score in result.scores}


def _find_track_score(scores: Mapping[str, float], name: str) -> float:
    """The score of the only track."""
    return next(value for key, value in scores.items() if key.startswith(name))


def _write_without_columns(source: Path, out: Path, columns: Sequence[str]) -> None:
    """The table without columns that are results."""
    rows = [line.split(",") for line in source.read_text(encoding="utf-8").splitlines()]
    kept = [k for k, name in enumerate(rows[0]) if name not in columns]
    out.write_text(
        "\n".join(",".join(row[k] for k in kept) for row in rows) + "\n", encoding="utf-8"
    )


ROBOTS: dict[str, RealRobot] = {
    "NAO": RealRobot(
        ("nao/left_train.csv", "nao/left_test.csv", "nao/nao.urdf"),
        measure_nao,
        "500 withheld poses of a NAO: errors are below the published calibration's",
        "RMS distance",
        "px",
        2.13,
        "the same 250 poses to learn from, the same 500 withheld, the same robot model",
        "published: kinematic parameters alone; ours: kinematics and a Gaussian process on "
        "what it leaves",
    ),
    "Motoman": RealRobot(
        ("motoman/leica_left_hand_6x6x6.csv",),
        measure_motoman,
        "72 withheld poses of a Motoman are predicted to 0.85 px per axis",
        "RMS error per axis",
        "px",
        0.85,
        "the poses of the published data set; a prototype of a Gaussian process reached 0.72 "
        "to 0.81 px on such splits",
        "no figure on this split is published: the bound is the prototype's; repeated poses "
        "scatter by 0.3 to 0.5 px",
    ),
    "Panda": RealRobot(
        ("panda/panda.urdf", "panda/real_new/poses.csv"),
        measure_panda,
        "withheld images of a Panda: the board's corners are predicted to 1 px",
        "RMS error per axis",
        "px",
        1.0,
        "the images of the published data set; a prototype with joint offsets reached 0.85 "
        "and 0.43 px in five folds",
        "no figure is published: the bound is above the prototype's; one fold here, five there",
    ),
}


def digest_tables(data: Path) -> str:
    """Digest of the folder's tables, 12 hex digits; UsageError where it holds no robot's part."""
    there = [name for robot in ROBOTS.values() for name in robot.files if (data / name).is_file()]
    if not any(has_all_files(data, robot) for robot in ROBOTS.values()):
        needed = "; ".join(", ".join(robot.files) for robot in ROBOTS.values())
        raise UsageError(
            f"--data {data}: no robot's measurements in it; possible: {needed}; docs/real.md "
            "says where to get them"
        )
    digest = sha256()
    for name in there:
        digest.update(name.encode() + (data / name).read_bytes())
    return digest.hexdigest()[:12]


def has_all_files(data: Path, robot: RealRobot) -> bool:
    """Whether all files of a robot's part are there."""
    return all((data / name).is_file() for name in robot.files)


def run_real_robots(lab: Lab, seed: int, tried: ExperimentReadings, data: Path) -> Trial:
    """Every robot whose part is in the folder; the others give a reason."""
    figures: dict[str, float] = {}
    missing: dict[str, str] = {}
    for name, robot in ROBOTS.items():
        if not has_all_files(data, robot):
            missing[name] = f"not in {data.name}"
            continue
        with create_scratch_folder() as work:
            try:
                figures |= {f"{name} {key}": value for key, value in robot.run(data, work).items()}
            except BodylogError as error:
                missing[name] = str(error)
    return {"figures": figures, "panels": [], "said": missing}


def _refuse_without_data(lab: Lab, seed: int, tried: ExperimentReadings) -> Trial:
    raise UsageError(
        "reproduce real: the folder with the measurements is not given; type: --data DIR "
        "(docs/real.md)"
    )


def _claim_real_robots(trials: Sequence[Trial], tried: ExperimentReadings) -> tuple[Claim, ...]:
    return tuple(
        _claim_one_robot(k, name, trials)
        for k, name in enumerate(ROBOTS, 1)
        if f"{name} ours" in trials[0]["figures"]
    )


def _claim_one_robot(number: int, name: str, trials: Sequence[Trial]) -> Claim:
    robot = ROBOTS[name]
    published = f"{name} published"
    figures = (
        {"published": figure_column(trials, published)} if published in trials[0]["figures"] else {}
    )
    figures["ours"] = figure_column(trials, f"{name} ours")
    bound = Bound("≤", robot.published)
    return judge_comparison(
        f"Real.{number}",
        robot.text,
        robot.measured,
        robot.unit,
        bound,
        figures,
        robot.shared,
        robot.differences,
    )


def _tabulate_real_robots(trials: Sequence[Trial]) -> tuple[TextTable, ...]:
    rows = tuple((name, f"{value:.3f}") for name, value in trials[0]["figures"].items())
    missing = tuple((name, f"not judged: {why}") for name, why in trials[0].get("said", {}).items())
    return (TextTable("Every figure, px unless named", ("what", "value"), (*rows, *missing)),)


EXPERIMENT = Experiment(
    "Real",
    "Real robots' poses",
    _refuse_without_data,
    _claim_real_robots,
    (),
    _tabulate_real_robots,
)
