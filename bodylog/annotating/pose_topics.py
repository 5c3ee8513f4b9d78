"""Poses of one frame in another from a topic of stamped poses, with or without a covariance."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..logs.decode.columns import read_topic_columns
from ..logs.decode.parts import TopicColumns
from ..logs.formats import open_log
from ..types import Estimate, Poses, Recording

TRUTH = "/truth/effector_pose"
"""Topic of the effector's true poses in the robot's base."""
_PLAIN = "geometry_msgs/msg/PoseStamped"
_COVARIANT = "geometry_msgs/msg/PoseWithCovarianceStamped"
_AXES = (*(f"position.{axis}" for axis in "xyz"), *(f"orientation.{axis}" for axis in "xyzw"))
_HEADER = ("header.stamp", "header.frame_id")
POSED = (*_HEADER, *(f"pose.pose.{field}" for field in _AXES), "pose.covariance")
"""The fields of a PoseWithCovarianceStamped."""
_FIELDS = {_PLAIN: (*_HEADER, *(f"pose.{field}" for field in _AXES)), _COVARIANT: POSED}


def with_true_poses(log: Path, found: Estimate, read: Recording) -> Recording:
    """The recording with the effector's true poses, where
    the estimate has poses and the log carries true ones.
    """
    if found.effector is None:
        return read
    poses = _true_poses(log, read.start_ns)
    return replace(read, signals=replace(read.signals, truth_pose=poses))


def _true_poses(path: Path, start_ns: int) -> Poses | None:
    """The effector's true poses in a log, t in s since `start_ns`; None without any."""
    with open_log(path) as log:
        topic = next(
            (topic for topic in log.topics if topic.name == TRUTH and topic.type in _FIELDS), None
        )
        return (
            None
            if topic is None
            else poses_from_columns(read_topic_columns(log, topic, _FIELDS[topic.type]), start_ns)
        )


def poses_from_columns(found: TopicColumns, start_ns: int) -> Poses | None:
    """The poses of a topic in order of t, without rows that are not numbers; None without any."""
    rows = []
    covs = []
    stamps = []
    logged = []
    frames = list[str]()
    for part in found.parts:
        stamp, frame, *values = part.values
        numbers = np.column_stack(
            [np.asarray(value, float).reshape(len(part.rows), -1) for value in values]
        )
        rows.append(numbers[:, :7])
        covs.append(numbers[:, 7:])
        stamps.append(np.asarray(stamp, np.int64))
        logged.append(found.log_ns[part.rows])
        frames.append(str(np.asarray(frame).reshape(-1)[0]))
    if not rows:
        return None
    pose, cov, ns, log_ns = (np.concatenate(part) for part in (rows, covs, stamps, logged))
    length = np.linalg.norm(pose[:, 3:], axis=1)
    sound = np.isfinite(pose).all(axis=1) & (np.abs(length - 1.0) < 0.1)
    order = np.flatnonzero(sound)[np.argsort(ns[sound], kind="stable")]
    known = cov[order].reshape(-1, 6, 6) if cov.shape[1] == 36 else None
    turn = pose[order, 3:] / length[order, None]
    return Poses(
        (ns[order] - start_ns) / 1e9, pose[order, :3], turn, frames[0], log_ns[order], known
    )
