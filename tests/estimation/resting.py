"""Arms whose encoders count in steps and whose joints rest, reach and stick, drawn from a seed."""

from dataclasses import dataclass

import numpy as np

from bodylog.body_model import BodyModel, Noise, TouchConstants
from bodylog.types import Array, Features, Series
from tests.estimation.conftest import JOINTS, Arm, World, motion

MOTIONS = ("rest", "slow", "sines", "reach")


@dataclass(frozen=True)
class Drawn:
    """How an arm moves and is read: step, noise and stick-slip in rad, rates in Hz, gaps in the log."""

    motion: str
    step: float = 0.0
    noise: float = 0.0
    encoder_hz: float = 50.0
    camera_hz: float = 12.0
    slip: float = 0.0
    gaps: int = 0
    duration: float = 16.0
    pixel: float = 0.4


def drawn(seed: int, how: Drawn) -> World:
    """The world of a seed."""
    rng = np.random.default_rng([seed, MOTIONS.index(how.motion)])
    t, frames = np.arange(0.0, how.duration, 1 / how.encoder_hz), np.arange(0.003, how.duration, 1 / how.camera_hz)
    both = np.concatenate([t, frames])
    order = np.argsort(both, kind="stable")
    x = np.empty((len(both), 3))
    x[order] = _sticking(_angles(both[order], rng, how.motion), how.slip)
    truth = x[: len(t)]
    read = truth + rng.normal(0.0, 1.0, truth.shape) * how.noise
    read = np.round(read / how.step) * how.step if how.step else read
    keep = np.ones(len(t), bool)
    for begin in rng.uniform(2.0, how.duration - 2.0, how.gaps):
        keep &= (t < begin) | (t > begin + rng.uniform(0.2, 1.5))
    seen = Arm().predict(x[len(t) :])[0] + rng.normal(0.0, how.pixel, (len(frames), 2))
    ns, frames_ns = (t * 1e9).astype(np.int64), (frames * 1e9).astype(np.int64)
    joints = Series(t[keep], read[keep], JOINTS, "rad", ns[keep])
    track = Series(frames, seen, ("u", "v"), "px", frames_ns, np.full(seen.shape, how.pixel))
    noise = Noise((0.003**2,) * 3, {"effector": (how.pixel**2,) * 2}, (0.3,) * 3)
    body = BodyModel(JOINTS, {"effector": Arm()}, noise, TouchConstants(1.0, 0.005), {})
    return World(Features(joints, {"effector": track}, None, (), (), {}), Series(t, truth, JOINTS, "rad", ns), body)


def _angles(t: Array, rng: np.random.Generator, how: str) -> Array:
    x = np.tile(np.array([-0.9, -0.9, 1.0]) + rng.uniform(-0.1, 0.1, 3), (len(t), 1))
    if how in ("slow", "sines"):
        return motion(t, rng, 0.02 if how == "slow" else 0.5)
    for column in x.T if how == "reach" else ():
        begin = 1.0
        while (begin := begin + rng.uniform(0.5, 4.0)) < t[-1] - 1.2:
            lasting = rng.uniform(0.3, 1.2)
            s = np.clip((t - begin) / lasting, 0.0, 1.0)
            column += rng.uniform(-0.4, 0.4) * (10 * s**3 - 15 * s**4 + 6 * s**5)
            begin += lasting
    return x


def _sticking(x: Array, width: float) -> Array:
    """Angles (N,M) of joints that follow only once they are `width` rad off."""
    found = x.copy()
    for k in range(1, len(x)) if width else ():
        found[k] = np.where(np.abs(x[k] - found[k - 1]) > width, x[k], found[k - 1])
    return found


def judged(world: World, joints: Series, cov: Array) -> tuple[float, float]:
    """Root mean square error (rad) and squared error over stated variance.

    The worst in a thousand errors are left out: at the onset of a motion the gate takes a reading for a part.
    """
    truth = np.stack([np.interp(joints.t, world.truth.t, column) for column in world.truth.values.T], axis=1)
    error = joints.values - truth
    typical = np.sort((error**2).ravel())[: -max(1, error.size // 1000)]
    return float(np.sqrt(np.mean(typical))), float(np.mean(error**2 / np.einsum("nii->ni", cov)))


READ = (
    {"noise": 0.02},
    {"noise": 0.003, "camera_hz": 30.0},
    {"noise": 0.005, "gaps": 3},
    {"noise": 0.001, "encoder_hz": 125.0, "slip": 0.004},
    {"step": 1e-6, "encoder_hz": 100.0, "camera_hz": 30.0},
    {"step": 1e-4},
    {"step": 1.5e-3},
    {"step": 1.5e-3, "noise": 1e-3},
    {"step": 1.5e-3, "encoder_hz": 20.0, "slip": 0.006},
    {"step": 1.5e-3, "encoder_hz": 200.0, "slip": 0.006, "camera_hz": 30.0},
    {"step": 1.5e-3, "noise": 5e-4, "encoder_hz": 18.0, "slip": 0.003, "gaps": 2, "camera_hz": 10.0},
    {"step": 4.6e-3, "noise": 0.002, "encoder_hz": 100.0, "slip": 0.01},
    {"step": 0.01, "gaps": 2},
)
"""How joints are read: 13 ways for each of four motions, four seeds each: 208 logs, with a camera and without."""
