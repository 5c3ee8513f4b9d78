"""Repeated readings and silence: of frozen and dead encoders, of sound ones at rest, and of frozen
cameras.

An encoder at rest repeats its reading, too, if it counts in steps or is read only after motion. So
repeats alone are a fault only of encoders that are noisy all the time, at rest and in motion. Other
encoders that repeat are frozen if images show that their joint moved: residuals of the images
against the encoders' predictions are explained by motion of one joint at a time, and motion of
this joint explains them and motion of no other joint does.

A camera is frozen if images repeat while the encoders show motion.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...body_model import BodyModel
from ...types import Array, Fault, FaultKind
from ..inference.reacquisition import LONG_SILENCE_S, measure_reading_gaps
from ..inference.tangents import OFFSET_STD
from ..measurements.long_arrays import find_finite_rows
from ..measurements.records import Encoders, Evidence, Sighting
from ..noise.encoder_noise import MAX_MEMORY_S
from ..noise.quantisation import find_reading_step
from .jumping import find_level_shifts
from .threshold import EVIDENCE_THRESHOLD_NATS

MAX_REPEAT_SHARE = 0.02
"""Largest share of repeats of a noisy encoder; one that repeats more often counts in steps."""
MOTION_STEP = 0.125
"""rad: from one tried motion to the next, and Gauss and Newton's longest step from the nearest."""
TRIED_MOTIONS = np.arange(-25, 26) * MOTION_STEP
"""rad: up to half a turn. Steps from no motion do not find one of 0.7 past a fold of the image."""


class RepeatedReadings(NamedTuple):
    """Readings [begin, end) that a frozen or dead encoder
    repeats, none if it is silent, and the nats it wins.
    """

    kind: FaultKind
    begin: int
    end: int
    nats: float


def select_images_beside_readings(encoders: Encoders, sighting: Sighting) -> Sighting:
    """The images at times when all encoders are read: in a long gap postures are unknown."""
    gaps = measure_reading_gaps(sighting.t, encoders)
    return sighting.select_rows(np.asarray((gaps <= LONG_SILENCE_S).all(axis=1)))


def measure_motion_nats(
    encoders: Encoders, images: Sequence[Sighting], joint: int, begin: int, end: int
) -> float:
    """Nats that motion of a joint wins in images while
    its encoder repeats the readings [begin, end).
    """
    return max(
        (
            _measure_joint_motion_nats(encoders, joint, s, encoders.t[begin], encoders.t[end - 1])
            for s in images
        ),
        default=0.0,
    )


def _measure_joint_motion_nats(
    encoders: Encoders, joint: int, sighting: Sighting, begin: float, end: float
) -> float:
    """Nats that motion of this joint alone wins in images from begin to end (s); 0 if it leaves
    much unexplained, or is less than the encoder's step.
    """
    rows = find_finite_rows(sighting.values) & (sighting.t > begin) & (sighting.t <= end)
    parts = split_stretch(sighting.t[rows])
    if len(parts) < 2:
        return 0.0
    x = encoders.interpolate_at(sighting.t[rows])
    y = sighting.values[rows]
    var = sighting.var[rows]
    middle = np.stack([np.median(x[p], axis=0) for p in parts])
    # motion within a part, as the encoders predict it, is subtracted before averaging
    known = sighting.model.predict(x)[0]
    at, jac, model = sighting.model.predict(middle)
    place = np.stack([np.median(y[p] - known[p], axis=0) for p in parts]) + at
    noise = np.stack([1.6 * var[p].mean(axis=0) / len(p) for p in parts]) + model
    noise += np.square(jac) @ encoders.variance
    # a constant offset is not motion
    constant = ((place - at) / noise).sum(axis=0) / (1.0 / noise).sum(axis=0)
    still = float(_sum_squared_misfits(place - at - constant, noise).sum())
    if still - len(parts) <= EVIDENCE_THRESHOLD_NATS:
        return 0.0
    found = [_explain_by_joint_motion(sighting, place, noise, middle, k) for k in range(x.shape[1])]
    gains = [still - left for left, _ in found]
    gain = gains.pop(joint)
    left, apart = found[joint]
    least = max(
        OFFSET_STD,
        2.0 * find_reading_step(encoders.values[np.isfinite(encoders.values[:, joint]), joint]),
    )
    # better than rest, and better than motion of any other joint
    won = min(gain - len(parts), gain - max(gains, default=0.0))
    return won if left < 0.2 * gain + len(parts) and apart > least else 0.0


def _explain_by_joint_motion(
    sighting: Sighting, place: Array, noise: Array, x: Array, joint: int
) -> tuple[float, float]:
    """Nats that motion of one joint leaves of positions (P,D) at postures x (P,M), and its range
    (rad).
    """
    own = np.arange(x.shape[1]) == joint
    tried = x + TRIED_MOTIONS[:, None, None] * own
    places = sighting.model.predict(tried.reshape(-1, x.shape[1]))[0]
    misfits = _sum_squared_misfits(place - places.reshape(len(tried), *place.shape), noise)
    moved = TRIED_MOTIONS[misfits.argmin(axis=0)]
    for _ in range(4):
        mean, jac, _ = sighting.model.predict(x + np.outer(moved, own))
        slope = jac[:, :, joint]
        off = place - mean
        stiff = (slope * slope / noise).sum(axis=1)
        step = np.divide(
            (slope * off / noise).sum(axis=1), stiff, out=np.zeros_like(stiff), where=stiff > 0.0
        )
        # no farther than to the next one tried
        moved = moved + np.clip(step, -MOTION_STEP, MOTION_STEP)
    mean = sighting.model.predict(x + np.outer(moved, own))[0]
    left = float(_sum_squared_misfits(place - mean, noise).sum())
    return left, float(np.ptp(moved))


def _sum_squared_misfits(off: Array, noise: Array) -> Array:
    """Half the squared residuals off (…,P,D) over their variances (P,D), of each part (…,P)."""
    return np.asarray(0.5 * (np.square(off) / noise).sum(axis=-1))


def detect_frozen_camera(evidence: Evidence, body: BodyModel) -> Evidence:
    """Remove track positions that repeat exactly while the encoders predict motion."""
    if evidence.encoders is None or "encoders" in body.senses:
        return evidence
    used = dict(evidence.used)
    sightings = list[Sighting]()
    faults = list[Fault]()
    for sighting in evidence.sightings:
        values = sighting.values
        found = list[Fault]()
        if sighting.name != "touch":
            values, found = _remove_false_repeats(sighting, evidence.encoders)
        if found:
            health = used[sighting.name]
            left = int(find_finite_rows(values).sum())
            rejected = {**health.rejected, "frozen": health.used - left}
            used[sighting.name] = replace(health, used=left, rejected=rejected)
        sightings.append(replace(sighting, values=values))
        faults += found
    return replace(
        evidence, sightings=tuple(sightings), used=used, faults=(*evidence.faults, *faults)
    )


def _remove_false_repeats(sighting: Sighting, encoders: Encoders) -> tuple[Array, list[Fault]]:
    """Return positions (N,D) with false repeats as NaN,
    the first of each stretch kept, and the faults.
    """
    shown = np.flatnonzero(find_finite_rows(sighting.values))
    values = sighting.values.copy()
    found = []
    for begin, end in find_equal_stretches(sighting.t[shown], sighting.values[shown]):
        own = shown[begin:end]
        if moved := _predict_largest_motion(
            sighting, encoders, sighting.t[own[0]], sighting.t[own[-1]]
        ):
            values[own[1:]] = np.nan
            since = float(sighting.t[own[1]])
            until = float(sighting.t[shown[end]]) if end < len(shown) else None
            unit = getattr(sighting.model, "unit", "px")
            found.append(
                Fault("vision", sighting.name, FaultKind.FROZEN, since, moved, unit, until=until)
            )
    return values, found


def _predict_largest_motion(
    sighting: Sighting, encoders: Encoders, begin: float, end: float
) -> float:
    """Largest motion (px or mm) that the encoders predict from
    the first part of a stretch on; 0 if not significant.
    """
    inside = (encoders.t >= begin) & (encoders.t <= end)
    x = encoders.interpolate_at(encoders.t[inside])
    parts = split_stretch(encoders.t[inside])
    if not parts or not np.isfinite(x).all():
        return 0.0
    means = np.stack([x[part].mean(axis=0) for part in parts])
    var = encoders.variance / np.maximum(
        np.isfinite(encoders.values[inside]).sum(axis=0) / len(parts), 1.0
    )
    noise = 2.0 * (np.square(sighting.model.predict(means)[1]) * var).sum(axis=(1, 2)).max()
    # a single encoder against the images may itself be faulty
    without = [np.where(alone, means[0], means) for alone in np.eye(means.shape[1]) > 0]
    places = np.stack([sighting.model.predict(some)[0] for some in without])
    apart = float(np.linalg.norm(places - places[:, :1], axis=2).max(axis=1).min())
    # the largest of as many distances as there are parts
    least = (EVIDENCE_THRESHOLD_NATS + np.log(len(parts))) * noise
    return apart if 0.5 * apart**2 > least and apart > 1.0 else 0.0


def find_frozen_readings(
    t: Array, y: Array, moved: Callable[[int, int], float]
) -> Iterator[RepeatedReadings]:
    """Yield long repeats in readings y (N,) rad at t (N,) s: of a noisy
    encoder, after a fall to exactly zero, or while its joint moved, as
    images show; `moved` gives their nats for readings [begin, end).
    """
    long = find_equal_stretches(t, y)
    if not long:
        return
    scatters = has_steady_scatter(np.delete(y, np.concatenate([np.arange(*run) for run in long])))
    fell = {at: nats for at, _, nats in find_level_shifts(t, y) if y[at] == 0.0}
    for begin, end in long:
        chance = (end - begin - 1) * -np.log(MAX_REPEAT_SHARE) - np.log(len(y)) if scatters else 0.0
        nats = max(float(chance), fell.get(begin, 0.0), moved(begin, end))
        dead = y[begin] == 0.0
        # the first of the values that a frozen encoder repeats was sound
        kind = FaultKind.DEAD if dead else FaultKind.FROZEN
        yield RepeatedReadings(kind, begin + (not dead), end, nats)


def find_final_silence(t: Array, y: Array) -> RepeatedReadings:
    """The last of readings y (N,) rad at t (N,) s: dead
    since then if MAX_MEMORY_S and twice its longest gap ago.
    """
    known = np.flatnonzero(np.isfinite(y))
    longest = np.diff(t[known]).max(initial=0.0)
    last = int(known[-1])
    return RepeatedReadings(
        FaultKind.DEAD,
        last,
        last,
        EVIDENCE_THRESHOLD_NATS * float(t[-1] - t[last]) / max(MAX_MEMORY_S, 2.0 * longest),
    )


def find_equal_stretches(t: Array, y: Array) -> list[tuple[int, int]]:
    """Return long stretches [begin, end) of bitwise equal
    readings y (N,) or (N,D) at t (N,) s, the first included.
    """
    same = np.diff(y, axis=0) == 0.0
    same = same if y.ndim == 1 else same.all(axis=1)
    edges = np.flatnonzero(np.diff(same, prepend=False, append=False)).tolist()
    runs = zip(edges[::2], edges[1::2], strict=True)
    return [(a, b + 1) for a, b in runs if t[b] - t[a] > LONG_SILENCE_S]


def split_stretch(t: Array) -> list[Array]:
    """Rows of each part of a stretch of instants t (N,)
    s, a part being half the shortest stretch of repeats.
    """
    count = int(2.0 * np.ptp(t) / LONG_SILENCE_S) if len(t) else 0
    return np.array_split(np.arange(len(t)), min(count, len(t))) if count else []


def has_steady_scatter(y: Array) -> bool:
    """Whether readings (N,) scatter all the time and rarely repeat."""
    y = y[np.isfinite(y)]
    bends = np.diff(y, 2)
    # second differences of noise change sign 73 % of the time
    if (
        len(bends) < 10
        or np.mean(np.diff(y) == 0.0) > MAX_REPEAT_SHARE
        or np.mean(bends[1:] * bends[:-1] < 0) <= 0.4
    ):
        return False
    width = min(16, len(bends))
    scatter = np.sqrt(
        np.square(bends[: len(bends) // width * width].reshape(-1, width)).mean(axis=1)
    )
    usual = float(np.median(scatter))
    # a quiet window is rest; rounding alone scatters bends by
    # √(6/12) = 0.7 of a step, noise of one step by √6.5 = 2.5
    return bool(scatter.min() > 0.2 * usual) and usual > 1.35 * find_reading_step(y)
