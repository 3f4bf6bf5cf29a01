"""Poses and covariances as the bytes of a row, one at a time or all of a commit's."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.errors import DataError

POSE_BYTES = 7 * 8
_FAR = 1e12
_LOWER = np.tril_indices(6)
COVARIANCE_BYTES = len(_LOWER[0]) * 2
_FACTOR_SCALE, _FLOAT16_MAX = 1e3, 65504.0  # sigmas from 6e-11 to 65 rad or m

Array = NDArray[np.float64]


def pack_pose(T: Array) -> bytes:
    """(4, 4) -> 56 bytes: x y z, qx qy qz qw, little-endian float64."""
    return np.concatenate([T[:3, 3], se3.quat_from_matrix(T[:3, :3])]).astype("<f8").tobytes()


def pack_all(poses: Array) -> list[bytes]:
    """(n, 4, 4) -> each as pack_pose does it."""
    rows = np.concatenate([poses[:, :3, 3], _quaternions(poses[:, :3, :3])], axis=1).astype("<f8").tobytes()
    return [rows[at : at + POSE_BYTES] for at in range(0, len(rows), POSE_BYTES)]


def unpack_pose(data: bytes | None) -> Array:
    """56 bytes -> (4, 4). Raises DataError("corrupt") for what cannot be a pose."""
    (values,) = _values([data])
    return se3.from_quat(values[:3], values[3:])


def unpack_all(packed: Sequence[bytes | None]) -> Array:
    """Each as unpack_pose does it -> (n, 4, 4). Raises DataError("corrupt")."""
    values = _values(packed)
    poses = np.zeros((len(values), 4, 4))
    poses[:, :3, :3], poses[:, :3, 3], poses[:, 3, 3] = _matrices(values[:, 3:]), values[:, :3], 1.0
    return poses


def _values(packed: Sequence[bytes | None]) -> Array:
    """(n, 7). Raises DataError("corrupt")."""
    for data in packed:
        if data is None or len(data) != POSE_BYTES:
            raise DataError("corrupt", f"a pose of {0 if data is None else len(data)} bytes")
    values = np.frombuffer(b"".join(packed), "<f8").reshape(-1, 7)  # type: ignore[arg-type]
    if not (np.abs(values) < _FAR).all():  # NaN as well
        raise DataError("corrupt", "a pose that is nowhere")
    if not values[:, 3:].any(axis=1).all():
        raise DataError("corrupt", "a pose without a rotation")
    return values


def _quaternions(R: Array) -> Array:
    """(n, 3, 3) -> unit quaternions (n, 4) x y z w, w >= 0: the longest row of 4 q q^T, which R tells."""
    n = len(R)
    (a, b, c), (d, e, f), (g, h, i) = R.transpose(1, 2, 0)
    products = np.empty((4, 4, n))
    products[0, 0], products[1, 1], products[2, 2] = 1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i
    products[3, 3] = 1.0 + a + e + i
    for k, j, value in ((0, 1, b + d), (0, 2, c + g), (1, 2, f + h), (0, 3, h - f), (1, 3, c - g), (2, 3, d - b)):
        products[k, j] = products[j, k] = value
    longest = np.argmax(np.einsum("kkn->kn", products), axis=0)
    q = products[longest, :, np.arange(n)]
    return q * (np.where(q[:, 3:] < 0.0, -1.0, 1.0) / np.linalg.norm(q, axis=1, keepdims=True))


def _matrices(q: Array) -> Array:
    """Quaternions (n, 4) x y z w, any norm > 0 -> rotation matrices (n, 3, 3)."""
    x, y, z, w = q.T
    s = 2.0 / np.einsum("nk,nk->n", q, q)
    rows = (
        (1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)),
        (s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w)),
        (s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y)),
    )
    return np.array(rows).transpose(2, 0, 1)


def pack_covariance(covariance: Array | None) -> bytes | None:
    """(6, 6) -> 42 bytes: its Cholesky factor's lower triangle in mrad and mm, row by row, little-endian float16.

    None for what is no covariance. A factor, so that rounding cannot make a direction of negative variance.
    """
    if covariance is None or not np.isfinite(covariance).all():
        return None
    try:
        factor = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:  # known to rounding along some direction
        variances, axes = np.linalg.eigh(covariance)
        factor = np.linalg.qr((axes * np.sqrt(np.maximum(variances, 0.0))).T).R.T
    return _pack_factor(np.asarray(factor, np.float64))


def pack_covariances(covariances: Sequence[Array | None]) -> list[bytes | None]:
    """Each as pack_covariance does it."""
    try:
        return [_pack_factor(factor) for factor in np.linalg.cholesky(np.array(covariances, np.float64))]
    except (np.linalg.LinAlgError, TypeError, ValueError):  # one of them is none, or not quite one
        return [pack_covariance(covariance) for covariance in covariances]


def _pack_factor(factor: Array) -> bytes:
    return np.clip(factor[_LOWER] * _FACTOR_SCALE, -_FLOAT16_MAX, _FLOAT16_MAX).astype("<f2").tobytes()


def pack_factors(factors: Array) -> list[bytes | None]:
    """The reverse of `unpack_factors`."""
    return [None if np.isnan(factor[0, 0]) else _pack_factor(factor) for factor in factors]


def unpack_covariance(data: bytes | None) -> Array | None:
    """42 bytes -> (6, 6), each entry to 2e-3 of its two sigmas. Raises DataError("corrupt")."""
    if data is None:
        return None
    (factor,) = unpack_factors([data])
    return factor @ factor.T


def unpack_factors(packed: Sequence[bytes | None]) -> Array:
    """The Cholesky factors (n, 6, 6) of what pack_covariance packed, NaN for None. Raises DataError("corrupt")."""
    if wrong := next((data for data in packed if data is not None and len(data) != COVARIANCE_BYTES), None):
        raise DataError("corrupt", f"a covariance of {len(wrong)} bytes")
    known = np.array([data is not None for data in packed], bool)
    values = np.frombuffer(b"".join(data for data in packed if data is not None), "<f2").astype(np.float64)
    if not np.isfinite(values).all():
        raise DataError("corrupt", "a covariance without numbers")
    factors = np.zeros((len(packed), 6, 6))
    factors[~known] = np.nan
    of_known = np.zeros((int(known.sum()), 6, 6))
    of_known[:, *_LOWER] = values.reshape(-1, len(_LOWER[0])) / _FACTOR_SCALE
    factors[known] = of_known
    return factors
