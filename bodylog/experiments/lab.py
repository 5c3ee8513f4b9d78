"""Where experiments get their logs, bodies and beliefs: recorded and learned once, kept in a folder."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from .. import __version__, files, pipeline
from ..settings import Body, Colours, Estimation, Fit, Settings
from ..types import Array, BodyModel, Estimate, Features, Series

JOINTS = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")
"""The paper's shoulder 1, shoulder 2 and elbow, the order of x."""
EXPLORATION_S = 30.0
"""How long a body is explored for."""
ELSEWHERE = 1000
"""Added to the seed for another log of the same kind."""


@dataclass(frozen=True, eq=False)
class Heard:
    """A log as found by perception, and the truth beside it."""

    features: Features
    truth: Series

    def true(self, joints: tuple[str, ...], t: Array) -> Array:
        """True angles (N,M) rad of these joints at times t (N,) s."""
        from ..evaluation.scores import at_times

        return at_times(self.truth, list(joints), t)


@dataclass(frozen=True)
class Lab:
    """A folder of what was recorded and learned so far; picture size (px), seconds of exploration per body."""

    folder: Path
    size: tuple[int, int] = (320, 240)
    exploration: float = EXPLORATION_S
    shapes: Mapping[str, str] = field(default_factory=dict)

    def heard(self, scenario: str, seed: int, **options: Any) -> Heard:
        """What perception finds in a recording of `scenario` (options as `sim.record`), made when it is not there."""
        settings = self._settings()
        read, features = pipeline.observe(self.log(scenario, seed, **options), settings)
        assert read.truth is not None  # every simulated log carries it
        return Heard(features, read.truth)

    def log(self, scenario: str, seed: int, **options: Any) -> Path:
        """The recording's signals and tracks, without its pictures."""
        path = self._path(f"{scenario}-{seed}", "mcap", options)
        if not path.exists():
            with TemporaryDirectory() as folder:  # another process may be recording the same
                whole = Path(folder) / path.name
                pipeline.record(scenario, whole, seed=seed, size=self.size, **options)
                pipeline.extract(whole, path, self._settings())
        return path

    def body(self, preset: str, seed: int, scenario: str = "babble", joints: tuple[str, ...] = JOINTS,
             touched: bool = False, **options: Any) -> BodyModel:  # fmt: skip
        """The body learned by fit preset `preset` from an exploration, and from a log of touches when `touched`."""
        from ..body import model

        options = {"duration": self.exploration, **options}
        path = self._path(f"body-{scenario}-{preset}-{seed}", "npz", {**options, "joints": joints, "touched": touched})
        if not path.exists():
            settings = replace(self._settings(), fit=Fit(preset=preset), body=Body(joints=joints))
            strokes = [self.log("touch", seed + ELSEWHERE)] if touched else []
            pipeline.fit([self.log(scenario, seed, **options), *strokes], path, settings)
        return model.load(path)

    def key(self, options: Mapping[str, Any]) -> str:
        """What a kept file depends on beside its name, as 12 hex digits."""
        told = {**options, "size": self.size, "exploration": self.exploration, "version": __version__}
        told["shapes"] = dict(self.shapes)
        return sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[:12]

    def _path(self, name: str, suffix: str, options: Mapping[str, Any]) -> Path:
        self.folder.mkdir(parents=True, exist_ok=True)
        return self.folder / f"{name}-{self.key(options)}.{suffix}"

    def _settings(self) -> Settings:
        return Settings(colours=Colours(shapes=self.shapes))


@dataclass(frozen=True, eq=False)
class Belief:
    """A belief over time: t (N,) s · x (N,M) rad, NaN after it diverged · true (N,M) rad."""

    t: Array
    x: Array
    true: Array

    def error(self, since: float) -> Array:
        """Belief minus truth (K,M) rad from `since` s on."""
        return np.asarray((self.x - self.true)[self.t >= since])

    def rmse(self, since: float) -> float:
        """Root mean square error over all joints (rad) from `since` s on; NaN when the belief diverged."""
        return float(np.sqrt(np.mean(self.error(since) ** 2)))


def ours(heard: Heard, body: BodyModel, senses: tuple[str, ...] | None = None, **settings: Any) -> Belief:
    """What our default believes."""
    return believed(estimated(heard, body, Estimation(senses=senses, **settings)), heard)


def estimated(heard: Heard, body: BodyModel, settings: Estimation) -> Estimate:
    """The estimate by these settings."""
    return pipeline.infer(heard.features, body, replace(Settings(), estimate=settings))


def believed(found: Estimate, heard: Heard) -> Belief:
    """An estimate beside the truth."""
    return Belief(found.joints.t, found.joints.values, heard.true(found.joints.names, found.joints.t))


def kalman(heard: Heard, body: BodyModel, start: tuple[float, ...] | None = None) -> Belief:
    """What the paper's Kalman filter believes."""
    return ours(heard, body, ("encoders",), method="kalman", start=start)


def printed(
    heard: Heard, body: BodyModel, senses: tuple[str, ...], start: tuple[float, ...] | None = None,
    sigma_v: float | None = None, implicit: bool = False,
) -> Belief:  # fmt: skip
    """What Algorithm 1 believes with the printed constants, errata applied; `sigma_v` in place of the printed 5.

    `implicit` puts the prediction errors at their equilibrium instead of integrating them.
    """
    from ..estimation import predictive_coding as algorithm
    from ..estimation.plan import plan_for

    settings = Estimation(method="predictive-coding", preset="paper", touch="literal", senses=senses, start=start)
    plan, _, _ = plan_for(heard.features, body, settings)
    if sigma_v is not None:
        changed = [s if s.name == "encoders" else replace(s, sigma=np.full_like(s.sigma, sigma_v)) for s in plan.senses]
        plan = replace(plan, senses=tuple(changed))
    x, _, _ = (algorithm.implicitly if implicit else algorithm.explicitly)(plan)
    return Belief(plan.t, x, heard.true(body.joints, plan.t))


def noisier(heard: Heard, std: float, seed: int) -> Heard:
    """The same log with more noise (rad) on its encoders."""
    joints = heard.features.joints
    assert joints is not None
    noise = std * np.random.default_rng([seed, 11]).standard_normal(joints.values.shape)
    return replace(heard, features=replace(heard.features, joints=replace(joints, values=joints.values + noise)))


def typed(body: BodyModel) -> BodyModel:
    """The body with the printed touch constants, a_1 = 0.001 and b_1 = 1 (1/px²)."""
    return replace(body, touch=replace(body.touch, a1=0.001, b1=1.0))


def shaped(body: BodyModel, width: float) -> BodyModel:
    """The body with a_1 = 1 and f_s of another width 1/√(2 b_1) (px)."""
    return replace(body, touch=replace(body.touch, a1=1.0, b1=1.0 / (2.0 * width**2)))


def kept(path: Path, make: Any) -> Any:
    """The value in a JSON file; made by `make()` and kept there when it is not."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        with files.replacing(path) as beside:
            beside.write_text(json.dumps(_plain(make()), sort_keys=True), encoding="utf-8")
    return json.loads(path.read_text(encoding="utf-8"))


def _plain(value: Any) -> Any:
    """The value without numpy in it; what is not a finite number is null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value
