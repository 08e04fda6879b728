"""Row: a job between prepare and decode."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from motiongen_ardy.model.packed import RowConditions
from motiongen_server.engine.types import WindowJob


@dataclass(slots=True)
class Row:
    """A job that the runner holds.

    tokens: (G / 4, 20 + L), the horizon, noisy until the last step. history: (H / 4, 20 + L), clean; both in the
    window's frame. translation: (3) metres from that to the world's frame. goals: observed features (G, D) of the
    horizon, normalised, in the window's frame, and their mask. num_frames: how many of the horizon's frames are used.
    is_led: whether its root is kept once it has been predicted often enough. root: (G / 4, 20), as the last step
    predicted it.
    """

    job: WindowJob
    tokens: Tensor
    history: Tensor
    translation: Tensor
    conditions: RowConditions
    num_frames: int
    goals: tuple[Tensor, Tensor] | None = None
    is_led: bool = False
    root: Tensor | None = None
    steps_done: int = 0
