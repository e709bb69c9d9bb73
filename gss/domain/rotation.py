"""Rotation matrices and scalar-last quaternions.

A rotation is named target-from-source: ``v_cam = cam_from_icrs @ v_icrs``. A quaternion ``(x, y, z, w)`` with the
same name represents the same rotation. Tests compare with scipy's ``Rotation``.
"""

from __future__ import annotations

import math

import numpy as np

from gss.domain.angles import Array


def rotation_x(angle_rad: float) -> Array:
    """Return the matrix that changes coordinates to axes rotated by ``angle_rad`` about x (Jacobs 1995 eq. 1.10)."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[1, 0, 0], [0, c, s], [0, -s, c]], float)


def rotation_y(angle_rad: float) -> Array:
    """Return the matrix that changes coordinates to axes rotated by ``angle_rad`` about y (Jacobs 1995 eq. 1.11)."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]], float)


def rotation_z(angle_rad: float) -> Array:
    """Return the matrix that changes coordinates to axes rotated by ``angle_rad`` about z (Jacobs 1995 eq. 1.12)."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]], float)


def matrix_from_quaternion(quaternion: Array) -> Array:
    """Return (…, 3, 3) matrices that act on column vectors, from (…, 4) scalar-last quaternions of any non-zero
    length."""
    q = np.asarray(quaternion, float)
    # A single quaternion is computed with Python's numbers, in a tenth of the time of arrays.
    x, y, z, w = q.tolist() if q.ndim == 1 else np.moveaxis(q, -1, 0)
    two = np.divide(2.0, x * x + y * y + z * z + w * w)
    matrix = np.array(
        [
            [1 - two * (y * y + z * z), two * (x * y - z * w), two * (x * z + y * w)],
            [two * (x * y + z * w), 1 - two * (x * x + z * z), two * (y * z - x * w)],
            [two * (x * z - y * w), two * (y * z + x * w), 1 - two * (x * x + y * y)],
        ]
    )
    return matrix if q.ndim == 1 else np.moveaxis(matrix, (0, 1), (-2, -1))


def quaternion_from_matrix(matrix: Array) -> Array:
    """Return the (4,) scalar-last quaternion with w ≥ 0 of a (3, 3) rotation matrix (Shepperd's method: divide by the
    largest term)."""
    m = np.asarray(matrix, float).tolist()
    diagonal = [m[0][0], m[1][1], m[2][2], m[0][0] + m[1][1] + m[2][2]]
    k = diagonal.index(max(diagonal))
    if k == 3:
        q = [m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1], 1 + diagonal[3]]
    else:
        i, j = (k + 1) % 3, (k + 2) % 3
        q = [0.0, 0.0, 0.0, m[j][i] - m[i][j]]
        q[k] = 1 + diagonal[k] - diagonal[i] - diagonal[j]
        q[i], q[j] = m[i][k] + m[k][i], m[j][k] + m[k][j]
    length = math.copysign(math.hypot(*q), q[3])
    return np.array([v / length for v in q])


def rotation_from_vector(vector_rad: Array) -> Array:
    """Return the (3, 3) active rotation about the direction of a (3,) vector by an angle equal to its length
    (Rodrigues)."""
    x, y, z = np.asarray(vector_rad, float).tolist()
    angle2 = x * x + y * y + z * z
    angle_rad = math.sqrt(angle2)
    # Half-angle forms keep full precision down to zero rotation.
    half = 0.5 * (math.sin(angle_rad / 2) / (angle_rad / 2) if angle_rad else 1.0)
    sinc, versed = 2 * half * math.cos(angle_rad / 2), 2 * half * half
    c = 1 - versed * angle2
    return np.array(
        [
            [c + versed * x * x, versed * x * y - sinc * z, versed * x * z + sinc * y],
            [versed * x * y + sinc * z, c + versed * y * y, versed * y * z - sinc * x],
            [versed * x * z - sinc * y, versed * y * z + sinc * x, c + versed * z * z],
        ]
    )


def rotation_angle_rad(a: Array, b: Array) -> float:
    """Return the angle of the rotation between two (3, 3) rotations."""
    return 2.0 * float(np.arcsin(min(1.0, np.linalg.norm(np.asarray(a) - b) / np.sqrt(8.0))))


def vector_from_rotation(matrix: Array) -> Array:
    """Return the (3,) rotation vector of a (3, 3) active rotation, at most π long. The result is accurate to rounding at
    every angle; the two vectors of a rotation by exactly π are equivalent, and one of them is returned."""
    axis = np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]]) / 2
    sine, cosine = float(np.linalg.norm(axis)), (float(np.trace(matrix)) - 1) / 2
    if cosine < 0:  # near π the differences above lose the axis; the quaternion keeps it
        quaternion = quaternion_from_matrix(matrix)
        half_sine = float(np.linalg.norm(quaternion[:3]))
        return np.asarray(quaternion[:3] / half_sine * 2 * np.arctan2(half_sine, quaternion[3]))
    angle_rad = float(np.arctan2(sine, cosine))
    return axis if sine < 1e-12 else axis / sine * angle_rad


def quaternion_product(left: Array, right: Array) -> Array:
    """Return (…, 4) Hamilton products, scalar last. The product represents the matrix of ``left`` times the matrix of
    ``right``."""
    x1, y1, z1, w1 = np.moveaxis(np.asarray(left, float), -1, 0)
    x2, y2, z2, w2 = np.moveaxis(np.asarray(right, float), -1, 0)
    return np.stack(
        [
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
        ],
        axis=-1,
    )


def quaternion_inverse(quaternion: Array) -> Array:
    """Return the (…, 4) inverses of unit quaternions."""
    return np.asarray(quaternion * np.array([-1.0, -1.0, -1.0, 1.0]))


def turn_between(first: Array, second: Array) -> Array:
    """Return (n, 3) rotation vectors δ with second = exp([δ]×)·first, from (n, 4) quaternions cam_from_icrs. The vectors
    are in camera axes and at most π long."""
    q = quaternion_product(second, quaternion_inverse(first))
    q = np.where(q[..., 3:] < 0, -q, q)
    sine = np.linalg.norm(q[..., :3], axis=-1)
    angle = 2 * np.arctan2(sine, q[..., 3])
    return np.asarray(q[..., :3] * np.where(sine < 1e-12, 2.0, angle / np.maximum(sine, 1e-300))[..., None])


def turned(quaternion: Array, vector_rad: Array) -> Array:
    """Return (n, 4) quaternions exp([δ]×)·q, from (n, 4) or (4,) ``quaternion`` q and (n, 3) or (3,) ``vector_rad``
    δ."""
    angle = np.linalg.norm(vector_rad, axis=-1)
    half = np.where(angle < 1e-12, 0.5, np.sin(angle / 2) / np.maximum(angle, 1e-300))
    step = np.concatenate([vector_rad * half[..., None], np.cos(angle / 2)[..., None]], axis=-1)
    return quaternion_product(step, quaternion)


def random_quaternion(rng: np.random.Generator) -> Array:
    """Return a random (4,) quaternion, uniform over all rotations."""
    q = rng.normal(size=4)
    return np.asarray(q / np.linalg.norm(q))
