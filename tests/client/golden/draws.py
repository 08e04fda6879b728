"""Sources of golden vectors: a chain of three joints, random rows, and numbers as the files have them."""

from __future__ import annotations

import random
from collections.abc import Iterable

import numpy as np

from motiongen_client.motion import CONTACT_BLOCK, ROOT_BLOCK, ROTATION_BLOCK, Float32, Rig

RATE_HZ = 20
JOINTS = 3
RIG = Rig(
    "chain",
    ("root", "middle", "end"),
    (-1, 0, 1),
    np.array([[0, 0, 0], [0, 1, 0], [0, 1, 0]], np.float32),
    RATE_HZ,
    {ROOT_BLOCK: 3, ROTATION_BLOCK: 4 * JOINTS, CONTACT_BLOCK: 4},
)


def numbers(values: Iterable[float]) -> str:
    return " ".join(f"{float(value):.7g}" for value in np.asarray(values, np.float64).ravel())


def drawn_rotations(draw: random.Random, count: int) -> Float32:
    """(count, 4) unit quaternions, of both signs."""
    values = np.array([[draw.gauss(0, 1) for _ in range(4)] for _ in range(count)])
    return (values / np.linalg.norm(values, axis=1, keepdims=True)).astype(np.float32)


def drawn_rows(draw: random.Random, count: int) -> Float32:
    """(count, D) of the chain, with independent random values in each frame, rounded as in the files."""
    rows = np.zeros((count, RIG.row_width), np.float32)
    for row in rows:
        row[:3] = [draw.uniform(-5, 5) for _ in range(3)]
        row[3:15] = drawn_rotations(draw, JOINTS).ravel()
        row[15:] = [draw.randint(0, 1) for _ in range(4)]
    return np.array([[float(f"{value:.6g}") for value in row] for row in rows], np.float32)
