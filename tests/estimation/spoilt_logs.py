"""Logs with one thing wrong: late images, or encoders that fall silent."""

from dataclasses import replace

import numpy as np


def delayed(features, seconds):
    """Delay image timestamps by camera, {"" or name: s}, or all by one number."""
    by = seconds if isinstance(seconds, dict) else dict.fromkeys(("", "side"), seconds)
    tracks = {name: replace(t, t=t.t + by.get(name.rpartition("/")[0], 0.0)) for name, t in features.tracks.items()}
    return replace(features, tracks=tracks)


ALL = ("pan", "lift", "elbow")


def muted(features, begin, end, names=ALL):
    """Without a word of some encoders from begin to end (s)."""
    joints = features.joints
    gone = np.outer((joints.t >= begin) & (joints.t < end), np.isin(joints.names, names))
    values = np.where(gone, np.nan, joints.values)
    keep = np.isfinite(values).any(axis=1)
    few = replace(joints, t=joints.t[keep], values=values[keep], source_ns=joints.source_ns[keep])
    return replace(features, joints=few)
