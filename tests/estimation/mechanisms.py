"""Arms with the errors of real mechanisms, explored and then replayed with a fault, drawn from a seed."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from bodylog import body
from bodylog.body_model import BodyModel
from bodylog.settings import Settings
from bodylog.types import Array, Features, Series
from tests.estimation.conftest import JOINTS, Arm

ENCODER_HZ = 100.0
PIXEL_STD = 0.3
_GRAVITY = np.array([0.0, 1.0, 0.4])
"""How far each joint sags under a load, as a share of the lift's sag."""


@dataclass(frozen=True)
class Mechanism:
    """How joints turn and are read; all angles in rad, 0 where an error is absent.

    `white`: noise of each reading · `lasting`, `memory`: an Ornstein-Uhlenbeck error and its time (s) · `count`: an
    encoder's step · `tails`: degrees of freedom of Student's t in place of the normal noise · `jitter`: of the stamps
    (s) · `play`: between motor and link · `sag`: of the lift, its arm stretched out · `slip`: how far a joint sticks ·
    `outliers`: share of readings that are 0.2 rad off · `camera_hz`: images a second.
    """

    white: float = 1e-3
    lasting: float = 0.0
    memory: float = 1.0
    count: float = 0.0
    tails: float = 0.0
    jitter: float = 0.0
    play: float = 0.0
    sag: float = 0.0
    slip: float = 0.0
    outliers: float = 0.0
    camera_hz: float = 20.0


SOUND = Mechanism()
QUIET = Mechanism(2e-4, camera_hz=10.0)
QUANTISED = Mechanism(1e-5, count=2 * np.pi / 4096)
CORRELATED = Mechanism(lasting=2e-3, memory=2.0)
REALISTIC = Mechanism(
    5e-4, lasting=1e-3, count=2 * np.pi / 4096, tails=4.0, jitter=1e-3, play=4e-3, sag=3e-3, slip=1e-3, outliers=1e-3
)


@dataclass(frozen=True)
class Fault:
    """What goes wrong during a run: drift (rad/s) or offset (rad) of one joint since 8 s, or a load's sag (rad)."""

    joint: int = 1
    drift: float = 0.0
    offset: float = 0.0
    payload: float = 0.0


def learned(seed: int, mechanism: Mechanism) -> BodyModel:
    """The body learned from 40 s of babbling."""
    return body.learn([replayed(seed, mechanism, Fault(), duration=40.0)], Settings(), {}).model


def replayed(
    seed: int, mechanism: Mechanism, fault: Fault, duration: float = 16.0, reaches: bool = False
) -> Features:
    """What encoders read and a camera sees during a run: smooth motion, or reaches with rests between them."""
    rng = np.random.default_rng([seed, int(reaches), round(duration)])
    t = np.arange(0.0, duration, 1 / ENCODER_HZ)
    frames = np.arange(0.003, duration, 1 / mechanism.camera_hz)
    motors = (_reaching if reaches else _wandering)(t, rng)
    sagging = (mechanism.sag + fault.payload) * np.cos(motors[:, 1:2]) * _GRAVITY
    links = _loose(_loose(motors, mechanism.play), mechanism.slip) + sagging
    at_frames = np.column_stack([np.interp(frames, t, column) for column in links.T])
    seen = Arm().place(at_frames) + rng.normal(0.0, PIXEL_STD, (len(frames), 2))
    since = np.maximum(t - 8.0, 0.0)
    read = motors + _noise(rng, motors.shape, mechanism)
    read[:, fault.joint] += fault.drift * since + fault.offset * (since > 0.0)
    if mechanism.count:
        read = np.round(read / mechanism.count) * mechanism.count
    stamps = np.maximum.accumulate(t + rng.normal(0.0, 1.0, len(t)) * mechanism.jitter)
    joints = Series(stamps, read, JOINTS, "rad", (t * 1e9).astype(np.int64))
    std = np.full(seen.shape, PIXEL_STD)
    track = Series(frames, seen, ("u", "v"), "px", (frames * 1e9).astype(np.int64), std)
    return Features(joints, {"effector": track}, None, (), (), {})


def _wandering(t: Array, rng: np.random.Generator) -> Array:
    angles = np.tile(np.array([-0.9, -0.9, 1.0]), (len(t), 1))
    for _ in range(4):
        rate, phase = rng.uniform(0.4, 1.8, 3), rng.uniform(0.0, 2 * np.pi, 3)
        angles += 0.17 / rate * np.sin(np.outer(t, rate) + phase)
    return angles


def _reaching(t: Array, rng: np.random.Generator) -> Array:
    """Minimum-jerk reaches (Flash & Hogan 1985) of 1 s between rests of up to 1 s."""
    angles = np.tile(np.array([-0.9, -0.9, 1.0]), (len(t), 1))
    here, begin = np.zeros(3), 0.5
    while begin < t[-1]:
        there = rng.uniform(-0.35, 0.35, 3)
        s = np.clip(t - begin, 0.0, 1.0)[:, None]
        angles += (there - here) * (10 * s**3 - 15 * s**4 + 6 * s**5)
        here = there
        begin += 1.0 + rng.uniform(0.0, 1.0)
    return angles


def _loose(driving: Array, play: float) -> Array:
    """Angles that follow the driving ones (N,M) only once these are half the play away."""
    driven = driving.copy()
    for k in range(1, len(driving)) if play else ():
        driven[k] = np.clip(driven[k - 1], driving[k] - play / 2, driving[k] + play / 2)
    return driven


def _noise(rng: np.random.Generator, shape: tuple[int, int], mechanism: Mechanism) -> Array:
    tails = mechanism.tails
    unit = rng.standard_t(tails, shape) / np.sqrt(tails / (tails - 2)) if tails else rng.standard_normal(shape)
    noise = mechanism.white * unit
    if mechanism.lasting:
        kept = np.exp(-1 / ENCODER_HZ / mechanism.memory)
        driven = np.sqrt(1 - kept**2) * rng.standard_normal(shape)
        noise += mechanism.lasting * np.asarray(lfilter([1.0], [1.0, -kept], driven, axis=0))
    noise += 0.2 * rng.choice([-1.0, 1.0], shape) * (rng.random(shape) < mechanism.outliers)
    return np.asarray(noise)
