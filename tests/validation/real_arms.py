"""Error bars where encoders and joints have the errors of real arms: play, sag, correlated errors, stick-slip.

The logs are of an independent generator; the folder is not part of this project.
"""

from functools import cache
from pathlib import Path

import numpy as np

from bodylog import config, pipeline
from bodylog.delays import camera_delay
from bodylog.evaluation.scores import truth_at_times
from bodylog.experiments.lab import ObservedLog
from bodylog.types import HARDWARE_ERRORS, LASTING_ERROR
from tests.validation import figures

FOLDER = Path(__file__).parents[3] / "shared" / "logs" / "hardware"
RUNS = 2
KINDS = {
    "none": ("sound", "sound"),
    "correlated over 0.2 s, 1 mrad": ("correlated_02s", "correlated_02s"),
    "correlated over 2 s, 2 mrad": ("correlated_2s", "correlated_2s"),
    "12 bit": ("quantised", "quantised"),
    "heavy tails": ("heavy_tails", "heavy_tails"),
    "outliers": ("outliers", "outliers"),
    "stamps that jitter": ("stamp_jitter", "stamp_jitter"),
    "rolling shutter, 20 ms": ("rolling_shutter", "rolling_shutter"),
    "play of 0.25°": ("play_025", "play_025"),
    "play of 1°": ("play_1", "play_1"),
    "sag of 0.5°": ("sag_05", "sag_05"),
    "stick-slip": ("stick_slip", "stick_slip"),
    "payload, 0.2°, in the run only": ("sound", "payload_02"),
    "payload, 0.5°, in the run only": ("sound", "payload_05"),
    "payload, 1°, in the run only": ("sound", "payload_1"),
    "all of these, mild": ("realistic", "realistic"),
}
"""Error: the exploration that the body is learned from, and the runs."""
METHODS = ("filter", "smoother")


def ready():
    """Whether the logs are at hand."""
    return FOLDER.is_dir()


def table():
    """A row for each error of the hardware."""
    head = (
        f"error of the hardware ({RUNS} runs of 16 s each)",
        "raw encoders, mrad",
        *(f"`{method}`, mrad; NEES; within 2σ" for method in METHODS),
        "faults named (filter)",
        "logs explained, with wider bars (filter)",
    )
    return figures.table(head, [row(name, *files) for name, files in KINDS.items()])


@cache
def settings():
    """The settings beside the logs."""
    return config.load_settings(FOLDER / "robot.toml")


@cache
def learned(name):
    """The body that `fit` learns from an exploration."""
    _, features = pipeline.observe(FOLDER / f"{name}_explore.mcap", settings())
    return camera_delay.learn_with_delays([features], settings(), {}, None).model


@cache
def log(name):
    """A run with its truth."""
    read, features = pipeline.observe(FOLDER / f"{name}.mcap", settings())
    return ObservedLog(features, read.signals.truth)


def row(name, exploration, run):
    """Figures over the runs, with truth: the angles of the links."""
    logs = [log(f"{run}_run{number}") for number in range(RUNS)]
    cells = []
    counts = ()
    for method in METHODS:
        runs = [figures.found(one, learned(exploration), method) for one in logs]
        nees = np.mean([found.nees.mean() for found in runs])
        coverage = 100.0 * np.mean([found.coverage for found in runs])
        cells.append(f"{figures.mrad(runs)}; {figures.joined([nees])}; {coverage:.0f} %")
        counts = counts or (
            str(sum(len(found.faults) for found in runs)),
            ", ".join(
                str(sum(key in found.settings for found in runs))
                for key in (HARDWARE_ERRORS, LASTING_ERROR)
            ),
        )
    raw = 1e3 * figures.rms([raw_error(one, learned(exploration)) for one in logs])
    return (name, f"{raw:.3g}", *cells, *counts)


def raw_error(one, model):
    """Root mean square error (rad) of the encoders' readings."""
    joints = one.features.joints
    names = [joint for joint in one.truth.names if joint in model.joints]
    columns = [joints.names.index(joint) for joint in names]
    return figures.rms(joints.values[:, columns] - truth_at_times(one.truth, names, joints.t))
