"""One line of a table of residuals: how near targets of a kind came."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from motiongen_client import Residual


def residual_row(name: str, residuals: Sequence[Residual]) -> str:
    """Mean and worst of metres and of radians, and how many targets were met."""
    positions = [each.position_m.worst for each in residuals if each.position_m is not None]
    angles = [angle.worst for each in residuals for angle in (each.heading_rad, each.rotation_rad) if angle is not None]
    met = sum(each.met for each in residuals)
    return f"| {name} | {_cell(positions)} | {_cell(angles)} | {met} of {len(residuals)} |"


def _cell(numbers: Sequence[float]) -> str:
    return f"{np.mean(numbers):.3f} ({max(numbers):.3f})" if numbers else "-"
