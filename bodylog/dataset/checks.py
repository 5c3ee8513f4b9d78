"""The table of checks: what each measures, whether siblings are compared by it, what it costs a
learner."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from . import action_checks, camera_checks, joint_checks
from .reading import EpisodeReading
from .records import Measurement
from .views import RESOLUTION_PX


@dataclass(frozen=True)
class Check:
    """One check: the figure's name and unit ("joint": the joints' own), and the function that
    measures it, None of what the judgement finds between episodes.

    resolution: the least spread between siblings that is believed, in the unit, None where siblings
    are not compared; of a figure in the joints' unit, as a share of what the joint moves in all
    episodes · public: whether it is a score · cost: what it costs a learner · accuses: whether an
    episode that stands out in it is accused; others differ for good reasons as well, and that is
    said alone.
    """

    name: str
    unit: str
    measure: Callable[[EpisodeReading], Iterator[Measurement]] | None
    resolution: float | None
    cost: str
    public: bool = True
    accuses: bool = True


CHECKS: tuple[Check, ...] = (
    Check(
        "delay",
        "s",
        camera_checks.measure_delays,
        0.005,
        "it sees the past: it acts on a posture that the robot has left",
    ),
    Check(
        "row_time",
        "s",
        camera_checks.measure_row_times,
        None,
        "its pictures are sheared where things move fast",
    ),
    Check(
        "repeated",
        "1",
        camera_checks.measure_repeats,
        0.05,
        "it sees each picture twice, beside joints that moved on",
    ),
    Check(
        "rate",
        "Hz",
        camera_checks.measure_rates,
        None,
        "its pictures change less often than its clock says",
    ),
    Check(
        "dropped",
        "1",
        camera_checks.measure_dropped_frames,
        0.02,
        "it has no pictures of some motions",
    ),
    Check(
        "frozen",
        "1",
        camera_checks.measure_frozen_images,
        0.03,
        "it learns to act on a picture that does not change",
    ),
    Check(
        "black", "1", camera_checks.measure_black_images, 0.03, "it learns to act without seeing"
    ),
    Check(
        "saturated",
        "1",
        camera_checks.measure_saturated_images,
        0.03,
        "it learns to act on white pictures",
    ),
    Check(
        "blurred", "1", camera_checks.measure_blurred_images, 0.2, "it cannot see where things are"
    ),
    Check(
        "moved", "px", None, RESOLUTION_PX, "it sees every place elsewhere than in other episodes"
    ),
    Check(
        "sharpness",
        "ln grey²",
        camera_checks.measure_sharpness,
        0.3,
        "its pictures are of another focus than in other episodes",
        False,
        False,
    ),
    Check(
        "brightness",
        "grey",
        camera_checks.measure_brightness,
        10.0,
        "its pictures are of another exposure than in other episodes",
        False,
        False,
    ),
    Check(
        "unreadable",
        "1",
        camera_checks.measure_missing_images,
        None,
        "the loader stops, or pairs the wrong rows",
        False,
    ),
    Check(
        "stamp_jitter",
        "s",
        joint_checks.measure_stamp_jitter,
        None,
        "with stamps that are row numbers over the rate, no jitter of the recorder can be seen",
    ),
    Check("duration", "s", joint_checks.measure_duration, None, "it is weighted by length"),
    Check("not_finite", "1", joint_checks.measure_rows, None, "its loss is not a number", False),
    Check(
        "missing_rows",
        "1",
        joint_checks.measure_row_counts,
        None,
        "it pairs pictures with other rows",
        False,
    ),
    Check(
        "idle", "1", joint_checks.measure_idle_share, 0.1, "it learns to do nothing", True, False
    ),
    Check(
        "clipped",
        "1",
        joint_checks.measure_clipped_joints,
        0.03,
        "it does not learn where the joint really is",
    ),
    Check(
        "stuck",
        "s",
        joint_checks.measure_joint_standstills,
        0.1,
        "it believes a joint that does not do what it was asked",
    ),
    Check(
        "longest_repeat",
        "s",
        joint_checks.measure_longest_repeats,
        0.1,
        "it believes a joint that does not say where it is",
    ),
    Check(
        "jumps", "1", joint_checks.measure_jumps, None, "it learns motions that no joint can make"
    ),
    Check(
        "still",
        "1",
        joint_checks.measure_still_joints,
        0.1,
        "it learns a constant for that joint",
        False,
    ),
    Check(
        "start",
        "joint",
        joint_checks.measure_starts,
        0.02,
        "it begins where other episodes never were",
        False,
        False,
    ),
    Check(
        "mean",
        "joint",
        joint_checks.measure_means,
        0.02,
        "the joint is used elsewhere than in others",
        False,
        False,
    ),
    Check(
        "size",
        "ln",
        joint_checks.measure_sizes,
        0.1,
        "it is trained with two units at once",
        False,
        False,
    ),
    Check(
        "delay/action",
        "s",
        action_checks.measure_action_delay,
        0.01,
        "the state answers the action that much later: chunks must be longer",
    ),
    Check(
        "error/action",
        "joint",
        action_checks.measure_action_error,
        0.02,
        "the joints do not do what the action says",
    ),
    Check(
        "swapped",
        "1",
        action_checks.measure_swapped_joints,
        None,
        "it moves the wrong joint",
        False,
    ),
)
BY_NAME: Mapping[str, Check] = {check.name: check for check in CHECKS}


def figure_name(check: Check, part: str) -> str:
    """The name of a figure of a check, for one camera or joint; delay/action is a figure of its
    own."""
    if not part or check.name.endswith(f"/{part}"):
        return check.name
    return f"{check.name}/{part}"
