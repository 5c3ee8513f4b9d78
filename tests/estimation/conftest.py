"""Worlds with a known answer: a linear body and a pinhole arm, drawn from a seed."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from scipy.linalg import expm

from bodylog.body_model import BodyModel, Noise, TouchConstants
from bodylog.estimation.inference.filter_problem import FilterProblem
from bodylog.estimation.methods import filtering
from bodylog.motion import WHITE_ACCELERATION, WHITE_JERK
from bodylog.types import Array, Features, Series, Synchrony, Touch

JOINTS = ("pan", "lift", "elbow")
WHITE_MOTIONS = {2: WHITE_ACCELERATION, 3: WHITE_JERK}


@dataclass(frozen=True)
class Linear:
    """u, v as a plane over the angles."""

    a: Array
    b: Array
    outputs: tuple[str, ...] = ("u", "v")

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        return x @ self.a.T + self.b, np.repeat(self.a[None], len(x), axis=0), np.zeros((len(x), 2))


@dataclass(frozen=True)
class Arm:
    """A three-joint arm (pan, lift, elbow) before a pinhole camera; `blur` is its stated variance, px²."""

    blur: float = 0.0
    outputs: tuple[str, ...] = ("u", "v")

    def place(self, x: Array) -> Array:
        pan, lift, elbow = np.moveaxis(x, -1, 0)
        reach = 0.425 * np.cos(lift) + 0.39 * np.cos(lift + elbow)
        height = -0.425 * np.sin(lift) - 0.39 * np.sin(lift + elbow)
        forward, side = reach * np.cos(pan), reach * np.sin(pan)
        depth = 1.6 - 0.6 * forward + 0.3 * height
        return np.stack([160 + 420 * side / depth, 120 - 420 * (height - 0.2 + 0.3 * forward) / depth], axis=-1)

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        # complex steps: the derivative to machine precision
        jac = self.place(x[:, None] + 1e-30j * np.eye(3)).imag / 1e-30
        return self.place(x), jac.swapaxes(1, 2), np.full((len(x), 2), self.blur)


@dataclass(frozen=True)
class Explored(Arm):
    """The same with the angles (N,3) rad at which it was explored."""

    samples: Array = field(default_factory=lambda: motion(np.linspace(0.0, 60.0, 80), np.random.default_rng(77)))


@dataclass
class World:
    features: Features
    truth: Series
    body: BodyModel
    rate: Array = field(default_factory=lambda: np.empty(0))


def motion(t: Array, rng: np.random.Generator, speed: float = 0.5) -> Array:
    """Smooth angles (N,3): sums of slow sines about a bent arm."""
    x = np.tile(np.array([-0.9, -0.9, 1.0]), (len(t), 1))
    for _ in range(4):
        w, phase = rng.uniform(0.5, 2.0, 3), rng.uniform(0, 2 * np.pi, 3)
        x += speed * 0.35 / w * np.sin(np.outer(t, w) + phase)
    return x


def draw(
    seed: int = 0, duration: float = 20.0, encoder_hz: float = 50.0, camera_hz: float = 12.0, encoder_std: float = 0.02,
    pixel_std: float = 0.4, model: object = None, hidden: tuple[float, float] = (0.0, 0.0), speed: float = 0.5,
    blunder: float = 0.0,
) -> World:  # fmt: skip
    """A world with its truth; `hidden`: when the effector is out of view, `blunder`: share of false sightings."""
    rng = np.random.default_rng(seed)
    model = Arm() if model is None else model
    t = np.arange(0.0, duration, 1 / encoder_hz)
    frames = np.arange(0.003, duration, 1 / camera_hz)
    both = np.concatenate([t, frames])
    x = motion(both, rng, speed)
    truth, at_frames = x[: len(t)], x[len(t) :]
    readings = truth + rng.normal(0, encoder_std, truth.shape)
    seen = model.predict(at_frames)[0] + rng.normal(0, pixel_std, (len(frames), 2))  # type: ignore[attr-defined]
    wrong = rng.random(len(frames)) < blunder
    seen[wrong] += rng.normal(0, 60, (int(wrong.sum()), 2))
    seen[(frames >= hidden[0]) & (frames < hidden[1])] = np.nan
    order = [2, 0, 1]  # alphabetical, as drivers publish
    names = tuple(JOINTS[i] for i in order)
    ns, frames_ns = (t * 1e9).astype(np.int64), (frames * 1e9).astype(np.int64)
    joints = Series(t, readings[:, order], names, "rad", ns)
    track = Series(frames, seen, ("u", "v"), "px", frames_ns, np.full(seen.shape, pixel_std))
    features = Features(joints, {"effector": track}, None, (), (), {})
    noise = Noise((encoder_std**2,) * 3, {"effector": (pixel_std**2,) * 2}, (0.3,) * 3)
    body = BodyModel(JOINTS, {"effector": model}, noise, TouchConstants(1.0, 0.005), {})  # type: ignore[dict-item]
    return World(features, Series(t, truth, JOINTS, "rad", ns), body)


def strokes(world: World, weight: float, offset: tuple[float, float] = (0.0, 0.0)) -> Features:
    """The world's features with touches of the given synchrony weight, the hand `offset` px from the effector."""
    track = world.features.tracks["effector"]
    touches = tuple(Touch(s, s + 1.0, (1,), 0.9, 1, int(s * 1e9)) for s in np.arange(5.0, track.t[-1] - 1, 2.5))
    pairs = tuple(Synchrony(i, i, 0.0, weight) for i in range(len(touches)))
    hand = Series(track.t, track.values + np.array(offset), ("u", "v"), "px", track.source_ns, track.std)
    tracks = {**world.features.tracks, "hand": hand}
    return Features(world.features.joints, tracks, touches, (), pairs, {})


@pytest.fixture
def world() -> Callable[..., World]:
    return draw


@pytest.fixture
def stroked() -> Callable[..., Features]:
    return strokes


@pytest.fixture
def linear_model() -> Linear:
    return Linear(np.array([[300.0, -40.0, 20.0], [15.0, 250.0, 120.0]]), np.array([160.0, 120.0]))


@dataclass(frozen=True)
class Dense:
    """A textbook Kalman filter and Rauch–Tung–Striebel smoother over the same readings, all in full matrices."""

    t: Array
    mean: Array
    cov: Array
    nats: Array
    smooth: Array
    smooth_cov: Array


def dense(world: World, process: Array, encoder: Array, pixel: float, order: int = 2, fade: float = 0.0) -> Dense:
    """The reference for a linear body: every reading at its own time, all of one instant in one update."""
    joints, track, model = world.features.joints, world.features.tracks["effector"], world.body.senses["effector"]
    assert joints is not None
    columns, k = [joints.names.index(name) for name in JOINTS], 3 * order
    t = np.unique(np.concatenate([joints.t, track.t]))
    z = np.concatenate([joints.values[0, columns], np.zeros(k - 3)])
    p, last, rows = np.diag(np.repeat([1.0, 1.0, 9.0][:order], 3)), t[0], []
    for now in t:
        dt, last = now - last, now
        f, q = discretised(process, dt, order, fade)
        zp, pp = f @ z, f @ p @ f.T + q
        h, y, r = [], [], []
        for values in joints.values[joints.t == now]:
            h += list(np.eye(k)[:3])
            y += list(values[columns])
            r += list(encoder)
        for values in track.values[track.t == now]:
            if np.isfinite(values).all():
                h += [np.concatenate([row, np.zeros(k - 3)]) for row in model.a]  # type: ignore[attr-defined]
                y += list(values - model.b)  # type: ignore[attr-defined]
                r += [pixel, pixel]
        nats = 0.0
        z, p = zp, pp
        if y:
            hm, s = np.array(h), np.array(h) @ pp @ np.array(h).T + np.diag(r)
            nu, gain = np.array(y) - hm @ zp, pp @ hm.T @ np.linalg.inv(s)
            keep = np.eye(k) - gain @ hm
            z, p = zp + gain @ nu, keep @ pp @ keep.T + gain @ np.diag(r) @ gain.T
            nats = 0.5 * float(nu @ np.linalg.solve(s, nu) + np.linalg.slogdet(2 * np.pi * s)[1])
        rows.append((f, zp, pp, z, p, nats))
    smooth, cov = [rows[-1][3]], [rows[-1][4]]
    for (_, _, _, z, p, _), (f, zp, pp, *_) in zip(rows[-2::-1], rows[:0:-1], strict=True):
        gain = p @ f.T @ np.linalg.inv(pp)
        smooth.append(z + gain @ (smooth[-1] - zp))
        cov.append(p + gain @ (cov[-1] - pp) @ gain.T)
    parts = (np.array([row[part] for row in rows]) for part in (3, 4, 5))
    return Dense(t, *parts, np.array(smooth[::-1]), np.array(cov[::-1]))


def discretised(process: Array, dt: float, order: int, fade: float = 0.0) -> tuple[Array, Array]:
    """Transition and noise (K,K) of three joints whose derivative `order` is white noise, by Van Loan's exponential.

    fade (1/s): rate at which the last state decays, as in Singer's model.
    """
    k = 3 * order
    rates, noise = np.eye(k, k, 3), np.zeros((k, k))
    rates[k - 3 :, k - 3 :] = -fade * np.eye(3)
    noise[k - 3 :, k - 3 :] = np.diag(process)
    both = expm(dt * np.block([[-rates, noise], [np.zeros((k, k)), rates.T]]))
    f = both[k:, k:].T
    return f, f @ both[:k, k:]


@pytest.fixture
def reference() -> Callable[..., Dense]:
    return dense


@pytest.fixture
def white_acceleration(monkeypatch: pytest.MonkeyPatch) -> None:
    """Motion of order 2, whatever the evidence."""
    monkeypatch.setattr(filtering, "with_preferred_order", lambda problem: problem)


@pytest.fixture
def white_jerk(monkeypatch: pytest.MonkeyPatch) -> Array:
    """Motion of order 3 with these densities, whatever the evidence."""
    process = np.array([9.0, 15.0, 30.0])

    def jerk(problem: FilterProblem) -> FilterProblem:
        return replace(problem, precision=replace(problem.precision, motion=WHITE_JERK, process=process))

    monkeypatch.setattr(filtering, "with_preferred_order", jerk)
    return process
