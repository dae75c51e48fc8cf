"""Rigid poses as arrays `x y z qw qx qy qz`: composing, inverting, sampling and averaging them.

A pose is named by its frames, parent first: `pose_world_camera` takes camera coordinates to world coordinates, and
`multiply(pose_world_camera, pose_camera_link)` is `pose_world_link`. All functions broadcast over leading axes. A
quaternion and its negative are the same rotation; nothing here prefers either. Products, inverses and moves are
compiled: a chain of joints multiplies many short arrays, on which NumPy spends ten times longer on bookkeeping than on
arithmetic. For the same reason they are called as NumPy's own ufuncs (`.ufunc`), without numba's wrapper in Python.
"""

from __future__ import annotations

import fcntl
from contextlib import ExitStack, suppress

import numpy as np
from numba import float64, guvectorize, njit
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

IDENTITY: Array = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
IDENTITY.setflags(write=False)
ORIGIN: Array = np.zeros(3)
ORIGIN.setflags(write=False)

# One process at a time compiles what follows, or reads it. Of each ufunc numba keeps the loop in one file and in
# another the wrapper, which finds the loop by a name that counts what its process compiled before. Of two processes
# that begin at once each may keep one, and whoever reads both calls an address that is none. The source itself is
# locked, as it can be read wherever it is; where a file system has no locks it goes without.
_turn_taken = ExitStack()
with suppress(OSError):
    fcntl.flock(_turn_taken.enter_context(open(__file__, "rb")), fcntl.LOCK_EX)  # noqa: SIM115


@njit
def _product(a, b):  # type: ignore[no-untyped-def]
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@njit
def _rotated(q, vector):  # type: ignore[no-untyped-def]
    # v + 2 u × (u × v + w v), u the vector part: cheaper than the product with the conjugate
    x = q[2] * vector[2] - q[3] * vector[1] + q[0] * vector[0]
    y = q[3] * vector[0] - q[1] * vector[2] + q[0] * vector[1]
    z = q[1] * vector[1] - q[2] * vector[0] + q[0] * vector[2]
    return (
        vector[0] + 2.0 * (q[2] * z - q[3] * y),
        vector[1] + 2.0 * (q[3] * x - q[1] * z),
        vector[2] + 2.0 * (q[1] * y - q[2] * x),
    )


@guvectorize([(float64[:], float64[:], float64[:])], "(n),(n)->(n)", nopython=True, cache=True)
def _quaternion_multiply(a, b, out):  # type: ignore[no-untyped-def]
    out[0], out[1], out[2], out[3] = _product(a, b)


@guvectorize([(float64[:], float64[:], float64[:])], "(n),(m)->(m)", nopython=True, cache=True)
def _rotate(q, vector, out):  # type: ignore[no-untyped-def]
    out[0], out[1], out[2] = _rotated(q, vector)


@njit
def _turn(rotation):  # type: ignore[no-untyped-def]
    angle = np.sqrt(rotation[0] ** 2 + rotation[1] ** 2 + rotation[2] ** 2)
    # nearer to zero the sine is its argument, to the last bit
    scale = np.sin(0.5 * angle) / angle if angle > 1e-9 else 0.5
    return np.cos(0.5 * angle), scale * rotation[0], scale * rotation[1], scale * rotation[2]


# An input that is not read, here and below, gives the output its length.
@guvectorize([(float64[:], float64[:], float64[:])], "(m),(n)->(n)", nopython=True, cache=True)
def _from_rotation_vector(rotation, _, out):  # type: ignore[no-untyped-def]
    out[0], out[1], out[2], out[3] = _turn(rotation)


@guvectorize([(float64[:], float64[:], float64[:])], "(n),(m)->(m)", nopython=True, cache=True)
def _to_rotation_vector(q, _, out):  # type: ignore[no-untyped-def]
    sine = np.sqrt(q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    scale = 2.0 * np.arctan2(sine, abs(q[0])) / sine if sine > 1e-12 else 2.0
    # of a quaternion and its negative the turn that is the shorter
    scale = -scale if q[0] < 0.0 else scale
    out[0], out[1], out[2] = scale * q[1], scale * q[2], scale * q[3]


@guvectorize(
    [(float64[:], float64[:], float64[:], float64[:], float64[:])], "(n),(m),(m),(m)->(n)", nopython=True, cache=True
)
def _perturb(pose, translation, rotation, centre, out):  # type: ignore[no-untyped-def]
    w, x, y, z = _product(_turn(rotation), pose[3:])
    length = np.sqrt(w * w + x * x + y * y + z * z)
    out[3], out[4], out[5], out[6] = w / length, x / length, y / length, z / length
    before, after = _rotated(pose[3:], centre), _rotated(out[3:], centre)
    for k in range(3):
        out[k] = pose[k] + before[k] + translation[k] - after[k]


@guvectorize([(float64[:], float64[:], float64[:])], "(n),(n)->(n)", nopython=True, cache=True)
def _multiply(a, b, out):  # type: ignore[no-untyped-def]
    w, x, y, z = a[3], a[4], a[5], a[6]
    cx = y * b[2] - z * b[1] + w * b[0]
    cy = z * b[0] - x * b[2] + w * b[1]
    cz = x * b[1] - y * b[0] + w * b[2]
    out[0] = (b[0] + 2.0 * (y * cz - z * cy)) + a[0]
    out[1] = (b[1] + 2.0 * (z * cx - x * cz)) + a[1]
    out[2] = (b[2] + 2.0 * (x * cy - y * cx)) + a[2]
    out[3] = w * b[3] - x * b[4] - y * b[5] - z * b[6]
    out[4] = w * b[4] + x * b[3] + y * b[6] - z * b[5]
    out[5] = w * b[5] - x * b[6] + y * b[3] + z * b[4]
    out[6] = w * b[6] + x * b[5] - y * b[4] + z * b[3]


@guvectorize([(float64[:], float64[:])], "(n)->(n)", nopython=True, cache=True)
def _inverse(pose, out):  # type: ignore[no-untyped-def]
    w, x, y, z = pose[3], -pose[4], -pose[5], -pose[6]
    cx = y * pose[2] - z * pose[1] + w * pose[0]
    cy = z * pose[0] - x * pose[2] + w * pose[1]
    cz = x * pose[1] - y * pose[0] + w * pose[2]
    out[0] = -(pose[0] + 2.0 * (y * cz - z * cy))
    out[1] = -(pose[1] + 2.0 * (z * cx - x * cz))
    out[2] = -(pose[2] + 2.0 * (x * cy - y * cx))
    out[3], out[4], out[5], out[6] = w, x, y, z


_turn_taken.close()


def quaternion_multiply(a: Array, b: Array) -> Array:
    """Hamilton product of quaternions `a` and `b`, both (..., 4), w x y z."""
    return _quaternion_multiply.ufunc(a, b)


def quaternion_conjugate(q: Array) -> Array:
    """Conjugate of `q`, (..., 4), w x y z; the inverse where `q` has unit length."""
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def rotate(q: Array, vectors: Array) -> Array:
    """Rotate `vectors` (..., 3) by unit quaternions `q` (..., 4), w x y z."""
    return _rotate.ufunc(q, vectors)


def multiply(a: Array, b: Array) -> Array:
    """Compose poses (..., 7): `multiply(pose_a_b, pose_b_c)` is `pose_a_c`."""
    return _multiply.ufunc(a, b)


def inverse(pose: Array) -> Array:
    """Inverse of poses (..., 7): `inverse(pose_a_b)` is `pose_b_a`."""
    return _inverse.ufunc(pose)


def transform_points(pose: Array, points: Array) -> Array:
    """Points (..., 3) of frame b in frame a, by `pose_a_b` (..., 7); the leading axes broadcast."""
    return rotate(pose[..., 3:], points) + pose[..., :3]


def normalise(pose: ArrayLike) -> Array:
    """`pose` (..., 7) with its quaternion at unit length.

    Raises ValueError where a quaternion has no direction: a zero or non-finite one is an error, not the identity.
    """
    pose = np.asarray(pose, dtype=np.float64)
    length = np.linalg.norm(pose[..., 3:], axis=-1, keepdims=True)
    if not np.all(np.isfinite(pose)) or np.any(length < 1e-9):
        raise ValueError("a pose needs seven finite numbers x y z qw qx qy qz and a quaternion that is not zero")
    return np.concatenate([pose[..., :3], pose[..., 3:] / length], axis=-1)


def from_rotation_vector(rotation: Array) -> Array:
    """Unit quaternions (..., 4), w x y z, of rotation vectors (..., 3), radians (the exponential map)."""
    return _from_rotation_vector.ufunc(rotation, IDENTITY[3:])


def to_rotation_vector(q: Array) -> Array:
    """Rotation vectors (..., 3) in radians, length at most pi, of unit quaternions (..., 4) (the logarithm)."""
    return _to_rotation_vector.ufunc(q, ORIGIN)


def rotation_angle(a: Array, b: Array) -> Array:
    """Angle in radians, 0 to pi, between the rotations of unit quaternions `a` and `b` (..., 4)."""
    relative = quaternion_multiply(quaternion_conjugate(a), b)
    return 2.0 * np.arctan2(np.linalg.norm(relative[..., 1:], axis=-1), np.abs(relative[..., 0]))


def from_rpy(rpy: ArrayLike) -> Array:
    """Unit quaternions (..., 4) of roll, pitch, yaw (..., 3), radians about fixed X, Y, Z (URDF's convention)."""
    half = np.asarray(rpy, dtype=np.float64) / 2.0
    (cr, cp, cy), (sr, sp, sy) = np.moveaxis(np.cos(half), -1, 0), np.moveaxis(np.sin(half), -1, 0)
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=-1,
    )


def to_rpy(q: Array) -> Array:
    """Roll, pitch, yaw (..., 3), radians about fixed X, Y, Z, of unit quaternions (..., 4)."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.stack([roll, pitch, yaw], axis=-1)


def from_xyz_rpy(xyz: ArrayLike, rpy: ArrayLike) -> Array:
    """Poses (..., 7) of a URDF `<origin>`: `xyz` in metres, `rpy` in radians about fixed X, Y, Z."""
    return np.concatenate([np.asarray(xyz, dtype=np.float64), from_rpy(rpy)], axis=-1)


def to_matrix(pose: Array) -> Array:
    """Homogeneous matrices (..., 4, 4) of poses (..., 7)."""
    matrix = np.zeros((*pose.shape[:-1], 4, 4))
    axes = np.eye(3)
    for column in range(3):
        matrix[..., :3, column] = rotate(pose[..., 3:], np.broadcast_to(axes[column], (*pose.shape[:-1], 3)))
    matrix[..., :3, 3] = pose[..., :3]
    matrix[..., 3, 3] = 1.0
    return matrix


def from_matrix(matrix: ArrayLike) -> Array:
    """Poses (..., 7) of homogeneous matrices (..., 4, 4) whose upper left block is a rotation.

    Raises ValueError where it is not one (to 1e-3), or a number is not finite.
    """
    matrix = np.asarray(matrix, dtype=np.float64)
    rotation = matrix[..., :3, :3]
    gram = np.swapaxes(rotation, -1, -2) @ rotation
    if not np.all(np.isfinite(matrix)) or np.abs(gram - np.eye(3)).max() > 1e-3 or np.any(np.linalg.det(rotation) < 0):
        raise ValueError("the upper left 3x3 block of the matrix is not a rotation")
    m = np.moveaxis(rotation, (-2, -1), (0, 1))
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    # Four forms, each exact where its leading component is large; the largest is taken (Shepperd 1978).
    forms = np.stack(
        [
            np.stack([1 + trace, m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]], axis=-1),
            np.stack([m[2, 1] - m[1, 2], 1 + 2 * m[0, 0] - trace, m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]], axis=-1),
            np.stack([m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], 1 + 2 * m[1, 1] - trace, m[1, 2] + m[2, 1]], axis=-1),
            np.stack([m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], 1 + 2 * m[2, 2] - trace], axis=-1),
        ],
        axis=-2,
    )
    leading = np.stack([forms[..., k, k] for k in range(4)], axis=-1).argmax(axis=-1)
    q = np.take_along_axis(forms, leading[..., None, None], axis=-2)[..., 0, :]
    return np.concatenate([matrix[..., :3, 3], q / np.linalg.norm(q, axis=-1, keepdims=True)], axis=-1)


def random_quaternions(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """Unit quaternions (*shape, 4) uniform over all rotations."""
    q = rng.standard_normal((*shape, 4))
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def perturb(pose: Array, translation: Array, rotation: Array, centre: Array = ORIGIN) -> Array:
    """Move poses (..., 7) by a `translation` and a `rotation` vector (..., 3), both in the world's axes.

    The turn is about the point `centre` (..., 3) of the moved frame, so that a part's far end is not thrown about
    when its frame's origin lies outside it. Quaternions come back at unit length, however often they are moved.
    """
    return _perturb.ufunc(pose, translation, rotation, centre)


def perturbation(before: Array, after: Array, centre: Array) -> tuple[Array, Array]:
    """The translation and the rotation vector (..., 3) by which `perturb` moves poses `before` to `after` (..., 7),
    about the point `centre` (..., 3) of the moved frame."""
    translation = transform_points(after, centre) - transform_points(before, centre)
    turn = quaternion_multiply(after[..., 3:], quaternion_conjugate(before[..., 3:]))
    return translation, to_rotation_vector(turn)


def mean(pose: Array, weights: Array) -> Array:
    """Weighted means (..., 7) of poses (T, ..., 7), weights (T,): mean position, and the chordal mean rotation (Markley
    et al. 2007)."""
    share = (weights / weights.sum()).reshape(-1, *(1,) * (pose.ndim - 1))
    q = np.moveaxis(pose[..., 3:], 0, -2)
    _, vectors = np.linalg.eigh(np.swapaxes(q, -1, -2) @ np.moveaxis(share * pose[..., 3:], 0, -2))
    return np.concatenate([(share * pose[..., :3]).sum(axis=0), vectors[..., -1]], axis=-1)
