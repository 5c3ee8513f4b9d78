"""How fast `record_scenario` is: seconds of processor per second of log, and what a picture costs beside the bare renderer."""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bodylog.sim import record_scenario
from bodylog.sim.arms import ARMS
from bodylog.sim.camera import draw_background, look_at
from bodylog.sim.world import World, open_world
from tests.benchmarks.timing import side_by_side

_LOGS = {
    "babble 640x480 jpeg": {"scenario": "babble", "duration": 10.0},
    "babble 640x480 raw": {"scenario": "babble", "duration": 10.0, "image": "raw"},
    "babble 320x240 jpeg": {"scenario": "babble", "duration": 10.0, "size": (320, 240)},
    "touch 640x480 jpeg (still arm)": {"scenario": "touch", "duration": 10.0},
}


def _frames(world: World) -> dict[str, Callable[[], object]]:
    """One picture by the renderer alone at full and half size, and ours."""
    arm = ARMS["ur5"]
    target = world.pose(np.array(arm.home))[0][world.links.index("effector")]
    large, small = (look_at(target + np.array(arm.camera), target, size) for size in ((640, 480), (320, 240)))
    wall = draw_background(large, np.random.default_rng(0))
    return {
        "bare renderer 640x480": lambda: world._render(large),
        "bare renderer 320x240": lambda: world._render(small),
        "World.picture 640x480": lambda: world.picture(large, wall),
    }


def main() -> None:
    """Print both tables."""
    with open_world(ARMS["ur5"]) as world:
        side_by_side("one picture of the arm", _frames(world), repeats=20)
    print("\nrecording, 20 pictures/s, 100 Hz joints and skin")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "log.mcap"
        record_scenario("babble", out, duration=0.2)
        for name, options in _LOGS.items():
            wall, processor = time.perf_counter(), time.process_time()
            record_scenario(out=out, **options)  # type: ignore[arg-type]
            wall, processor = time.perf_counter() - wall, time.process_time() - processor
            size = out.stat().st_size / 1e6
            print(f"  {name:<32} {10 / wall:6.2f} x real time, {processor / 10:.3f} s processor per s, {size:.1f} MB")


if __name__ == "__main__":
    main()
