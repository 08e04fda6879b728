"""Rotations: 6-D, matrix, quaternion (w, x, y, z) and axis-angle. Pure functions on torch tensors.

Matrices act on column vectors. The 6-D form is the first column of the matrix followed by the second
(Zhou et al. 2019, "On the continuity of rotation representations in neural networks").
"""

from __future__ import annotations

import torch
from torch import Tensor


def angle_of(sine: Tensor, cosine: Tensor) -> Tensor:
    """Angles in -pi..pi, in radians.

    Computed in float64: torch rounds float32 otherwise where a tensor ends than inside it, and what a row gets would
    depend on who shares its batch.
    """
    return torch.atan2(sine.double(), cosine.double()).to(sine.dtype)


def matrix_to_6d(matrix: Tensor) -> Tensor:
    """(..., 3, 3) -> (..., 6): first column, then second column."""
    return torch.cat([matrix[..., :, 0], matrix[..., :, 1]], dim=-1)


def matrix_from_6d(values: Tensor) -> Tensor:
    """(..., 6) -> (..., 3, 3), orthonormal even when the input is not: x = a/|a|, z = (x X b)/|x X b|, y = z X x."""
    # Component by component: products and roots of whole tensors take half of the time that those of triples do.
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
    """(..., 3) axis times angle in radians -> (..., 3, 3), by Rodrigues' formula.

    The axis is divided by (angle + 1e-6), so it is very slightly short; files written for ARDY rely on that.
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
    """(..., 3, 3) -> (..., 4) as (w, x, y, z). The largest component is taken positive, so w may be negative."""
    flat = matrix.flatten(-2)
    signed = matrix.diagonal(dim1=-2, dim2=-1)[..., None] * _SQUARE_SIGNS.to(matrix)
    squares = 1 + signed[..., 0, :] + signed[..., 1, :] + signed[..., 2, :]
    first, second = (flat.index_select(-1, number.to(matrix.device)) for number in (_FIRST, _SECOND))
    products = first + _PRODUCT_SIGNS.to(matrix) * second
    roots = torch.sqrt(squares.clamp(min=0))  # twice each component's magnitude
    largest = roots.argmax(dim=-1)
    # Row k of _ROWS names the quaternion scaled by twice its k-th component times two.
    row = torch.cat([squares, products], dim=-1).gather(-1, _ROWS.to(matrix.device)[largest])
    return row / (2 * roots.gather(-1, largest[..., None]))


# The squares of w, x, y, z are 1 and the diagonal with these signs, a column each; the products wx, wy, wz, xy, xz, yz
# are sums and differences of two entries of the matrix, numbered row by row. In few operations, since where there are
# few matrices they are what takes the time.
_SQUARE_SIGNS = torch.tensor([[1.0, 1.0, -1.0, -1.0], [1.0, -1.0, 1.0, -1.0], [1.0, -1.0, -1.0, 1.0]])
_FIRST, _SECOND = torch.tensor([7, 2, 3, 3, 2, 7]), torch.tensor([5, 6, 1, 1, 6, 5])
_PRODUCT_SIGNS = torch.tensor([-1.0, -1.0, -1.0, 1.0, 1.0, 1.0])
_ROWS = torch.tensor([[0, 4, 5, 6], [4, 1, 7, 8], [5, 7, 2, 9], [6, 8, 9, 3]])


def rotation_vector(matrix: Tensor) -> Tensor:
    """(..., 3, 3) -> (..., 3) axis times angle in radians, the angle in 0..pi; exact also near 0 and pi."""
    quaternion = matrix_to_quaternion(matrix)
    quaternion = torch.where(quaternion[..., :1] < 0, -quaternion, quaternion)
    imaginary = quaternion[..., 1:]
    sine = imaginary.norm(dim=-1, keepdim=True)
    angle = 2 * torch.atan2(sine, quaternion[..., :1])
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
