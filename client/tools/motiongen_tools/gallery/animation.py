"""Animation: one take as the page plays it: joints by frame, what was asked, and what became of that."""

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
    """What was asked at a frame, or, without one, over the whole take. points_m: (K, 3); is_path: they are a line."""

    frame: int | None
    points_m: NDArray[np.float32]
    is_path: bool = False


@dataclass(frozen=True, eq=False)
class Animation:
    """positions_m: (T, J, 3), world; contacts: (T, 4) bool, left heel and toe, right heel and toe; feet: their joints.

    detail: what is said below the picture. verdict: met, missed, refused, or "" where nothing was asked for.
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
        """How fast the feet that are said to stand move over the ground, on average; 0 where none stands."""
        ground = self.positions_m[:, list(self.feet)][..., [0, 2]]
        speeds = np.linalg.norm(np.diff(ground, axis=0), axis=-1) * self.frame_rate_hz
        stands = (self.contacts[1:] & self.contacts[:-1])[:, : len(self.feet)]
        return float(speeds[stands].mean()) if stands.any() else 0.0

    def speed_mps(self) -> float:
        """Of the root over the ground, on average."""
        steps = np.linalg.norm(np.diff(self.positions_m[:, 0, [0, 2]], axis=0), axis=-1)
        return float(steps.mean() * self.frame_rate_hz) if len(steps) else 0.0

    def shown(self) -> dict[str, Any]:
        """As the page reads it: whole millimetres of two bytes, seen from where the take begins."""
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
    """In place of an animation that the server would not make."""
    return {"num_frames": 0, "detail": reason, "verdict": "refused"}


def feet_of(joint_names: Sequence[str]) -> tuple[int, ...]:
    """The joints that the four contacts speak of, where the names tell them; none where they do not."""
    names = ("LeftFoot", "LeftToeBase", "RightFoot", "RightToeBase")
    return tuple(joint_names.index(name) for name in names) if all(name in joint_names for name in names) else ()


def _side(name: str) -> str:
    lower = name.lower()
    return "left" if lower.startswith("left") else "right" if lower.startswith("right") else "middle"


def _goal(goal: Goal, origin: NDArray[np.float32]) -> dict[str, Any]:
    points = (goal.points_m.astype(np.float64) - origin).round(3).tolist()
    return {"frame": goal.frame, "points": points, "is_path": goal.is_path}
