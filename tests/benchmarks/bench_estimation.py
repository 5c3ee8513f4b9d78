"""Cost of a step: ours beside filterpy's extended filter with scikit-learn predictions, and beside the model alone."""

import importlib.util
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from bodylog import body
from bodylog.body_model import BodyModel
from bodylog.estimation import estimate_from_features
from bodylog.estimation.live import LiveEstimator
from bodylog.settings import EstimationSettings, Settings
from bodylog.types import Features, Series
from tests.benchmarks.goals import at_least, at_most, unmeasured
from tests.benchmarks.timing import side_by_side
from tests.estimation.conftest import World, draw

MINUTES = 10
GIVEN = EstimationSettings(precision="model", bias="off")
_BESIDE_FILTERPY = "`filter`, precisions learned, times faster than filterpy and scikit-learn"
PEERS = ("filterpy EKF, scikit-learn means", "filterpy EKF, scikit-learn means and variances")


def fitted(features: Features) -> BodyModel:
    """The body that `fit` learns without a URDF."""
    return body.with_kinematics([features], Settings(), body.learn_body([features], Settings(), {}), None).model


def learned(samples: int) -> BodyModel:
    """A body learned from an exploration with about so many pictures."""
    explored = draw(1, duration=samples / 8, camera_hz=8.0, encoder_hz=50.0, encoder_std=0.003, pixel_std=0.3)
    model = fitted(explored.features)
    # noise of the logs below, whose encoders are louder than the exploration's
    noise_model = replace(model.noise, encoder=(0.01**2,) * 3, senses={"effector": (0.3**2,) * 2})
    return replace(model, noise=noise_model)


def whole_log(model: BodyModel) -> dict[str, float]:
    """Ten minutes at 100 Hz with pictures at 30 Hz, features present; seconds per step of each case."""
    world = draw(2, duration=60.0 * MINUTES, encoder_hz=100.0, camera_hz=30.0, encoder_std=0.01, pixel_std=0.3)
    steps, track = len(world.features.joints.t), world.features.tracks["effector"]
    sense, where = model.senses["effector"], np.repeat(world.truth.values[:1], len(track.t), axis=0)
    where = where[:, [("pan", "lift", "elbow").index(name) for name in model.joints]]
    cases: dict[str, Callable[[], object]] = {
        "filter": partial(estimate_from_features, world.features, model, EstimationSettings()),
        "smoother": partial(estimate_from_features, world.features, model, EstimationSettings(method="smoother")),
        "filter, the body's precisions": partial(estimate_from_features, world.features, model, GIVEN),
        "limit: the model's predictions alone, once": partial(sense.predict, where),
        "kalman": partial(estimate_from_features, world.features, model, EstimationSettings(method="kalman")),
    }
    medians = side_by_side(f"{MINUTES} minutes, {steps} steps, {len(track.t)} pictures", cases, repeats=3, cpu=True)
    for name in ("filter", "smoother"):
        print(f"  {name}: {medians[name] / steps * 1e6:.1f} µs per step")
    at_most("`filter`, 10 minutes, a step", medians["filter"] / steps * 1e6, 40, "µs", f"{steps} steps")
    ratio, text = medians["smoother"] / medians["filter"], f"filter, {medians['filter']:.2f} s"
    at_most("`smoother`, times filter", ratio, 1.3, "", text)
    return {name: seconds / steps for name, seconds in medians.items()}


def fast_encoders(model: BodyModel) -> None:
    """A minute with encoders at 500 Hz, estimates at 100 Hz and pictures at 30 Hz: milliseconds, and µs per reading."""
    world = draw(7, duration=60.0, encoder_hz=500.0, camera_hz=30.0, encoder_std=0.01, pixel_std=0.3)
    cases: dict[str, Callable[[], object]] = {
        "filter": partial(estimate_from_features, world.features, model, EstimationSettings()),
        "smoother": partial(estimate_from_features, world.features, model, EstimationSettings(method="smoother")),
        "filter, the body's precisions": partial(estimate_from_features, world.features, model, GIVEN),
    }
    readings = len(world.features.joints.t)
    took = side_by_side(f"60 s of encoders at 500 Hz, {readings} readings", cases, repeats=3, cpu=True)
    for name, seconds in took.items():
        print(f"  {name}: {seconds * 1e3:.0f} ms, {seconds / readings * 1e6:.1f} µs per reading")
        if name == "filter":
            each, text = seconds / readings * 1e6, f"{readings} readings"
            at_most("`filter`, encoders at 500 Hz, a reading", each, 18, "µs", text)


def beside_filterpy(model: BodyModel, ours: dict[str, float]) -> None:
    """Thirty seconds by both, and by our stream; the peer's step beside ours of the long log."""
    world = draw(3, duration=30.0, encoder_hz=100.0, camera_hz=30.0, encoder_std=0.01, pixel_std=0.3)
    order = [world.features.joints.names.index(name) for name in model.joints]
    events = sorted(
        [(t, 0, k) for k, t in enumerate(world.features.joints.t)]
        + [(t, 1, k) for k, t in enumerate(world.features.tracks["effector"].t)]
    )
    cases: dict[str, Callable[[], object]] = {
        "filter": partial(estimate_from_features, world.features, model, GIVEN),
        "filter, precisions learned": partial(estimate_from_features, world.features, model, EstimationSettings()),
        "Estimator.step": partial(stream, world, model, events, order),
    }
    if importlib.util.find_spec("filterpy") and importlib.util.find_spec("sklearn"):
        cases[PEERS[0]] = partial(filterpy, world, model, events, order, False)
        cases[PEERS[1]] = partial(filterpy, world, model, events, order, True)
    else:
        unmeasured(_BESIDE_FILTERPY, "filterpy or scikit-learn is not installed: pip install 'bodylog[bench]'")
    medians = side_by_side("30 seconds, one and the same log", cases, repeats=1, cpu=True)
    for peer in (peer for peer in PEERS if peer in medians):
        for name in ("filter", "filter, the body's precisions"):
            step = medians[peer] / len(world.features.joints.t)
            print(f"  {peer}, its step / {name}'s of {MINUTES} minutes: {step / ours[name]:.1f}")
    if PEERS[1] in medians:
        step = medians[PEERS[1]] / len(world.features.joints.t)
        at_least(_BESIDE_FILTERPY, step / ours["filter"], 20, "", f"{PEERS[1]}, {step * 1e6:.0f} µs a step")


def stream(world: World, model: BodyModel, events: list[tuple[float, int, int]], order: list[int]) -> None:
    """Our filter, one instant at a time."""
    live, joints = LiveEstimator(model), world.features.joints.values[:, order]
    for t, seen, k in events:
        if seen:
            live.step(t, effector=world.features.tracks["effector"].values[k])
        else:
            live.step(t, joints=joints[k])


def filterpy(
    world: World, model: BodyModel, events: list[tuple[float, int, int]], order: list[int], spread: bool
) -> None:
    """The peer: the same states and noise, the Jacobian by differences since scikit-learn has none.

    `spread` adds the model's own variance to the pixels', as our filter does.
    """
    from filterpy.kalman import ExtendedKalmanFilter
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel

    sense = model.senses["effector"]
    kernel = ConstantKernel(float(sense.amplitude[0]), "fixed") * RBF(sense.scales[0], "fixed")
    noise = float(sense.noise.mean()) + sense.spread.mean(axis=1)
    gp = GaussianProcessRegressor(kernel, alpha=noise, optimizer=None)
    gp.fit(sense.samples, sense.targets - sense.mean)
    steps = 1e-4 * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    ekf = ExtendedKalmanFilter(dim_x=6, dim_z=3)
    values, last = world.features.joints.values[:, order], 0.0
    ekf.x[:3] = values[0][:, None]
    q, encoder = np.diag(model.noise.process), np.diag(model.noise.encoder)
    pixel, eye = np.diag(model.noise.senses["effector"]), np.eye(6)[:3]
    for t, seen, k in events:
        dt, last = t - last, t
        ekf.F = np.eye(6) + dt * np.eye(6, k=3)
        ekf.Q = np.block([[q * dt**3 / 3, q * dt**2 / 2], [q * dt**2 / 2, q * dt]])
        ekf.predict()
        if not seen:
            ekf.update(values[k][:, None], lambda x: eye, lambda x: x[:3], R=encoder)
            continue
        found = gp.predict(ekf.x[:3, 0] + steps, return_std=spread)
        around, var = (found[0], pixel + np.diag(found[1][0] ** 2)) if spread else (found, pixel)
        around = around + sense.mean
        slope = np.concatenate([(around[1:4] - around[4:]).T / 2e-4, np.zeros((2, 3))], axis=1)
        z = world.features.tracks["effector"].values[k]
        ekf.update(z[:, None], lambda x, s=slope: s, lambda x, a=around: a[0][:, None], R=var)


def growth() -> dict[str, dict[int, float]]:
    """Cost per step against the samples n of the model, the number N of tracks and M of joints: µs by size."""
    costs: dict[str, dict[int, float]] = {"n": {}, "N": {}, "M": {}}
    world = draw(4, duration=60.0, encoder_hz=100.0, camera_hz=30.0, encoder_std=0.01, pixel_std=0.3)
    for samples in (46, 100, 200, 400, 800, 1600):
        costs["n"][samples] = per_step(world.features, learned(samples), 1)
    model = learned(100)
    for tracks in (1, 2, 4, 8):
        costs["N"][tracks] = per_step(world.features, model, tracks)
    for joints in range(2, 8):
        explored, replayed = chain(joints, 5, 12.5, 8.0, 50.0), chain(joints, 6, 60.0, 30.0, 100.0)
        costs["M"][joints] = per_step(replayed, fitted(explored), 1)
    print("\nfilter, µs per step of a 60 s log (body's precisions)")
    for name, by_size in costs.items():
        text = ", ".join(f"{size}: {cost:.1f}" for size, cost in by_size.items())
        print(f"  {name} = {text}; exponent {exponent(by_size):.2f}")
    return costs


def chain(joints: int, seed: int, duration: float, camera_hz: float, encoder_hz: float) -> Features:
    """What is read and seen of a chain of so many links that bends in the plane of the picture."""
    rng = np.random.default_rng(seed)
    encoders, frames = np.arange(0.0, duration, 1 / encoder_hz), np.arange(0.003, duration, 1 / camera_hz)
    t = np.concatenate([encoders, frames])
    angles = np.full((len(t), joints), 0.4)
    for _ in range(3):
        rate, phase = rng.uniform(0.5, 2.0, (2, joints))
        angles += 0.15 * np.sin(np.outer(t, rate) + np.pi * phase)
    turned, link = np.cumsum(angles, axis=1), 300.0 / joints
    place = link * np.column_stack([np.cos(turned).sum(axis=1), np.sin(turned).sum(axis=1)])
    read = angles[: len(encoders)] + rng.normal(0, 0.01, (len(encoders), joints))
    seen = place[len(encoders) :] + rng.normal(0, 0.3, (len(frames), 2))
    names = tuple(f"joint{k}" for k in range(joints))
    encoder_readings = Series(encoders, read, names, "rad", (1e9 * encoders).astype(np.int64))
    track = Series(frames, seen, ("u", "v"), "px", (1e9 * frames).astype(np.int64), np.full(seen.shape, 0.3))
    return Features(encoder_readings, {"effector": track}, None, (), (), {})


def per_step(given: Features, model: BodyModel, tracks: int) -> float:
    """Microseconds per step, the best of three."""
    track, sense = given.tracks["effector"], model.senses["effector"]
    names = [f"mark{k}" for k in range(tracks)]
    features = replace(given, tracks=dict.fromkeys(names, track))
    noise = replace(model.noise, senses=dict.fromkeys(names, (0.3**2,) * 2))
    several = replace(model, senses=dict.fromkeys(names, sense), noise=noise)
    times = []
    for _ in range(3):
        started = time.perf_counter()
        found = estimate_from_features(features, several, GIVEN)
        times.append(time.perf_counter() - started)
    return min(times) / len(found.joints.t) * 1e6


def exponent(costs: dict[int, float]) -> float:
    """Slope of log cost over log size."""
    return float(np.polyfit(np.log(list(costs)), np.log(list(costs.values())), 1)[0])


def plot(costs: dict[str, dict[int, float]], out: Path) -> None:
    """Cost over each size, both axes logarithmic, with linear or cubic growth from the first point on."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(1, 3, figsize=(9, 3.0), layout="constrained", sharey=True)
    text = {"n": ("samples n of the model", 1), "N": ("tracks N", 1), "M": ("joints M", 3)}
    for axes, (name, (label, power)) in zip(panels, text.items(), strict=True):
        sizes, cost = np.array(list(costs[name])), np.array(list(costs[name].values()))
        axes.loglog(sizes, cost, "o-", label="measured")
        allowed = cost[0] * (sizes / sizes[0]) ** power
        axes.loglog(sizes, allowed, ":", color="grey", label="linear" if power == 1 else f"{name}³")
        axes.set_xticks(sizes, [str(size) for size in sizes])
        axes.minorticks_off()
        axes.set(xlabel=label)
        axes.legend(frameon=False)
        axes.grid(alpha=0.3)
    panels[0].set(ylabel="µs per step", ylim=(10, None))
    figure.savefig(out, dpi=90, metadata={"Software": None})
    plt.close(figure)
    print(f"  drawn: {out}")


def main() -> None:
    """Run all cases; --figure PNG draws how the cost grows, alone."""
    if "--figure" in sys.argv:
        plot(growth(), Path(sys.argv[sys.argv.index("--figure") + 1]))
        return
    model = learned(320)
    beside_filterpy(model, whole_log(model))
    fast_encoders(model)
    growth()


if __name__ == "__main__":
    main()
