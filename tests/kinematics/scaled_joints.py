"""Calibrations in which joints' scales are unknowns."""

from dataclasses import replace

import numpy as np

from bodylog.kinematics.calibration import calibrate_rig
from bodylog.kinematics.starts import find_starts

PRIOR, STEP = 0.02, 1e-6


def scaled(rig):
    return replace(rig, scale_doubt=np.full(len(rig.joints), PRIOR))


def solve(rig, data):
    anchored, first = find_starts(rig, [data])
    return calibrate_rig(anchored, [data], first)
