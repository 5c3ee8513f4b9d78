"""The arms that can be recorded: URDF, home, range of motion, cameras."""

from dataclasses import dataclass
from math import pi
from pathlib import Path

_ASSETS = Path(__file__).parent / "assets"


@dataclass(frozen=True)
class Arm:
    """One arm: joints as in its URDF, home and swing (rad,
    one per joint), moving joints, cameras relative to home.

    `swing` is the half range a wide exploration uses; `camera` and `side` are the places (m) of the
    head's camera and of one at the side, seen from the end effector at home, in the base frame;
    `marker` is the link at whose origin a blue ball can sit.
    """

    urdf: Path
    joints: tuple[str, ...]
    home: tuple[float, ...]
    swing: tuple[float, ...]
    moving: tuple[int, ...]
    elbow: int
    camera: tuple[float, float, float]
    side: tuple[float, float, float]
    marker: str


ARMS: dict[str, Arm] = {
    "ur5": Arm(
        urdf=_ASSETS / "ur5.urdf",
        joints=(
            "shoulder_pan_joint",
            "shoulder_lift_joint",
            "elbow_joint",
            "wrist_1_joint",
            "wrist_2_joint",
            "wrist_3_joint",
        ),
        home=(-0.955, -0.869, 0.753, -pi / 2, -pi / 2, 0.0),
        swing=(0.40, 0.30, 0.32, 0.40, 0.35, 0.40),
        moving=(0, 1, 2),
        elbow=2,
        camera=(0.20, -1.12, 0.38),
        side=(1.05, -0.10, 0.45),
        marker="wrist_2_link",
    ),
    "seven": Arm(
        urdf=_ASSETS / "seven.urdf",
        joints=tuple(f"joint_{number}" for number in range(1, 8)),
        home=(0.4, 0.7, 0.2, -1.3, 0.1, 0.4, 0.0),
        swing=(0.35, 0.22, 0.30, 0.25, 0.40, 0.35, 0.40),
        moving=(0, 1, 2, 3, 4, 5, 6),
        elbow=3,
        camera=(-0.50, 1.00, 0.50),
        side=(1.00, 0.40, 0.45),
        marker="link_6",
    ),
}
