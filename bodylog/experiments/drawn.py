"""Logs drawn without a renderer: features of the
simulated arm at any speed, as perception would find them.

A rendered minute takes a minute; only the motion matters here, and perception's error is known.
"""

from functools import cache

import numpy as np

from ..kinematics import chain, urdf
from ..sim.arms import ARMS
from ..sim.camera import PinholeCamera, ellipse_centre, look_at
from ..types import Array, Features, Series
from .lab import JOINTS, ObservedLog

ARM = ARMS["ur5"]
RADIUS = 0.025
"""m: the effector's ball."""
ENCODER_HZ = 100.0
CAMERA_HZ = 30.0
PIXEL_STD = 0.1
"""px: the 99th percentile of perception's error on rendered logs (docs/validation.md)."""
SIZE = (320, 240)
SETTLING = 8.0
"""s at the start of each log that do not count."""
_ASIDE = np.array([0.017, 0.0, 0.03])
_RATIOS = np.array([1.0, 1.3, 1.7])
"""Periods of the three joints, in the first's: they never repeat together."""
_SWING = 0.7 * np.array(ARM.swing[:3])


@cache
def _effector_chain() -> chain.Chain:
    return chain.chain_between(urdf.load_urdf(ARM.urdf), "base_link", "effector").over(ARM.joints)


@cache
def simulated_head_camera(size: tuple[int, int] = SIZE) -> PinholeCamera:
    """The simulator's head camera."""
    target = effector_position(np.array([ARM.home[:3]]))[0]
    return look_at(target + np.array(ARM.camera), target + _ASIDE, size)


def effector_position(x: Array) -> Array:
    """The effector's position (N,3) m at x (N,3) rad, the wrist at rest."""
    return _effector_chain().at(np.column_stack([x, np.tile(ARM.home[3:], (len(x), 1))])).place


def place_in_image(x: Array, size: tuple[int, int] = SIZE) -> Array:
    """Its place in the image (N,2) px at x (N,3) rad."""
    return ellipse_centre(simulated_head_camera(size), effector_position(x), RADIUS)


def px_per_cm() -> float:
    """Pixels per centimetre across the view at the effector's home."""
    seen = simulated_head_camera()
    return float(
        seen.focal
        / (seen.rotation @ (effector_position(np.array([ARM.home[:3]]))[0] - seen.position))[2]
        / 100.0
    )


def draw_swing(
    period: float,
    seed: int,
    moving: tuple[bool, bool, bool],
    begins: float = 0.0,
    t: Array | None = None,
) -> tuple[Array, Array]:
    """Times (N,) s and true angles (N,3) rad of sines of
    this period (s) about home; at rest until `begins` s.
    """
    t = np.arange(0.0, begins + SETTLING + period, 1.0 / ENCODER_HZ) if t is None else t
    phase = np.random.default_rng([seed, 21]).uniform(0.0, 2.0 * np.pi, 3) * (begins == 0.0)
    since = np.maximum(t - begins, 0.0)[:, None]
    swing = _SWING * np.array(moving)
    return t, np.array(ARM.home[:3]) + swing * np.sin(
        2.0 * np.pi * since / (period * _RATIOS) + phase
    )


def draw_log(
    period: float,
    noise: float,
    seed: int,
    moving: tuple[bool, bool, bool] = (True, True, True),
    begins: float = 0.0,
    square: bool = False,
    seconds: float | None = None,
) -> ObservedLog:
    """A log of that motion: encoders with `noise` (rad) at
    100 Hz, the effector at 30 Hz; `square`: they read x².
    """
    rng = np.random.default_rng([seed, 22])
    end = begins + SETTLING + period if seconds is None else seconds
    t, x = draw_swing(period, seed, moving, begins, np.arange(0.0, end, 1.0 / ENCODER_HZ))
    frames, there = draw_swing(period, seed, moving, begins, np.arange(0.0, end, 1.0 / CAMERA_HZ))
    read = np.where(square, x**2, x) + noise * rng.standard_normal(x.shape)
    seen = place_in_image(there) + PIXEL_STD * rng.standard_normal((len(frames), 2))
    track = Series(
        frames, seen, ("u", "v"), "px", _to_nanoseconds(frames), np.full(seen.shape, PIXEL_STD)
    )
    joints = Series(t, read, JOINTS, "rad", _to_nanoseconds(t))
    features = Features(joints, {"effector": track}, None, (), (), {}, (), SIZE)
    return ObservedLog(features, Series(t, x, JOINTS, "rad", _to_nanoseconds(t)))


def _to_nanoseconds(t: Array) -> Array:
    return np.asarray(np.rint(t * 1e9).astype(np.int64))
