"""Rendered explorations of some length with some marker, the body learned from each, and its errors in other logs."""

import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import bodylog.logs as logs
from bodylog import config, pipeline
from bodylog.body import storage
from bodylog.settings import KinematicsSettings, Settings

SEEDS = 3
_ELSEWHERE = 100
"""Added to the seeds of the logs that a body is tested on."""

AWAY, FOCAL = 1.20, 0.9 * 640
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


def rows(cases: Iterable[Case]) -> Iterator[list[str]]:
    """Of each case: images that show the marker %, the body's error px, errors rad of the estimates of _USED."""
    with tempfile.TemporaryDirectory() as folder:
        for case in cases:
            found = np.array([measured(case, seed, Path(folder)) for seed in range(SEEDS)])
            yield [_spread(column) for column in found.T]


def _spread(column: np.ndarray) -> str:
    low, middle, high = np.quantile(column, [0.0, 0.5, 1.0])
    return f"{middle:.3g}" if high - low < 0.005 * high else f"{middle:.3g}, {low:.3g} to {high:.3g}"


def measured(case: Case, seed: int, work: Path) -> tuple[float, ...]:
    """Learn a body and use it on logs of other motions, which are kept in `work`.

    Share of images with the feature %, the body's error px, errors of the estimates of _USED rad.
    """
    explore, body = work / "explore.mcap", work / "body.npz"
    settings = _settings(case, work)
    pipeline.record("babble", explore, **case.options(seed, case.seconds))
    tracked = pipeline.fit([explore], body, settings).health["effector"]
    used = {scenario: _recorded(scenario, seconds, case, seed, work) for scenario, seconds in _USED.items()}
    ends = []
    for log in used.values():
        scores = pipeline.estimate(log, body, work / "estimate.mcap", settings).scores
        ends.append(next(score.value for score in scores if score.name == "rmse/joint"))
    return 100 * tracked.used / tracked.seen, body_error(used["reach"], body), *ends


def _recorded(scenario: str, seconds: float, case: Case, seed: int, work: Path) -> Path:
    """The log of that scenario with the case's feature, recorded once."""
    log = work / f"{scenario}-{case.feature}-{case.size}-{seed}.mcap"
    if not log.exists():
        pipeline.record(scenario, log, **case.options(seed + _ELSEWHERE, seconds))
    return log


def _settings(case: Case, work: Path) -> Settings:
    """The defaults without the log's URDF; for a tag, which one it is."""
    if case.feature != "tag":
        return Settings(kinematics=KinematicsSettings(use=False))
    (work / "robot.toml").write_text(_TAGGED)
    return config.load_settings(work / "robot.toml", {"kinematics": {"use": False}})


def body_error(log: Path, body: Path) -> float:
    """Root mean square distance in px between where the body expects the feature and where it truly is."""
    learned = storage.load_body(body)
    with logs.open(log) as read:
        joints, pixels = read["/truth/joint_states"], read["/truth/effector_pixel"]
        names, t, q = list(joints.name[0]), joints.header.stamp, joints.position
        at, u, v = pixels.header.stamp, pixels.point.x, pixels.point.y
    order = [names.index(name) for name in learned.joints]
    x = np.column_stack([np.interp((at - t[0]) / 1e9, (t - t[0]) / 1e9, q[:, joint]) for joint in order])
    expected = learned.senses["effector"].predict(x)[0]
    return float(np.sqrt(np.mean(np.sum((expected - np.column_stack([u, v])) ** 2, axis=1))))
