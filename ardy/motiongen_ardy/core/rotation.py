"""Rotations: 6-D, matrix, quaternion (w, x, y, z) and axis-angle. Pure functions on torch tensors.

Matrices act on column vectors. The 6-D form is the first column of the matrix followed by the second
(Zhou et al. 2019, "On the continuity of rotation representations in neural networks").
"""

from __future__ import annotations

import torch
from torch import Tensor


def angle_of(sine: Tensor, cosine: Tensor) -> Tensor:
    """Angles in -pi..pi, in radians.

    Computed in float64: in float32, torch rounds the last elements of a tensor differently from those inside it, so
    that a row's result would depend on the other rows of its batch.
    """
    return torch.atan2(sine.double(), cosine.double()).to(sine.dtype)


def matrix_to_6d(matrix: Tensor) -> Tensor:
    """(..., 3, 3) -> (..., 6): first column, then second column."""
    return torch.cat([matrix[..., :, 0], matrix[..., :, 1]], dim=-1)


def matrix_from_6d(values: Tensor) -> Tensor:
    """(..., 6) -> (..., 3, 3), orthonormal for any input: x = a/|a|, z = (x X b)/|x X b|, y = z X x."""
    # Component by component: operations on whole tensors take half the time of operations on triples.
    ax, ay, az, bx, by, bz = values.movedim(-1, 0).contiguous().unbind(0)
    length = (ax * ax + ay * ay + az * az).sqrt()
    ax, ay, az = ax / length, ay / length, az / length
    cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    length = (cx * cx + cy * cy + cz * cz).sqrt()
    cx, cy, cz = cx / length, cy / length, cz / length
    rows = [
        ax, cy * az - cz * ay, cx,
        ay, cz * ax - cx * az, cy,
        az, cx * ay - cy * ax, cz,
    ]  # fmt: skip
    return torch.stack(rows, dim=-1).unflatten(-1, (3, 3))


def axis_angle_to_matrix(axis_angle: Tensor) -> Tensor:
    """(..., 3), axis times angle in radians, -> (..., 3, 3), by Rodrigues' formula.

    The axis is divided by (angle + 1e-6), so it is very slightly too short; files written for ARDY rely on that.
    """
    x, y, z = axis_angle.movedim(-1, 0).contiguous().unbind(0)
    angle = axis_angle.norm(dim=-1)
    short = 1 / (angle + 1e-6)
    x, y, z = x * short, y * short, z * short
    sine, rest = torch.sin(angle), 1 - torch.cos(angle)
    xx, yy, zz = x * x, y * y, z * z
    across, up, along = rest * x * y, rest * x * z, rest * y * z
    rows = [
        1 - rest * (yy + zz), across - sine * z, up + sine * y,
        across + sine * z, 1 - rest * (xx + zz), along - sine * x,
        up - sine * y, along + sine * x, 1 - rest * (xx + yy),
    ]  # fmt: skip
    return torch.stack(rows, dim=-1).unflatten(-1, (3, 3))


def matrix_to_quaternion(matrix: Tensor) -> Tensor:
    """(..., 3, 3) -> (..., 4) as (w, x, y, z). The largest component is positive, so w may be negative."""
    return quaternion_components(matrix).movedim(0, -1).contiguous()


def quaternion_components(matrix: Tensor) -> Tensor:
    """(..., 3, 3) -> (4, ...): as `matrix_to_quaternion`, but components first, which is faster to compute with."""
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = matrix.flatten(-2).movedim(-1, 0).contiguous().unbind(0)
    more, less = 1 + m00, 1 - m00
    w, x, y, z = more + m11 + m22, more - m11 - m22, less + m11 - m22, less - m11 + m22  # four times their squares
    wx, wy, wz, xy, xz, yz = m21 - m12, m02 - m20, m10 - m01, m10 + m01, m02 + m20, m21 + m12
    # Each of these is the quaternion times four times one of its components; the largest one is the most exact.
    of_w, of_x, of_y, of_z = (
        torch.stack(row) for row in ((w, wx, wy, wz), (wx, x, xy, xz), (wy, xy, y, yz), (wz, xz, yz, z))
    )
    of_first, first = torch.where(x > w, of_x, of_w), torch.maximum(w, x)
    of_second, second = torch.where(z > y, of_z, of_y), torch.maximum(y, z)
    scaled = torch.where(second > first, of_second, of_first)
    return scaled / (2 * torch.maximum(first, second).sqrt())


def relative_components(base: Tensor, quaternion: Tensor) -> Tensor:
    """base^-1 * quaternion: the rotation `quaternion` relative to `base`; all (4, ...), unit quaternions."""
    bw, bx, by, bz = base.unbind(0)
    w, x, y, z = quaternion.unbind(0)
    return torch.stack(
        [
            bw * w + bx * x + by * y + bz * z,
            bw * x - bx * w - by * z + bz * y,
            bw * y + bx * z - by * w - bz * x,
            bw * z - bx * y + by * x - bz * w,
        ]
    )


def rotation_vector(matrix: Tensor) -> Tensor:
    """(..., 3, 3) -> (..., 3), axis times angle in radians; the angle is in 0..pi, and exact near 0 and pi too."""
    quaternion = matrix_to_quaternion(matrix)
    quaternion = torch.where(quaternion[..., :1] < 0, -quaternion, quaternion)
    imaginary = quaternion[..., 1:]
    sine = imaginary.norm(dim=-1, keepdim=True)
    angle = 2 * angle_of(sine, quaternion[..., :1])
    tiny = sine < 1e-12  # the axis is undefined; angle / sine tends to 2
    return imaginary * torch.where(tiny, 2.0, angle / torch.where(tiny, 1.0, sine))


def quaternion_to_matrix(quaternion: Tensor) -> Tensor:
    """(..., 4) as (w, x, y, z), of any length but zero -> (..., 3, 3)."""
    w, x, y, z = (quaternion / quaternion.norm(dim=-1, keepdim=True)).unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, dim=-1).unflatten(-1, (3, 3))


def slerp(start: Tensor, end: Tensor, fraction: Tensor) -> Tensor:
    """Spherical interpolation of quaternions (..., 4) along the shorter arc; fraction (...) in 0..1."""
    dot = (start * end).sum(-1, keepdim=True)
    end = torch.where(dot < 0, -end, end)
    angle = torch.acos(dot.abs().clamp(max=1))
    fraction = fraction[..., None]
    near = angle < 1e-4  # sin(angle) cancels; linear interpolation is exact to rounding here
    sine = torch.sin(torch.where(near, torch.ones_like(angle), angle))
    weight_start = torch.where(near, 1 - fraction, torch.sin((1 - fraction) * angle) / sine)
    weight_end = torch.where(near, fraction, torch.sin(fraction * angle) / sine)
    mixed = weight_start * start + weight_end * end
    return mixed / mixed.norm(dim=-1, keepdim=True)


def rotation_y(angle: Tensor) -> Tensor:
    """(...) radians about +Y -> (..., 3, 3) with rows (cos, 0, sin), (0, 1, 0), (-sin, 0, cos); +90 deg faces +X."""
    cosine, sine = torch.cos(angle), torch.sin(angle)
    zero, one = torch.zeros_like(angle), torch.ones_like(angle)
    return torch.stack([cosine, zero, sine, zero, one, zero, -sine, zero, cosine], dim=-1).unflatten(-1, (3, 3))
