"""Poses of a robot's links by PyBullet."""

import numpy as np


def ends_of(pybullet, text, angles, folder):
    """Poses (4,4) of all links in the base, by PyBullet."""
    limits = '<limit lower="-9" upper="9" effort="1" velocity="1"/></joint>'  # without limits it reads none
    (folder / "robot.urdf").write_text(text.replace("</joint>", limits))
    client = pybullet.connect(pybullet.DIRECT)
    try:
        body = pybullet.loadURDF(str(folder / "robot.urdf"), useFixedBase=True, physicsClientId=client)
        return _linked(pybullet, client, body, angles)
    finally:
        pybullet.disconnect(client)


def _linked(pybullet, client, body, angles):
    """Poses (4,4) of all links in the world; mimic joints are set by hand, which PyBullet does not do."""
    ends = {pybullet.getBodyInfo(body, client)[0].decode(): np.eye(4)}
    count = pybullet.getNumJoints(body, client)
    names = [pybullet.getJointInfo(body, k, client) for k in range(count)]
    for k, info in enumerate(names):
        name = info[1].decode()
        angle = angles.get(name, 0.1 - 0.5 * angles.get("turn", 0.0) if name == "follower" else 0.0)
        pybullet.resetJointState(body, k, angle, physicsClientId=client)
    for k, info in enumerate(names):
        place, turn = pybullet.getLinkState(body, k, computeForwardKinematics=True, physicsClientId=client)[4:6]
        ends[info[12].decode()] = np.eye(4)
        ends[info[12].decode()][:3, :3] = np.reshape(pybullet.getMatrixFromQuaternion(turn), (3, 3))
        ends[info[12].decode()][:3, 3] = place
    return ends
