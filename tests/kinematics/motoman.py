"""A Motoman's left arm as a URDF, by the Denavit-Hartenberg table that its calibration starts from.

The numbers are those of github.com/ctu-vras/multirobot-calibration (LGPL-3), Robots/Motoman/loadMotoman.m (48b63df2):
a, d in m, α and the angle's offset in rad. They are the robot's measures, as Stepanova et al. 2022 ("Automatic
self-contained calibration of an industrial dual-arm robot with cameras using self-contact, planar constraints, and
self-observation", Robotics and Computer-Integrated Manufacturing) state them.
"""

import numpy as np

from bodylog.kinematics.rotations import make_transform, rotation_from_vector, rpy_from_rotation

LEFT_ARM = {
    "external_E": (0.0, -0.263, np.radians(-15.0), -np.pi / 2),
    "left_S": (0.150, 1.4159, -np.pi / 2, 0.0),
    "left_L": (0.614, 0.0, np.pi, -np.pi / 2),
    "left_U": (0.200, 0.0, -np.pi / 2, 0.0),
    "left_R": (0.0, -0.640, np.pi / 2, 0.0),
    "left_B": (0.030, 0.0, np.pi / 2, -np.pi / 2),
    "left_T": (0.0, 0.200, 0.0, 0.0),
}
"""a, d, α and offset of each joint, from the base on."""


def left_arm_urdf() -> str:
    """The URDF, whose joints turn about the z axes of the table's frames."""
    links = ["base", *(f"{name}_link" for name in LEFT_ARM), "flange"]
    parts = [f'<link name="{name}"/>' for name in links]
    before = np.eye(4)
    for (name, (a, d, alpha, offset)), parent in zip(LEFT_ARM.items(), links, strict=False):
        origin = before @ make_transform(rotation_from_vector(np.array([0.0, 0.0, offset])), np.zeros(3))
        parts.append(_joint_element(name, "revolute", origin, parent, f"{name}_link"))
        before = make_transform(rotation_from_vector(np.array([alpha, 0.0, 0.0])), np.array([a, 0.0, d]))
    parts.append(_joint_element("flange_joint", "fixed", before, links[-2], "flange"))
    return f'<robot name="motoman_left">{"".join(parts)}</robot>'


def _joint_element(name: str, kind: str, origin: np.ndarray, parent: str, child: str) -> str:
    place = " ".join(f"{value:.9g}" for value in origin[:3, 3])
    turn = " ".join(f"{value:.12g}" for value in rpy_from_rotation(origin[:3, :3]))
    ends = f'<parent link="{parent}"/><child link="{child}"/><axis xyz="0 0 1"/>'
    limits = '<limit lower="-3.2" upper="3.2" effort="0" velocity="0"/>' if kind == "revolute" else ""
    return f'<joint name="{name}" type="{kind}"><origin xyz="{place}" rpy="{turn}"/>{ends}{limits}</joint>'
