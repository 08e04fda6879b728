"""SafeHold: commands for a robot's controller when frames stop: slow down, hold, and return smoothly."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from motiongen_client.errors import InvalidInput
from motiongen_client.robot.g1 import LOWER, QPOS_WIDTH, SPEED_LIMITS, UPPER

Float64 = NDArray[np.float64]
_UNIT_TOLERANCE = 1e-2


class HoldState(enum.Enum):
    """What the commands do: follow frames, slow down, stand still, or return to frames."""

    FOLLOWING = "following"
    STOPPING = "stopping"
    HOLDING = "holding"
    RETURNING = "returning"


@dataclass
class SafeHold:
    """Call `command` at the controller's rate, with each new frame's qpos once, and None otherwise.

    If no frame has come for stale_s, joints and root slow down over stop_s, within their ranges, and then stand still.
    When frames come again, the commands return to them within return_s, with no joint above its speed limit. The first
    command is the first frame: bring the robot to that pose beforehand.
    """

    stale_s: float = 0.15
    stop_s: float = 0.3
    return_s: float = 0.5
    state: HoldState = field(default=HoldState.FOLLOWING, init=False)
    _frame: Float64 | None = field(default=None, init=False)
    _frame_at_s: float = field(default=0.0, init=False)
    _command: Float64 | None = field(default=None, init=False)
    _command_at_s: float = field(default=0.0, init=False)
    _speed: Float64 = field(default_factory=lambda: np.zeros(QPOS_WIDTH), init=False)
    _since_s: float = field(default=0.0, init=False)
    _from: Float64 = field(default_factory=lambda: np.zeros(QPOS_WIDTH), init=False)

    def __post_init__(self) -> None:
        for name in ("stale_s", "stop_s", "return_s"):
            if not getattr(self, name) > 0:
                raise InvalidInput(name, getattr(self, name), "seconds above 0")

    def command(self, now_s: float, qpos: Float64 | None = None) -> Float64:
        """(36,) the commanded qpos at now_s, on a monotonic clock. Raises InvalidInput before the first frame."""
        if self._command is not None:
            now_s = max(now_s, self._command_at_s)  # a clock that goes back stands still
        if qpos is not None:
            self._take(np.array(qpos, np.float64), now_s)
        if self._frame is None or self._command is None:
            raise InvalidInput("qpos", None, f"a first state of {QPOS_WIDTH} numbers")
        if now_s - self._frame_at_s > self.stale_s and self.state in (HoldState.FOLLOWING, HoldState.RETURNING):
            self.state, self._since_s, self._from = HoldState.STOPPING, now_s, self._command
        wanted = self._wanted(now_s)
        self._move_to(wanted, now_s)
        return self._command.copy()

    def _take(self, qpos: Float64, now_s: float) -> None:
        if qpos.shape != (QPOS_WIDTH,) or not np.isfinite(qpos).all():
            raise InvalidInput("qpos", f"an array of shape {qpos.shape}", f"{QPOS_WIDTH} finite numbers")
        if abs(float(np.linalg.norm(qpos[3:7])) - 1) > _UNIT_TOLERANCE:
            raise InvalidInput("qpos", qpos[3:7].tolist(), "a unit quaternion w, x, y, z after the root's position")
        if self._command is not None and qpos[3:7] @ self._command[3:7] < 0:
            qpos[3:7] *= -1  # the same rotation; returning to frames interpolates the numbers, which must be close
        if self._command is None:
            self._command, self._command_at_s = qpos, now_s
        elif self.state in (HoldState.STOPPING, HoldState.HOLDING):
            self.state, self._since_s, self._from = HoldState.RETURNING, now_s, self._command
        self._frame, self._frame_at_s = qpos, now_s

    def _wanted(self, now_s: float) -> Float64:
        assert self._frame is not None
        since = now_s - self._since_s
        if self.state is HoldState.STOPPING:
            if since < self.stop_s:
                return self._from + self._speed * since * (1 - since / (2 * self.stop_s))
            self.state, self._from = HoldState.HOLDING, self._from + self._speed * self.stop_s / 2
        if self.state is HoldState.HOLDING:
            return self._from
        if self.state is HoldState.RETURNING:
            if since < self.return_s:
                share = since / self.return_s
                return self._from + (self._frame - self._from) * share * share * (3 - 2 * share)
            self.state = HoldState.FOLLOWING
        return self._frame

    def _move_to(self, wanted: Float64, now_s: float) -> None:
        """Step toward `wanted` within speed limits, and track the mean speed, with which a stop begins."""
        assert self._command is not None
        passed, before = now_s - self._command_at_s, self._command
        moved = wanted.copy()
        if moved[3:7] @ before[3:7] < 0:
            moved[3:7] *= -1
        most = SPEED_LIMITS * passed  # 0 if no time has passed, as with a coarse clock
        moved[7:] = before[7:] + np.clip(moved[7:] - before[7:], -most, most)
        moved[7:] = np.clip(moved[7:], LOWER, UPPER)
        moved[3:7] /= np.linalg.norm(moved[3:7])
        if passed > 0 and self.state in (HoldState.FOLLOWING, HoldState.RETURNING):
            share = min(passed / self.stale_s, 1.0)  # frames come in steps, so their speed is averaged
            self._speed = (1 - share) * self._speed + share * (moved - before) / passed
        self._command, self._command_at_s = moved, now_s
