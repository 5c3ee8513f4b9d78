"""Logs of a camera that moved, and the faults of cameras that are found in them."""

from dataclasses import replace

import numpy as np

from bodylog.estimation.faults.screening import screen_measurements
from bodylog.settings import EstimationSettings

MOVED = 8.0


def moved(features, px, angle, since=MOVED, names=None):
    """The features with positions displaced by px at some angle from a time on."""
    tracks = dict(features.tracks)
    for name in names or tracks:
        off = np.outer(tracks[name].t >= since, px * np.array([np.cos(angle), np.sin(angle)]))
        tracks[name] = replace(tracks[name], values=tracks[name].values + off)
    return replace(features, tracks=tracks)


def cameras(features, body):
    return [fault for fault in screen_measurements(features, body, EstimationSettings()).faults if fault.sense == "vision"]
