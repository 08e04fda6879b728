"""Animation: one take as the page plays it: joint positions by frame, what was asked for, and the result."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motiongen_client.errors import InvalidInput

LONGEST_S = 12.0
_MM = 1000
_MOST_MM = 32_000


@dataclass(frozen=True, eq=False)
class Goal:
    """What was asked for at a frame; frame None: over the whole take. points_m: (K, 3); is_path: they form a line."""

    frame: int | None
    points_m: NDArray[np.float32]
    is_path: bool = False


@dataclass(frozen=True, eq=False)
class Animation:
    """One take. positions_m: (T, J, 3), world. contacts: (T, 4) bool, left heel and toe, right heel and toe. feet: the
    joints that contacts are of. detail: text below the picture. verdict: met, missed, refused, or "" if nothing was
    asked for.
    """

    positions_m: NDArray[np.float32]
    contacts: NDArray[np.bool_]
    feet: tuple[int, ...]
    parents: tuple[int, ...]
    joint_names: tuple[str, ...]
    frame_rate_hz: int
    goals: tuple[Goal, ...] = ()
    detail: str = ""
    verdict: str = ""

    def __post_init__(self) -> None:
        joints = len(self.parents)
        if self.positions_m.ndim != 3 or self.positions_m.shape[1:] != (joints, 3) or len(self.positions_m) == 0:
            raise InvalidInput("positions_m", self.positions_m.shape, f"one frame or more of {joints} joints, x y z")
        if self.contacts.shape != (len(self.positions_m), 4):
            raise InvalidInput("contacts", self.contacts.shape, f"four a frame, of {len(self.positions_m)} frames")
        if not np.isfinite(self.positions_m).all():
            raise InvalidInput("positions_m", "numbers that are not finite", "finite metres")

    def slide_mps(self) -> float:
        """Average speed over the ground of the feet that are marked as in contact; 0 if there are none."""
        ground = self.positions_m[:, list(self.feet)][..., [0, 2]]
        speeds = np.linalg.norm(np.diff(ground, axis=0), axis=-1) * self.frame_rate_hz
        stands = (self.contacts[1:] & self.contacts[:-1])[:, : len(self.feet)]
        return float(speeds[stands].mean()) if stands.any() else 0.0

    def speed_mps(self) -> float:
        """Average speed of the root over the ground."""
        steps = np.linalg.norm(np.diff(self.positions_m[:, 0, [0, 2]], axis=0), axis=-1)
        return float(steps.mean() * self.frame_rate_hz) if len(steps) else 0.0

    def shown(self) -> dict[str, Any]:
        """The take as the page reads it: whole millimetres in two bytes each, relative to where the take begins."""
        frames = self.positions_m[: round(LONGEST_S * self.frame_rate_hz)]
        origin = np.array([frames[0, 0, 0], 0.0, frames[0, 0, 2]], np.float32)
        whole = np.clip(np.rint((frames - origin) * _MM), -_MOST_MM, _MOST_MM).astype("<i2")
        return {
            "fps": self.frame_rate_hz,
            "parents": list(self.parents),
            "sides": [_side(name) for name in self.joint_names],
            "head": next((n for n, name in enumerate(self.joint_names) if name.lower().startswith("head")), None),
            "num_frames": len(frames),
            "left_out": len(self.positions_m) - len(frames),
            "data": base64.b64encode(whole.tobytes()).decode(),
            "goals": [_goal(goal, origin) for goal in self.goals],
            "figures": f"{self.speed_mps():.2f} m/s; feet that stand slide at {self.slide_mps():.2f} m/s",
            "detail": self.detail,
            "verdict": self.verdict,
        }


def refused(reason: str) -> dict[str, Any]:
    """Takes the place of an animation that the server refused."""
    return {"num_frames": 0, "detail": reason, "verdict": "refused"}


def feet_of(joint_names: Sequence[str]) -> tuple[int, ...]:
    """The joints of the four contacts, as far as their names tell; empty if they do not."""
    names = ("LeftFoot", "LeftToeBase", "RightFoot", "RightToeBase")
    return tuple(joint_names.index(name) for name in names) if all(name in joint_names for name in names) else ()


def _side(name: str) -> str:
    lower = name.lower()
    return "left" if lower.startswith("left") else "right" if lower.startswith("right") else "middle"


def _goal(goal: Goal, origin: NDArray[np.float32]) -> dict[str, Any]:
    points = (goal.points_m.astype(np.float64) - origin).round(3).tolist()
    return {"frame": goal.frame, "points": points, "is_path": goal.is_path}
