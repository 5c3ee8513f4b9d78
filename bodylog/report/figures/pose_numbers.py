"""A log of still poses with the number of each pose in place of its time."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...types import Array, Estimate, Features, Recording, Series


def number_poses(
    recording: Recording, features: Features, estimate: Estimate
) -> tuple[Recording, Features, Estimate]:
    """The same records with poses numbered from 1 in place of seconds: rows of still poses have an
    order, and nothing happens between them.
    """
    times = _pose_times(recording, features)

    def numbered(t: Array) -> Array:
        return np.searchsorted(times, t - 1e-6) + 1.0

    def renamed(series: Series | None) -> Series | None:
        return None if series is None else replace(series, t=numbered(series.t))

    def renamed_all(named: Mapping[str, Series]) -> dict[str, Series]:
        return {name: replace(series, t=numbered(series.t)) for name, series in named.items()}

    until = [
        None if x.until is None else float(numbered(np.array(x.until))) for x in estimate.faults
    ]
    faults = tuple(
        replace(fault, since=float(numbered(np.array(fault.since))), until=end)
        for fault, end in zip(estimate.faults, until, strict=True)
    )
    signals = replace(
        recording.signals,
        joints=renamed(recording.signals.joints),
        truth=renamed(recording.signals.truth),
        skin=renamed(recording.signals.skin),
    )
    return (
        replace(recording, duration_s=float(len(times)), signals=signals),
        replace(features, tracks=renamed_all(features.tracks), joints=renamed(features.joints)),
        replace(
            estimate,
            joints=replace(estimate.joints, t=numbered(estimate.joints.t)),
            rate=replace(estimate.rate, t=numbered(estimate.rate.t)),
            errors=renamed_all(estimate.errors),
            predicted=renamed_all(estimate.predicted),
            kinematic=renamed_all(estimate.kinematic),
            bias=renamed(estimate.bias),
            faults=faults,
        ),
    )


def _pose_times(recording: Recording, features: Features) -> Array:
    """The times of all poses, ascending."""
    joints = [] if recording.signals.joints is None else [recording.signals.joints.t]
    return np.unique(
        np.concatenate([np.zeros(0), *joints, *(x.t for x in features.tracks.values())])
    )
