"""Other people's measurements of real robots: learned and withheld poses, the published figure and ours.

The folder is the user's (docs/real.md says where to get the measurements). Each part in it is judged.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

import numpy as np

from .. import pipeline
from ..errors import BodylogError, UsageError
from ..io.temporary import scratch
from ..score_names import split
from ..settings import Settings
from ..sources import CharucoSource
from .claims import Bound, Claim
from .judging import comparison
from .lab import Lab
from .records import Experiment, Readings, Table, Trial, column

NAO_COLUMNS = ("published_u", "published_v")
BOARD = CharucoSource("10x14", 0.07, 0.04, "4x4_1000", True)
"""The Panda's."""
OFTEN = 35
"""Withheld sightings that a Motoman's track needs to be counted."""


@dataclass(frozen=True)
class Robot:
    """One robot's part: its files, the published figure, and the setup's shared and differing parts."""

    files: tuple[str, ...]
    run: Callable[[Path, Path], dict[str, float]]
    text: str
    measured: str
    unit: str
    published: float
    shared: str
    differences: str


def nao(data: Path, work: Path) -> dict[str, float]:
    """Learned from 250 poses, judged on 500: RMS distance (px) with the URDF, without it, and as published."""
    folder = data / "nao"
    found = {}
    for name in ("left_train.csv", "left_test.csv"):
        _without(folder / name, work / name, NAO_COLUMNS)
    for key, urdf in (("ours", str(folder / "nao.urdf")), ("ours, process alone", None)):
        scores = _fitted(work / "left_train.csv", work / "left_test.csv", work / "nao.npz", urdf)
        found[key] = _named(scores, "rmse/test/")
        found[f"{key}, median"] = _named(scores, "median_error/test/")
        found[f"{key}, within 2 σ in %"] = _named(scores, "coverage_2sigma/test/")
    table = np.genfromtxt(folder / "left_test.csv", delimiter=",", names=True)
    off = np.hypot(table["marker_u"] - table["published_u"], table["marker_v"] - table["published_v"])
    return found | {"published": float(np.sqrt(np.nanmean(off**2))), "published, median": float(np.nanmedian(off))}


def motoman(data: Path, work: Path) -> dict[str, float]:
    """Every third of 216 poses withheld: RMS error (px) per axis over the tracks that are seen often."""
    head, *rows = (data / "motoman" / "leica_left_hand_6x6x6.csv").read_text(encoding="utf-8").splitlines()
    for name, part in {"train": [r for k, r in enumerate(rows) if k % 3 != 2], "test": rows[2::3]}.items():
        (work / f"motoman_{name}.csv").write_text("\n".join([head, *part]) + "\n", encoding="utf-8")
    scores = _fitted(work / "motoman_train.csv", work / "motoman_test.csv", work / "motoman.npz", None)
    seen = {split(name)[1]: value for name, value in scores.items() if split(name)[0] == "sightings/test"}
    often = [name for name, value in seen.items() if value >= OFTEN]
    axes = [float(np.sqrt(np.mean([scores[f"rmse/test_{axis}/{name}"] ** 2 for name in often]))) for axis in "uv"]
    return {"ours": float(np.mean(axes)), "ours, u": axes[0], "ours, v": axes[1], "tracks": float(len(often))}


def panda(data: Path, work: Path) -> dict[str, float]:
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
    train, test = work / "panda_train.csv", work / "panda_test.csv"
    scores = _fitted(train, test, work / "panda.npz", str(data / "panda" / "panda.urdf"), settings)
    axes = [scores[f"rmse/test_{axis}/board"] for axis in "uv"]
    return {"ours": float(np.sqrt(np.mean(np.square(axes)))), "ours, u": axes[0], "ours, v": axes[1]}


def _fitted(train: Path, test: Path, out: Path, urdf: str | None, settings: Settings | None = None) -> dict[str, float]:
    chosen = settings or Settings()
    chosen = replace(chosen, kinematics=replace(chosen.kinematics, urdf=urdf)) if urdf else chosen
    result = pipeline.fit([train], out, chosen, test=[test])
    return {score.name: score.value for score in result.scores}


def _named(scores: Mapping[str, float], name: str) -> float:
    """The score of the only track."""
    return next(value for key, value in scores.items() if key.startswith(name))


def _without(source: Path, out: Path, columns: Sequence[str]) -> None:
    """The table without columns that are results."""
    rows = [line.split(",") for line in source.read_text(encoding="utf-8").splitlines()]
    kept = [k for k, name in enumerate(rows[0]) if name not in columns]
    out.write_text("\n".join(",".join(row[k] for k in kept) for row in rows) + "\n", encoding="utf-8")


ROBOTS: dict[str, Robot] = {
    "NAO": Robot(
        ("nao/left_train.csv", "nao/left_test.csv", "nao/nao.urdf"), nao,
        "500 withheld poses of a NAO: errors are below the published calibration's", "RMS distance", "px", 2.13,
        "the same 250 poses to learn from, the same 500 withheld, the same robot model",
        "published: kinematic parameters alone; ours: kinematics and a Gaussian process on what it leaves",
    ),
    "Motoman": Robot(
        ("motoman/leica_left_hand_6x6x6.csv",), motoman,
        "72 withheld poses of a Motoman are predicted to 0.85 px per axis", "RMS error per axis", "px", 0.85,
        "the poses of the published data set; a prototype of a Gaussian process reached 0.72 to 0.81 px on such splits",
        "no figure on this split is published: the bound is the prototype's; repeated poses scatter by 0.3 to 0.5 px",
    ),
    "Panda": Robot(
        ("panda/panda.urdf", "panda/real_new/poses.csv"), panda,
        "withheld images of a Panda: the board's corners are predicted to 1 px", "RMS error per axis", "px", 1.0,
        "the images of the published data set; a prototype with joint offsets reached 0.85 and 0.43 px in five folds",
        "no figure is published: the bound is above the prototype's; one fold here, five there",
    ),
}  # fmt: skip


def fingerprint(data: Path) -> str:
    """Digest of the folder's tables, 12 hex digits; UsageError where it holds no robot's part."""
    there = [name for robot in ROBOTS.values() for name in robot.files if (data / name).is_file()]
    if not any(complete(data, robot) for robot in ROBOTS.values()):
        needed = "; ".join(", ".join(robot.files) for robot in ROBOTS.values())
        raise UsageError(
            f"--data {data}: no robot's measurements in it; possible: {needed}; docs/real.md says where to get them"
        )
    digest = sha256()
    for name in there:
        digest.update(name.encode() + (data / name).read_bytes())
    return digest.hexdigest()[:12]


def complete(data: Path, robot: Robot) -> bool:
    """Whether all files of a robot's part are there."""
    return all((data / name).is_file() for name in robot.files)


def run(lab: Lab, seed: int, tried: Readings, data: Path) -> Trial:
    """Every robot whose part is in the folder; the others give a reason."""
    figures: dict[str, float] = {}
    missing: dict[str, str] = {}
    for name, robot in ROBOTS.items():
        if not complete(data, robot):
            missing[name] = f"not in {data.name}"
            continue
        with scratch() as work:
            try:
                figures |= {f"{name} {key}": value for key, value in robot.run(data, work).items()}
            except BodylogError as error:
                missing[name] = str(error)
    return {"figures": figures, "panels": [], "said": missing}


def _unasked(lab: Lab, seed: int, tried: Readings) -> Trial:
    raise UsageError("reproduce real: the folder with the measurements is not given; type: --data DIR (docs/real.md)")


def _claims(trials: Sequence[Trial], tried: Readings) -> tuple[Claim, ...]:
    return tuple(_claim(k, name, trials) for k, name in enumerate(ROBOTS, 1) if f"{name} ours" in trials[0]["figures"])


def _claim(number: int, name: str, trials: Sequence[Trial]) -> Claim:
    robot, published = ROBOTS[name], f"{name} published"
    figures = {"published": column(trials, published)} if published in trials[0]["figures"] else {}
    figures["ours"] = column(trials, f"{name} ours")
    bound = Bound("≤", robot.published)
    return comparison(
        f"Real.{number}", robot.text, robot.measured, robot.unit, bound, figures, robot.shared, robot.differences
    )


def _tables(trials: Sequence[Trial]) -> tuple[Table, ...]:
    rows = tuple((name, f"{value:.3f}") for name, value in trials[0]["figures"].items())
    missing = tuple((name, f"not judged: {why}") for name, why in trials[0].get("said", {}).items())
    return (Table("Every figure, px unless named", ("what", "value"), (*rows, *missing)),)


EXPERIMENT = Experiment("Real", "Real robots' poses", _unasked, _claims, (), _tables)
