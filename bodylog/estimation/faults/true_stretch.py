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
    first = _measure_misfits(encoders, images)
    won = {
        begin: IMAGES_OF_LOG
        * sum(
            float(np.median(before - after))
            for before, after in zip(
                first, _measure_misfits(continue_stretch(begin), images), strict=True
            )
        )
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
    """
    for sighting in images:
        known = np.flatnonzero(find_finite_rows(sighting.values))
        if not len(known):
            continue
        rows = known[:: 1 + len(known) // MOST_IMAGES]
        mean, slope, var = sighting.model.predict(encoders.interpolate_at(sighting.t[rows]))
        yield sighting.values[rows] - mean, slope, sighting.var[rows] + var
