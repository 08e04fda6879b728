"""Reads BVH text: any hierarchy, channels in any order.

A position channel replaces the OFFSET of its joint (it is not added to it), and a joint's rotation is the product of
its rotation channels in the order in which the file names them, acting on column vectors. Lengths keep the unit of the
file; angles in the file are in degrees.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

POSITION_CHANNELS = ("Xposition", "Yposition", "Zposition")
ROTATION_CHANNELS = ("Xrotation", "Yrotation", "Zrotation")
MAX_JOINTS = 2_000
MIN_FRAME_TIME_S = 1e-6
# A longer one is not motion but a frame time in milliseconds, and resampling would fill memory with frames.
MAX_FRAME_TIME_S = 1.0


class BvhError(ValueError):
    """Raised for a file that is not BVH. The message names the file, the line and what is wrong there."""

    def __init__(self, source: str, line: int, problem: str) -> None:
        super().__init__(f"{source}, line {line}: {problem}")
        self.source = source
        self.line = line
        self.problem = problem


@dataclass(frozen=True, eq=False)
class Bvh:
    """The content of a BVH file, unchanged.

    offsets: (J, 3) float64, in the file's unit. end_sites: the OFFSET of each End Site, by the index of its joint.
    channels: each joint's channel names, in file order. values: (T, C) float64, all channels of a frame in file order.
    Parents precede their children.
    """

    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: np.ndarray
    end_sites: dict[int, tuple[float, float, float]]
    channels: tuple[tuple[str, ...], ...]
    frame_time_s: float
    values: np.ndarray

    @property
    def num_frames(self) -> int:
        return int(self.values.shape[0])

    @property
    def fps(self) -> float:
        """Frames per second; a rounded frame time (0.0333333) still gives a whole number."""
        fps = 1.0 / self.frame_time_s
        return float(round(fps)) if abs(fps - round(fps)) < 1e-3 * fps else fps

    def pose(self) -> tuple[Tensor, Tensor]:
        """Local rotations (T, J, 3, 3) and local translations (T, J, 3), float64, in the file's unit."""
        rotations = torch.eye(3, dtype=torch.float64, device="cpu").repeat(self.num_frames, len(self.joint_names), 1, 1)
        translations = torch.from_numpy(self.offsets).repeat(self.num_frames, 1, 1)
        column = 0
        for joint, names in enumerate(self.channels):
            rotation: Tensor | None = None
            for name in names:
                values = torch.from_numpy(self.values[:, column])
                column += 1
                if name in POSITION_CHANNELS:
                    translations[:, joint, POSITION_CHANNELS.index(name)] = values
                    continue
                turn = axis_rotation(ROTATION_CHANNELS.index(name), torch.deg2rad(values))
                rotation = turn if rotation is None else rotation @ turn
            if rotation is not None:
                rotations[:, joint] = rotation
        return rotations, translations

    def global_pose(self) -> tuple[Tensor, Tensor]:
        """Global rotations (T, J, 3, 3) and world positions (T, J, 3), float64, in the file's unit."""
        local_rotations, translations = self.pose()
        rotations: list[Tensor] = []
        positions: list[Tensor] = []
        for joint, parent in enumerate(self.parents):
            if parent < 0:
                rotations.append(local_rotations[:, joint])
                positions.append(translations[:, joint])
                continue
            rotations.append(rotations[parent] @ local_rotations[:, joint])
            step = (rotations[parent] @ translations[:, joint, :, None]).squeeze(-1)
            positions.append(positions[parent] + step)
        return torch.stack(rotations, dim=1), torch.stack(positions, dim=1)


def axis_rotation(axis: int, angle: Tensor) -> Tensor:
    """(...) radians about the x, y or z axis (0, 1 or 2) -> (..., 3, 3)."""
    cosine, sine = torch.cos(angle), torch.sin(angle)
    matrix = torch.zeros(*angle.shape, 3, 3, dtype=angle.dtype, device=angle.device)
    following, last = (axis + 1) % 3, (axis + 2) % 3
    matrix[..., axis, axis] = 1
    matrix[..., following, following] = cosine
    matrix[..., last, last] = cosine
    matrix[..., last, following] = sine
    matrix[..., following, last] = -sine
    return matrix


def read_bvh(path: Path) -> Bvh:
    """Read a BVH file. Raises BvhError for anything that is not BVH, and OSError if the file cannot be read."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise BvhError(str(path), 1, f"not text: {error}") from error
    return parse_bvh(text, str(path))


def parse_bvh(text: str, source: str = "BVH text") -> Bvh:
    """Parse the text of a BVH file; `source` names it in errors. Raises BvhError."""
    return _Parser(text, source).parse()


class _Parser:
    """Parses the lines in one pass: first the hierarchy, then the numbers."""

    def __init__(self, text: str, source: str) -> None:
        self.source = source
        self.lines = text.splitlines()
        self.next_line = 0
        self.names: list[str] = []
        self.parents: list[int] = []
        self.offsets: list[tuple[float, float, float]] = []
        self.channels: list[tuple[str, ...]] = []
        self.end_sites: dict[int, tuple[float, float, float]] = {}

    def parse(self) -> Bvh:
        if self.words() != ["HIERARCHY"]:
            raise self.error("expected HIERARCHY")
        opening = self.words()
        if opening[0] != "ROOT":
            raise self.error(f"expected ROOT and a name, found {' '.join(opening)!r}")
        self.read_joints(opening)
        num_frames, frame_time_s = self.read_motion_header()
        values = self.read_values(num_frames)
        offsets = np.asarray(self.offsets, dtype=np.float64)
        return Bvh(
            joint_names=tuple(self.names),
            parents=tuple(self.parents),
            offsets=offsets,
            end_sites=self.end_sites,
            channels=tuple(self.channels),
            frame_time_s=frame_time_s,
            values=values,
        )

    def error(self, problem: str) -> BvhError:
        return BvhError(self.source, max(self.next_line, 1), problem)

    def words(self) -> list[str]:
        """The words of the next line that is not blank."""
        while self.next_line < len(self.lines):
            words = self.lines[self.next_line].split()
            self.next_line += 1
            if words:
                return words
        raise self.error("the file ends too early")

    def numbers(self, words: list[str], count: int, what: str) -> list[float]:
        try:
            values = [float(word) for word in words]
        except ValueError as error:
            raise self.error(f"{what}: {error}") from error
        if len(values) != count:
            raise self.error(f"{what}: expected {count} numbers, found {len(values)}")
        if not all(map(math.isfinite, values)):
            raise self.error(f"{what}: numbers must be finite")
        return values

    def read_joints(self, opening: list[str]) -> None:
        """The whole tree, from the ROOT line to its closing brace."""
        stack: list[int] = []
        words = opening
        while True:
            if words[0] in ("ROOT", "JOINT"):
                self.open_joint(words, stack)
            elif words == ["End", "Site"]:
                self.read_end_site(stack)
            elif words == ["}"]:
                stack.pop()
                if not stack:
                    return
            else:
                raise self.error(f"expected JOINT, End Site or a closing brace, found {' '.join(words)!r}")
            words = self.words()

    def open_joint(self, words: list[str], stack: list[int]) -> None:
        if (words[0] == "ROOT" and stack) or len(words) < 2:
            raise self.error(f"expected JOINT and a name, found {' '.join(words)!r}")
        name = " ".join(words[1:])
        if len(self.names) == MAX_JOINTS:
            raise self.error(f"more than {MAX_JOINTS} joints")
        if name in self.names:
            raise self.error(f"a second joint named {name!r}")
        self.expect_brace()
        offset = self.read_offset()
        self.names.append(name)
        self.parents.append(stack[-1] if stack else -1)
        self.offsets.append(offset)
        self.channels.append(self.read_channels())
        stack.append(len(self.names) - 1)

    def read_end_site(self, stack: list[int]) -> None:
        self.expect_brace()
        self.end_sites[stack[-1]] = self.read_offset()
        if self.words() != ["}"]:
            raise self.error("expected the closing brace of the End Site")

    def expect_brace(self) -> None:
        if self.words() != ["{"]:
            raise self.error("expected an opening brace")

    def read_offset(self) -> tuple[float, float, float]:
        words = self.words()
        if words[0] != "OFFSET":
            raise self.error(f"expected OFFSET, found {' '.join(words)!r}")
        x, y, z = self.numbers(words[1:], 3, "OFFSET")
        return x, y, z

    def read_channels(self) -> tuple[str, ...]:
        words = self.words()
        if words[0] != "CHANNELS" or len(words) < 2:
            raise self.error(f"expected CHANNELS, found {' '.join(words)!r}")
        names = tuple(words[2:])
        if words[1] != str(len(names)):
            raise self.error(f"CHANNELS says {words[1]} but names {len(names)}")
        known = POSITION_CHANNELS + ROTATION_CHANNELS
        for name in names:
            if name not in known:
                raise self.error(f"unknown channel {name!r}; channels are {', '.join(known)}")
        if len(set(names)) != len(names):
            raise self.error("a channel is named twice")
        return names

    def read_motion_header(self) -> tuple[int, float]:
        if self.words() != ["MOTION"]:
            raise self.error("expected MOTION")
        words = self.words()
        if words[0] != "Frames:" or len(words) != 2 or not re.fullmatch(r"0*[1-9][0-9]{0,8}", words[1]):
            raise self.error(f"expected 'Frames:' and a count of at least 1, found {' '.join(words)!r}")
        num_frames = int(words[1])
        words = self.words()
        if words[:2] != ["Frame", "Time:"]:
            raise self.error(f"expected 'Frame Time:' and seconds, found {' '.join(words)!r}")
        (frame_time_s,) = self.numbers(words[2:], 1, "Frame Time")
        if not MIN_FRAME_TIME_S <= frame_time_s <= MAX_FRAME_TIME_S:
            allowed = f"{MIN_FRAME_TIME_S:g} to {MAX_FRAME_TIME_S:g}"
            raise self.error(f"Frame Time is seconds from one frame to the next, {allowed}, found {frame_time_s:g}")
        return num_frames, frame_time_s

    def read_values(self, num_frames: int) -> np.ndarray:
        num_channels = sum(map(len, self.channels))
        rows = []
        for _ in range(num_frames):
            try:
                words = self.words()
            except BvhError as error:
                raise self.error(f"expected {num_frames} frames, found {len(rows)}") from error
            rows.append(self.numbers(words, num_channels, f"frame {len(rows)}"))
        if any(line.strip() for line in self.lines[self.next_line :]):
            self.next_line += 1
            raise self.error(f"more lines than the {num_frames} frames that the file announces")
        return np.asarray(rows, dtype=np.float64).reshape(num_frames, num_channels)
