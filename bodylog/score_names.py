"""Names of scores: FIGURE or FIGURE/PART, the unit of each figure, and their names of before."""

from collections.abc import Mapping

FIGURES: Mapping[str, str] = {
    "rmse/joint": "rad",
    "rmse/encoders": "rad",
    "rmse/effector_position": "m",
    "rmse/effector_rotation": "rad",
    "rmse/innovation": "px",
    "rmse/held_out": "px",
    "rmse/held_out_encoders": "rad",
    "rmse/kinematics": "px",
    "rmse/test": "px",
    "rmse/test_u": "px",
    "rmse/test_v": "px",
    "rmse/test_x": "mm",
    "rmse/test_y": "mm",
    "rmse/test_z": "mm",
    "median_error/test": "px",
    "nees/joint": "1",
    "nees/effector_position": "1",
    "nees/effector_rotation": "1",
    "nis": "1",
    "nis/held_out": "1",
    "nis/test": "1",
    "coverage_2sigma/joint": "%",
    "coverage_2sigma/effector_position": "%",
    "coverage_2sigma/effector_rotation": "%",
    "coverage_2sigma/test": "%",
    "free_energy": "nats",
    "log_evidence": "nats",
    "log_density/held_out": "nats",
    "used": "messages",
    "used_share": "1",
    "sightings/test": "images",
    "explained": "1",
    "std/encoders": "rad",
    "std/noise": "px",
    "std/model": "px",
    "std/lasting": "px",
    "std_over_noise/model": "1",
    "process_noise/acceleration": "rad²/s³",
    "process_noise/jerk": "rad²/s⁵",
    "variance_factor": "1",
    "range": "rad",
    "influence": "px",
    "length_scale": "rad",
    "offset": "rad",
    "std/offset": "rad",
    "scale": "1",
    "std/scale": "1",
    "faults": "1",
    "fault": "",
    "delay": "s",
    "std/delay": "s",
    "repeated": "1",
    "rate": "Hz",
    "dropped": "1",
    "frozen": "1",
    "black": "1",
    "saturated": "1",
    "blurred": "1",
    "stamp_jitter": "s",
    "idle": "1",
    "duration": "s",
    "stuck": "s",
    "longest_repeat": "s",
    "clipped": "1",
    "jumps": "1",
    "moved": "px",
    "error/action": "",
    "jitter/delay": "s",
    "flow/delay": "s",
    "std/flow/delay": "s",
    "jitter/flow/delay": "s",
    "flow/row_time": "s",
    "std/flow/row_time": "s",
    "episodes": "1",
    "outliers": "1",
    "row_time": "s",
    "std/row_time": "s",
    "focal": "px",
    "std/focal": "px",
    "rmse/surface": "px",
}
"""Unit of each figure; a linear joint's offset is in m, a fault's size in its own unit."""
_LONGEST_FIRST = sorted(FIGURES, key=len, reverse=True)


def split_score_name(name: str) -> tuple[str, str]:
    """A score's figure and its part, "" for the whole."""
    for figure in _LONGEST_FIRST:
        if name == figure or name.startswith(f"{figure}/"):
            return figure, name[len(figure) + 1 :]
    figure, _, part = name.partition("/")
    return figure, part


def score_unit(name: str) -> str:
    """The unit of a score, "" where its name does not give it."""
    return FIGURES.get(split_score_name(name)[0], "")
