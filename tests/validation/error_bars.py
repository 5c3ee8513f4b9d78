"""NEES of each joint, one where error bars are true, over drawn logs and the recorded arm."""

import numpy as np

from bodylog.sim import motion, plan
from tests.estimation import conftest as worlds
from tests.validation import figures, logs

METHODS = ("filter", "smoother")
RECORDED = {"recorded exploration": "explore.mcap", "recorded reach, 20 s": "reach.mcap"}


def table():
    """Rows by kind of log, columns by method."""
    kinds = [(name, list(each())) for name, each in KINDS.items()]
    kinds += [(name, [recorded(file)]) for name, file in RECORDED.items()]
    head = ("log", *(f"`{method}`: RMSE, mrad; NEES of pan, lift, elbow; within 2 σ" for method in METHODS))
    return figures.table(head, [row(name, pairs) for name, pairs in kinds])


def row(name, pairs):
    """The figures of one kind of log; pairs of (log, body)."""
    cells = []
    for method in METHODS:
        runs = [figures.found(log, body, method) for log, body in pairs]
        cover = 100.0 * np.mean([run.coverage for run in runs])
        cells.append(f"{figures.mrad(runs)}; {figures.mean_nees(runs)}; {cover:.1f} %")
    return (f"{name} ({len(pairs)})" if len(pairs) > 1 else name, *cells)


def recorded(file):
    """A recorded log, and the body learned from the recorded exploration."""
    return logs.recorded(file), logs.recorded_body()


def reaches(cameras=1, count=20):
    """Reaches of 10 s."""
    return ((logs.drawn("reach", 1000 + seed, 10.0, cameras), logs.learned(seed, cameras)) for seed in range(count))


def babble(cameras=1, count=10):
    """Explorations, the body learned from another."""
    pairs = ((seed, (seed + 1) % count) for seed in range(count))
    return ((logs.drawn("babble", seed, 40.0, cameras), logs.learned(other, cameras)) for seed, other in pairs)


def sines(count=10):
    """Slow sines of 20 s, the model known."""
    return ((logs.of(world), world.body) for world in map(worlds.draw, range(count)))


def drifting(count=10):
    """Reaches of 30 s, pan's encoder drifting to 0.3 rad."""
    return ((logs.drawn("drift", 1000 + seed), logs.learned(seed)) for seed in range(count))


def still(count=40):
    """Arms that stand still for 30 s in drawn postures."""

    def stands(request):
        away = 0.7 * plan.swing_of_joints(request, None) * request.rng.uniform(-1, 1, len(request.arm.home))
        return plan.ScenarioPlan(motion.stand_still(np.array(request.arm.home) + away), 0.01, plan.read_angles_with_noise)

    return ((logs.drawn("touch", seed, plan=stands), logs.learned(seed % 20)) for seed in range(count))


KINDS = {
    "reaches of 10 s, one camera": reaches,
    "reaches, two cameras": lambda: reaches(2),
    "babble of 40 s, one camera, the body of another": babble,
    "babble, two cameras, the body of another": lambda: babble(2),
    "slow sines of 20 s, the model known": sines,
    "reaches of 30 s, pan's encoder drifting": drifting,
    "still arms in drawn postures": still,
}
