"""Which stretch between an encoder's jumps is the true one, by the images.

Readings alone show that encoders jump, and not whether they are wrong after it or before it: one
that is homed late is wrong before it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ...types import Array, Fault, FaultKind
from ..measurements.long_arrays import find_finite_rows
from ..measurements.records import Encoders, Sighting
from .jumping import IMAGES_BESIDE_SHIFT, index_resumed_readings
from .threshold import EVIDENCE_THRESHOLD_NATS

IMAGES_OF_LOG = 3
"""Images that count, of all of a sense: what a body does not know of the arm is common to them.
Where they are far off, they then tell two stretches apart if one has a quarter of the errors."""
MOST_STRETCHES = 16
"""Stretches that are compared with the first, the longest ones: a bound on time."""
MOST_IMAGES = 100
"""Images of a sense, spread over the log, that are compared: as many as a median asks for."""


def refer_to_true_stretch(
    encoders: Encoders, images: Sequence[Sighting], joints: Sequence[str], faults: Sequence[Fault]
) -> tuple[Encoders, list[Fault]]:
    """Angles that continue the stretch between jumps that images show to be the true one, in place
    of the first, and the faults: encoders are wrong until the jumps before it.

    encoders: readings (N,M) out of which the jumps among the faults, in their unit, were taken.
    """
    jumps = [fault for fault in faults if fault.kind == FaultKind.JUMPING]
    if not jumps or not images or not np.isfinite(encoders.values).any(axis=0).all():
        return encoders, list(faults)
    encoders, behind_gaps = _take_out_jumps_at_gaps(encoders, images, joints, jumps)
    jumps += behind_gaps
    faults = [*faults, *behind_gaps]

    def continue_stretch(begin: float) -> Encoders:
        level = [
            sum(one.size for one in jumps if one.name == name and one.since <= begin)
            for name in joints
        ]
        values = encoders.values + np.array(level)
        # readings of the true stretch are as read but for rounding
        read = encoders.as_read.values
        return replace(encoders, values=np.where(np.isclose(values, read), read, values))

    begins = np.array(sorted({fault.since for fault in jumps}))
    lasting = np.diff(begins, append=encoders.t[-1])
    won = {
        begin: _compare_misfits(encoders, continue_stretch(begin), images)
        for begin in begins[np.argsort(-lasting)[:MOST_STRETCHES]].tolist()
    }
    true_since = max(won, key=lambda begin: won[begin])
    if won[true_since] < EVIDENCE_THRESHOLD_NATS:
        return encoders, list(faults)
    start = float(encoders.t[0])
    return continue_stretch(true_since), [
        replace(one, since=start, until=one.since, size=-one.size)
        if one in jumps and one.since <= true_since
        else one
        for one in faults
    ]


def _take_out_jumps_at_gaps(
    encoders: Encoders, images: Sequence[Sighting], joints: Sequence[str], jumps: Sequence[Fault]
) -> tuple[Encoders, list[Fault]]:
    """Readings without the jumps that hide in gaps, where images show them, and these jumps.

    An encoder whose driver starts again may read wrongly until it is homed, or be homed while it is
    silent: one of its two jumps shows in its readings, and the other undoes it in a gap.
    """
    found = list[Fault]()
    for jump in jumps[:MOST_STRETCHES]:
        joint = joints.index(jump.name)
        for since in _find_longest_gaps(encoders, joint, jump, [*jumps, *found]):
            values = encoders.values.copy()
            values[encoders.t >= since, joint] += jump.size
            mended = replace(encoders, values=values)
            if _compare_misfits(encoders, mended, images) > EVIDENCE_THRESHOLD_NATS:
                encoders = mended
                found.append(replace(jump, since=since, size=-jump.size))
                break
    return encoders, found


def _find_longest_gaps(
    encoders: Encoders, joint: int, jump: Fault, jumps: Sequence[Fault]
) -> list[float]:
    """When (s) a joint's encoder reads again after the longest gap between one of its jumps and the
    jump before, and after that between it and the next one.
    """
    resumed = index_resumed_readings(encoders.t, encoders.values[:, joint])
    known = np.flatnonzero(np.isfinite(encoders.values[:, joint]))
    before = encoders.t[known[np.searchsorted(known, resumed[1:]) - 1]]
    after = encoders.t[resumed[1:]]
    others = [one.since for one in jumps if one.name == jump.name]
    earlier = max((since for since in others if since < jump.since), default=-np.inf)
    later = min((since for since in others if since > jump.since), default=np.inf)
    longest = list[float]()
    for begin, end in ((earlier, jump.since), (jump.since, later)):
        within = (after > begin) & (after < end)
        if within.any():
            longest.append(float(after[within][(after - before)[within].argmax()]))
    return longest


def _compare_misfits(encoders: Encoders, mended: Encoders, images: Sequence[Sighting]) -> float:
    """Nats by which images fit mended readings better than the readings, by the median of each
    sense's images at which the two differ; none by fewer than IMAGES_BESIDE_SHIFT.
    """
    nats = 0.0
    pairs = zip(_measure_misfits(encoders, images), _measure_misfits(mended, images), strict=True)
    for misfits, fewer in pairs:
        differ = misfits != fewer
        if np.count_nonzero(differ) >= IMAGES_BESIDE_SHIFT:
            nats += IMAGES_OF_LOG * float(np.median((misfits - fewer)[differ]))
    return nats


def _measure_misfits(encoders: Encoders, images: Sequence[Sighting]) -> list[Array]:
    """How far each sense's images (F,) are off the angles, in nats of a Cauchy law, whose tails
    hold errors of many standard deviations.
    """
    misfits = list[Array]()
    for off, _, var in compare_with_images(encoders, images):
        outputs = off.shape[1]
        misfits.append(0.5 * (1 + outputs) * np.log1p((np.square(off) / var).sum(axis=1)))
    return misfits


def compare_with_images(
    encoders: Encoders, images: Sequence[Sighting]
) -> Iterator[tuple[Array, Array, Array]]:
    """Yield how far some of each sense's images are from where readings put them (F,D), the slopes
    by the angles (F,D,M), and the variance of images and body (F,D).

    Readings put an image nowhere if a joint is never read.
    """
    for sighting in images:
        seen = np.flatnonzero(find_finite_rows(sighting.values))
        some = seen[:: 1 + len(seen) // MOST_IMAGES]
        angles = encoders.interpolate_at(sighting.t[some])
        known = find_finite_rows(angles)
        if not known.any():
            continue
        rows = some[known]
        mean, slope, var = sighting.model.predict(angles[known])
        yield sighting.values[rows] - mean, slope, sighting.var[rows] + var
