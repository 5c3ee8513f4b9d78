"""Offsets put into held-out episodes of a real humanoid, judged by a body of the other episodes: python -m
tests.surface.humanoid_faults prints the table."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from bodylog.body_model import BodyModel
from bodylog.delays.findings import middle_of_recording
from bodylog.errors import EvidenceError
from bodylog.kinematics.joint_motion import JointCurve
from bodylog.kinematics.landmark_hypotheses import join_changes
from bodylog.recording import recording
from bodylog.settings import KinematicsSettings, Settings
from bodylog.surface import calibration, estimate, tracks
from bodylog.surface.body import learn_surface_body
from bodylog.surface.estimate import CameraJudgement
from bodylog.types import Array, Fault, Recording
from tests.changed_recordings import change_recording

G1 = Path(__file__).parents[3] / "shared" / "real" / "g1"
EPISODES = (1, 2, 4, 5, 7, 8, 10, 11)
PAIRS = ((1, 4), (2, 8), (5, 11))
JOINTS = ("kRightShoulderPitch", "kRightShoulderRoll", "kRightShoulderYaw", "kRightElbow", "kRightWristRoll",
          "kRightWristPitch", "kRightWristYaw")  # fmt: skip
INJECTED = np.radians(5.0)


@dataclass(frozen=True, eq=False)
class JudgedPair:
    """What a pair of held-out episodes tells with 5° on one joint, "" for none: the joint that it names, the size
    found (degrees) and its std, and the same of each episode alone."""

    pair: tuple[int, int]
    joint: str
    found: tuple[str, float, float]
    alone: tuple[tuple[str, float, float], ...]


@cache
def episode(number: int) -> Recording:
    read = recording.read_recording(Path(f"{G1}#{number}"), settings(), False)
    return middle_of_recording(read, calibration.LONGEST_S, calibration.MOST_IMAGES)


def settings() -> Settings:
    return Settings(kinematics=KinematicsSettings(urdf=str(G1 / "g1_inspire.urdf")))


@cache
def body_without(pair: tuple[int, ...]) -> BodyModel:
    """A body of all episodes but these."""
    logs = [(Path(f"{G1}#{number}"), episode(number)) for number in EPISODES if number not in pair]
    return learn_surface_body(logs, settings(), {}).model


@cache
def motion_of(number: int, joints: tuple[str, ...]) -> JointCurve:
    read = episode(number)
    assert read.signals.joints is not None
    return calibration.smoothed_motion(read.signals.joints, joints)


def judge(number: int, learned: BodyModel, joint: str) -> CameraJudgement:
    """An episode with 5° added to a joint's readings, "" for none, by a body."""
    motion = motion_of(number, learned.joints)
    offset = INJECTED * (np.array(learned.joints) == joint)
    moved = replace(motion, q=motion.q + offset)
    assert learned.surface is not None
    camera = learned.surface.cameras[0]
    return estimate.judge_by_camera(Path(f"{G1}#{number}"), episode(number), learned.surface, camera, moved)


def judge_pair(pair: tuple[int, int], joint: str) -> JudgedPair:
    learned = body_without(pair)
    both = [judge(number, learned, joint) for number in pair]
    assert learned.surface is not None
    logs = len(learned.surface.cameras[0].delays)
    changes = join_changes([one.changes for one in both], logs, estimate.MARGIN_NATS)
    sure = estimate._identifiable_joints(changes, learned.surface)
    joined = replace(both[0], changes=changes, identifiable=sure)
    faults = [estimate._winning_fault(one, 0.0, learned) for one in (joined, *both)]
    shown = [_describe(fault) for fault in faults]
    return JudgedPair(pair, joint, shown[0], tuple(shown[1:]))


def _describe(fault: Fault | None) -> tuple[str, float, float]:
    if fault is None:
        return "", 0.0, 0.0
    return fault.name, float(np.degrees(fault.size)), float(np.degrees(fault.std or np.nan))


def held_out_error(number: int, learned: BodyModel) -> tuple[float, float]:
    """Error (px, per axis) of a held-out episode's corners where the body's camera, lens and zeros predict them, and
    the share of its moving corners that lie on links; its delay is its own."""
    judged = judge(number, learned, "")
    assert learned.surface is not None
    model, phi, seen = judged.linked.model, judged.linked.phi.copy(), judged.linked.seen
    camera = learned.surface.cameras[0]
    own = len(camera.unknowns) + 1
    late = model.of_delays.start
    phi[np.delete(np.arange(own), late)] = camera.unknowns
    phi[own:] = 0.0
    linked = tracks.link_tracks(model, phi, seen)
    used = np.flatnonzero(linked.on_moving_links)
    part = seen.take(used)
    residual = part.uv - model.predict(phi, part, linked.body[used], linked.places[used]).image
    return float(np.sqrt(np.square(residual).mean())), len(used) / seen.count


def half_delays(number: int, learned: BodyModel) -> Array:
    """Delay (s) and std of both halves (2,2) of an episode, by a body; NaN of a half that shows too little of the arm."""
    assert learned.surface is not None
    read = episode(number)
    assert read.cameras.frames is not None
    camera = learned.surface.cameras[0]
    middle = 0.5 * read.duration_s
    found = []
    for first in (True, False):
        part = change_recording(
            read, frames=lambda first=first: (one for one in read.cameras.frames() if (one.t < middle) == first)
        )
        motion = motion_of(number, learned.joints)
        try:
            judged = estimate.judge_by_camera(Path(f"{G1}#{number}"), part, learned.surface, camera, motion)
        except EvidenceError:
            found.append((np.nan, np.nan))
        else:
            found.append(judged.delay)
    return np.array(found)


def table() -> Iterator[str]:
    """The table as lines: each pair sound and with each fault, then delays of halves and held-out errors."""
    for pair in PAIRS:
        for joint in ("", *JOINTS):
            one = judge_pair(pair, joint)
            alone = "; ".join("{} {:.2f} ± {:.2f}".format(*shown) if shown[0] else "-" for shown in one.alone)
            both = "{} {:.2f} ± {:.2f}".format(*one.found) if one.found[0] else "-"
            yield f"| {pair} | {joint or 'sound'} | {both} | {alone} |"
        for number in pair:
            error, share = held_out_error(number, body_without(pair))
            yield f"| {number} | held out | {error:.2f} px | {share:.0%} of its moving corners |"
            first, second = half_delays(number, body_without(pair))
            apart = (first[0] - second[0]) ** 2 / (first[1] ** 2 + second[1] ** 2)
            each = " and ".join(f"{1e3 * late:.1f} ± {1e3 * std:.1f} ms" for late, std in (first, second))
            yield f"| {number} | halves | {each} | chi² {apart:.2f} |"


if __name__ == "__main__":
    for line in table():
        print(line, flush=True)
