"""Logs and bodies of the experiments: recorded and learned once, kept in a folder."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

from .. import pipeline
from ..body_model import BodyModel
from ..io import atomic_files
from ..io.temporary import create_scratch_folder
from ..settings import BodySettings, ColourSettings, FitSettings, Settings
from ..types import Array, Features, Series
from ..version import __version__
from .json_values import to_json_value

JOINTS = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")
"""The paper's shoulder 1, shoulder 2 and elbow, the order of x."""
NAMES = ("shoulder 1", "shoulder 2", "elbow")
"""The paper's names."""
EXPLORATION_S = 30.0
"""Duration of an exploration."""
OTHER_LOG_SEED = 1000
"""Added to the seed for another log of the same kind."""


@dataclass(frozen=True, eq=False)
class ObservedLog:
    """A log as found by perception, and the truth beside it."""

    features: Features
    truth: Series

    def true(self, joints: tuple[str, ...], t: Array) -> Array:
        """True angles (N,M) rad of these joints at times t (N,) s."""
        from ..evaluation.scores import truth_at_times

        return truth_at_times(self.truth, list(joints), t)


@dataclass(frozen=True)
class Lab:
    """A folder of recorded logs and learned bodies;
    image size (px), seconds of exploration per body.
    """

    folder: Path
    size: tuple[int, int] = (320, 240)
    exploration: float = EXPLORATION_S
    markers: Mapping[str, str] = field(default_factory=dict)

    def observed(self, scenario: str, seed: int, **options: Any) -> ObservedLog:
        """The features of a recording of `scenario` (options
        as `sim.record_scenario`), made unless it exists.
        """
        settings = self._settings()
        read, features = pipeline.observe(self.log(scenario, seed, **options), settings)
        assert read.signals.truth is not None  # every simulated log carries it
        return ObservedLog(features, read.signals.truth)

    def log(self, scenario: str, seed: int, **options: Any) -> Path:
        """The recording's signals and tracks, without its images."""
        path = self._path(f"{scenario}-{seed}", "mcap", options)
        if not path.exists():
            with create_scratch_folder() as folder:  # another process may be recording the same
                whole = folder / path.name
                pipeline.record(scenario, whole, seed=seed, size=self.size, **options)
                pipeline.extract(whole, path, self._settings())
        return path

    def body(
        self,
        preset: str,
        seed: int,
        scenario: str = "babble",
        joints: tuple[str, ...] = JOINTS,
        touched: bool = False,
        **options: Any,
    ) -> BodyModel:
        """The body learned by fit preset `preset` from an
        exploration, and from a log of touches when `touched`.
        """
        from ..body import storage

        options = {"duration": self.exploration, **options}
        path = self._path(
            f"body-{scenario}-{preset}-{seed}",
            "npz",
            {**options, "joints": joints, "touched": touched},
        )
        if not path.exists():
            settings = replace(
                self._settings(), fit=FitSettings(preset=preset), body=BodySettings(joints=joints)
            )
            strokes = [self.log("touch", seed + OTHER_LOG_SEED)] if touched else []
            pipeline.fit([self.log(scenario, seed, **options), *strokes], path, settings)
        return storage.load_body(path)

    def key(self, options: Mapping[str, Any]) -> str:
        """Digest of a kept file's inputs, 12 hex digits."""
        inputs = {
            **options,
            "size": self.size,
            "exploration": self.exploration,
            "version": __version__,
        }
        inputs["markers"] = dict(self.markers)
        return sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest()[:12]

    def _path(self, name: str, suffix: str, options: Mapping[str, Any]) -> Path:
        self.folder.mkdir(parents=True, exist_ok=True)
        return self.folder / f"{name}-{self.key(options)}.{suffix}"

    def _settings(self) -> Settings:
        return Settings(colours=ColourSettings(markers=self.markers))


def load_or_make(path: Path, make: Any) -> Any:
    """The value in a JSON file; made by `make()` and stored there unless it exists."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps(to_json_value(make()), sort_keys=True)
        atomic_files.write_text_atomically(path, text)
    return json.loads(path.read_text(encoding="utf-8"))
