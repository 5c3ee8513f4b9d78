"""Arms with the errors of real mechanisms, explored and then replayed with a fault, drawn from a seed."""

from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from bodylog import body
from bodylog.body_model import BodyModel
from bodylog.delays import camera_delay
from bodylog.evaluation.scores import truth_at_times
from bodylog.settings import Settings
from bodylog.sim.hardware import Hardware, add_play, add_stick, encoder_noise, rounded_to_counts
from bodylog.types import Array, Estimate, Features, Series
from tests.estimation.conftest import JOINTS, Arm

ENCODER_HZ = 100.0
PIXEL_STD = 0.3


@dataclass(frozen=True)
class Mechanism:
    """How joints turn and are read: noise of each reading `white` (rad), errors of the hardware, images a second,
    and their noise (px).
    """

    white: float = 1e-3
    hardware: Hardware = field(default_factory=Hardware)
    camera_hz: float = 20.0
    pixel_std: float = PIXEL_STD


SOUND = Mechanism()
QUIET = Mechanism(2e-4, camera_hz=10.0)
LASTING = Mechanism(5e-4, Hardware(correlated=2e-3, correlation_s=2.0))
LOOSE = Mechanism(5e-4, Hardware(play=8e-3))
QUANTISED = Mechanism(1e-5, Hardware(counts=4096))
CORRELATED = Mechanism(hardware=Hardware(correlated=2e-3, correlation_s=2.0))
REALISTIC = Mechanism(
    5e-4,
    Hardware(
        play=4e-3, sag=3e-3, stick=1e-3, correlated=1e-3, counts=4096, tails=4.0, outliers=1e-3, jitter=1e-3
    ),
)


@dataclass(frozen=True)
class Fault:
    """What goes wrong during a run: drift (rad/s) or offset (rad) of one joint since 8 s, or a load's sag (rad).

    moments: s, when the load is taken, put down, taken, … in turn, within 0.2 s; all the time without any.
    """

    joint: int = 1
    drift: float = 0.0
    offset: float = 0.0
    payload: float = 0.0
    moments: tuple[float, ...] = ()

    def sag(self, t: Array) -> Array:
        """What the lift sags by (N,1) rad under the load at times t (N,) s, level."""
        changes = (np.clip((t - one) / 0.2, 0.0, 1.0) * (-1.0) ** i for i, one in enumerate(self.moments))
        return self.payload * (sum(changes) if self.moments else np.ones(len(t)))[:, None]


@cache
def learned(seed: int, mechanism: Mechanism) -> BodyModel:
    """The body learned from 40 s of babbling."""
    return body.learn_body([replayed(seed, mechanism, Fault(), duration=40.0)], Settings(), {}).model


@cache
def fitted(mechanism: Mechanism) -> BodyModel:
    """The body that `fit` learns from 40 s of babbling, with the errors of its mechanism."""
    features = replayed(7699, mechanism, Fault(), duration=40.0)
    return camera_delay.learn_with_delays([features], Settings(), {}, None).model


def replayed(
    seed: int, mechanism: Mechanism, fault: Fault, duration: float = 16.0, reaches: bool = False
) -> Features:
    """What encoders read and a camera sees during a run: smooth motion, or reaches with pauses between them."""
    rng = np.random.default_rng([seed, int(reaches), round(duration)])
    t = np.arange(0.0, duration, 1 / ENCODER_HZ)
    frames = np.arange(0.003, duration, 1 / mechanism.camera_hz)
    motors = (_reaching if reaches else _wandering)(t, rng)
    hardware = mechanism.hardware
    motors = add_stick(motors, hardware.stick)
    sagging = (hardware.sag + hardware.payload + fault.sag(t)) * sink(motors)
    links = add_play(motors, hardware.play) + sagging
    at_frames = np.column_stack([np.interp(frames, t, column) for column in links.T])
    seen = Arm().place(at_frames) + rng.normal(0.0, mechanism.pixel_std, (len(frames), 2))
    since = np.maximum(t - 8.0, 0.0)
    read = motors + encoder_noise(hardware, mechanism.white, motors.shape, ENCODER_HZ, rng)
    read[:, fault.joint] += fault.drift * since + fault.offset * (since > 0.0)
    read = rounded_to_counts(hardware, read)
    stamps = np.maximum.accumulate(t + rng.normal(0.0, 1.0, len(t)) * hardware.jitter)
    joints = Series(stamps, read, JOINTS, "rad", (t * 1e9).astype(np.int64))
    std = np.full(seen.shape, mechanism.pixel_std)
    track = Series(frames, seen, ("u", "v"), "px", (frames * 1e9).astype(np.int64), std)
    return Features(joints, {"effector": track}, None, (), (), {})


def true_angles(seed: int, mechanism: Mechanism, duration: float = 16.0) -> Series:
    """The links' angles during the run of this seed, by what encoders without errors read."""
    motors = replayed(seed, Mechanism(0.0, Hardware()), Fault(), duration).joints
    values = add_play(motors.values, mechanism.hardware.play)
    return Series(motors.t, values, motors.names, "rad", motors.source_ns)


def links_of(seed: int, mechanism: Mechanism, fault: Fault, reaches: bool = False) -> Series:
    """The links' angles of a drawn log, without the sag that the exploration had."""
    bare = replace(mechanism.hardware, play=0.0, sag=0.0, correlated=0.0, tails=0.0, outliers=0.0)
    quiet = Mechanism(0.0, replace(bare, counts=0.0, jitter=0.0))
    motors = replayed(seed, quiet, Fault(), reaches=reaches).joints
    links = add_play(motors.values, mechanism.hardware.play)
    links = links + fault.sag(motors.t) * sink(motors.values)
    return replace(motors, values=links)


def errors_and_nees(found: Estimate, true: Series) -> tuple[Array, float]:
    """Errors (N,M) rad, and the mean square of those in standard deviations."""
    error = found.joints.values - truth_at_times(true, list(found.joints.names), found.joints.t)
    return error, float((error**2 / np.einsum("nii->ni", found.cov)).mean())


def sink(angles: Array) -> Array:
    """How far joints (N,3) sink under a weight at the hand, in shares of the lift's with the arm stretched out."""
    lift, both = angles[:, 1], angles[:, 1] + angles[:, 2]
    elbow = 0.39 * np.cos(both)
    return np.stack([np.zeros(len(angles)), 0.425 * np.cos(lift) + elbow, elbow], axis=1) / 0.815


def _wandering(t: Array, rng: np.random.Generator) -> Array:
    angles = np.tile(np.array([-0.9, -0.9, 1.0]), (len(t), 1))
    for _ in range(4):
        rate, phase = rng.uniform(0.4, 1.8, 3), rng.uniform(0.0, 2 * np.pi, 3)
        angles += 0.17 / rate * np.sin(np.outer(t, rate) + phase)
    return angles


def _reaching(t: Array, rng: np.random.Generator) -> Array:
    """Minimum-jerk reaches (Flash & Hogan 1985) of 1 s between pauses of up to 1 s."""
    angles = np.tile(np.array([-0.9, -0.9, 1.0]), (len(t), 1))
    here, begin = np.zeros(3), 0.5
    while begin < t[-1]:
        there = rng.uniform(-0.35, 0.35, 3)
        s = np.clip(t - begin, 0.0, 1.0)[:, None]
        angles += (there - here) * (10 * s**3 - 15 * s**4 + 6 * s**5)
        here = there
        begin += 1.0 + rng.uniform(0.0, 1.0)
    return angles
