"""How exact tracked centres are: distance to the true place over rendered JPEG logs, by default and with `--fast`."""

from pathlib import Path

import numpy as np

from bodylog import logs, pipeline, sim
from bodylog.io.temporary import create_scratch_folder
from bodylog.settings import ColourSettings, Settings
from tests.validation import figures

SECONDS, SMALL, LARGE = 16.0, (320, 240), (640, 480)
KINDS = {
    "babble, 320 × 240": ("babble", SMALL, 3),
    "reach, 320 × 240": ("reach", SMALL, 3),
    "touch (a hand beside a still effector), 320 × 240": ("touch", SMALL, 3),
    "babble, 640 × 480": ("babble", LARGE, 1),
}


def table():
    """A row for each kind of log."""
    columns = (f"{name}: median, 99th percentile, px; NEES" for name in ("default", "`--fast`"))
    head = (f"logs of {SECONDS:g} s", *columns)
    return figures.table(head, [(f"{name} ({kind[2]})", *cells(*kind)) for name, kind in KINDS.items()])


def cells(scenario, size, count):
    """The figures of one kind, by default and fast."""
    apart = {False: [], True: []}
    with create_scratch_folder() as folder:
        path = Path(folder) / "log.mcap"
        for seed in range(count):
            sim.record_scenario(scenario, path, seed=seed, size=size, duration=SECONDS)
            for fast, some in apart.items():
                some.append(errors(path, Settings(colours=ColourSettings(fast=fast))))
    for some in apart.values():
        error, std = (np.concatenate(part) for part in zip(*some, strict=True))
        distance = np.hypot(*error.T)
        nees = np.mean((error / std) ** 2)
        yield f"{np.median(distance):.3f}, {np.quantile(distance, 0.99):.3f}; {nees:.2f}"


def errors(path, settings):
    """Errors (N,2) and stated deviations (N,2) px of the effector in the images that show it."""
    read, features = pipeline.observe(path, settings)
    track = features.tracks["effector"]
    with logs.open(path) as log:
        true = log["/truth/effector_pixel"]
        at, u, v = true.header.stamp - read.start_ns, true.point.x, true.point.y
    stamps = np.rint(track.t * 1e9).astype(np.int64)
    rows = np.minimum(np.searchsorted(at, stamps), len(at) - 1)
    seen = (at[rows] == stamps) & np.isfinite(track.values[:, 0])
    return (track.values - np.column_stack([u, v])[rows])[seen], track.std[seen]
