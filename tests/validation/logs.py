"""Logs with truth: the simulator's motions before its two cameras, drawn without a renderer; and the recorded arm.

A track's error is a smooth function of the place in the image, as perception's is: images px apart correlate by
exp(−2 px) (docs/validation.md), so a still target errs by one amount.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from bodylog import body, pipeline
from bodylog.experiments.lab import JOINTS, ObservedLog
from bodylog.settings import BodySettings, Settings
from bodylog.sim.arms import ARMS
from bodylog.sim.plan import Request
from bodylog.sim.scenarios import SCENARIOS
from bodylog.types import Features, Series
from tests.estimation import textbook

ARM, SIZE = ARMS["ur5"], (320, 240)
ENCODER_HZ, CAMERA_HZ = 100.0, 20.0
PIXEL_STD = 0.04
"""px: as on the rendered logs of the table `tracking`."""
FALL = 2.0
"""1/px: how fast the correlation of a track's errors falls with distance."""
WAVES = 400
TRACKS = ("effector", "side/effector")
RECORDED = Path(__file__).parents[2] / "fixtures" / "arm"


@cache
def eyes():
    """The two cameras' projections of joint angles (N,3) rad, from the URDF."""
    return textbook.eyes(ARM, JOINTS, SIZE)


def drawn(scenario, seed, seconds=None, cameras=1, plan=None):
    """The log of a scenario, or of another plan: encoders at 100 Hz, each camera's track at 20 Hz."""
    entry, rng = SCENARIOS[scenario], np.random.default_rng([seed, 31])
    length = entry.duration if seconds is None else seconds
    request = Request(ARM, length, False, entry.variants[0], entry.places[0], np.random.default_rng([seed, 0]))
    made = (plan or entry.plan)(request)
    t, frames = np.arange(0.0, length, 1 / ENCODER_HZ), np.arange(0.004, length, 1 / CAMERA_HZ)
    angles, there = made.motion.position(t), made.motion.position(frames)[:, :3]
    read = made.encoders(t, angles, made.noise * rng.standard_normal(angles.shape))
    tracks = {}
    for name, eye in list(zip(TRACKS, eyes(), strict=True))[:cameras]:
        seen = perceived(eye.place(there), rng)
        if made.covered is not None and name == TRACKS[0]:
            seen[(frames >= made.covered[0]) & (frames < made.covered[1])] = np.nan
        tracks[name] = Series(frames, seen, ("u", "v"), "px", ns(frames), np.full(seen.shape, PIXEL_STD))
    joints = Series(t, read, ARM.joints, "rad", ns(t))
    truth = Series(t, angles[:, :3], JOINTS, "rad", ns(t))
    return ObservedLog(Features(joints, tracks, None, (), (), {}, (), SIZE), truth)


def perceived(places, rng):
    """Places (N,2) px with perception's error: a Gaussian field of correlation exp(−FALL · distance)."""
    turns = FALL * rng.standard_normal((2, WAVES, 2)) / np.abs(rng.standard_normal((2, WAVES, 1)))
    waves = np.cos(np.einsum("nk,dwk->ndw", places, turns) + rng.uniform(0.0, 2.0 * np.pi, (2, WAVES)))
    return places + PIXEL_STD * np.sqrt(2.0 / WAVES) * waves.sum(axis=2)


@cache
def learned(seed, cameras=1, seconds=40.0):
    """The body learned from the exploration of a seed."""
    explored = drawn("babble", seed, seconds, cameras).features
    return learn([explored], Settings(body=BodySettings(joints=JOINTS)))


@cache
def recorded(name):
    """A recorded log of fixtures/arm: what perception finds, and the truth it carries."""
    read, features = pipeline.observe(RECORDED / name, Settings())
    return ObservedLog(features, read.signals.truth)


@cache
def recorded_body():
    """The body learned from the recorded exploration."""
    return learn([recorded("explore.mcap").features], Settings())


def learn(features, settings):
    """The body that `fit` learns from these features without a URDF, their clocks being right."""
    found = body.learn_body(features, settings, {})
    return body.with_kinematics(features, settings, found, None).model


def ns(t):
    """Stamps (N,) ns of times (N,) s."""
    return np.rint(t * 1e9).astype(np.int64)


def of(world):
    """A drawn world of the tests as a log."""
    return ObservedLog(world.features, world.truth)


def with_motion(draw, motion, *args, **options):
    """`draw` of the tests' worlds with another motion."""
    import tests.estimation.conftest as worlds

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(worlds, "motion", motion)
        return draw(*args, **options)


def with_encoders(log, change):
    """The log with encoders' values changed: change(t (N,), values (N,M), names) -> values."""
    joints = log.features.joints
    values = change(joints.t, joints.values.copy(), joints.names)
    return replace(log, features=replace(log.features, joints=replace(joints, values=values)))
