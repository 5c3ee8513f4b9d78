"""Measure the tables of docs/recording.md: errors against seconds of exploration and against the feature's size.

python -m docs.measure_recording [seconds size tag] [--seeds N]      prints them, over seeds 0 to N - 1
"""

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import bodylog.logs as logs
from bodylog import config, pipeline
from bodylog.body import storage
from bodylog.settings import Kinematics, Settings

_ELSEWHERE = 100
"""Added to the seeds of the logs that a body is tested on."""

_AWAY, _FOCAL = 1.20, 0.9 * 640
"""How far (m) the head's camera is from the arm at home, and its focal length in px."""

_TAGGED = '[features]\neffector = { tag = 7, dictionary = "apriltag_36h11" }\n'
_USED = {"reach": 12.0, "drift": 16.0}
"""The scenarios a body is tested on, and their seconds."""


@dataclass(frozen=True)
class Case:
    """One exploration: its feature and the feature's size m, its length s."""

    feature: str = "ball"
    size: float = 0.05
    seconds: float = 40.0

    def options(self, seed: int, seconds: float) -> dict[str, Any]:
        """Options of `record`."""
        return {"feature": self.feature, "feature_size": self.size, "seed": seed, "duration": seconds}


TABLES = {
    "seconds": [Case(seconds=seconds) for seconds in (5.0, 10.0, 20.0, 40.0)],
    "size": [Case(size=size, seconds=20.0) for size in (0.0125, 0.025, 0.05)],
    "tag": [Case("tag", size, 20.0) for size in (0.04, 0.08)],
}
HEAD = (
    "| feature | size cm | px | exploration s | images that show it % | error of the body px "
    "| reach rad | drift rad |\n" + "|---" * 8 + "|"
)


def main() -> None:
    """Print the tables that were asked for, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tables", nargs="*", help=f"of {', '.join(TABLES)}; default: all")
    parser.add_argument("--seeds", type=int, default=3)
    wish = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for name in wish.tables or TABLES:
            print(f"\n{name}\n\n{HEAD}", flush=True)
            for case in TABLES[name]:
                found = [measured(case, seed, Path(folder)) for seed in range(wish.seeds)]
                print(_row(case, np.array(found)), flush=True)


def _row(case: Case, found: np.ndarray) -> str:
    """A row of the table from figures (seeds, 6): medians, and least to most where they are of the body."""
    seen, error, *rest = (_spread(column) for column in found.T[:4])
    beside = [f"{cell} ({np.median(column):.3f})" for cell, column in zip(rest, found.T[4:], strict=True)]
    size = f"{case.size * 100:g} | {case.size * _FOCAL / _AWAY:.0f}"
    return f"| {case.feature} | {size} | {case.seconds:g} | {seen} | {error} | {' | '.join(beside)} |"


def _spread(column: np.ndarray) -> str:
    low, middle, high = np.quantile(column, [0.0, 0.5, 1.0])
    return f"{middle:.3g}" if high - low < 0.005 * high else f"{middle:.3g}, {low:.3g} to {high:.3g}"


def measured(case: Case, seed: int, work: Path) -> tuple[float, ...]:
    """Learn a body and use it on logs of other motions, which are kept in `work`.

    Share of images with the feature %, the body's error px, errors of the estimates of _USED rad, of their encoders.
    """
    explore, body = work / "explore.mcap", work / "body.npz"
    settings = _settings(case, work)
    pipeline.record("babble", explore, **case.options(seed, case.seconds))
    tracked = pipeline.fit([explore], body, settings).health["effector"]
    used = {scenario: _recorded(scenario, seconds, case, seed, work) for scenario, seconds in _USED.items()}
    ends = []
    for log in used.values():
        scores = pipeline.estimate(log, body, work / "estimate.mcap", settings).scores
        values = {score.name: score.value for score in scores}
        ends.append((values["rmse/joint"], values["rmse/encoders"]))
    estimates, encoders = zip(*ends, strict=True)
    return 100 * tracked.used / tracked.seen, body_error(used["reach"], body), *estimates, *encoders


def _recorded(scenario: str, seconds: float, case: Case, seed: int, work: Path) -> Path:
    """The log of that scenario with the case's feature, recorded once."""
    log = work / f"{scenario}-{case.feature}-{case.size}-{seed}.mcap"
    if not log.exists():
        pipeline.record(scenario, log, **case.options(seed + _ELSEWHERE, seconds))
    return log


def _settings(case: Case, work: Path) -> Settings:
    """The defaults without the log's URDF; for a tag, which one it is."""
    if case.feature != "tag":
        return Settings(kinematics=Kinematics(use=False))
    (work / "robot.toml").write_text(_TAGGED)
    return config.load(work / "robot.toml", {"kinematics": {"use": False}})


def body_error(log: Path, body: Path) -> float:
    """Root mean square distance in px between where the body expects the feature and where it truly is."""
    learned = storage.load(body)
    with logs.open(log) as read:
        joints, pixels = read["/truth/joint_states"], read["/truth/effector_pixel"]
        names, t, q = list(joints.name[0]), joints.header.stamp, joints.position
        at, u, v = pixels.header.stamp, pixels.point.x, pixels.point.y
    order = [names.index(name) for name in learned.joints]
    x = np.column_stack([np.interp((at - t[0]) / 1e9, (t - t[0]) / 1e9, q[:, joint]) for joint in order])
    expected = learned.senses["effector"].predict(x)[0]
    return float(np.sqrt(np.mean(np.sum((expected - np.column_stack([u, v])) ** 2, axis=1))))


if __name__ == "__main__":
    main()
