"""Whether a log's images are late against its joints, by
the motion of the whole picture: no marker, body or URDF.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..body.data import angle_smoother
from ..perception.surface.camera_clock import fit_camera_clock
from ..perception.surface.flow import GridFlow, measure_grid_flow
from ..perception.surface.repeats import FrameRepeats
from ..types import Array, Recording, Series
from .flow_delay import MIN_EVIDENCE_NATS, FlowDelay, estimate_flow_delay

LONGEST_KNOT_S = 0.02
"""Longest distance of the times at which smoothed
joints are known: well below the delays that matter.
"""
KNOTS_PER_INTERVAL = 4
"""Least number of these times between two images."""
LEAST_READINGS = 8
"""Fewest readings of a joint whose motion is smoothed."""
LEAST_REPEATS = 10
"""Fewest repeats that tell a camera whose frames are stored twice."""
ALTERNATING_SHARE = 0.9
"""Share of the gaps between its repeats that have an even
number of frames; the rest are slips of the recorder.
"""
LEAST_OF_ARM = 3
"""Fewest joints of a numbered arm: numbers may count joints, too."""
_SIDES = {"left": "left", "l": "left", "right": "right", "r": "right"}


@dataclass(frozen=True)
class CameraFlow:
    """A camera's name, and its delay by flow; None
    where the images or the joints do not suffice.
    """

    camera: str
    found: FlowDelay | None


def measure_flow_delays(read: Recording) -> Iterator[CameraFlow]:
    """Yield the delay of each camera of a recording by flow; nothing without joints."""
    if not has_motion(read):
        return
    for name, seen in see_cameras(read):
        yield CameraFlow(name, delay_by_flow(read, seen))


def has_motion(read: Recording) -> bool:
    """Whether a recording has joints that a delay can be measured against."""
    return (
        read.signals.joints is not None
        and not read.signals.poses
        and len(read.signals.joints.t) >= LEAST_READINGS
    )


def see_cameras(read: Recording) -> Iterator[tuple[str, GridFlow | None]]:
    """Yield each camera's name and the motion of its picture, None without two images; each image
    is decoded once."""
    for name, film in {"": read.cameras.frames, **read.cameras.views}.items():
        if film is not None:
            yield name or "camera", measure_grid_flow(film())


def delay_by_flow(read: Recording, seen: GridFlow | None) -> FlowDelay | None:
    """The delay of a camera whose picture moves as `seen`; None where images or joints do not
    suffice."""
    if read.signals.joints is None or seen is None or len(seen.times) < 2:
        return None
    seen = date_by_camera_clock(merge_slow_repeats(seen))
    interval_s = float(np.median(np.diff(seen.times, axis=1)))
    joints = smooth_joints(
        read.signals.joints, min(interval_s / KNOTS_PER_INTERVAL, LONGEST_KNOT_S)
    )
    arms = group_joints(joints.names)
    row_time_s = _longest_row_time(seen)
    return estimate_flow_delay(joints, seen.times, seen.flow, list(arms.values()), row_time_s)


def alternating_repeats(repeats: FrameRepeats) -> Array:
    """Which frames (N,) repeat the one before, those of a slow picture included.

    Where the picture moves slowly, a repeat looks like a new frame.
    Two repeats that an even number of frames lies between say that every
    second frame repeats there, if nearly all repeats of the film do.
    """
    certain = np.flatnonzero(repeats.repeated)
    gaps = np.diff(certain)
    found = repeats.repeated.copy()
    if len(gaps) < LEAST_REPEATS or np.mean(gaps % 2 == 0) < ALTERNATING_SHARE:
        return found
    for first, last in zip(certain[:-1].tolist(), certain[1:].tolist(), strict=True):
        if (last - first) % 2 == 0:
            found[first:last:2] = True
    found[certain[0] % 2 or 2 : certain[0] : 2] = True
    found[certain[-1] :: 2] = True
    return found


def merge_slow_repeats(seen: GridFlow) -> GridFlow:
    """The flow of a camera without intervals that end at
    a repeat: half of the motion's time would be missing.
    """
    repeated = alternating_repeats(seen.repeats)
    first = np.flatnonzero(~np.isin(seen.times[:, 0], seen.repeats.t[repeated]))
    if not len(first) or len(first) == len(seen.times):
        return seen
    last = np.append(first[1:] - 1, len(seen.times) - 1)
    times = np.column_stack([seen.times[first, 0], seen.times[last, 1]])
    return replace(seen, times=times, flow=np.add.reduceat(seen.flow, first, axis=0))


def date_by_camera_clock(seen: GridFlow) -> GridFlow:
    """The flow of a camera with the times of its own clock, where it has one that its recorder's
    stamps tell; intervals between copies of one picture join the one that follows."""
    clock = fit_camera_clock(seen.repeats.t, alternating_repeats(seen.repeats))
    if clock is None:
        return seen
    dates = clock.date_pictures(np.append(seen.times[:, 0], seen.times[-1, 1]))
    kept = np.flatnonzero(np.diff(dates, prepend=-np.inf))
    times = np.column_stack([dates[kept[:-1]], dates[kept[1:]]])
    flow = np.add.reduceat(seen.flow[: kept[-1]], kept[:-1], axis=0)
    return replace(seen, times=times, flow=flow)


def _longest_row_time(seen: GridFlow) -> float:
    """Time (s) that a rolling shutter may take: not
    more than from one distinct image to the next.
    """
    return float(np.median(np.diff(seen.times, axis=1)))


def group_joints(names: tuple[str, ...]) -> dict[str, tuple[int, ...]]:
    """Joints of each arm, by what its names have in common: the left side, the right side and
    neither; or a numbered word before the same joints, as in arm1_elbow and arm2_elbow; one group
    without either."""
    arms: dict[str, list[int]] = {}
    for number, name in enumerate(names):
        words = [word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)]
        side = next((_SIDES[word] for word in words if word in _SIDES), "")
        arms.setdefault(side, []).append(number)
    if set(arms) == {""}:
        parts = [re.split(r"[_./ -]", name, maxsplit=1) for name in names]
        own: dict[str, list[int]] = {}
        for number, part in enumerate(parts):
            own.setdefault(part[0], []).append(number)
        ends = {tuple("".join(parts[k][1:]) for k in group) for group in own.values()}
        words = [re.sub(r"\d", "", arm) for arm in own]
        if len(own) > 1 and len(ends) == 1 == len(set(words)) and len(ends.pop()) >= LEAST_OF_ARM:
            arms = own
    return {arm: tuple(group) for arm, group in arms.items()}


def name_moving_arm(names: tuple[str, ...], found: FlowDelay) -> str | None:
    """The arm, of several, whose joints explain the motion of a camera's picture; None where the
    evidence does not tell."""
    arms = {group: arm for arm, group in group_joints(names).items()}
    arm = arms.get(found.joints, "")
    if len(arms) < 2 or not arm or not found.certain or found.joints_nats < MIN_EVIDENCE_NATS:
        return None
    return f"the {arm} side" if arm in _SIDES else arm


def smooth_joints(joints: Series, step_s: float) -> Series:
    """Joints at evenly spaced times, by integrated Wiener processes of greatest evidence.

    Interpolated readings would do harm: between two readings they have less noise than at them, and
    the delay at which images fall between readings would win.
    """
    t = np.arange(joints.t[0], joints.t[-1], step_s)
    columns = [
        _smooth_joint(joints.t, joints.values[:, k], t) for k in range(joints.values.shape[1])
    ]
    return replace(
        joints, t=t, values=np.column_stack(columns), source_ns=np.zeros(len(t), np.int64), std=None
    )


def _smooth_joint(t: Array, values: Array, at: Array) -> Array:
    """A joint's angle at the times `at` (K,); NaN without
    enough readings, constant for a joint at rest.
    """
    finite = np.isfinite(values)
    if finite.sum() < LEAST_READINGS:
        return np.full(len(at), np.nan)
    if np.ptp(values[finite]) == 0.0:
        return np.full(len(at), values[finite][0])
    chain = angle_smoother.build_reading_chain(t[finite], values[finite])
    motions = [
        angle_smoother.fit_white_motion([chain], order, with_errors=False) for order in (2, 3)
    ]
    best = max(motions, key=lambda motion: motion.evidence)
    inside = np.clip(at, chain.t[0], chain.t[-1])
    return angle_smoother.smooth_angles(chain, best, inside)[0]
