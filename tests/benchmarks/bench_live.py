"""Cost of a live step: how long the robot waits for its belief, and what late pictures and long days add to it."""

import gc
import time
import tracemalloc

import numpy as np

from bodylog import Estimator
from bodylog.body_model import BodyModel
from bodylog.types import Array
from tests.benchmarks.bench_estimation import learned
from tests.benchmarks.goals import at_most
from tests.estimation.conftest import World, draw

ENCODERS, CAMERA, SECONDS = 500.0, 30.0, 20.0
"""Hz, Hz and s of the motion replayed."""
_LIMITS_US = {(0.0, "encoders"): 60, (0.0, "a picture"): 500, (0.05, "a picture"): 900}
"""By delay (s) of the images, and the step's readings."""


def stream(model: BodyModel, world: World, late: float) -> dict[str, Array]:
    """Microseconds of each step by its readings; images come `late` s after they were taken."""
    joints, track = world.features.joints, world.features.tracks["effector"]
    order = [joints.names.index(name) for name in model.joints]
    places = np.hstack([track.values, track.std])
    events = [(t, t, "encoders", {"joints": row}) for t, row in zip(joints.t, joints.values[:, order], strict=True)]
    events += [(t + late, t, "a picture", {"effector": row}) for t, row in zip(track.t, places, strict=True)]
    live, costs = Estimator(model), {"encoders": [], "a picture": []}
    for _, t, what, given in sorted(events, key=lambda event: event[0]):
        started = time.thread_time()
        live.step(t, **given)
        costs[what].append(time.thread_time() - started)
    return {what: 1e6 * np.array(each[len(each) // 10 :]) for what, each in costs.items()}


def allocated(model: BodyModel, world: World, steps: int) -> tuple[int, int]:
    """Bytes held after a fifth of the steps, and after all."""
    x = world.features.joints.values[0][[world.features.joints.names.index(name) for name in model.joints]]
    place, live, held = model.senses["effector"].predict(x[None])[0][0], Estimator(model), []
    tracemalloc.start()
    for part in (range(steps // 5), range(steps // 5, steps)):
        for k in part:
            live.step(k / ENCODERS, joints=x, effector=place if k % 16 == 0 else None)
        gc.collect()  # tuples kept for reuse would count as held
        held.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    return held[0], held[1]


def main() -> None:
    """Percentiles by kind of step, on time and late; memory."""
    model = learned(320)
    world = draw(3, duration=SECONDS, encoder_hz=ENCODERS, camera_hz=CAMERA, encoder_std=0.01, pixel_std=0.3)
    print(f"\nEstimator.step, {ENCODERS:.0f} Hz encoders, {CAMERA:.0f} Hz pictures, {SECONDS:.0f} s, µs")
    for late in (0.0, 0.02, 0.05):
        for what, costs in stream(model, world, late).items():
            middle, rare, most = np.quantile(costs, [0.5, 0.99, 1.0])
            text = f", {1e3 * late:.0f} ms late" if late and what != "encoders" else ""
            if (late, what) in _LIMITS_US:
                at_most(f"`Estimator.step`, {what}{text}, median", middle, _LIMITS_US[late, what], "µs")
            print(f"  {what + text:<24} median {middle:6.0f}  99th percentile {rare:6.0f}  most {most:6.0f}")
    soon, after = allocated(model, world, 20_000)
    print(f"  held after 4,000 steps {soon / 1024:.0f} KiB, after 20,000 {after / 1024:.0f} KiB")


if __name__ == "__main__":
    main()
