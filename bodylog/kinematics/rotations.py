"""Rotations and homogeneous transforms; angles in rad."""

import numpy as np

from ..types import Array

_SMALL = 1e-4


def cross_product_matrix(v: Array) -> Array:
    """Cross-product matrices (…,3,3) of vectors (…,3)."""
    cross = np.zeros((*v.shape, 3))
    for first, second, third in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        cross[..., second, first] = v[..., third]
        cross[..., first, second] = -v[..., third]
    return cross


def rotation_from_vector(w: Array) -> Array:
    """Rotation (3,3) by the vector w (3,), rad (Rodrigues)."""
    angle = float(np.linalg.norm(w))
    cross = cross_product_matrix(w)
    if angle < _SMALL:
        return np.asarray(np.eye(3) + cross + 0.5 * cross @ cross)
    return np.asarray(
        np.eye(3) + np.sin(angle) / angle * cross + (1 - np.cos(angle)) / angle**2 * cross @ cross
    )


def left_jacobian(w: Array) -> Array:
    """J (3,3) with exp(w + dw) = exp(J dw) exp(w) to first order."""
    angle = float(np.linalg.norm(w))
    cross = cross_product_matrix(w)
    if angle < _SMALL:
        return np.asarray(np.eye(3) + 0.5 * cross + cross @ cross / 6.0)
    first = (1 - np.cos(angle)) / angle**2
    second = (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)


def vector_from_rotation(rotation: Array) -> Array:
    """The vector (3,), rad, of a rotation (3,3); its length is at most π."""
    # the largest eigenvector is the quaternion (Bar-Itzhack 2000), which is stable near π, too
    r = rotation
    lower = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    matrix = np.empty((4, 4))
    matrix[:3, :3] = r + r.T - np.trace(r) * np.eye(3)
    matrix[:3, 3] = lower
    matrix[3, :3] = lower
    matrix[3, 3] = np.trace(r)
    quaternion = np.linalg.eigh(matrix)[1][:, -1]
    vector = quaternion[:3] * np.sign(quaternion[3] or 1.0)
    scalar = abs(quaternion[3])
    length = float(np.linalg.norm(vector))
    if length < 1e-12:
        return np.zeros(3)
    return np.asarray(vector / length * 2.0 * np.arctan2(length, scalar))


def nearest_rotation(matrix: Array) -> Array:
    """The rotation (3,3) nearest to a matrix."""
    u, _, vt = np.linalg.svd(matrix)
    return np.asarray(u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt)


def rotation_from_rpy(rpy: Array) -> Array:
    """Rotation (3,3) of URDF's roll, pitch, yaw (3,), rad: about the fixed x, y, then z axis."""
    x, y, z = (rotation_from_vector(np.eye(3)[k] * rpy[k]) for k in range(3))
    return np.asarray(z @ y @ x)


def rpy_from_rotation(rotation: Array) -> Array:
    """Roll, pitch, yaw (3,), rad, of a rotation (3,3)."""
    pitch = np.arctan2(-rotation[2, 0], np.hypot(rotation[0, 0], rotation[1, 0]))
    if np.hypot(rotation[0, 0], rotation[1, 0]) < 1e-9:  # gimbal lock: yaw is zero
        return np.array([np.arctan2(-rotation[1, 2], rotation[1, 1]), pitch, 0.0])
    return np.array(
        [
            np.arctan2(rotation[2, 1], rotation[2, 2]),
            pitch,
            np.arctan2(rotation[1, 0], rotation[0, 0]),
        ]
    )


def rotation_from_z(axis: Array) -> Array:
    """A rotation (3,3) that turns the z axis into the unit vector `axis` (3,)."""
    if abs(axis[2]) > 1.0 - 1e-15:
        return np.eye(3) if axis[2] > 0 else np.diag([1.0, -1.0, -1.0])
    cross = np.cross([0.0, 0.0, 1.0], axis)
    return rotation_from_vector(
        cross / np.linalg.norm(cross) * np.arctan2(np.linalg.norm(cross), axis[2])
    )


def make_transform(rotation: Array, place: Array) -> Array:
    """The homogeneous matrix (4,4) of a rotation (3,3) and a translation (3,)."""
    result = np.eye(4)
    result[:3, :3] = rotation
    result[:3, 3] = place
    return result


def invert_transform(pose: Array) -> Array:
    """The inverse of a homogeneous matrix (4,4)."""
    return make_transform(pose[:3, :3].T, -pose[:3, :3].T @ pose[:3, 3])


def quaternions_from_rotations(rotation: Array) -> Array:
    """Unit quaternions x, y, z, w (N,4) of rotations (N,3,3), w not negative."""
    r = rotation
    trace = np.einsum("nii->n", r)
    # of four equivalent formulas, the one with the largest root is stable (Shepperd 1978)
    roots = np.stack([r[:, 0, 0], r[:, 1, 1], r[:, 2, 2], trace], axis=1)
    largest = roots.argmax(axis=1)
    found = np.empty((len(r), 4))
    for n in range(3):
        i = n
        j = (n + 1) % 3
        k = (n + 2) % 3
        rows = largest == n
        one = r[rows]
        found[np.ix_(rows, [i, j, k, 3])] = np.column_stack(
            [
                1.0 + one[:, i, i] - one[:, j, j] - one[:, k, k],
                one[:, i, j] + one[:, j, i],
                one[:, i, k] + one[:, k, i],
                one[:, k, j] - one[:, j, k],
            ]
        )
    rows = largest == 3
    one = r[rows]
    lower = [one[:, 2, 1] - one[:, 1, 2], one[:, 0, 2] - one[:, 2, 0], one[:, 1, 0] - one[:, 0, 1]]
    found[rows] = np.column_stack([*lower, 1.0 + trace[rows]])
    found /= np.linalg.norm(found, axis=1)[:, None]
    return np.asarray(np.where(found[:, 3:] < 0.0, -found, found))
